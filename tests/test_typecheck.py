"""The checks of types and shapes that all other tests run under."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import typecheck
from jaxtyping import TypeCheckError

from brafit.geometry.rotation import skew
from brafit.landmarks.cup_frame import CupFrame

RIGHT, WRONG = torch.zeros(4, 3), torch.zeros(3, 4)


def test_wrong_shapes_are_refused_at_first_and_now_and_then() -> None:
    with pytest.raises(TypeCheckError, match=r"parameters of brafit\.geometry\.rotation\.skew"):
        skew(WRONG)
    for _ in range(typecheck.EVERY - 2):
        skew(RIGHT)
    with pytest.raises(TypeCheckError):
        skew(WRONG)


def test_results_and_dataclasses_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TypeCheckError, match=r"parameters of brafit\.landmarks\.cup_frame\.CupFrame\.__init__"):
        CupFrame(np.zeros(3), np.zeros(3))
    monkeypatch.setattr(torch, "stack", lambda *_, **__: torch.zeros(9))
    with pytest.raises(TypeCheckError, match=r"return value of brafit\.geometry\.rotation\.skew"):
        skew(RIGHT)
