"""A file that is whole, but of a kind that is not read."""

from __future__ import annotations


class UnreadError(ValueError):
    """`cause` says what the file is, in the words of a sentence about it; `remedy` what to do."""

    def __init__(self, cause: str, remedy: str):
        self.cause, self.remedy = cause, remedy
        super().__init__(cause)

    def __reduce__(self) -> tuple:
        return UnreadError, (self.cause, self.remedy)
