"""Fits for different cloth: cups for other thickness can be neither compared nor laid on one another, and pieces for
other stretch are told of."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from brafit.errors import InputError
from brafit.pattern import PatternOptions
from brafit.pattern.cloth import cloth_words, ease_words
from brafit.sizing.stored import StoredFit, options_of


def check_thickness(fits: Sequence[StoredFit]) -> None:
    """Refuse cups of which some were fitted for thicker material than others.

    Args:
        fits: whose cups can be made again.

    Raises:
        InputError: those that are fewest, the first of them named.
    """
    found = _by(fits, lambda options: f"{options.cloth['thickness']:g}")
    if len(found) < 2:
        return
    (usual, most), (other, few) = found[0], found[-1]
    cause = (
        f"its cup was fitted for material {other} mm thick (pattern.cloth.thickness={other}), but {len(most)} of the "
        f"{len(fits)} cups for {usual} mm: a cup is the middle of its material, so they lie at different distances "
        "from the skin, and can be neither compared nor laid on one another"
    )
    remedy = "Name folders of one thickness, or fit those scans anew with the other's"
    raise InputError(few[0].folder / "fit.json", cause, remedy)


def cloth_notes(fits: Sequence[StoredFit]) -> list[str]:
    """What to say where pieces of some fits are cut for other cloth or ease than those of others; nothing else."""
    found = _by(fits, lambda options: ", ".join((*cloth_words(options), ease_words(options))))
    if len(found) < 2:
        return []
    told = "; ".join(f"{words}: {len(own)}" for words, own in found)
    return [f"pieces are cut for different cloth or ease, and dimensions as cut differ by that too (fits: {told})"]


def _by(fits: Sequence[StoredFit], about: Callable[[PatternOptions], str]) -> list[tuple[str, list[StoredFit]]]:
    """The fits by something that their options say, what most of them say first."""
    groups: dict[str, list[StoredFit]] = {}
    for fit in fits:
        groups.setdefault(about(options_of(fit)), []).append(fit)
    return sorted(groups.items(), key=lambda group: -len(group[1]))
