"""The command line's arguments, as Hydra takes them: `brafit FOLDER` is `brafit scans=FOLDER`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from brafit.errors import ConfigError
from brafit.settings.compose import readable_settings, settings_called
from brafit.settings.quoting import listed
from brafit.settings.schema import Config

WITH_VALUE = frozenset(
    {
        "--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd",
        "--experimental-rerun",
    }
)  # fmt: skip
"""Options of Hydra that take the next word as their value."""
OPTIONS = WITH_VALUE | {
    "--help", "--hydra-help", "--version", "--resolve", "--run", "--multirun", "--shell-completion", "--info",
}  # fmt: skip
"""The long options of Hydra; what an option begins with means it too."""
_SHORT = 3
"""Characters of the longest short option."""
_SETTING = re.compile(r"[+~]*[^\W\d][\w./@-]*(=.*)?", re.DOTALL)


def prepared(arguments: Sequence[str]) -> list[str]:
    """Settings as Hydra can read them, then the options. Words that are no settings are scans.

    Raises:
        ConfigError: scans are named in two ways; a setting is taken away or added.
    """
    options, words = parted(arguments)
    paths = [word for word in words if not is_setting(word)]
    settings = [word for word in words if is_setting(word)]
    named = next((text for text in settings if text.partition("=")[0] == "scans"), None)
    for word in options:
        _check_option(word)
    if "=" in paths:
        raise ConfigError("a setting is written without spaces: key=value, as in cup.panels=3")
    for path in paths:
        if (name := _setting_meant(path)) and not Path(path).exists():
            value = path[len(name) :].lstrip(" :") or "VALUE"
            raise ConfigError(f"{path}: there is no such file or folder; a setting needs its value: {name}={value}")
        if named and not Path(path).exists():
            raise ConfigError(f"{path}: there is no such file or folder, and it is no setting of the form key=value")
        if named:
            raise ConfigError(f"{path} and {named} both name scans; write one list: brafit PATH PATH ...")
    return [*readable_settings(settings), *[f"scans={listed(paths)}"] * bool(paths), *options]


def _setting_meant(word: str) -> str:
    """The setting whose name a word is, maybe with a colon and a value behind it; empty if it is none."""
    name = re.split(r"[:\s]", word, maxsplit=1)[0]
    if name in _names():
        return name
    group, dot, _ = name.partition(".")
    return name if dot and group in _names() and name in settings_called(name) else ""


def _check_option(word: str) -> None:
    """Refuse an option that is none: a setting with dashes, most likely.

    Raises:
        ConfigError: names the setting that is meant, if there is one like it.
    """
    option, equals, value = word.partition("=")
    long = option.startswith("--")
    if (long and any(known.startswith(option) for known in OPTIONS)) or (not long and len(option) <= _SHORT):
        return
    name = option.lstrip("-").replace("-", "_")
    found = [name] if name.partition(".")[0] in _names() else settings_called(name)
    if found:
        raise ConfigError(f"{word}: settings have no dashes, write {found[0]}={value if equals else 'VALUE'}")
    if not long:
        return
    raise ConfigError(f"{word}: there is no such option, and no setting of that name; brafit --help shows all settings")


def is_setting(word: str) -> bool:
    """Whether a word of the command line is a setting, and no path.

    What begins with the name of a setting that exists is one. So is any other `name=value`, unless a file of that very
    name exists.
    """
    marked = word[:1] in ("+", "~")
    if _SETTING.fullmatch(word) is None or not (marked or "=" in word):
        return False
    name = re.split(r"[=./@]", word.lstrip("+~"), maxsplit=1)[0]
    return ("=" in word and name in _names()) or not Path(word).exists()


def _names() -> set[str]:
    return {item.name for item in fields(Config)} | {"hydra", "experiment"}


def parted(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Options with their values, and the other words; after `--` there are no options."""
    options: list[str] = []
    words: list[str] = []
    rest = iter(arguments)
    for word in rest:
        if word == "--":
            words += rest
        elif word.startswith("-") and len(word) > 1:
            options.append(word)
            if word in WITH_VALUE:
                options += [value for value in [next(rest, None)] if value is not None]
        else:
            words.append(word)
    return options, words
