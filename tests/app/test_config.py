"""Settings: every override of the command line composes, and every wrong one is refused in one line that helps."""

from __future__ import annotations

import inspect
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any

import pytest
import yaml
from hydra import compose, initialize_config_module
from hydra.utils import get_class
from omegaconf import DictConfig, OmegaConf

from brafit.errors import ConfigError
from brafit.fitting.anneal import OPTIMISERS
from brafit.fitting.loss import point_loss
from brafit.geometry.ritz import BASES
from brafit.scan import Preparation, load_scan
from brafit.settings.checks import check, sources
from brafit.settings.compose import explain, from_settings, plain_composed, register

CONF = Path(__file__).parents[2] / "conf"


def composed(*overrides: str) -> DictConfig:
    register()
    with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
        return compose("config", overrides=list(overrides))


def refusal(*overrides: str) -> str:
    """The line that a user gets."""
    try:
        check(composed(*overrides))
    except ConfigError as error:
        return str(error)
    except Exception as error:
        return explain(error, list(overrides))
    raise AssertionError(f"{overrides} was accepted")


def test_defaults_pass_their_own_checks() -> None:
    config = composed()
    check(config)
    assert sources(config) == ["samples"]
    assert (config.cup.panels, config.cup.terms, config.scan.points) == (2, 14, 2000)


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("scans=some/folder", "scans", "some/folder"),
        ("scans=some/*.ply", "scans", "some/*.ply"),
        ("scans=[a.ply,b.ply]", "scans", ["a.ply", "b.ply"]),
        ("scans='a[1] b.ply'", "scans", "a[1] b.ply"),
        ("cup.panels=3", "cup.panels", 3),
        ("cup.terms=8", "cup.terms", 8),
        ("cup=frames", "cup._target_", "brafit.cup.FramesCup"),
        ("solver=anneal", "solver._target_", "brafit.fitting.Anneal"),
        ("solver.stages.0.steps=7", "solver.stages.0.steps", 7),
        ("condition.points=l1", "condition.points", "l1"),
        ("scan.points=500", "scan.points", 500),
        ("scan.points=null", "scan.points", None),
        ("scan.outliers=null", "scan.outliers", None),
        ("scan.wire=36", "scan.wire", "36"),
        ("scan.wire=36/short", "scan.wire", "36/short"),
        ("scan.wire=harriet:36", "scan.wire", "harriet:36"),
        ("scan.wire=france:36/short", "scan.wire", "france:36/short"),
        ("device=cpu", "device", "cpu"),
        ("out=elsewhere", "out", "elsewhere"),
        ("dtype=float32", "dtype", "float32"),
        ("restarts=4", "restarts", 4),
        ("batch=2", "batch", 2),
        ("threads=1", "threads", 1),
        ("experiment=quick", "restarts", 1),
        ("pattern.formats=[svg,pdf]", "pattern.formats", ["svg", "pdf"]),
        ("pattern.allowance.wire=8", "pattern.allowance.wire", 8.0),
        ("pattern.ease.width=-5", "pattern.ease.width", -5.0),
        ("pattern=default", "pattern._target_", "brafit.pattern.PatternOptions"),
    ],
)
def test_overrides_compose(override: str, key: str, value: Any) -> None:
    config = composed(*within(override))
    check(config)
    for part in key.split("."):
        config = config[int(part) if part.isdigit() else part]
    assert config == value


def within(override: str) -> list[str]:
    """The override, together with the cup and solver whose keys these tests know, unless it chooses such a group."""
    chooses = override.startswith(("cup=", "solver=", "experiment="))
    return [override] if chooses else ["cup=frames", "solver=anneal", override]


def test_an_override_beats_an_experiment() -> None:
    assert composed("experiment=quick", "scan.points=77").scan.points == 77


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("cup.pannels=3", ["cup.pannels", "did you mean cup.panels?", "terms"]),
        ("scan.foo=1", ["scan.foo", "allowed in scan", "outliers"]),
        ("devise=cpu", ["devise", "did you mean device?"]),
        ("cup=framez", ["cup=framez", "allowed: frames, strips"]),
        ("experiment=slow", ["experiment=slow", "quick"]),
        ("cup.panels=two", ["cup.panels=two", "whole number"]),
        ("cup.panels=0", ["cup.panels=0", "from 1 to 8"]),
        ("cup.basis=sine", ["cup.basis=sine", "one of cosine"]),
        ("condition.neckline=-1", ["condition.neckline=-1", "at least 0"]),
        ("solver.stages.0.steps=-7", ["solver.stages.0.steps=-7", "at least 0"]),
        ("solver.stages.1.optimiser=sgd", ["solver.stages.1.optimiser=sgd", "one of adam, lbfgs"]),
        ("scan.points=3", ["scan.points=3", "at least 10"]),
        ("scan.wire=37", ["scan.wire=37", "nobody sells", "harriet 30 to 58"]),
        ("scan.wire=acme:36", ["scan.wire=acme:36", "no maker acme is known", "orange 30 to 52"]),
        ("dtype=half", ["dtype=half", "float64", "float32"]),
        ("device=tpu", ["device=tpu", "cpu, cuda"]),
        ("device=cuda:77", ["device=cuda:77", "device=cpu"]),
        ("batch=0", ["batch=0", "at least 1"]),
        ("pattern.allowance.wire=-1", ["pattern.allowance.wire=-1", "from 0 to 100"]),
        ("pattern.allowance.ridges=6", ["did you mean pattern.allowance.ridge?", "wire, ridge, upper"]),
        ("pattern.allowance.seam=10", ["did you mean pattern.allowance.ridge?"]),
        ("units=inch", ["did you mean ", "scan.units", " or ", "pattern.units"]),
        ("pattern.allowance=8", ["pattern.allowance=8", "pattern.allowance.wire=8", "pattern.allowance.upper=8"]),
        ("pattern.ease=null", ["pattern.ease=null", "pattern.ease.width=VALUE"]),
        ("sinks.table=3", ["sinks.table.parquet=3"]),
        ("restarts=null", ["restarts=null", "must have a value"]),
        ("scan=3", ["scan=3", "allowed: default"]),
        ("panels=3", ["unknown setting 'panels'", "did you mean cup.panels?"]),
        ("cup.panels.x=3", ["unknown setting 'cup.panels.x'", "did you mean cup.panels?"]),
        ("pattern.alowance.wire=3", ["did you mean pattern.allowance?"]),
        ("hydra/launcher=foo", ["hydra/launcher=foo", "basic"]),
        ("pattern.paper=a0", ["pattern.paper=a0", "a4, letter"]),
        ("pattern.units=cm", ["pattern.units=cm", "mm, inch"]),
        ("scans=null", ["scans", "file", "folder"]),
        ("scans=[]", ["scans", "file", "folder"]),
        ("scans=3", ["scans=3", "file", "folder"]),
        ("scans=a[1].ply", ["scans=a[1].ply", "quotes"]),
        ("nonsense", ["nonsense", "key=value"]),
        ("cup.terms=4,6", ["cup.terms=4,6", "-m"]),
        ("pattern.formats=pdf,svg", ["-m", "or write a list: pattern.formats=[pdf,svg]"]),
        ("scans=a.ply,b.ply", ["-m", "or write a list: scans=[a.ply,b.ply]"]),
        ("out=a,b", ["several values; add -m", "or quote it, if the comma is a part of it: \"out='A,B'\""]),
        ("pattern.allowance.wire=6,5", ["add -m", "or write a decimal point: pattern.allowance.wire=6.5"]),
        ("pattern.allowance.wire=6mm", ["must be a number, without 'mm': lengths are in mm"]),
        ("pattern.allowance.wire=0.6 cm", ["must be a number, without 'cm': lengths are in mm"]),
        ("pattern.ease.width=5%", ["pattern.ease.width=5%: must be a number, without '%'"]),
        ("Cup.Panels=3", ["unknown setting 'Cup.Panels'; did you mean cup.panels?"]),
        ("cup.panels=[2,3]", ["cup.panels=[2, 3]: must be auto or a whole number from 1 to 8"]),
        ("condition.points=[l1,l2]", ["condition.points=['l1', 'l2']: must be one of l2, l1, robust"]),
        ("pattern.cloth.stretch=[1,2]", ["pattern.cloth.stretch=[1, 2]: must be a number"]),
        ("pattern.pair=[true,false]", ["pattern.pair=[True, False]: must be true or false, not a list"]),
        ("pattern.pair=ja", ["pattern.pair=ja: must be true or false"]),
        ("cup.panels=2.5", ["cup.panels=2.5: must be auto or a whole number"]),
        ("cup.panels='3'", ["cup.panels='3': must be auto or a whole number"]),
        ("cup.panels=${nothing}", ["cup.panels=${nothing}: its value cannot be taken from elsewhere", "'nothing'"]),
        ("cup.panels=range(2,4)", ["cup.panels=range(2,4): several values; add -m"]),
        ("cup.panels=choice(2,3)", ["cup.panels=choice(2,3): several values; add -m"]),
        ("cup/panels=3", ["unknown setting 'cup/panels'; did you mean cup.panels?"]),
        ("solver@foo=lm", ["unknown setting 'solver@foo'; did you mean solver=VALUE?"]),
        ("scan.outliers=0", ["scan.outliers=0.0: must be above 0, or null"]),
        ("scan.outliers=-3", ["scan.outliers=-3.0: must be above 0, or null"]),
        ("condition.fairness=inf", ["condition.fairness=inf: must be a finite number"]),
        ("condition.fairness=nan", ["condition.fairness=nan: must be a finite number"]),
        ("cup.tolerance=-0.1", ["cup.tolerance=-0.1: must be at least 0"]),
        ("scan.mesh_points=0", ["scan.mesh_points=0: must be from 1000 to 20000000"]),
        ("pattern.paper=[a4,a3]", ["pattern.paper=['a4', 'a3']: must be one text, not a list"]),
    ],
)
def test_wrong_settings_are_refused_in_one_line(override: str, words: list[str]) -> None:
    line = refusal(*within(override))
    assert "\n" not in line
    for word in words:
        assert word in line


def test_words_to_choose_from_may_have_capitals() -> None:
    """Americans write Letter; what is kept is one spelling, so that it makes no other run."""
    config = from_settings(["pattern.paper=Letter", "scan.side=LEFT", "out=unused"])
    assert (config.pattern.paper, config.scan.side) == ("letter", "left")


@pytest.mark.parametrize("override", ["cup.panels=2,3", "pattern.paper=a4,letter"])
def test_a_list_is_advised_only_where_one_is_taken(override: str) -> None:
    line = refusal(*within(override))
    assert line.endswith("several values; add -m to run each in turn")


def test_unknown_key_names_the_keys_of_the_chosen_group() -> None:
    line = refusal("cup=frames", "cup.foo=1")
    assert "panels, terms, stations" in line


def test_every_choice_is_named_in_the_help() -> None:
    text = (CONF / "hydra" / "help" / "brafit.yaml").read_text()
    for file in CONF.glob("*/*.yaml"):
        assert f"{file.parent.name}={file.stem}" in text


def test_words_are_those_that_the_code_knows() -> None:
    config = composed("cup=frames", "solver=anneal")
    for basis in BASES:
        config.cup.basis = basis
        check(config)
    for optimiser in OPTIMISERS:
        config.solver.stages[0].optimiser = optimiser
        check(config)
    for loss in ("l1", "l2", "robust"):
        config.condition.points = loss
        check(config)
        point_loss(loss, 1.0)


MADE = {
    f"{group}={file.stem}": group
    for group in ("cup", "solver", "condition", "pattern")
    for file in sorted((CONF / group).glob("*.yaml"))
}
NOT_OF_THE_CLASS = {"cup": {"tolerance"}}
"""Settings that are the recipe's, and not an argument of what a group makes."""


@pytest.mark.parametrize("choice", MADE)
def test_a_group_has_the_defaults_of_the_class_that_it_names(choice: str) -> None:
    """Whoever calls from Python gets the same as who runs the command."""
    group = MADE[choice]
    default = choice in ("condition=default", "pattern=default")
    settings = plain(composed(*(() if default else (choice,)))[group])
    target = get_class(settings["_target_"])
    known = with_defaults(target)
    values = {key: value for key, value in settings.items() if not key.startswith("_")}
    assert NOT_OF_THE_CLASS.get(group, set()) <= values.keys()
    shared = {key: value for key, value in values.items() if key not in NOT_OF_THE_CLASS.get(group, set())}
    required = inspect.signature(target).parameters.keys() - known.keys()
    assert {key: value for key, value in shared.items() if key not in required} == known


def test_scans_are_prepared_by_the_defaults_of_the_code() -> None:
    known = with_defaults(Preparation) | {"side": with_defaults(load_scan)["side"]}
    del known["apart"]  # a run reads in processes of its own anyway
    assert plain(composed().scan) == known


def test_sinks_have_the_defaults_of_their_classes() -> None:
    """But for what follows another setting."""
    written = OmegaConf.to_container(composed().sinks)
    assert isinstance(written, dict)
    for settings in written.values():
        known = with_defaults(get_class(settings["_target_"]))
        assert settings.keys() == {"_target_", *known}
        own = {key: value for key, value in settings.items() if key in known and "${" not in str(value)}
        assert own == {key: known[key] for key in own}, settings["_target_"]


def plain(settings: DictConfig) -> dict[str, Any]:
    values = OmegaConf.to_container(settings, resolve=True)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items()}


BARE = (str, int, float, tuple, NoneType)


def with_defaults(target: Any) -> dict[str, Any]:
    """Arguments that have a default, as settings would have them: lists for tuples, mappings for objects."""
    made = {}
    for entry in inspect.signature(target).parameters.values():
        if entry.default is not inspect.Parameter.empty:
            value: Any = entry.default if isinstance(entry.default, BARE) else getattr(target(), entry.name)
            value = asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
            made[entry.name] = list(value) if isinstance(value, tuple) else value
    return made


def test_no_group_shares_its_name_with_a_scalar() -> None:
    """Hydra would take `name=value` for a choice."""
    scalars = yaml.safe_load((CONF / "config.yaml").read_text()).keys() - {"defaults", "hydra"}
    assert not scalars & {folder.name for folder in CONF.iterdir() if folder.is_dir()}


def test_settings_that_were_composed_before_are_their_callers_own(tmp_path: Path, monkeypatch) -> None:
    first, again = (plain_composed(["cup.panels=3", "out=a"])[0] for _ in range(2))
    first["cup"]["panels"] = 9
    assert again["cup"]["panels"] == plain_composed(["cup.panels=3", "out=a"])[0]["cup"]["panels"] == 3
    own = [f"hydra.searchpath=[file://{tmp_path}]", "experiment=mine", "out=a"]
    (tmp_path / "experiment").mkdir()
    for count in (4, 5):  # a file may change, and the environment
        (tmp_path / "experiment/mine.yaml").write_text(f"# @package _global_\nrestarts: {count}\n")
        assert plain_composed(own)[0]["restarts"] == count
        monkeypatch.setenv("STARTS", str(count))
        assert plain_composed(["restarts=${oc.env:STARTS}", "out=a"])[0]["restarts"] == count
