"""A cup model: strips that are drawn towards a house's own block, where others are drawn towards a plain cup.

    brafit out=runs/block
    brafit --config-dir conf cup=house cup.block=runs/block/anny_04/fit.json

The block is an earlier fit (first line) with the same panels and terms. What data do not determine then is as in the
block.
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
        ValueError: names the block, and says that it is not there, is no fit.json, or has other panels or terms.
    """

    def __init__(
        self, wire: Wire, block: str | Path | Mapping[str, Any], panels: int = 2, terms: int = 14, **others: Any
    ):
        super().__init__(wire, panels, terms, **others)
        parameters = block if isinstance(block, Mapping) else parameters_of(block)
        named = "(parameters)" if isinstance(block, Mapping) else block
        parts = [self.stations.new_tensor(parameters.get(name, [])) for name in self.layout]
        if [tuple(part.shape) for part in parts] != list(self.layout.values()):
            wanted = f"strips with {panels} panels and {terms} terms"
            remedy = "give cup.panels and cup.terms as the block has them, or fit it anew with these"
            raise ValueError(f"cup.block={named}: not a fit of {wanted}; {remedy}")
        self.register_buffer("block", torch.cat([part.flatten() for part in parts]), persistent=False)

    def plain(self, height: Tensor) -> tuple[Tensor, Tensor]:
        """The block, whatever the breast's height; angles and corner do not count, as in other plain cups."""
        values, counts = super().plain(height)
        return torch.where(counts > 0, self.get_buffer("block").to(values), values), counts


def parameters_of(file: str | Path) -> Mapping[str, Any]:
    """The parameters in a fit.json.

    Raises:
        ValueError: names the file, and says what is wrong with it.
    """
    try:
        content = json.loads(Path(file).read_text(encoding="utf-8"))
    except OSError as error:
        remedy = "make the block first: brafit SCAN out=runs/block"
        raise ValueError(f"cup.block={file}: cannot be read ({error.strerror}); {remedy}") from error
    except ValueError as error:
        raise ValueError(f"cup.block={file}: not JSON; give the fit.json of a fit") from error
    parameters = content.get("parameters") if isinstance(content, dict) else None
    if not isinstance(parameters, dict):
        raise ValueError(f"cup.block={file}: has no parameters of a cup; give the fit.json of a fit that succeeded")
    return parameters
