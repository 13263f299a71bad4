"""The course of a batch's fits, told as that of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from brafit.fitting.solver import Callback, Step


class Course:
    """Tells of several fits of a batch as of one: steps go on where the fit before ended, and scans have their places
    in the batch.
    """

    def __init__(self, callback: Callback | None):
        self._callback, self._done, self._last = callback, 0, 0

    def of(self, places: Sequence[int], name: str) -> Callback | None:
        """What the next fit is to call.

        Args:
            places: of its scans in the batch.
            name: stands before the names of its stages; empty: nothing does.
        """
        if self._callback is None:
            return None
        self._done += self._last
        self._last = 0
        tell, done = self._callback, self._done

        def told(step: Step) -> None:
            self._last = step.total
            scans = step.scans.new_tensor(places)[step.scans] if len(step.scans) else step.scans
            stage = f"{name}, {step.stage}" if name else step.stage
            tell(replace(step, stage=stage, index=done + step.index, total=done + step.total, scans=scans))

        return told
