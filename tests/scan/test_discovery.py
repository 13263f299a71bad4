from __future__ import annotations

import numpy as np
import pytest
from breasts import write_breast, write_ply

from brafit.cloud import FORMATS
from brafit.errors import InputError
from brafit.samples import sample_paths
from brafit.scan import find_scans, scan_names


@pytest.fixture
def folder(tmp_path):
    """Two usable breasts, a cloud without a landmark file, and things that are no clouds."""
    for name in ("b", "a"):
        write_breast(tmp_path / "set", name)
    (tmp_path / "set" / "alone.ply").write_bytes((tmp_path / "set" / "a.ply").read_bytes())
    (tmp_path / "set" / "notes.txt").write_text("no cloud")
    return tmp_path / "set"


def names(paths) -> list[str]:
    return [path.name for path in paths]


def test_the_bundled_scans_are_the_default():
    assert find_scans() == find_scans("samples") == sample_paths()
    assert len(find_scans()) == 3


def test_a_folder_means_clouds_with_landmarks(folder):
    assert names(find_scans(str(folder))) == ["a.ply", "b.ply"]


def test_a_pattern_keeps_clouds_without_landmarks(folder):
    assert names(find_scans(f"{folder}/*")) == ["a.ply", "alone.ply", "b.ply"]
    assert names(find_scans(f"{folder}/[ab].ply")) == ["a.ply", "b.ply"]
    assert names(find_scans(f"{folder.parent}/*")) == ["a.ply", "b.ply"]
    assert names(find_scans(f"{folder.parent}/**/al*.ply")) == ["alone.ply"]


def test_tables_found_in_passing_need_a_landmark_file_or_their_extension(folder):
    (folder / "c.csv").write_text("x,y,z")
    assert "c.csv" not in names(find_scans(f"{folder}/*"))
    assert names(find_scans(f"{folder}/*.csv")) == ["c.csv"]
    (folder / "c.json").write_text("{}")
    assert "c.csv" in names(find_scans(f"{folder}/*"))


def test_a_named_file_is_kept_whatever_it_is(folder):
    for name in ("alone.ply", "notes.txt", "missing.ply"):
        assert find_scans(str(folder / name)) == [folder / name]


def test_several_are_joined_once_each(folder):
    entries = [str(folder / "b.ply"), f"{folder}/*.ply", str(folder), "samples"]
    assert names(find_scans(entries)) == names(sorted([*sample_paths(), *find_scans(f"{folder}/*.ply")]))


def test_a_fruitless_entry_among_others_is_reported_later(folder):
    assert "nowhere" in names(find_scans([str(folder), "nowhere"]))


def test_relative_paths_start_from_the_working_folder(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    assert names(find_scans("set")) == ["a.ply", "b.ply"]


def test_nothing_found_is_an_error(folder, tmp_path):
    formats = ", ".join(sorted(FORMATS))
    (tmp_path / "empty").mkdir()
    write_ply(tmp_path / "bare.ply", np.zeros((1, 3)))
    for entry, expected in {
        f"{folder}/*.pcd": "the pattern matches no cloud. "
        f"Name a folder, a pattern or a file of {formats}, or 'samples'.",
        "nowhere": f"there is no such file or folder. Name a folder, a pattern or a file of {formats}, or 'samples'.",
        f"{tmp_path}/empty": f"the folder holds no cloud. Name a folder with clouds ({formats}).",
        f"{tmp_path}": "the folder has no cloud with a landmark file, and 1 without. "
        "Write NAME.json beside NAME.ply, see brafit/landmarks/landmarks.schema.json.",
    }.items():
        with pytest.raises(InputError) as caught:
            find_scans(entry)
        assert str(caught.value) == f"{entry}: {expected}"
    (tmp_path / "bare.ply").unlink()
    with pytest.raises(InputError, match=r"the folder holds no cloud\. Name a folder inside it: set\."):
        find_scans(str(tmp_path))
    with pytest.raises(InputError, match="the list is empty"):
        find_scans([])


def test_names_are_unique():
    paths = ["x/a.ply", "x/b.ply", "y/b.ply", "x/c.ply", "x/c.pcd", "z/x/b.ply"]
    assert scan_names(paths) == ["a", "x_b", "y_b", "c_ply", "c_pcd", "x_b_2"]
    assert scan_names(["x/a.ply", "x/b.ply"]) == ["a", "b"]
    assert scan_names(["x/c.ply", "x/c.pcd"]) == ["c_ply", "c_pcd"]
    assert len({name.lower() for name in scan_names(["x/e.ply", "y/E.ply", "y/x_e.ply"])}) == 3
