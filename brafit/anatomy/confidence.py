"""How far landmarks that nobody looked at can be trusted: evidence from the body's surface, and bounds for each piece.

A piece of evidence within its usual bounds counts 1, at the edge of what is possible 0, in between in proportion; the
confidence is that of the worst. Marks outside the usual are warned of, impossible ones are no breast's and refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from brafit.anatomy.apex import mound
from brafit.anatomy.body import Body
from brafit.anatomy.wire_detection import guessed_share
from brafit.anatomy.wire_ends import off_usual
from brafit.errors import InputError
from brafit.geometry.polyline import evenly_spaced, polyline_length
from brafit.remarks import Remark
from brafit.surface.normals import Surface

Shown = Callable[[float, Mapping[str, float], str], str]
"""Words for a piece of evidence, given its value, all the evidence and the breast's side."""


def _length(value: float, evidence: Mapping[str, float], side: str) -> str:
    return f"{value:.0f} mm"


def _share(value: float, evidence: Mapping[str, float], side: str) -> str:
    return f"{100 * value:.0f} %"


def _both_wires(value: float, evidence: Mapping[str, float], side: str) -> str:
    """The lengths of both wires, of which the value is the difference."""
    own, other = evidence["wire"], evidence["wire"] - value
    left, right = (own, other) if side == "left" else (other, own)
    return f"left {left:.0f} mm, right {right:.0f} mm"


@dataclass(frozen=True)
class Bound:
    """Which values of a measure are usual, and which are possible.

    Attributes:
        says: what is said of another value, with `{value}` and maybe `{side}`.
        usual, possible: least and largest value. What is not usual is warned of, what is not possible is refused.
        remedy: what helps; empty where the sentence goes on.
        shown: words for a value among evidence.
    """

    says: str
    usual: tuple[float, float]
    possible: tuple[float, float] = (-np.inf, np.inf)
    remedy: str = ""
    shown: Shown = _length

    def is_usual(self, value: float) -> bool:
        """Whether the value needs no warning; nan does."""
        return bool(self.usual[0] <= value <= self.usual[1])

    def is_possible(self, value: float) -> bool:
        """Whether the value need not be refused; nan is."""
        return bool(self.possible[0] <= value <= self.possible[1])

    def confidence(self, value: float) -> float:
        """1 within the usual, falling to 0 where it becomes impossible; outside the usual never more than 0.9."""
        if self.is_usual(value):
            return 1.0
        k = 0 if value < self.usual[0] else 1
        wide = abs(self.possible[k] - self.usual[k])
        if not np.isfinite(wide):
            return 0.5
        return float(np.clip(1 - abs(value - self.usual[k]) / wide, 0.0, 0.9))

    def sentence(self, shown: str, side: str = "") -> str:
        """What is said of a value, with the remedy if there is one.

        Args:
            shown: the value with its unit.
            side: of the breast.
        """
        cause = self.cause(shown, side)
        return f"{cause}; {self.remedy}" if self.remedy else cause

    def cause(self, shown: str, side: str = "") -> str:
        """What is said of a value; the arguments are those of `sentence`."""
        return self.says.format(value=shown, side=side)


OF_APEX = ("rise", "apex_out", "apex_off", "level", "mirrored")
"""Evidence on the apex; all other is on the wire."""
A_SIZE = 15.0
"""By how much (mm) wires that are sold grow from size to size."""
BOUNDS: Mapping[str, Bound] = {
    "rise": Bound(
        "the body rises by {value} at the bust point over what is about it, where a breast does by 13 and more",
        (13.0, 40.0),
        (11.0, 70.0),
    ),
    "apex_out": Bound(
        "the bust point is {value} from the body's middle, 60 to 145 are usual", (60.0, 145.0), (25.0, 170.0)
    ),
    "inner_out": Bound(
        "the wire's inner end is {value} outwards of the body's middle, 0 to 45 are usual", (0.0, 45.0), (-25.0, 80.0)
    ),
    "wire": Bound("the wire is {value} long, wires are 150 to 350 mm", (165.0, 300.0), (150.0, 350.0)),
    "inner_usual": Bound("the wire's inner end is {value} from where such a breast's wire usually begins", (0.0, 25.0)),
    "outer_usual": Bound("the wire's outer end is {value} from where such a breast's wire usually ends", (0.0, 31.0)),
    "guessed": Bound("no crease shows along {value} of the wire", (0.0, 0.4), (0.0, 0.93), shown=_share),
    "apex_off": Bound("the bust point is {value} off the surface", (0.0, 7.0), (0.0, 25.0)),
    "wire_off": Bound("a fifth of the wire is {value} and more off the surface", (0.0, 9.0), (0.0, 40.0)),
    "end_off": Bound("an end of the wire is {value} off the surface", (0.0, 12.0), (0.0, 60.0)),
    "crease": Bound(
        "the two sides disagree: the crease under this one is {value} as deep as that under the other",
        (0.5, 1.0),
        (0.2, 2.0),
        shown=_share,
    ),
    "level": Bound("the two sides disagree: one bust point is {value} higher than the other", (0.0, 20.0), (0.0, 60.0)),
    "mirrored": Bound("the two sides disagree: the bust points are {value} from being mirror images", (0.0, 35.0)),
    "wires": Bound("the two sides disagree: the wires are up to {value} from being mirror images", (0.0, 16.0)),
    "longer": Bound(
        "the wires of the two sides differ by more than a size: {value}",
        (-A_SIZE, A_SIZE),
        shown=_both_wires,
    ),
}
"""By the name of the evidence; lengths in mm. Read off 60 parametric bodies of the kinds of `scripts/check_bodies.py`
(other seeds) and scans of 14 breasts:

| | on breasts | elsewhere |
| --- | --- | --- |
| rise | 13 to 28 (half a breast: 12) | men 2 to 11, a missing breast 4 to 11, shoulder blades 9 to 13 |
| apex_out | 70 to 131 | a missing breast 30 to 194 |
| inner_out | 2 to 39 | |
| wire | 163 to 290 | |
| inner_usual | to 22 on plain bodies, to 25 on 95 % of all | from 25 on where an end is off by 30, but for some |
| outer_usual | to 29 on plain bodies, to 30 on 95 % of all | 25 to 77, in the same way |
| guessed | 0 to 0.4; very small breasts to 0.55 | men and missing breasts 0.6 to 1 |
| apex_off, wire_off, end_off | to 4, 4, 9 | wires that went astray 18 and more |
| crease | 0.6 to 1; beside half a breast 0.34 | a missing breast 0 to 0.17 |
| level | to 8 | 60 to 140 beside a missing breast |
| mirrored | to 3; beside half a breast 25 to 46 | |
| longer | to 11 where the breasts are alike; beside half a breast to 20 | |
| wires | to 16; beside half a breast 20 to 86 | 21 and more where one end is off by more than 30 |
"""


@dataclass(frozen=True)
class Confidence:
    """What speaks for the landmarks of one breast.

    Attributes:
        side: of the breast.
        evidence: its pieces, by the names of BOUNDS.
    """

    side: str
    evidence: Mapping[str, float]

    @property
    def value(self) -> float:
        """0 (impossible) to 1 (all is as usual): that of the worst piece."""
        return min((BOUNDS[key].confidence(value) for key, value in self.evidence.items()), default=1.0)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is unusual, worst first."""
        return tuple(self.sentence(key) for key in self.unusual)

    @property
    def unusual(self) -> tuple[str, ...]:
        """Names of the evidence that is unusual, worst first."""
        found = {key: BOUNDS[key].confidence(value) for key, value in self.evidence.items()}
        return tuple(key for key in sorted(found, key=lambda key: found[key]) if found[key] < 1)

    @property
    def faults(self) -> tuple[str, ...]:
        """What is impossible."""
        found = self.evidence.items()
        return tuple(self.sentence(key) for key, value in found if BOUNDS[key].confidence(value) <= 0)

    def sentence(self, key: str) -> str:
        """What is said of a piece of evidence, with its value."""
        bound = BOUNDS[key]
        return bound.sentence(bound.shown(self.evidence[key], self.evidence, self.side), self.side)


def evidence(
    surface: Surface, body: Body, side: str, apex: Float[np.ndarray, "3"], wire: Float[np.ndarray, "k 3"]
) -> dict[str, float]:
    """What the surface about a breast says of its apex and wire (inner end first), all in the scan's frame, mm.

    Args:
        surface: about the breast, with outward normals.
        body: axes of the torso.
        side: the wearer's `left` or `right`.
        apex: the bust point.
        wire: inner end first.
    """
    off = np.asarray(surface.tree.query(wire)[0])
    apex_out, inner_out = body.away(np.stack([apex, wire[0]]), side)
    inner_usual, outer_usual = off_usual((wire - apex) @ body.breast_axes(side).T)
    return {
        "rise": mound(surface, surface.points[surface.tree.query(apex)[1]]),
        "apex_out": float(apex_out),
        "inner_out": float(inner_out),
        "wire": polyline_length(wire),
        "inner_usual": float(inner_usual),
        "outer_usual": float(outer_usual),
        "guessed": guessed_share(surface, wire),
        "apex_off": float(surface.tree.query(apex)[0]),
        "wire_off": float(np.quantile(off, 0.8)),
        "end_off": float(off[[0, -1]].max()),
    }


def compared(
    body: Body,
    apexes: Mapping[str, Float[np.ndarray, "3"]],
    wires: Mapping[str, Float[np.ndarray, "k 3"]],
) -> dict[str, float]:
    """How the two sides agree.

    Args:
        body: axes of the torso, with its plane of symmetry.
        apexes: bust points by side, mm.
        wires: wire lines by side, inner ends first, mm.
    """
    left = body.left

    def image(points: np.ndarray) -> np.ndarray:
        return points - 2 * (points @ left - body.offset)[..., None] * left

    one, other = (evenly_spaced(line, 51) for line in (wires["left"], image(wires["right"])))
    return {
        "level": abs(float((apexes["left"] - apexes["right"]) @ body.up)),
        "mirrored": float(np.linalg.norm(apexes["left"] - image(apexes["right"]))),
        "wires": float(np.linalg.norm(one - other, axis=1).max()),
    }


def refusal(path: Path, found: Sequence[Confidence], how: str = "proposed") -> InputError:
    """The error of marks that are impossible.

    Args:
        path: the cloud's file, which the error names.
        found: of all sides that there are marks of, each with faults.
        how: where the marks are from, `proposed` or `mirrored`.
    """
    side = "" if len(found) > 1 else f"{found[0].side} "
    faults = "; ".join(dict.fromkeys(fault for one in found for fault in one.faults))
    if any("rise" in one.evidence and BOUNDS["rise"].confidence(one.evidence["rise"]) <= 0 for one in found):
        remedy = "If there is one, mark it by hand; a scan of a standing torso from all sides shows it best"
        return InputError(path, f"no {side}breast was found: {faults}", remedy)
    if how == "mirrored":
        cause = f"the other side's marks, mirrored, are not those of the {side}breast: {faults}"
        return InputError(path, cause, f"Add the {side}breast to the landmark file: breasts: [...]")
    cause = f"the landmarks proposed for the {side}breast are not plausible: {faults}"
    return InputError(path, cause, "Mark them by hand, on a page of brafit-mark")


OFF = "give or take 3 mm at the bust point and 15 mm at the wire's ends, on some bodies 12 and 28 mm"
"""How far proposed landmarks that nothing unusual was told of lay off the truth on 220 made bodies, median and largest
(docs/proposals.md)."""


def warning(found: Confidence, how: str = "proposed", *, shown: bool = False) -> Remark | None:
    """What is said of marks that nobody looked at: their doubts; of proposed ones without any, how far such lie off all
    the same. None for mirrored ones without doubts.

    Args:
        found: what speaks for the marks of one breast.
        how: where the marks are from, `proposed` or `mirrored`.
        shown: whoever reads it sees them already.
    """
    if words := doubt(found, how, shown=shown):
        return Remark("doubtful_landmarks", words)
    words = f"nobody has looked at the proposed landmarks, {OFF}: {_remedy(shown)}"
    return Remark("unseen_landmarks", words) if how == "proposed" else None


def doubt(found: Confidence, how: str = "proposed", *, shown: bool = False) -> str:
    """The warning of marks that are unusual, in one line; empty where they are not.

    Args:
        found: what speaks for the marks of one breast.
        how: where the marks are from, `proposed` or `mirrored`.
        shown: whoever reads it sees them already.
    """
    if not found.doubts:
        return ""
    told = f"the landmarks are {how}, and doubtful (confidence {found.value:.1f})"
    more = "" if shown else ", mark by hand what is wrong"
    return f"{told}: {'; '.join(found.doubts)}. {_remedy(shown).capitalize()}{more}"


def _remedy(shown: bool) -> str:
    return "mark by hand what is wrong" if shown else "look at them with brafit-inspect"
