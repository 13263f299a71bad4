"""Which points of a scan move the ridge of its cup most: a picture, from derivatives through the fit.

    python examples/which_points_move_the_ridge.py [SCAN] [PICTURE] [key=value ...]

Every point is given by how far the ridge moves, in the mean along it, for a millimetre that the point alone moves.
Prints the point that moves it most, the median point, and how many points hold half of all influence.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch

import brafit
from brafit.fitting import FittedCups, TensorTarget
from brafit.samples import sample_paths

PLACES = 12
"""Places along the ridge that are looked at."""


def influence(cups: FittedCups, points: torch.Tensor) -> np.ndarray:
    """Millimetres that the ridge moves for a millimetre of each point, (n): the root mean square over places on it."""
    ridge = cups.edges[0, 1]
    inner = np.linspace(0, len(ridge) - 1, PLACES + 2).round().astype(int)[1:-1]
    along = torch.nn.functional.normalize(ridge[inner + 1] - ridge[inner - 1], dim=1).detach()
    across = ridge[inner] - (ridge[inner] * along).sum(1, keepdim=True) * along
    rows = [torch.autograd.grad(value, points, retain_graph=True)[0] for value in across.flatten()]
    return (torch.stack(rows).square().sum((0, 2)) / PLACES).sqrt().numpy()


def draw(points: np.ndarray, moved: np.ndarray, edges: np.ndarray, path: Path) -> None:
    """The cloud from the front and from the side, coloured, with the cup's edges."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    front, side = np.ptp(edges[..., 1]), np.ptp(edges[..., 2])
    figure, axes = plt.subplots(
        1, 2, figsize=(11, 6), layout="constrained", sharey=True, width_ratios=(front, side + 0.1 * front)
    )
    order = moved.argsort()
    for axis, (across, title) in zip(axes, ((1, "from the front"), (2, "from the side")), strict=True):
        dots = axis.scatter(points[order, across], -points[order, 0], c=moved[order], s=9, cmap="viridis", vmin=0)
        for edge, name in zip(edges, ("wire", "ridge", "upper edge"), strict=False):
            axis.plot(edge[:, across], -edge[:, 0], lw=3 if name == "ridge" else 1, color="black", label=name)
        axis.set(aspect="equal", title=title, xlabel="mm")
    axes[0].set_ylabel("mm, upwards")
    axes[0].legend(("scan's points", "wire (lower) and upper edge", "ridge"), loc="upper left")
    figure.colorbar(dots, ax=axes, label="mm that the ridge moves for a mm of this point alone")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(scan: Path, picture: Path, settings: Sequence[str]) -> None:
    layer, (target,) = brafit.layer([scan], settings=settings)
    points = torch.from_numpy(target.points).requires_grad_()
    cups = layer([TensorTarget.of(target, points=points)])
    moved = influence(cups, points)
    draw(target.points, moved, cups.edges[0].detach().numpy(), picture)

    most, half = moved.argmax(), np.sort(moved**2)[::-1].cumsum().searchsorted(0.5 * (moved**2).sum()) + 1
    print(f"{target.name}: {len(moved)} points, the ridge {cups.lengths()[0, 1]:.1f} mm long")
    print(f"the point that moves it most, at {target.points[most].round(1)}: {moved[most]:.4f} mm a mm")
    print(f"the median point: {np.median(moved):.4f} mm a mm; half of all influence is in {half} points")
    print(f"picture: {picture}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("scan", nargs="?", type=Path, default=sample_paths()[1])
    parser.add_argument("picture", nargs="?", type=Path, default=Path("runs/which_points_move_the_ridge.png"))
    parser.add_argument("settings", nargs="*", metavar="key=value")
    main(**vars(parser.parse_args()))
