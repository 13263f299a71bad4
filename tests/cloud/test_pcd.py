"""PCD as old and new programs write it: what a header may leave out, and images whose pixels mostly see nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from breasts import cup_frame_points

from brafit.cloud import read_cloud
from brafit.errors import InputError

POINTS = cup_frame_points(150)
HEADER = {
    "VERSION": "0.7",
    "FIELDS": "x y z",
    "SIZE": "4 4 4",
    "TYPE": "F F F",
    "COUNT": "1 1 1",
    "WIDTH": "150",
    "HEIGHT": "1",
    "VIEWPOINT": "0 0 0 1 0 0 0",
    "POINTS": "150",
}


def same(points: np.ndarray) -> None:
    """They are `POINTS`, in the single precision of the file."""
    np.testing.assert_allclose(points, POINTS, rtol=1e-7)


def write(path: Path, points: np.ndarray, coding: str = "binary", drop: str = "", **changes: str) -> Path:
    """A PCD of these points; header lines dropped or changed, `old=new` also renames one."""
    header = {key: value for key, value in (HEADER | changes).items() if key not in drop.split()}
    lines = [f"{key} {value}" for key, value in header.items()]
    table = points.astype("<f4")
    ascii = "\n".join(" ".join(map(str, row)) for row in table).encode()
    body = table.tobytes() if coding.lower() == "binary" else ascii
    path.write_bytes("\n".join([*lines, f"DATA {coding}", ""]).encode() + body)
    return path


@pytest.mark.parametrize("coding", ["binary", "ascii"])
@pytest.mark.parametrize(
    ("drop", "changes"),
    [
        ("POINTS", {}),
        ("WIDTH HEIGHT", {}),
        ("HEIGHT POINTS", {}),
        ("COUNT VIEWPOINT", {"VERSION": ".6"}),
        ("FIELDS COUNT VIEWPOINT POINTS", {"VERSION": ".5", "COLUMNS": "x y z"}),
        ("FIELDS COUNT SIZE TYPE WIDTH HEIGHT", {"VERSION": ".5", "COLUMNS": "x y z"}),
        ("", {"# written by hand": "", "FIELDS": "X Y Z", "TYPE": "f f f"}),
        ("", {"FIELDS": "x y z # the position", "WIDTH": "15", "HEIGHT": "10"}),
    ],
)
def test_headers_of_every_age_are_read(tmp_path: Path, coding: str, drop: str, changes: dict[str, str]) -> None:
    cloud = read_cloud(write(tmp_path / "a.pcd", POINTS, coding, drop, **changes))
    same(cloud.points)


def test_case_and_comments_do_not_count(tmp_path: Path) -> None:
    path = write(tmp_path / "a.pcd", POINTS)
    head, _, body = path.read_bytes().partition(b"DATA binary\n")
    path.write_bytes(b"# .PCD v0.7\r\n" + head.lower().replace(b"\n", b"\r\n# more\r\n") + b"data BINARY\r\n" + body)
    np.testing.assert_array_equal(read_cloud(path).points, POINTS)


def test_a_field_of_no_values_takes_no_place(tmp_path: Path) -> None:
    fields = {"FIELDS": "empty x y z", "SIZE": "4 4 4 4", "TYPE": "U F F F", "COUNT": "0 1 1 1"}
    for coding in ("binary", "ascii"):
        same(read_cloud(write(tmp_path / "a.pcd", POINTS, coding, **fields)).points)
    write(tmp_path / "a.pcd", POINTS, COUNT="0 1 1")
    with pytest.raises(InputError, match="its field x has COUNT 0"):
        read_cloud(tmp_path / "a.pcd")


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "1.#QNAN"])
@pytest.mark.parametrize("coding", ["binary", "ascii"])
def test_an_image_may_see_little(tmp_path: Path, coding: str, word: str) -> None:
    """Most pixels of a depth image see the background: they are no points."""
    image = np.full((30 * 20, 3), np.nan)
    image[::4] = POINTS
    path = write(tmp_path / "a.pcd", image, coding, WIDTH="30", HEIGHT="20", POINTS="600")
    path.write_bytes(path.read_bytes().replace(b"nan", word.encode()))
    cloud = read_cloud(path)
    same(cloud.points)
    assert cloud.dropped == 450
    np.save(tmp_path / "a.npy", image.reshape(30, 20, 3))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy").points, POINTS)
    row = write(tmp_path / "b.pcd", image, coding, WIDTH="600", POINTS="600")
    with pytest.raises(InputError, match="450 of 600 points have coordinates that are NaN"):
        read_cloud(row)


def test_points_in_columns_are_refused_with_the_cause(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS.T)
    with pytest.raises(
        InputError, match=r"its array is 3 x 150: a point a column, .*\. Save it transposed, as n x 3\."
    ):
        read_cloud(tmp_path / "a.npy")


def test_arrays_by_any_case_and_apart(tmp_path: Path) -> None:
    x, y, z = POINTS.T
    np.savez(tmp_path / "a.npz", X=x, Y=y, Z=z)
    np.savez(tmp_path / "b.npz", Points=POINTS, colours=POINTS)
    for name in ("a.npz", "b.npz"):
        np.testing.assert_array_equal(read_cloud(tmp_path / name).points, POINTS)
