"""Cups of thick material: what is fitted is the middle of the material, half its thickness outside of the skin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from brafit.scan.load import Scan
from brafit.surface.normals import FRONT, Surface, settle, surface_of

RADIUS = 8.0
"""Of the points that say which way is outwards, mm: wide enough that their noise does not turn it."""


def middle_of(scan: Scan, thickness: float) -> Scan:
    """The scan as the middle of a material sees it that lies on the skin: points and marks are moved outwards along the
    skin's normals by half of the thickness.

    Cloth that is bent keeps its lengths in its middle, so that surface is the developable one, and its flat pattern the
    one to cut. The wire stays: it lies in its channel at the cup's edge, and its length is that of a wire to be bought.
    With it stay the two ends of the neckline, which are the wire's.

    Args:
        scan: of the skin.
        thickness: of the material, mm. 0: the scan as it is.
    """
    if thickness == 0:
        return scan
    skin = surface_of(np.concatenate([scan.dense, scan.assumed]), FRONT)

    def outwards(places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        return places + thickness / 2 * _normals(skin, places)

    def mark(place: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"] | None:
        return None if place is None else outwards(place[None])[0]

    line = scan.neckline
    if line is not None:
        line = np.concatenate([line[:1], outwards(line[1:-1]), line[-1:]])
    return replace(
        scan,
        points=outwards(scan.points),
        spacing=None,
        assumed=outwards(scan.assumed),
        dense=outwards(scan.dense),
        neckline=line,
        strap_point=mark(scan.strap_point),
        apex=mark(scan.apex),
    )


def _normals(skin: Surface, places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return settle(skin, places, RADIUS)[1] if len(places) else places
