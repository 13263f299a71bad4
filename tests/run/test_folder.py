"""Folders that results cannot be written to: one line says why."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

import pytest

from brafit.errors import ConfigError
from brafit.run.folder import is_about_writing, make_writable


def refusal(out: Path) -> str:
    with pytest.raises(ConfigError) as refused:
        make_writable(out)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_a_folder_is_made_and_left_empty(tmp_path: Path) -> None:
    make_writable(tmp_path / "a" / "b")
    make_writable(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []


def test_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert f"{tmp_path / 'file'} is in the way: it is no folder" in refusal(tmp_path / "file")
    assert f"{tmp_path / 'file'} is no folder, so nothing can be in it" in refusal(tmp_path / "file" / "x" / "y")


def test_a_path_that_is_too_long(tmp_path: Path) -> None:
    line = refusal(tmp_path / ("x" * 5000))
    assert "the path is too long; take a shorter out" in line
    assert len(line) < 250


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="whoever may do all is refused nothing")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    assert f"no permission to write in {tmp_path / 'locked'}" in refusal(tmp_path / "locked" / "out")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.ENOSPC, "the disk of {} is full; make room"),
        (errno.EACCES, "there is no permission to write in {}"),
        (errno.EROFS, "{} can only be read"),
        (errno.EIO, "no folder can be made or written to there"),
    ],
)
def test_what_the_system_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, words: str) -> None:
    def fails(**_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(tempfile, "TemporaryFile", fails)
    assert words.format(tmp_path) in refusal(tmp_path / "out")
    assert list(tmp_path.iterdir()) == [], "the folder is left"


def test_which_errors_are_about_writing() -> None:
    assert is_about_writing(OSError(errno.ENOSPC, "full"))
    assert not is_about_writing(OSError(errno.ENOENT, "gone"))
    assert not is_about_writing(ValueError("x"))
