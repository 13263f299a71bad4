"""One step of gradient descent on the shape of a body, so that its pattern fits a given width of cloth.

    python examples/fit_a_width_of_cloth.py [SCAN] [--width MM] [key=value ...]

The body's shape has three parameters: how high, wide and deep the breast is (logarithms of factors). The pattern's
width is that of the narrowest straight strip of cloth from which each of its pieces can be cut. Without --width, one
1 % narrower than the pattern is asked for. Prints the width's derivatives by the three, the step, and how far it got.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import torch

import brafit
from brafit.fitting import FittedCups, Target, TensorTarget
from brafit.samples import sample_paths


def body(target: Target, shape: torch.Tensor) -> TensorTarget:
    """The scan with its marks, as high, wide and deep as the shape says."""
    places = ("points", "wire", "neckline", "strap_point", "apex")
    given = {name: torch.as_tensor(v) for name in places if (v := getattr(target, name)) is not None}
    return TensorTarget.of(target, **{name: v * shape.exp() for name, v in given.items()})


def strip_width(cups: FittedCups) -> torch.Tensor:
    """Width of the narrowest strip that each of the pieces can be cut from, mm: over all turns of each piece."""
    outlines = torch.cat((cups.flat.lower, cups.flat.upper), dim=-2)[0]
    turn = torch.linspace(0, math.pi, 721, dtype=torch.float64)[:-1]
    across = outlines @ torch.stack((turn.cos(), turn.sin()))
    return (across.amax(-2) - across.amin(-2)).amin(-1).amax()


def main(scan: Path, wanted: float | None, settings: Sequence[str]) -> None:
    layer, (target,) = brafit.layer([scan], settings=settings)
    shape = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    cups = layer([body(target, shape)])
    width = strip_width(cups)
    (gradient,) = torch.autograd.grad(width, shape)
    wanted = 0.99 * width.item() if wanted is None else wanted
    print(f"{target.name}: its pattern needs cloth {width.item():.2f} mm wide; wanted: {wanted:.2f} mm")
    for name, rate in zip(("higher", "wider", "deeper"), gradient.tolist(), strict=True):
        print(f"  1 % {name}: {rate / 100:+.3f} mm")

    # Gradient descent on (width - wanted)^2 / 2, as far as the width would be right if it were linear in the shape.
    step = (width - wanted).detach() / gradient.square().sum()
    changed = (shape - step * gradient).detach()
    after = layer([body(target, changed)], near=cups)
    found = strip_width(after).item()
    share = (width.item() - found) / (width.item() - wanted)
    factors = ", ".join(f"{100 * (value - 1):+.2f} %" for value in changed.exp().tolist())
    print(f"one step makes the body (high, wide, deep) {factors}")
    print(f"and its pattern {found:.2f} mm wide, {found - wanted:+.2f} mm off: {share:.0%} of the way")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("scan", nargs="?", type=Path, default=sample_paths()[1])
    parser.add_argument("settings", nargs="*", metavar="key=value")
    parser.add_argument("--width", type=float, help="wanted, mm", dest="wanted")
    main(**vars(parser.parse_args()))
