"""Every setting is read: by the code that has the object that is built from it, not by any code that knows the word."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra.utils import get_class

from brafit.fitting import AnnealStage, Conditions, LMStage
from brafit.pattern import PatternOptions
from brafit.pattern.piece import KIND_NAMES
from brafit.run.dataset import dataset
from brafit.scan import Preparation

CONF = Path(__file__).parents[2] / "conf"
BRAFIT = CONF.parent / "brafit"
TEXTS = {
    file.relative_to(BRAFIT).as_posix(): file.read_text(encoding="utf-8")
    for file in sorted(BRAFIT.rglob("*.py"))
    # types and limits of settings are no reading; conf is a link to the settings that working trees have
    if file.relative_to(BRAFIT).parts[0] not in ("settings", "conf")
}
TREES = {name: ast.parse(text) for name, text in TEXTS.items()}

HELD: dict[type, tuple[str, str]] = {
    LMStage: (r"fitting/(lm|schedule)\.py", r"stage"),
    AnnealStage: (r"fitting/(anneal|schedule)\.py", r"stage"),
    Conditions: (r".*", r"(.*\.)?(c|condition|conditions)"),
    PatternOptions: (r".*", r"(.*\.)?(options|recipe\.pattern)"),
    Preparation: (r".*", r"prepared"),
}
"""In which modules values with settings are read, and what they are called there."""


@cache
def loads(tree: ast.AST) -> list[tuple[str, str]]:
    """Attributes that are read, and of what, as far as it has a name."""
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)]
    return [(node.attr, name_of(node.value)) for node in nodes]


def name_of(node: ast.expr) -> str:
    """A name with dots; what has no name is a question mark."""
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def module_of(thing: type | Callable) -> str:
    """The file that a class or function is written in."""
    return thing.__module__.removeprefix("brafit.").replace(".", "/") + ".py"


def body_of(trees: Mapping[str, ast.Module], thing: type | Callable) -> Any:
    """Where a class or function is written."""
    return next(node for node in trees[module_of(thing)].body if getattr(node, "name", None) == thing.__name__)


def fields_read(trees: Mapping[str, ast.Module], kind: type) -> set[str]:
    """Fields of a value with settings that are read of it, or by its own methods; to check them is not to read them."""
    modules, names = HELD[kind]
    chosen = [tree for name, tree in trees.items() if re.fullmatch(modules, name)]
    found = {attribute for tree in chosen for attribute, whose in loads(tree) if re.fullmatch(names, whose)}
    for node in body_of(trees, kind).body:
        if isinstance(node, ast.FunctionDef) and node.name != "__post_init__":
            found |= {attribute for attribute, whose in loads(node) if whose == "self"}
    return found


def arguments_read(made: type | Callable) -> set[str]:
    """Arguments that a function or constructor uses; of those that a constructor keeps, what is read later."""
    body, kept = body_of(TREES, made), set[str]()
    if isinstance(made, type):
        body = next(node for node in body.body if isinstance(node, ast.FunctionDef) and node.name == "__init__")
        kept = {
            node.attr for node in ast.walk(body) if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
        }
        own = [module_of(base) for base in made.__mro__ if base.__module__.startswith("brafit.")]
        kept -= {attribute for name in own for attribute, whose in loads(TREES[name]) if whose == "self"}
        named = re.compile(r"(.*\.)?(cup|solver)")
        kept -= {attribute for tree in TREES.values() for attribute, whose in loads(tree) if named.fullmatch(whose)}
    used = {node.id for node in ast.walk(body) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
    return {name for name in used if not {name, f"_{name}"} & kept}


def settings_in(file: str) -> dict[str, Any]:
    content = yaml.safe_load((CONF / file).read_text(encoding="utf-8"))
    return {
        key: value for key, value in content.items() if key not in ("defaults", "hydra") and not key.startswith("_")
    }


def unread(trees: Mapping[str, ast.Module], kind: type) -> set[str]:
    """Settings that a value of this kind has, and that nobody reads."""
    written = {
        LMStage: {key for stage in settings_in("solver/lm.yaml")["stages"] for key in stage},
        AnnealStage: {key for stage in settings_in("solver/anneal.yaml")["stages"] for key in stage},
        Conditions: {*settings_in("condition/default.yaml")},
        PatternOptions: {*settings_in("pattern/default.yaml")},
        Preparation: {*settings_in("scan/default.yaml")} - {"side"},
    }
    assert written[kind]
    return written[kind] - fields_read(trees, kind)


@pytest.mark.parametrize("kind", HELD)
def test_what_a_value_is_built_from_is_read_of_it(kind: type) -> None:
    assert unread(TREES, kind) == set()


@pytest.mark.parametrize(
    "file", sorted(f"{p.parent.name}/{p.name}" for g in ("cup", "solver") for p in (CONF / g).glob("*.yaml"))
)
def test_what_a_class_is_made_of_is_used(file: str) -> None:
    made = get_class(yaml.safe_load((CONF / file).read_text(encoding="utf-8"))["_target_"])
    written = settings_in(file).keys() & inspect.signature(made).parameters.keys()
    assert written
    assert written - arguments_read(made) == set()


def test_what_the_dataset_takes_is_used() -> None:
    assert {*settings_in("dataset/default.yaml"), "side"} <= arguments_read(dataset)


def texts_in(tree: ast.AST) -> set[str]:
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def keys_read(where: str) -> set[str]:
    """Keys in brackets, and those that are asked for with `get`, of some modules."""
    nodes = [node for name, tree in TREES.items() if re.fullmatch(where, name) for node in ast.walk(tree)]
    keys = [node.slice for node in nodes if isinstance(node, ast.Subscript)]
    calls = [node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)]
    keys += [
        call.args[0] for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "get" and call.args
    ]
    return set().union(*map(texts_in, keys))


def test_settings_that_are_in_no_group_are_read_by_the_run_or_the_command() -> None:
    """The folder by Hydra, as `${out}`."""
    assert "dir: ${out}" in (CONF / "config.yaml").read_text(encoding="utf-8")
    assert settings_in("config.yaml").keys() - {"out"} <= keys_read(r"(run|cli)/.*")


def test_parts_of_the_patterns_settings_are_read() -> None:
    groups = {key: value for key, value in settings_in("pattern/default.yaml").items() if isinstance(value, dict)}
    assert groups.pop("allowance").keys() == KIND_NAMES.keys(), "read by the kind of an edge"
    assert len(groups) > 2
    keys = keys_read(r"report/.*|pattern/(?!options).*")
    for group, parts in groups.items():
        reading = [
            tree for name, tree in TREES.items() if re.match(r"pattern/", name) and (group, "options") in loads(tree)
        ]
        assert parts.keys() <= keys.union(*map(texts_in, reading)), group


@pytest.mark.parametrize(
    ("kind", "key", "reading"),
    [
        (LMStage, "points", "stage.points"),
        (LMStage, "steps", "stage.steps"),
        (AnnealStage, "rate", "stage.rate"),
        (PatternOptions, "size", "options.size"),
        (Conditions, "points", "c.points"),
        (Preparation, "points", "prepared.points"),
    ],
)
def test_a_setting_that_nobody_reads_is_found_however_common_its_name(kind: type, key: str, reading: str) -> None:
    whose, _ = reading.split(".")
    dead = dict(TREES)
    for name, text in TEXTS.items():
        if reading in text:
            dead[name] = ast.parse(re.sub(rf"\b{re.escape(reading)}\b", f"{whose}.dead", text))
    assert unread(dead, kind) == {key}
