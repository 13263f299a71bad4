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
        return type(self), (self.file, self.cause, self.remedy)


class WrongWayError(InputError):
    """A wire that runs from its outer to its inner end, or a side that is not the wire's."""


class ApartError(InputError):
    """A cloud and marks that do not belong together: they differ in size, or lie in different places."""


class OtherUnitError(InputError):
    """Lengths that are those of another unit.

    `unit` is the one that they look like, as `scan.units` names it.
    """

    def __init__(self, file: str | Path, cause: str, remedy: str, unit: str):
        super().__init__(file, cause, remedy)
        self.unit = unit

    def __reduce__(self) -> tuple:
        return OtherUnitError, (self.file, self.cause, self.remedy, self.unit)


class ConfigError(BrafitError):
    """A setting that cannot be used: names the key, what came and what is allowed."""
