"""Clouds with a known truth: the quarter sphere of the paper's Case 1 and points on a given cup, its Case 2
(docs/formulation.md, section 6).
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.shape import CupShape
from brafit.geometry.hermite import hermite, hermite_slope

PAPER_RADIUS = 1 / 2.91
"""Radius of the paper's wire and sphere: its wire has the constant omega (0, 2.91, 0)."""


def quarter_sphere(n: int, radius: float, generator: np.random.Generator) -> Float[Tensor, "n 3"]:
    """Points uniform by area on {|p - (0, R, 0)| = R, x > 0, z > 0}, in the cup frame (the paper's Case 1).

    Args:
        n: number of points.
        radius: R, in any unit.
        generator: of the random numbers.
    """
    direction = generator.standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # The sphere's symmetry: reflecting three of its quarters into the fourth keeps the distribution uniform.
    direction[:, [0, 2]] = np.abs(direction[:, [0, 2]])
    return torch.from_numpy(radius * (direction + np.array([0.0, 1.0, 0.0])))


def on_panels(shape: CupShape, n: int, generator: np.random.Generator) -> Float[Tensor, "n 3"]:
    """Points uniform by area on all panels of one cup (no batch dimension), in its unit (the paper's Case 2).

    Between stations the edges are interpolated by cubic Hermite polynomials with their tangents (error h^4/384 times
    the fourth derivative), far below what linear interpolation of the rulings would leave. Uniformity comes from
    rejection against the area element |dX/ds x dX/du| of X(s, u) = (1 - u) lower(s) + u upper(s).

    Args:
        shape: one cup.
        n: number of points.
        generator: of the random numbers.

    Raises:
        ValueError: the shape has a batch dimension.
    """
    edges, tangents = (t.detach().cpu().double().numpy() for t in (shape.edges, shape.tangents))
    stations = shape.stations.detach().cpu().double().numpy()
    if edges.ndim != 3:
        raise ValueError(f"on_panels takes one cup, edges (panels + 1, n, 3), not {edges.shape}")
    bound = 1.1 * _largest_area_element(stations, edges, tangents)
    chosen, missing = [np.empty((0, 3))], n
    while missing > 0:
        tries = 2 * missing + 100
        panel = generator.integers(len(edges) - 1, size=tries)
        s = generator.uniform(stations[0], stations[-1], size=tries)
        points, area = _ruled(stations, edges, tangents, panel, s, generator.random(tries))
        accepted = points[generator.random(tries) * bound < area][:missing]
        chosen.append(accepted)
        missing -= len(accepted)
    return torch.from_numpy(np.concatenate(chosen))


def _largest_area_element(stations: np.ndarray, edges: np.ndarray, tangents: np.ndarray) -> float:
    """The largest area element on a grid that has four samples between neighbouring stations."""
    fine = np.interp(np.linspace(0, len(stations) - 1, 4 * len(stations)), np.arange(len(stations)), stations)
    panel, s, u = (a.ravel() for a in np.meshgrid(np.arange(len(edges) - 1), fine, np.linspace(0, 1, 9)))
    return float(_ruled(stations, edges, tangents, panel, s, u)[1].max())


def _ruled(
    stations: np.ndarray, edges: np.ndarray, tangents: np.ndarray, panel: np.ndarray, s: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points at (panel, s, u) and the area element there."""
    lower, d_lower = _hermite(stations, edges, tangents, panel, s)
    upper, d_upper = _hermite(stations, edges, tangents, panel + 1, s)
    u = u[:, None]
    area = np.cross((1 - u) * d_lower + u * d_upper, upper - lower)
    return (1 - u) * lower + u * upper, np.linalg.norm(area, axis=1)


def _hermite(
    stations: np.ndarray, edges: np.ndarray, tangents: np.ndarray, edge: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and derivatives of the edges at s."""
    k = np.clip(np.searchsorted(stations, s, side="right") - 1, 0, len(stations) - 2)
    steps = stations[k + 1] - stations[k]
    tau, h = torch.from_numpy((s - stations[k]) / steps), torch.from_numpy(steps)
    samples = np.stack((edges[edge, k], edges[edge, k + 1], tangents[edge, k], tangents[edge, k + 1]), axis=1)
    position, derivative = (
        (weights.numpy()[:, :, None] * samples).sum(axis=1) for weights in (hermite(tau, h), hermite_slope(tau, h))
    )
    return position, derivative / steps[:, None]
