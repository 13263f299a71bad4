"""How pieces are cut for their cloth: smaller, where it stretches when it is worn, and larger or smaller by an ease."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.pattern.grain import grain_angle
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Side


def as_cut(options: PatternOptions, side: Side) -> Float[ndarray, "2 2"]:
    """What takes places of a piece as it is worn to those of the piece as it is cut: points @ matrix.

    First comes the ease, along the chord of the piece's lower edge and at right angles to it. Then, along and across
    the grain line, lengths are divided by what they are multiplied with when the cloth is stretched.
    """
    ease = np.diag([1 + options.ease[way] / 100 for way in ("width", "height")])
    reduced = np.diag([1 - share for share in reductions(options)])
    if (np.diag(reduced) == 1).all():
        return ease
    angle = math.radians(grain_angle(options, side))
    along = np.array((math.cos(angle), math.sin(angle)))
    turn = np.stack((along, (-along[1], along[0])))
    return ease @ turn.T @ reduced @ turn


def reductions(options: PatternOptions) -> tuple[float, float]:
    """Shares by which pieces are cut shorter along and across the grain line: cloth that is stretched by s of its own
    length covers 1 + s, so 1 / (1 + s) of what it is to cover is cut.
    """
    along, across = (options.cloth[way] / 100 for way in ("stretch", "stretch_across"))
    return along / (1 + along), across / (1 + across)


def cloth_words(options: PatternOptions) -> list[str]:
    """What labels and reports say of the cloth, a line each, short enough for a label; nothing of cloth that is thin
    and does not stretch."""
    words = []
    if thickness := options.cloth["thickness"]:
        words.append(f"cloth {options.length_set(thickness)} thick")
    stretched = (options.cloth["stretch"], options.cloth["stretch_across"])
    ways = ("at its greatest", "across that") if options.by_stretch else ("along grain", "across grain")
    for way, stretch, share in zip(ways, stretched, reductions(options), strict=True):
        if stretch:
            words.append(f"stretch {stretch:g} % {way}: {100 * share:.1f} % less")
    return words


def ease_words(options: PatternOptions) -> str:
    """What labels say of the ease."""
    ease = ", ".join(f"{way} {value:+g} %" for way, value in options.ease.items() if value)
    return f"ease {ease}" if ease else "no ease"


def reshaped(options: PatternOptions) -> bool:
    """Whether pieces are cut to other sizes than they have when worn, for ease or stretch."""
    return any(options.ease.values()) or any(reductions(options))


def unequal(options: PatternOptions) -> tuple[str, str]:
    """What makes the two sides of a seam differ, if they do, and what would make them alike."""
    if not any(reductions(options)):
        return "ease", "ease width and height alike"
    if not any(options.ease.values()):
        return "stretch", "take cloth that stretches both ways alike"
    return "ease and stretch", "ease width and height alike and take cloth that stretches both ways alike"
