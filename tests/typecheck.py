"""The type checker that the tests put around every function of the package: beartype, with int allowed for float.

To check every call would take two thirds of the suite's time, nearly all of it for calls of the innermost loops that
are alike. So it is done sparingly: in every test each function's first FIRST calls are checked, then every EVERY-th.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections import Counter
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype
from beartype.roar import BeartypeDecorHintPep3119Exception

FIRST, EVERY = 10, 50
_beartype = beartype(conf=BeartypeConf(is_pep484_tower=True))
_jaxtyped = jaxtyping.jaxtyped
_calls: Counter[Any] = Counter()


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with its arguments and result checked; as it is where a protocol is for static checks only."""
    try:
        return _beartype(function)
    except BeartypeDecorHintPep3119Exception:
        return function


def check_sparingly() -> None:
    """Has jaxtyping's import hook put `sparing` around what it finds. The modules must not be imported yet."""
    jaxtyping.jaxtyped = sparing


def begin_anew() -> None:
    """Another test begins: first calls count as first ones again."""
    _calls.clear()


def sparing(thing: Any = None, *, typechecker: Callable[..., Any]) -> Any:
    """What `jaxtyping.jaxtyped` takes and gives, but that not every call is checked."""
    if thing is None:
        return functools.partial(sparing, typechecker=typechecker)
    if isinstance(thing, classmethod | staticmethod):
        return type(thing)(sparing(thing.__func__, typechecker=typechecker))
    if isinstance(thing, property):
        parts = (thing.fget, thing.fset, thing.fdel)
        return property(*(part and sparing(part, typechecker=typechecker) for part in parts))
    if inspect.isclass(thing):
        if "__init__" in vars(thing) and dataclasses.is_dataclass(thing):
            thing.__init__ = sparing(thing.__init__, typechecker=typechecker)
        return thing
    if not inspect.isfunction(thing):
        return _jaxtyped(thing, typechecker=typechecker)
    return _sparing(thing, typechecker)


def _sparing(function: Callable[..., Any], typechecker: Callable[..., Any]) -> Callable[..., Any]:
    key = function.__code__  # one for all that a function within a function becomes
    strict: Callable[..., Any] | None = None

    @functools.wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        nonlocal strict
        _calls[key] += 1
        if _calls[key] > FIRST and _calls[key] % EVERY:
            return function(*args, **kwargs)
        if strict is None:
            strict = _jaxtyped(function, typechecker=typechecker)
        return strict(*args, **kwargs)

    return wrapped
