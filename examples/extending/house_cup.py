"""A cup model: strips that are drawn towards a house's own block, where others are drawn towards a plain cup.

    brafit --config-dir conf cup=house cup.block=runs/block/fit.json

The block is an earlier fit with the same panels and terms. What data do not determine then is as in the block.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from brafit.cup import StripsCup, Wire


class HouseCup(StripsCup):
    """Strips with a plain cup of their own.

    Args:
        block: the fit.json of the block, or its `parameters`.
        others: as for `StripsCup`.

    Raises:
        ValueError: no fit.json of a cup of strips with so many panels and terms.
    """

    def __init__(
        self, wire: Wire, block: str | Path | Mapping[str, Any], panels: int = 2, terms: int = 14, **others: Any
    ):
        super().__init__(wire, panels, terms, **others)
        parameters = block if isinstance(block, Mapping) else json.loads(Path(block).read_text())["parameters"]
        parts = [self.stations.new_tensor(parameters.get(name, [])) for name in self.layout]
        if [tuple(part.shape) for part in parts] != list(self.layout.values()):
            raise ValueError(f"{block} is no block of strips with {panels} panels and {terms} terms")
        self.register_buffer("block", torch.cat([part.flatten() for part in parts]), persistent=False)

    @property
    def plain(self) -> tuple[Tensor, Tensor]:
        """The block; angles and corner do not count, so they stay as in other plain cups."""
        values, counts = super().plain
        return torch.where(counts > 0, self.get_buffer("block").to(values), values), counts
