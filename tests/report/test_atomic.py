import pytest

from brafit.atomic import replacing, write_bytes, write_text


def test_folders_are_made_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "a" / "b" / "file.txt"
    write_text(path, "Ü\n")
    assert path.read_bytes() == "Ü\n".encode()
    assert list(path.parent.iterdir()) == [path]


def test_an_error_leaves_the_old_file_whole(tmp_path):
    path = tmp_path / "file.bin"
    write_bytes(path, b"old")

    def break_off() -> None:
        with replacing(path) as temporary:
            temporary.write_bytes(b"half of the n")
            assert path.read_bytes() == b"old"
            assert temporary.parent == path.parent
            assert temporary.suffix == ".bin"
            raise RuntimeError

    with pytest.raises(RuntimeError):
        break_off()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_longest_possible_names(tmp_path):
    path = tmp_path / ("x" * 251 + ".txt")
    write_text(path, "content")
    assert path.read_text() == "content"


def test_files_can_be_read_by_others_as_the_umask_says(tmp_path):
    plain, written = tmp_path / "plain", tmp_path / "written"
    plain.write_text("x")
    write_text(written, "x")
    assert plain.stat().st_mode == written.stat().st_mode
