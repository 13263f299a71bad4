"""Settings as Hydra's grammar reads them. It knows a few plain characters only: what has others is quoted here."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException

PATHS = ("scans", "out", "dataset.manifest")
"""Settings that name files and folders."""
TEXTS = (*PATHS, "pattern.size")
"""Settings whose value is a text, even where it looks like a number."""
BACKSLASHES = os.sep == "\\"
"""Whether paths have backslashes here."""
_CLOSING = {"[": "]", "{": "}", "(": ")"}
_FORMS = tuple(re.compile(form, re.DOTALL) for form in (r"(\[)(.*)(\])", r"(\w+\()(.*)(\))", r"()(.*)()"))
"""A list, a function of a sweep such as `choice(a,b)`, and items with commas between them."""
_ITEMS = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|,|[^,'"]+|.""", re.DOTALL)


def readable(setting: str) -> str:
    """The setting in a form that Hydra can read.

    A path that exists is taken as it stands, whatever is in its name. Otherwise what Hydra can read stays as it is:
    lists, sweeps (`2,3`), what is quoted already. What it cannot read is quoted, each item of a list or sweep by
    itself; a value that is no list, as a whole.
    """
    key, mark, value = setting.partition("=")
    if not mark or not value:
        return setting
    plain = os.path.expanduser(value) if key in PATHS else value
    if key in PATHS and _exists(plain):
        return f"{key}={_word(plain.replace('${', chr(92) + '${'))}"
    if value[0] in "'\"" or (_parsed(setting) is not None and not _mistaken(key, value)):
        return setting
    broken = value[0] in _CLOSING and not value.endswith(_CLOSING[value[0]])
    if broken and key not in TEXTS:
        return setting
    for candidate in (*[f"{key}={_items_quoted(value)}"] * (not broken), f"{key}={quoted(plain)}"):
        if _parsed(candidate) is not None and not _mistaken(key, candidate.partition("=")[2]):
            return candidate
    return setting


def quoted(text: str) -> str:
    """A text in quotes that Hydra reads back as it is."""
    return QuotedString(text, Quote.single).with_quotes()


def unquoted(value: str) -> str:
    """What a value means that may be in quotes."""
    override = _parsed(f"key={value}")
    found = None if override is None or override.is_sweep_override() else override.value()
    return found if isinstance(found, str) else value


def listed(texts: Sequence[str]) -> str:
    """Texts as a value: the one, or a list of several."""
    words = [_word(text) for text in texts]
    return words[0] if len(words) == 1 else f"[{','.join(words)}]"


def _word(text: str) -> str:
    """A text as it is, if Hydra reads it so; in quotes otherwise."""
    override = _parsed(f"key={text}")
    same = override is not None and not override.is_sweep_override() and override.value() == text
    return text if same else quoted(text)


def _exists(path: str) -> bool:
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # no name that a file could have
        return False


def _parsed(setting: str) -> Any:
    """Hydra's reading of a setting, None where it has none."""
    try:
        return OverridesParser.create().parse_override(setting)
    except HydraException:
        return None


def _mistaken(key: str, value: str) -> bool:
    """Whether Hydra would read a text as something else: a number, or a path whose backslashes it takes away."""
    if key not in TEXTS or value[0] in "'\"[":
        return False
    override = _parsed(f"{key}={value}")
    if override is None or override.is_sweep_override():
        return False
    found = override.value()
    return isinstance(found, int | float) or (BACKSLASHES and isinstance(found, str) and "\\" in value)


def _items_quoted(value: str) -> str:
    """A list or sweep whose items are quoted where Hydra cannot read them."""
    form = next(found for form in _FORMS if (found := form.fullmatch(value)))
    items = [""]
    for match in _ITEMS.finditer(form[2]):
        if match[0] == ",":
            items.append("")
        else:
            items[-1] += match[0]
    return f"{form[1]}{','.join(map(_item, items))}{form[3]}"


def _item(text: str) -> str:
    word = text.strip()
    if not word or word[0] in "'\"" or _parsed(f"key={word}") is not None:
        return text
    return quoted(os.path.expanduser(word) if word.startswith("~") else word)
