"""The type checker that the tests put around every function of the package: beartype, with int allowed for float."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, beartype
from beartype.roar import BeartypeDecorHintPep3119Exception

_beartype = beartype(conf=BeartypeConf(is_pep484_tower=True))


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with its arguments and result checked; as it is where a protocol is for static checks only."""
    try:
        return _beartype(function)
    except BeartypeDecorHintPep3119Exception:
        return function
