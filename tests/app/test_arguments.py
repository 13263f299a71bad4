"""The command line: paths without `scans=`, letters and signs that Hydra's grammar does not know."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser

from brafit.cli.arguments import OPTIONS, WITH_VALUE, prepared
from brafit.errors import ConfigError
from brafit.settings import quoting
from brafit.settings.checks import sources
from brafit.settings.compose import from_settings
from brafit.settings.quoting import readable, unquoted


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def value(setting: str):
    """What Hydra reads."""
    return OverridesParser.create().parse_override(readable(setting)).value()


@pytest.mark.parametrize(
    "text",
    [
        "Müller.ply", "Größe 75", "日本/*.ply", "ΩЖ", "a=b.ply", "a(1).ply", "a[1].ply", "Anna's.ply", "x{1}",
        "a#b&c;d!", "1e3", "1_000", "2024", "true", "½", "weiß_${now:%Y}",
    ],
)  # fmt: skip
def test_a_text_is_read_as_it_stands(text: str) -> None:
    assert str(value(f"out={text}")) == text


@pytest.mark.parametrize(
    "setting",
    [
        "scans='Müller.ply'", 'scans="Müller.ply"', "scans=[a.ply,b.ply]", "cup.terms=4,6,8", "cup=strips,frames",
        "cup.terms=range(2,5)", "solver.stages=[{optimiser:adam,steps:3}]", "scan.points=null", "pattern.size=75B",
        "out=${now:%Y}/x", "cup.terms=8", "dataset.manifest=null", "scans='Müller", "cup.terms=[1,2", "out=",
        "nonsense",
    ],
)  # fmt: skip
def test_what_can_be_read_or_is_broken_stays_as_it_is(setting: str) -> None:
    assert readable(setting) == setting


def test_a_file_that_begins_like_a_setting_is_a_file() -> None:
    assert prepared(["scan.ply"]) == ["scans=scan.ply"]


def test_items_are_quoted_one_by_one() -> None:
    assert value("scans=[Müller (1).ply, b.ply]") == ["Müller (1).ply", "b.ply"]
    sweep = OverridesParser.create().parse_override(readable("scans=Müller.ply,b.ply"))
    assert [unquoted(text) for text in sweep.sweep_string_iterator()] == ["Müller.ply", "b.ply"]
    assert readable("cup.terms=choice(ü,3)") == "cup.terms=choice('ü',3)"


@pytest.mark.parametrize("name", ["a,b.ply", "[x].ply", "3", "null", "a ${b}.ply", "'q'.ply", "a\\,b.ply"])
def test_a_path_that_exists_is_taken_literally(folder: Path, name: str) -> None:
    (folder / name).touch()
    for setting in ([f"scans={name}"], prepared([name])):
        assert sources(from_settings([*setting, "out=unused"])) == [name]


def test_a_home_folder_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.setenv("USERPROFILE", "/home/me")
    assert value("out=~/results") == "/home/me/results"


def test_backslashes_are_part_of_paths_where_they_separate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quoting, "BACKSLASHES", True)
    for path in (r"C:\scans\a.ply", r"\\server\share\x", r"C:\Users\Müller (1)\[a]"):
        assert value(f"scans={path}") == path


def test_words_that_are_no_settings_are_scans(folder: Path) -> None:
    (folder / "cup.panels=2").mkdir()  # as a sweep names a job's folder
    (folder / "a=b.ply").touch()
    assert prepared(["FOLDER", "cup.panels=2"]) == ["cup.panels=2", "scans=FOLDER"]
    assert prepared(["a=b.ply", "Größe.ply", "x.ply"]) == ["scans=['a=b.ply','Größe.ply',x.ply]"]
    assert prepared(["--cfg", "job", "F", "-m", "cup.terms=2,3"]) == ["cup.terms=2,3", "scans=F", "--cfg", "job", "-m"]
    assert prepared(["--", "-x.ply", "--cfg"]) == ["scans=[-x.ply,--cfg]"]
    assert prepared([]) == []


def test_options_with_values_are_those_of_hydra() -> None:
    known = [action for action in get_args_parser()._actions if action.option_strings and action.nargs is None]
    assert {name for action in known for name in action.option_strings} == WITH_VALUE
    every = {name for action in get_args_parser()._actions for name in action.option_strings}
    assert {name for name in every if name.startswith("--")} == {name for name in OPTIONS if name.startswith("--")}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["FOLDER", "scans=x"], "FOLDER: there is no such file or folder"),
        ([".", "scans=x"], "both name scans"),
        (["restarts"], "restarts=VALUE"),
        (
            ["cup.panels", "3"],
            "cup.panels: there is no such file or folder; a setting needs its value: cup.panels=VALUE",
        ),
        (["cup.panels:3"], "a setting needs its value: cup.panels=3"),
        (["--out", "x"], "write out=VALUE"),
        (["--panels=3"], "--panels=3: settings have no dashes, write cup.panels=3"),
        (["--cup.panels=3"], "settings have no dashes, write cup.panels=3"),
        (["--pannels", "3"], "settings have no dashes, write cup.panels=VALUE"),
        (["-panels", "3"], "settings have no dashes, write cup.panels=VALUE"),
        (["cup.panels", "=", "3"], "a setting is written without spaces: key=value"),
        (["--zzz=3"], "--zzz=3: there is no such option"),
        (["+my.key=1"], "unknown setting '+my.key'; allowed: scans"),
        (["++cup.pannels=1"], "unknown setting '++cup.pannels'; did you mean cup.panels?"),
        (["+cup.panels=3"], "did you mean cup.panels=3?"),
        (["~scan"], "unknown setting '~scan': settings cannot be taken away; did you mean scan=VALUE?"),
        (["~scam"], "unknown setting '~scam'; did you mean scan?"),
        (["Größe=3"], "unknown setting 'Größe'; allowed: scans"),
        (["cup.größe=3"], "allowed in cup: panels"),
    ],
)
def test_what_is_refused(arguments: list[str], words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        prepared(arguments)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_two_plus_signs_change_what_exists() -> None:
    assert from_settings(["++cup.panels=3", "out=unused"]).cup.panels == 3
