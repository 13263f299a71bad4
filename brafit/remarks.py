"""What the user should know of a scan, a cup or a piece: words for people, a code for programs."""

from __future__ import annotations

from dataclasses import dataclass


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
