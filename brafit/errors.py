"""What can go wrong, said in one line: the file, the cause, and what to do about it."""

from __future__ import annotations

from pathlib import Path

from brafit.naming import shown


class BrafitError(Exception):
    """Base of every error that brafit raises on purpose."""


class InputError(BrafitError):
    """An input that cannot be used.

    `file` is the file (or the override) at fault, `cause` says what is wrong with it and
    `remedy` what the user can do. `str(error)` is one line holding all three, in letters that can be written.
    """

    def __init__(self, file: str | Path, cause: str, remedy: str):
        self.file, self.cause, self.remedy = str(file), cause, remedy
        line = f"{self.file}: {cause.rstrip('.')}. {remedy.rstrip('.')}."
        super().__init__(shown(" ".join(line.split())))

    def __reduce__(self) -> tuple:
        return InputError, (self.file, self.cause, self.remedy)


class ConfigError(BrafitError):
    """A setting that cannot be used: names the key, what came and what is allowed."""
