"""What the user should know of a scan, a cup or a piece: words for people, a code for programs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

GUESSES = frozenset({"bust_point_guessed", "guessed_marks"})
"""Codes of notes that whoever cuts the cloth should know too: a mark that pieces bear or begin at is a guess."""
UNSEEN = frozenset({"unseen_landmarks", "doubtful_landmarks"})
"""Codes of warnings that say as much of all marks."""


@dataclass(frozen=True)
class Remark:
    """One note or warning; as a string, a line for people. Nothing decides by its words, which may change.

    Attributes:
        code: what kind it is; docs/files.md lists them.
        text: what is so.
        about: what it is of, where that must be told: a file, a scan, a piece, a seam.
        remedy: what helps; empty where nothing is known to, or the text has it.
    """

    code: str
    text: str
    about: str = ""
    remedy: str = ""

    def __str__(self) -> str:
        head = f"{self.about}: " if self.about else ""
        return f"{head}{self.text}; {self.remedy}" if self.remedy else f"{head}{self.text}"


def on_paper(warnings: Iterable[Remark], facts: Mapping[str, Any]) -> tuple[Remark, ...]:
    """What patterns say of the scan and of the fit that they come from: warnings, and notes that a mark is a guess.

    Args:
        warnings: of the fit.
        facts: entries of fit.json, with its `notes` and `note_codes`.
    """
    told = tuple(warnings)
    wanted = GUESSES - ({"guessed_marks"} if UNSEEN & {one.code for one in told} else set())
    notes = map(Remark, map(str, facts.get("note_codes", ())), map(str, facts.get("notes", ())))
    return (*told, *(note for note in notes if note.code in wanted))
