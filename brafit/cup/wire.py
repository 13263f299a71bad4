"""The wire line: the curve that the cup starts from. Numbers in parentheses: docs/formulation.md.

Every wire is held as Chebyshev series of its position by arc length, divided by length / pi, so that in these solver
units each wire of a batch has s in [0, pi]. A half-circle wire has radius 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial import chebyshev
from torch import Tensor, nn

from brafit.geometry.grid import (
    chebyshev_analysis,
    chebyshev_integral,
    chebyshev_points,
    chebyshev_polynomials,
    chebyshev_synthesis,
)
from brafit.geometry.polyline import distinct
from brafit.geometry.rotation import motion_exp
from brafit.geometry.smoothing import chord_parameter, smooth_series

LENGTH = math.pi
"""Length of every wire in solver units."""
SMOOTHING = 1e-6
"""Of the smooth wire through given points, see `brafit.geometry.smoothing.smooth_series`."""
_TERMS = 64
_CUP_FRAME = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


Lines = Tensor | np.ndarray | Sequence
"""Points of one wire line (k, 3) or of several (batch, k, 3)."""
_AROUND = 65
"""Places of a wire that its plane is taken from."""
_FRAME_TOLERANCE = 0.01
"""How far a wire's ends may be from where the cup frame has them, as a share of the span."""


class Wire(nn.Module):
    """Wire lines of B cups, inner end to outer end, in cup frames.

    Attributes:
        coefficients: Chebyshev coefficients of the positions by arc length, solver units.
        scale: millimetres (or whatever unit the wire was given in) per solver unit.
        smoothing: largest distance of the given points from the smooth wire, in the given unit; 0 for exact curves.
    """

    coefficients: Float[Tensor, "batch terms 3"]
    scale: Float[Tensor, " batch"]
    smoothing: Float[Tensor, " batch"]

    def __init__(self, coefficients: Tensor, scale: Tensor, smoothing: Tensor):
        super().__init__()
        self.register_buffer("coefficients", coefficients)
        self.register_buffer("scale", scale)
        self.register_buffer("smoothing", smoothing)

    def __len__(self) -> int:
        return self.coefficients.shape[0]

    @property
    def length(self) -> Float[Tensor, " batch"]:
        """Arc length in the given unit."""
        return self.scale * LENGTH

    def sample(self, s: Float[Tensor, " n"], derivative: int = 0) -> Float[Tensor, "batch n 3"]:
        """Positions at arc lengths s in [0, pi], or their derivatives by s; solver units.

        Args:
            s: in solver units.
            derivative: order of the derivative by s; 0: positions.
        """
        x = (2 * s.detach().cpu().double().numpy() / LENGTH - 1).clip(-1, 1)
        matrix = torch.from_numpy(chebyshev_synthesis(self.coefficients.shape[1], x, derivative))
        matrix = matrix.to(self.coefficients) * (2 / LENGTH) ** derivative
        if matrix.device.type != "cpu":
            return matrix @ self.coefficients
        # one wire at a time, so that rounding does not depend on the batch
        return torch.stack([matrix @ c for c in self.coefficients])

    def plane(self) -> tuple[Float[Tensor, "batch 3"], Float[Tensor, "batch 3"]]:
        """The plane of the wires, closed by their chords: its unit normal, from the chest outwards, and the wires' mean
        point; solver units.
        """
        line = self.sample(torch.linspace(0, LENGTH, _AROUND, dtype=self.scale.dtype, device=self.scale.device))
        area = torch.linalg.cross(line, line.roll(-1, dims=1)).sum(1)
        return area / area.norm(dim=-1, keepdim=True), line.mean(1)

    def select(self, index: Tensor) -> "Wire":
        """The wires of these batch items."""
        return Wire(self.coefficients[index], self.scale[index], self.smoothing[index])

    @staticmethod
    def of(lines: "Wire | Lines") -> "Wire":
        """The wires through given lines; a `Wire` as it is. Lines of different numbers of points: `Wire.stack`.

        Args:
            lines: (k, 3) or (batch, k, 3) points in the cup frame, inner end (the origin) first, in millimetres; at
                least 4 distinct ones. A tensor's floating type and device are kept, others give float64 on the CPU.

        Raises:
            ValueError: no array of that shape, not in the cup frame, or points that make no wire.
        """
        if isinstance(lines, Wire):
            return lines
        if isinstance(lines, Tensor) and lines.requires_grad:
            raise ValueError("a cup has no derivatives by its wire: give wire.detach()")
        try:
            array = np.asarray(lines.cpu() if isinstance(lines, Tensor) else lines, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"a wire must be an array of shape (k, 3) or (batch, k, 3): {error}") from None
        if array.ndim not in (2, 3) or array.shape[-1] != 3 or array.size == 0:
            raise ValueError(f"a wire must be an array of shape (k, 3) or (batch, k, 3), got {array.shape}")
        wires = [Wire.from_polyline(line) for line in array.reshape(-1, *array.shape[-2:])]
        for line in array.reshape(-1, *array.shape[-2:]):
            _check_frame(line)
        wire = Wire.stack(wires)
        return wire.to(lines) if isinstance(lines, Tensor) and lines.is_floating_point() else wire

    @staticmethod
    def stack(wires: Sequence["Wire"]) -> "Wire":
        """One batch of several."""
        return Wire(*(torch.cat([getattr(w, k) for w in wires]) for k in ("coefficients", "scale", "smoothing")))

    @staticmethod
    def from_omega(omega: Sequence[float], length: float, frame: Sequence[Sequence[float]] = _CUP_FRAME) -> "Wire":
        """Wire of constant rates omega, three numbers per unit length, (53): an arc or a helix, from the origin.

        Args:
            omega: omega_xi, omega_eta, omega_zeta, per unit of length.
            length: of the wire, in the same unit.
            frame: the first frame, columns xi, eta, zeta. By default zeta = +x, xi = +y, eta = +z, which makes (0, 1/R,
                0) of length pi R the half circle of radius R in z = 0, x >= 0.

        Raises:
            ValueError: length not positive.
        """
        if not length > 0:
            raise ValueError(f"wire length must be positive, got {length}")
        s = torch.from_numpy((chebyshev_points(_TERMS) + 1) / 2 * length)
        rates = s[:, None] * torch.tensor(omega, dtype=torch.float64)
        shift = torch.zeros_like(rates)
        shift[:, 2] = s
        positions = motion_exp(rates, shift)[1] @ torch.tensor(frame, dtype=torch.float64).mT
        return _from_samples(positions.numpy(), length, 0.0)

    @staticmethod
    def from_arc(radius: float, length: float) -> "Wire":
        """Planar circular arc in the cup frame: z = 0, chord along +y, bulging to +x.

        Args:
            radius: of the circle, in any unit.
            length: of the arc, in the same unit; less than the full circle's.

        Raises:
            ValueError: not positive, or longer than the full circle.
        """
        if not (radius > 0 and length > 0):
            raise ValueError(f"wire radius and length must be positive, got {radius} and {length}")
        if length >= 2 * math.pi * radius:
            raise ValueError(f"a wire of length {length} is longer than the circle of radius {radius}")
        half = length / radius / 2
        along = (math.sin(half), math.cos(half), 0.0)
        inward = (-math.cos(half), math.sin(half), 0.0)
        frame = tuple(zip(inward, (0.0, 0.0, 1.0), along, strict=True))
        return Wire.from_omega((0.0, 1 / radius, 0.0), length, frame)

    @staticmethod
    def from_polyline(points: Float[np.ndarray, "k 3"], smoothing: float = SMOOTHING) -> "Wire":
        """Smooth wire through a polyline whose ends are kept.

        The wire's `smoothing` is the largest distance of the given points from it.

        Args:
            points: inner end first, in the cup frame; repeated ones count once.
            smoothing: of `brafit.geometry.smoothing.smooth_series`, in solver units.

        Raises:
            ValueError: fewer than 4 distinct points, or points that are not finite.
        """
        points = np.asarray(points, dtype=np.float64)
        if not np.isfinite(points).all():
            raise ValueError("the wire has points that are not finite numbers")
        points = distinct(points)
        if len(points) < 4:
            raise ValueError(f"a wire needs at least 4 distinct points, got {len(points)}")
        x, chords = chord_parameter(points)
        scale = chords.sum() / LENGTH
        series = smooth_series(x, points / scale, chords, smoothing) * scale
        positions, length = _by_arc_length(series)
        wire = _from_samples(positions, length, 0.0)
        off = _distances(wire, torch.from_numpy(points) / wire.scale).max() * wire.scale
        return Wire(wire.coefficients, wire.scale, off)


def _check_frame(line: Float[np.ndarray, "k 3"]) -> None:
    """Raises ValueError unless the line is a wire in the cup frame."""
    chord = line[-1] - line[0]
    span = float(np.linalg.norm(chord))
    off = max(np.abs(line[0]).max(), np.abs(chord[[0, 2]]).max()) > _FRAME_TOLERANCE * span
    if off or chord[1] <= 0 or line[:, 0].mean() <= 0:
        where = "inner end in the origin, outer end on +y, bottom towards +x, +z out of the chest"
        remedy = "brafit.landmarks.cup_frame.frame_from_wire gives that frame, brafit.scan.load_scan a scan in it"
        raise ValueError(f"the wire is not in the cup frame ({where}): {remedy}")


def _from_samples(positions: np.ndarray, length: float, smoothing: float) -> Wire:
    """One wire from its positions at Chebyshev points of the arc length."""
    scale = length / LENGTH
    coefficients = chebyshev_analysis(len(positions)) @ (positions / scale)
    numbers = (torch.tensor([v], dtype=torch.float64) for v in (scale, smoothing))
    return Wire(torch.from_numpy(coefficients)[None], *numbers)


def _by_arc_length(series: np.ndarray) -> tuple[np.ndarray, float]:
    """Positions at the Chebyshev points of the arc length, and the length, of a curve given as a Chebyshev series."""
    n = 200
    x = chebyshev_points(n)
    speed = np.linalg.norm(chebyshev_polynomials(len(series) - 1, x) @ chebyshev.chebder(series), axis=1)
    arc = chebyshev_integral(n) @ speed
    arc_series = chebyshev_analysis(n) @ arc
    target = (chebyshev_points(_TERMS) + 1) / 2 * arc[-1]
    place = np.interp(target, arc, x)
    for _ in range(4):
        error = chebyshev_polynomials(n, place) @ arc_series - target
        place = (place - error / np.interp(place, x, speed)).clip(-1, 1)
    place[0], place[-1] = -1, 1
    return chebyshev_polynomials(len(series), place) @ series, float(arc[-1])


_DENSE = 4000
"""Chords of a wire that distances are measured from: round ones are off by less than 1e-7 of the length."""


def _distances(wire: Wire, points: Float[Tensor, "k 3"]) -> Float[Tensor, " k"]:
    """Distances of points from one wire: of its many chords, those at the sample nearest to each point."""
    dense = torch.from_numpy(_dense_synthesis(wire.coefficients.shape[1])) @ wire.coefficients[0]
    nearest = torch.cdist(points, dense[::20]).argmin(1)
    window = (20 * nearest[:, None] + torch.arange(-21, 22)).clamp(0, _DENSE)
    x = dense[window]
    step = x[:, 1:] - x[:, :-1]
    offset = points[:, None] - x[:, :-1]
    place = ((offset * step).sum(-1) / step.square().sum(-1).clamp_min(1e-300)).clamp(0, 1)
    return (offset - place[..., None] * step).norm(dim=-1).amin(1)


@lru_cache
def _dense_synthesis(terms: int) -> np.ndarray:
    return chebyshev_synthesis(terms, np.linspace(-1, 1, _DENSE + 1))
