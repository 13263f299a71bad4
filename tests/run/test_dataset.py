"""What a run works on: files, tables of scans, shards of them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest

from brafit.errors import ConfigError, InputError
from brafit.run.dataset import dataset, read_manifest, shard_of
from brafit.samples import sample_paths


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Seven scans."""
    for k in range(7):
        for suffix in (".ply", ".json"):
            shutil.copy(sample_paths()[0].with_suffix(suffix), tmp_path / f"s{k}{suffix}")
    return tmp_path


def test_both_sides_share_one_file(folder: Path) -> None:
    refs, _ = dataset([folder], side="both")
    assert [ref.names for ref in refs[:2]] == [("s0_left", "s0_right"), ("s1_left", "s1_right")]
    assert [ref.positions for ref in refs[:2]] == [(0, 1), (2, 3)]


def test_a_side_is_not_called_like_another_scan(folder: Path) -> None:
    (folder / "list.csv").write_text("cloud,side\ns0.ply,both\ns0_left.ply,left\n")
    refs, _ = dataset([], manifest=str(folder / "list.csv"))
    assert [ref.names for ref in refs] == [("s0_left", "s0_right"), ("s0_left_2",)]


def test_with_proposals_clouds_without_landmarks_are_taken(folder: Path) -> None:
    (folder / "s3.json").unlink()
    refs, notes = dataset([folder])
    assert "s3" not in {name for ref in refs for name in ref.names}
    assert "1 cloud without landmark file" in notes[0]
    refs, notes = dataset([folder], propose=True)
    assert [ref.names for ref in refs] == [(f"s{k}",) for k in range(7)]
    assert notes == []


@pytest.mark.parametrize("count", [1, 3, 7, 16])
def test_shards_part_a_dataset_with_names_and_places_unchanged(folder: Path, count: int) -> None:
    (folder / "other").mkdir()
    for suffix in (".ply", ".json"):
        shutil.copy(folder / f"s3{suffix}", folder / "other" / f"s3{suffix}")
    whole, _ = dataset([folder, folder / "other"])
    parts = [ref for k in range(count) for ref in dataset([folder, folder / "other"], shard=f"{k + 1}/{count}")[0]]
    assert sorted(parts, key=lambda ref: ref.positions) == whole
    assert len({name for ref in whole for name in ref.names}) == 8


@pytest.mark.parametrize("text", ["0/4", "5/4", "3", "a/b", "1/0", "-1/2"])
def test_shards_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="K/N"):
        shard_of(text)


TABLE = [
    {"cloud": "s1.ply", "side": "left", "cup.panels": "3", "age": "31"},
    {"cloud": "s0.ply", "side": "", "cup.panels": "", "age": "40"},
    {"cloud": "s2.ply", "side": "both", "cup.panels": "", "age": ""},
]


def csv_table(folder: Path, delimiter: str = ",", bom: str = "") -> Path:
    lines = [delimiter.join(TABLE[0]), *(delimiter.join(row.values()) for row in TABLE)]
    (folder / "list.csv").write_text(bom + "\n".join(lines) + "\n", encoding="utf-8")
    return folder / "list.csv"


def parquet_table(folder: Path) -> Path:
    rows = [{**row, "cup.panels": int(row["cup.panels"]) if row["cup.panels"] else None} for row in TABLE]
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), folder / "list.parquet")
    return folder / "list.parquet"


@pytest.mark.parametrize("kind", ["csv", "semicolons", "parquet"])
def test_a_table_names_scans_and_their_own_settings(folder: Path, kind: str) -> None:
    file = (
        parquet_table(folder)
        if kind == "parquet"
        else csv_table(folder, ";" if kind == "semicolons" else ",", "\ufeff")
    )
    refs, notes = dataset(["not looked at"], manifest=str(file))
    assert [ref.path.name for ref in refs] == ["s1.ply", "s0.ply", "s2.ply"], "the table's order"
    assert all(ref.path.is_file() for ref in refs), "relative to the table"
    assert [ref.overrides for ref in refs] == [("cup.panels=3",), (), ()]
    assert [ref.sides for ref in refs] == [("left",), (None,), ("left", "right")]
    assert [ref.positions for ref in refs] == [(0,), (1,), (2, 3)]
    assert "age" in notes[0]


def test_names_of_a_table_are_taken(folder: Path) -> None:
    (folder / "list.csv").write_text("cloud,name\ns0.ply,Anna\ns0.ply,\n")
    refs, _ = dataset([], manifest=str(folder / "list.csv"))
    assert [ref.names for ref in refs] == [("Anna",), ("s0",)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("file,side\ns0.ply,left\n", "no column 'cloud'"),
        ("cloud,side\n,left\n", "row 1: the cell 'cloud' is empty"),
        ("cloud,side\ns0.ply,top\n", "side 'top'"),
        ("cloud\n", "no row"),
        ("cloud,name\ns0.ply,A\ns1.ply,A\n", "'A' stands twice"),
        (b"cloud\n\xff\xfe\xff\n", "is no CSV file"),
        (None, "no such table"),
    ],
)
def test_tables_that_cannot_be_used_say_why(tmp_path: Path, content: str | bytes | None, words: str) -> None:
    file = tmp_path / "list.csv"
    if isinstance(content, str):
        file.write_text(content)
    elif content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=words):
        dataset([], manifest=str(file))


def test_a_damaged_parquet_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "list.parquet").write_bytes(b"PAR1 and nothing more")
    with pytest.raises(InputError, match="is no Parquet file"):
        read_manifest(tmp_path / "list.parquet")
