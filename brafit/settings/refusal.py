"""What to say of a setting that is refused: one line with the key, what came and what is allowed."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from importlib import resources

from hydra.errors import OverrideParseException
from omegaconf import DictConfig, OmegaConf

from brafit.settings.quoting import TEXTS

Known = Callable[[], DictConfig]
"""Gives the settings that exist, with the choices of groups that were made."""
KINDS = {"Integer": "a whole number", "Float": "a number", "Boolean": "true or false"}
EXTRAS = {"joblib": "joblib", "ray": "ray", "submitit": "slurm"}
"""Of each launcher's package, the extra of brafit that brings it."""
_UNIT = re.compile(r"[-+]?[\d.]+\s*(mm|cm|in|inch|%)")
"""A number with a unit behind it."""
_LENGTHS = ": lengths are in mm"
CALLED = {
    "pattern.allowance.seam": "pattern.allowance.ridge",
    "pattern.allowance.seams": "pattern.allowance.ridge",
    "pattern.allowance.neckline": "pattern.allowance.upper",
}
"""Settings by what patterns and pages call the same thing."""
_KEY = r"[A-Za-z_][\w./@-]*"


def refused_mark(setting: str, known: Known) -> str | None:
    """What to say of a setting that takes one away (`~key`) or adds one (`+key=value`), or whose name is none.

    `++key=value` of a setting that exists means what `key=value` means. Hydra's own settings are left to Hydra.
    """
    key, _, value = setting.partition("=")
    mark, key = key[: len(key) - len(key.lstrip("+~"))], key.lstrip("+~")
    if re.match("hydra\\b", key) or (not mark and (re.fullmatch(_KEY, key, re.ASCII) or not value)):
        return None
    if not _exists(known(), key):
        return unknown_setting(key, known, mark)
    if mark == "~":
        remedy = f"settings cannot be taken away; did you mean {key}=VALUE?"
    else:
        remedy = f"the setting exists, so it needs no {mark}; did you mean {key}={value}?"
    return None if mark == "++" else f"unknown setting '{mark}{key}': {remedy}"


def _exists(tree: DictConfig, key: str) -> bool:
    parent, _, last = key.rpartition(".")
    node = OmegaConf.select(tree, parent, default=None) if parent else tree
    return key == "experiment" or (isinstance(node, DictConfig) and last in node)


def refusal(error: BaseException, overrides: Sequence[str], known: Known) -> str:
    """The line for what composing the configuration raised.

    Args:
        error: what Hydra or OmegaConf raised.
        overrides: the command line's arguments.
        known: the settings that there are.
    """
    text, cause = str(error), error.__cause__ or error
    if isinstance(error, OverrideParseException):
        form = "write key=value; a value with brackets and the like needs quotes of its own: \"key='a[1]'\""
        return f"'{error.override}' cannot be read: {form}"
    if match := re.match(r"Ambiguous value for argument '(.*?)=(.*)'", text):
        return _several(match[1], match[2], known)
    if match := re.match(r"Sweep parameters '(.*)' requires --multirun", text):
        return f"{match[1]}: several values; add -m to run each in turn"
    if match := re.match(r"Could not override '(([^'@]+)@[^']*)'", text):
        return f"unknown setting '{match[1]}'; did you mean {match[2]}=VALUE?"
    if match := re.search(r"Error locating target 'hydra_plugins\.hydra_(\w+)_launcher", f"{text} {cause}"):
        return missing_launcher(match[1], overrides)
    if match := re.search(r"Could not find '(\S+)/([^/\s]+)'", text):
        choices = [name for name in re.findall(r"^\t(\w+)$", text, re.MULTILINE) if not name.endswith("_schema")]
        return no_choice(match[1], match[2], choices)
    if text.startswith("Config group override must be a string or a list"):
        return _plain_choice(overrides)
    return _value_refused(cause, overrides, known) or " ".join(str(cause).split()) or type(cause).__name__


def _several(key: str, value: str, known: Known) -> str:
    """What to say of a value with a comma: of several values, a list, a decimal comma, or a path with a comma in it."""
    setting = OmegaConf.select(known(), key, throw_on_resolution_failure=False)
    told = f"{key}={value}: several values; add -m to run each in turn"
    if isinstance(setting, float) and (decimal := re.fullmatch(r"([-+]?\d+),(\d+)", value)):
        return f"{told}, or write a decimal point: {key}={decimal[1]}.{decimal[2]}"
    if key == "scans" or OmegaConf.is_list(setting):
        return f"{told}, or write a list: {key}=[{value}]"
    return f"{told}, or quote it, if the comma is a part of it: \"{key}='A,B'\"" if key in TEXTS else told


def missing_launcher(package: str, overrides: Sequence[str]) -> str:
    """What to install for the launcher that this package of Hydra's brings."""
    chosen = next((text for text in overrides if text.startswith("hydra/launcher=")), f"hydra/launcher={package}")
    return f"{chosen}: it needs a package that is not installed: pip install 'brafit[{EXTRAS[package]}]'"


def no_choice(group: str, value: str, choices: Sequence[str]) -> str:
    return f"{group}={value}: there is no such choice; allowed: {', '.join(choices) or 'none'}"


def unknown_setting(key: str, known: Known, mark: str = "") -> str:
    """What to say of a key that does not exist: the names that do, at the deepest level that does."""
    parent, _, last = key.rpartition(".")
    tree = known()
    node = OmegaConf.select(tree, parent) if parent else tree
    while parent and not isinstance(node, DictConfig):
        last, parent = parent.rpartition(".")[2], parent.rpartition(".")[0]
        node = OmegaConf.select(tree, parent) if parent else tree
    assert isinstance(node, DictConfig)
    names = [str(name) for name in node if not str(name).startswith("_")]
    meant = difflib.get_close_matches(last, names, n=1)
    found = [f"{parent}.{name}" if parent else name for name in meant] or _elsewhere(tree, last)
    dotted = key.replace("/", ".")
    alike = next((name for name in (dotted, dotted.strip().lower()) if name != key and _exists(tree, name)), None)
    alike = CALLED.get(dotted.lower(), alike)
    found = [alike] if alike else found
    hint = f"did you mean {' or '.join(found)}? " if found else ""
    return f"unknown setting '{mark}{key}'; {hint}allowed{f' in {parent}' if parent else ''}: {', '.join(names)}"


def _elsewhere(tree: DictConfig, name: str) -> list[str]:
    """Full names of the settings in groups that are called this."""
    groups = ((key, node) for key, node in tree.items_ex(resolve=False) if isinstance(node, DictConfig))
    return [f"{key}.{name}" for key, node in groups if name in node]


def _plain_choice(overrides: Sequence[str]) -> str:
    """Of a group that was given a number: its choices."""
    folder = resources.files("brafit.conf")
    for key, _, value in (text.partition("=") for text in reversed(overrides)):
        group = folder.joinpath(key)
        if group.is_dir() and not re.match(r"[A-Za-z\[]", value):
            return no_choice(key, value, sorted(file.name.removesuffix(".yaml") for file in group.iterdir()))
    return "a group's choice must be a word"


def _value_refused(cause: BaseException, overrides: Sequence[str], known: Known) -> str | None:
    """The line for a value that its setting's type does not take."""
    key, text = str(getattr(cause, "full_key", None) or ""), str(cause)
    below = next((text.partition("=")[0] for text in overrides if text.startswith(f"{key}.")), None)
    if below and not isinstance(OmegaConf.select(known(), key), DictConfig):
        return unknown_setting(below, known)
    if match := re.match(r"Value '(.*)' of type '\w+' could not be converted to (\w+)", text):
        unit = _UNIT.fullmatch(match[1])
        without = f", without {unit[1]!r}{_LENGTHS * (unit[1] != '%')}" if unit else ""
        return f"{key}={match[1]}: must be {KINDS.get(match[2], match[2])}{without}"
    if match := re.match(r"Value '([^\[].*)' is not a valid bool", text):
        return f"{key}={match[1]}: must be true or false"
    if match := re.match(r"Value '(\[.*\])' is not a valid bool|Cannot convert 'list' to string: '(\[.*\])'", text):
        return f"{key}={match[1] or match[2]}: must be {'true or false' if match[1] else 'one text'}, not a list"
    if match := re.match(r"Invalid value assigned: (\w+) is not a ListConfig", text):
        return f"{key}: must be a list: {key}=[VALUE,VALUE]"
    if key and re.match(r"Key '.*' (is not in struct|not in ')", text):
        return unknown_setting(key, known)
    if re.match(r"field '.*' is not Optional|Invalid type assigned: \w+ is not a subclass of \w+Config", text):
        return _unfit(key, overrides, known)
    return None


def _unfit(key: str, overrides: Sequence[str], known: Known) -> str:
    """What to say of `pattern.allowance=8`, where it holds several settings, and of `restarts=null`."""
    value = next((text.partition("=")[2] for text in reversed(overrides) if text.partition("=")[0] == key), "null")
    node = OmegaConf.select(known(), key)
    if not isinstance(node, DictConfig):
        return f"{key}={value}: must have a value"
    shown = "VALUE" if value == "null" else value
    each = [f"{key}.{name}={shown}" for name in node if not str(name).startswith("_")]
    rest = f": {' '.join(each)}" if len(each) > 1 else ""
    return f"{key}={value}: did you mean {each[0]}? {key} holds several settings{rest}"
