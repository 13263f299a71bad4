"""A process that fits shards of batches for another one: `python -m brafit.fit.worker`, see `brafit.fit.shards`.

It takes pickled jobs (work, items) on its standard input and answers on its standard output with what it has to tell,
pickled: ("step", Step), then ("done", results) or ("error", exception).
"""

from __future__ import annotations

import os
import pickle
import sys
from functools import partial
from typing import Any

import torch


def serve() -> None:
    """Do jobs until the input ends."""
    torch.set_num_threads(1)
    # What is printed must not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)

    def tell(kind: str, content: Any) -> None:
        pickle.dump((kind, content), answers)
        answers.flush()

    while True:
        try:
            work, items = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            results = work(items, partial(tell, "step"))
        except Exception as error:
            tell("error", error)
        else:
            tell("done", results)


if __name__ == "__main__":
    try:
        serve()
    except (KeyboardInterrupt, BrokenPipeError):
        sys.exit(1)
