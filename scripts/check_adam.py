"""How near the README's training loop comes to the solvers, on the bundled scans: python scripts/check_adam.py

Runs examples/adam_loop.py for every scan and cup model, and prints a table beside what `brafit.fit` finds.
"""

from __future__ import annotations

import contextlib
import io
import time
from pathlib import Path

import brafit
from brafit.cup import FramesCup
from brafit.fitting.measure import measured_cups
from brafit.samples import sample_paths

LOOP = Path(__file__).parents[1] / "examples" / "adam_loop.py"
MODELS = {
    "strips, 2 panels": ("StripsCup(target.wire, panels=2)", ["cup.panels=2"]),
    "strips, 3 panels": ("StripsCup(target.wire, panels=3)", ["cup.panels=3"]),
    "frames, 2 panels": ("FramesCup(target.wire, panels=2)", ["cup=frames", "solver=anneal", "restarts=2"]),
}


def looped(scan: int, made: str) -> dict:
    """What the example leaves, with another scan and cup."""
    code = LOOP.read_text().replace("sample_paths()[1]", f"sample_paths()[{scan}]")
    code = code.replace("StripsCup(target.wire, panels=2)", made)
    left = {"FramesCup": FramesCup}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(code, LOOP, "exec"), left)
    return left


def row(scan: int, name: str) -> str:
    made, settings = MODELS[name]
    known = brafit.fit(sample_paths()[scan], settings=settings).figures
    begun = time.process_time()
    left = looped(scan, made)
    seconds = time.process_time() - begun
    cup, target = left["cup"], left["target"]
    own = measured_cups(cup, [target])[0].figures
    ends = cup.ends(cup.shape()).abs().max().item() if isinstance(cup, FramesCup) else 0.0
    share = own["rms_mm"] / known["rms_mm"] - 1
    cells = [f"{known['rms_mm']:.2f}", f"{own['rms_mm']:.2f} ({share:+.1%})"]
    cells += [f"{own['upper_edge_mm']:.1f} ({known['upper_edge_mm']:.1f})", f"{own['regularity_min']:.2f}"]
    cells += [f"{own['twist_deg_max']:.1g}" if own["twist_deg_max"] < 0.01 else f"{own['twist_deg_max']:.1f}"]
    return " | ".join([f"| {name}", target.name, *cells, f"{ends:.2f}", f"{seconds:.0f} |"])


def main() -> None:
    head = "cup | scan | RMS of the solver | of the loop | upper edge off | least margin | twist | ends apart | CPU s"
    print(f"| {head} |\n|{' --- |' * 9}")
    for name in MODELS:
        for scan in range(len(sample_paths())):
            print(row(scan, name), flush=True)


if __name__ == "__main__":
    main()
