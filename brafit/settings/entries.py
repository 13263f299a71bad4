"""Objects made of settings: `{_target_: MODULE.NAME, ...}` calls MODULE.NAME with the other entries.

That is how classes from outside of brafit come in. Their modules are looked for as Python does, and in the working
folder.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from brafit.errors import ConfigError

TARGET = "_target_"


def made(settings: Any, setting: str) -> Any:
    """The object that settings describe.

    Args:
        settings: plain values, with `_target_`s anywhere in them.
        setting: name of the setting, for errors.

    Raises:
        ConfigError: a module or name that does not exist, or settings that are not what it takes; names the setting.
    """
    from hydra.errors import InstantiationException
    from hydra.utils import instantiate

    for name, target in targets(settings, setting):
        locate(target, name)
    try:
        return instantiate(settings, _convert_="all")
    except InstantiationException as error:
        said = refusal(error.__cause__ or error, setting, _place(settings, setting, str(error)))
        raise ConfigError(said) from error


def refusal(error: BaseException, setting: str, place: str) -> str:
    """What an error says in one line that begins with the setting at fault: `place` if it names no part of `setting`.

    Of a file that cannot be read it gives the name and the reason, without the system's number.
    """
    words = str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        words = f"{error.filename}: {error.strerror}"
    words = " ".join(words.split())
    return words if words.startswith(f"{setting}.") else f"{place}: {words}"


def _place(settings: Any, setting: str, words: str) -> str:
    """The setting at fault, which Hydra names without all dots."""
    inner = re.search(r"full_key: (\S+)", words)
    where = re.sub(r"\W", "", f"{setting}{inner[1] if inner else ''}")
    return next((name for name, _ in targets(settings, setting) if re.sub(r"\W", "", name) == where), setting)


def targets(settings: Any, setting: str) -> Iterator[tuple[str, Any]]:
    """Every `_target_` in settings, with the name of the setting it makes."""
    if isinstance(settings, Mapping):
        if TARGET in settings:
            yield setting, settings[TARGET]
        for key, value in settings.items():
            yield from targets(value, f"{setting}.{key}" if setting else str(key))
    elif isinstance(settings, list | tuple):
        for k, value in enumerate(settings):
            yield from targets(value, f"{setting}.{k}")


def locate(target: Any, setting: str) -> Any:
    """What a `_target_` names.

    Raises:
        ConfigError: there is no such module, it cannot be imported, or it holds no such name.
    """
    parts = str(target).split(".")
    if len(parts) < 2 or not all(part.isidentifier() for part in parts):
        raise ConfigError(f"{setting}: {TARGET} must be MODULE.NAME, such as my_module.MyClass, got {target}")
    _look_in_working_folder(parts[0])
    found: Any = None
    for k in range(1, len(parts) + 1):
        name = ".".join(parts[:k])
        try:
            found = importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name not in (name, name.rpartition(".")[0]):  # what it imports itself is missing
                raise ConfigError(f"{setting}: {name} cannot be imported ({error})") from error
            return _attribute(found, parts[k - 1 :], target, setting)
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())
            raise ConfigError(f"{setting}: {name} cannot be imported ({said})") from error
        if k < len(parts) and hasattr(found, parts[k]) and not _is_module(f"{name}.{parts[k]}"):
            return _attribute(found, parts[k:], target, setting)
    raise ConfigError(f"{setting}: {target} is a module; name a class or function in it")


def modules(settings: Any) -> list[Path]:
    """Files of the modules from outside of brafit that settings name."""
    files = set()
    for _, target in targets(settings, ""):
        parts = str(target).split(".")
        names = [".".join(parts[:k]) for k in range(len(parts), 0, -1)]
        module = next((sys.modules[name] for name in names if name in sys.modules), None)
        if parts[0] != "brafit" and module is not None and getattr(module, "__file__", None):
            files.add(Path(str(module.__file__)))
    return sorted(files)


def _attribute(module: Any, rest: list[str], target: str, setting: str) -> Any:
    if module is None:
        where = "in the working folder, on PYTHONPATH and among what is installed"
        raise ConfigError(f"{setting}: {target}: there is no module {rest[0]} ({where})")
    found = module
    for name in rest:
        if not hasattr(found, name):
            meant = difflib.get_close_matches(name, dir(found), n=1)
            hint = f"; did you mean {meant[0]}?" if meant else ""
            raise ConfigError(f"{setting}: {target}: {getattr(found, '__name__', found)} has no {name}{hint}")
        found = getattr(found, name)
    return found


def _look_in_working_folder(module: str) -> None:
    """Let modules of the working folder be found, after all others, where one is not found otherwise."""
    here = str(Path.cwd())
    if _is_module(module) or here in sys.path:
        return
    sys.path.append(here)
    importlib.invalidate_caches()
    if not _is_module(module):
        sys.path.remove(here)


def _is_module(name: str) -> bool:
    if name in sys.modules:
        return True
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError, AttributeError):
        return False
