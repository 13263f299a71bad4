from __future__ import annotations

import numpy as np
import pytest
from breasts import write_breast, write_ply

from brafit.cloud import FORMATS
from brafit.errors import InputError
from brafit.landmarks import landmarks_path
from brafit.samples import sample_paths
from brafit.scan import find_scans, load_scan, passed_over, scan_names


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


def test_links_to_one_cloud_are_scans_each(folder):
    for name in ("left", "right"):
        (folder / f"{name}.ply").symlink_to(folder / "alone.ply")
        (folder / f"{name}.json").write_text("{}")
    assert names(find_scans(str(folder))) == ["a.ply", "b.ply", "left.ply", "right.ply"]
    assert names(find_scans([str(folder / "left.ply"), f"{folder}/../{folder.name}/left.ply"])) == ["left.ply"]


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
        f"Mark them with brafit-mark {tmp_path}; for torsos scan.propose=true proposes landmarks.",
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


def test_hidden_files_are_passed_over(folder):
    for name in ("._a", ".hidden"):
        (folder / f"{name}.ply").write_bytes(b"\0\5\26\7Mac OS X")
        (folder / f"{name}.json").write_bytes(b"\0\5\26\7Mac OS X")
    assert names(find_scans(folder)) == ["a.ply", "b.ply"]
    assert names(find_scans(folder, propose=True)) == ["a.ply", "alone.ply", "b.ply"]
    assert names(find_scans(f"{folder}/*.ply")) == ["a.ply", "alone.ply", "b.ply"]
    assert passed_over(folder)[0].startswith(f"{folder}: 1 cloud without landmark file passed over (alone.ply)")
    assert names(find_scans(folder / "._a.ply")) == ["._a.ply"], "as it is named"


def test_with_proposals_a_folder_means_every_cloud(folder):
    for name in ("b", "alone"):
        np.savetxt(folder / f"{name}.csv", np.zeros((1, 3)))
    assert names(find_scans(folder, propose=True)) == ["a.ply", "alone.ply", "b.csv", "b.ply"]
    assert passed_over(folder, propose=True) == [
        f"{folder}: 2 tables without landmark file passed over (alone.csv, notes.txt): "
        f"to take such, name them: {folder}/*.csv, {folder}/*.txt"
    ]
    for path in folder.glob("*.json"):
        path.unlink()
    assert names(find_scans(folder, propose=True)) == ["a.ply", "alone.ply", "b.ply"]
    for path in folder.glob("*.ply"):
        path.unlink()
    with pytest.raises(
        InputError, match=r"holds 3 tables that may be clouds .* Write landmark files .*, or name them: "
    ):
        find_scans(folder, propose=True)


COMPOSED, DECOMPOSED = "Br\u00fcste", "Bru\u0308ste"


@pytest.mark.parametrize(("cloud", "marks"), [(COMPOSED, DECOMPOSED), (DECOMPOSED, COMPOSED)])
def test_letters_may_be_composed_or_decomposed(tmp_path, cloud, marks):
    """What looks the same is the same: cloud and landmark file, and what is typed for either."""
    folder = tmp_path / DECOMPOSED
    path = write_breast(folder, "a").rename(folder / f"{cloud}.ply")
    (folder / "a.json").rename(folder / f"{marks}.json")
    assert landmarks_path(path) == folder / f"{marks}.json"
    assert load_scan(path, points=100).side == "left"
    for typed in (COMPOSED, DECOMPOSED):
        for entry in (
            folder / f"{typed}.ply",
            tmp_path / typed,
            tmp_path / typed / f"{typed.partition('ste')[0]}*.ply",
        ):
            assert find_scans(entry) == [path], entry
    assert scan_names([path]) == [COMPOSED]
    assert scan_names([f"{COMPOSED}.ply", f"x/{DECOMPOSED}.ply"])[1] == f"x_{COMPOSED}"


OWN_FILES = (
    "summary.csv Summary.Parquet summary_03_of_16.csv index.html INDEX.HTML sweep sweep.csv .hydra .nest errors.log "
    "config.yaml tensorboard TensorBoard patterns.svg patterns_sheet.pdf con"
)


@pytest.mark.parametrize("stem", OWN_FILES.split())
def test_names_of_a_runs_own_files_are_no_scans(stem):
    assert scan_names([f"a/{stem}.ply", "a/b.ply"]) == [f"scan_{stem}", "b"]
    assert scan_names([f"a/{stem}.ply", f"b/scan_{stem}.ply"]) == [f"scan_{stem}", f"scan_{stem}_2"]


def test_names_that_cannot_be_folders_are_changed():
    long = "\u00e4" * 120
    paths = ["B\udcfcste.ply", "a\nb.ply", f"{long}.ply", "c .ply"]
    assert scan_names(paths) == ["B\ufffdste", "a_b", long[:90], "c"]
    assert scan_names(["x.ply", "v.ply", "w.ply"], ["", "v1.2", "../x"]) == ["x", "v1.2", "scan_.._x"]
    assert scan_names(["Anna.ply", "b.ply"], ["", "Anna"]) == ["Anna_2", "Anna"]
