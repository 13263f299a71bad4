"""A file that is sound, but of a kind that is not read: what it is, and what to do about it."""

from __future__ import annotations


class RefusedError(ValueError):
    """`cause` says what the file holds that is not read, `remedy` what the user can do."""

    def __init__(self, cause: str, remedy: str):
        self.cause, self.remedy = cause, remedy
        super().__init__(f"{cause}. {remedy}")

    def __reduce__(self) -> tuple:
        return RefusedError, (self.cause, self.remedy)
