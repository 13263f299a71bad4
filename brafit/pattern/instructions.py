"""What a cutter is told of a piece: its label, and the allowances that label and legend name."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from brafit.pattern.cloth import cloth_words, ease_words
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import KIND_NAMES, Kind, Piece, Side

_NAME, _CORE, _EDGES, _SIZE, _WHICH, _CLOTH, _FURTHER = range(7)
"""Lines of a label by how long they are kept where there is little room, from always to not for long."""


def label_stages(
    piece: Piece, options: PatternOptions, name: str, side: Side, number: str, date: str
) -> tuple[tuple[str, ...], ...]:
    """The lines of a piece's label; then all that a cutter cannot do without; then ever less, down to the piece's name.

    Args:
        piece: what it is of.
        options: how it is finished.
        name: of the scan.
        side: the wearer's side it is for.
        number: of the piece, in words.
        date: may be empty.
    """
    kinds: list[Kind] = [edge.kind for edge in piece.edges]
    allowances = {options.allowance[kind] for kind in kinds}
    own = options.length_set(options.allowance[kinds[0]]) if len(allowances) == 1 else _allowances(options, kinds)
    casing = options.wire["casing"] if "wire" in kinds else 0.0
    ranked = [
        (_NAME, piece.name),
        (_WHICH, number),
        (_WHICH, name * (name != options.size)),
        (_EDGES, f"{side} cup"),
        (_SIZE, options.size and f"size {options.size}"),
        (_CORE, f"cut {options.quantity}"),  # of a pair both sides are drawn, and each says so for itself
        (_CORE, f"allowance {own}"),
        (_EDGES, f"casing {options.length_set(casing)} more" if casing else ""),
        *((_CLOTH, words) for words in cloth_words(options)),
        (_FURTHER, ease_words(options)),
        (_FURTHER, date),
    ]
    lines = [(rank, " ".join(words.split())) for rank, words in ranked if words.strip()]
    return tuple(
        tuple(words for rank, words in lines if rank <= most) for most in (_FURTHER, _CLOTH, *range(_WHICH, -1, -1))
    )


def allowance_words(options: PatternOptions, kinds: Collection[Kind]) -> str:
    """What the legend says of the allowances of these kinds of edges."""
    own: list[Kind] = [kind for kind in KIND_NAMES if kind in kinds]
    return f"allowances: {_allowances(options, own, casing=True)}"


def _allowances(options: PatternOptions, kinds: Sequence[Kind], casing: bool = False) -> str:
    told = {kind: f"{KIND_NAMES[kind]} {options.length_set(options.allowance[kind])}" for kind in kinds}
    if casing and "wire" in told and options.wire["casing"]:
        told["wire"] += f", casing {options.length_set(options.wire['casing'])} more"
    return ", ".join(told.values())


def cut_words(options: PatternOptions) -> str:
    """How often each piece that is drawn is cut."""
    return "cut each piece " + ("once" if options.quantity == 1 else f"{options.quantity} times")
