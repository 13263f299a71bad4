"""What workers need, imported once, in the process that they are forked from.

Importing this module is what that process does first. It collects no garbage, which would only look through what is
imported again and again; its workers do.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import signal

from brafit.errors import BrafitError

NEEDED = ("brafit.run.stages", "brafit.pattern.dxf", "brafit.pattern.pdf", "brafit.report.pictures", "hydra.utils")


def _all() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what an interrupt means is for the command to say
    gc.disable()
    for name in NEEDED:
        importlib.import_module(name)
    from brafit.cloud.open3d_runtime import open3d

    with contextlib.suppress(BrafitError):  # whoever needs it says so
        open3d()


_all()
