"""What is added to the sewing lines, and which files are written."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from brafit.errors import ConfigError
from brafit.pattern.writers import WRITERS, PatternWriter, check_writers

FORMATS = tuple(WRITERS)
PAPERS: dict[str, tuple[float, float]] = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
"""Width and height in mm."""
UNITS: dict[str, float] = {"mm": 1.0, "inch": 25.4}
"""Names of the units that patterns are labelled in, and millimetres to one of each."""


NOTCHES = ("slit", "v", "t")
ARROWS = ("grain", "stretch")
"""What pieces are laid along."""


@dataclass(frozen=True)
class PatternOptions:
    """How patterns are finished and written. Lengths are mm.

    Attributes:
        formats: pattern files to write: names of `FORMATS`, and writers from outside of brafit.
        meshes: files of the cup in 3D to write: names and writers that `brafit.report.cup_writers` knows.
        report: whether to write web pages.
        allowance: seam allowance of each kind of edge: `wire`, `ridge`, `upper`.
        ease: by how many per cent pieces are made larger (negative: smaller, for stretch cloth) along the wire's chord
            (`width`) and at right angles to it (`height`). Allowances keep their width.
        cloth: what the cup is made of, each 0 for without: `thickness`, mm: the cup is the middle of the material,
            half of it outside of the skin; `stretch` and `stretch_across`, by how many per cent of its length the cloth
            is stretched along and across the grain line when the cup is worn: pieces are cut smaller by that, see
            `brafit.pattern.cloth`.
        notches: matching notches on the wire and on each seam; those in the outer half are double.
        notch_depth: length of a notch; at most two thirds of the allowance are cut into.
        notch_form: one of `NOTCHES`: a slit, a V that is cut out, or a slit with a bar at its end.
        notch_width: of a V, and of a T's bar.
        grain: direction of the grain line in degrees from the chord of the piece's lower edge, as seen on a left cup;
            right ones are its mirror image.
        arrow: what that line is laid along, of `ARROWS`: the grain, or the direction of the cloth's greatest stretch.
        wire: the wire's channel, each 0 for without: `casing`, cloth beyond the wire edge's allowance that is turned
            over the wire (bought channelling needs none); `play`, by how much the channel is longer than the wire at
            each end, where notches mark the wire's ends; `spring`, by how much the worn wire is opened from end to end.
        pair: whether the pieces for the other side are drawn as well.
        quantity: how often each piece that is drawn is to be cut.
        size: name of the size, for labels and block names; empty: the scan's name.
        units: unit of labels, tables and DXF files, of `UNITS`.
        paper: paper of the tiled PDF, of `PAPERS`.
        material_width: usable width of the cloth, at right angles to the grain.
        seam_tolerance: the two sides of a seam may differ in length by this much without a warning.
        twist_limit: twist (degrees) up to which a panel passes for developable without a warning.
        nest: whether all patterns of a run are also written into one file of each format.

    Raises:
        ConfigError: names the setting, what came and what is allowed.
    """

    formats: Sequence[str | PatternWriter] = FORMATS[:3]
    meshes: Sequence[Any] = ("ply", "obj", "glb")
    report: bool = True
    allowance: Mapping[str, float] = field(default_factory=lambda: {"wire": 6.0, "ridge": 6.0, "upper": 6.0})
    ease: Mapping[str, float] = field(default_factory=lambda: {"width": 0.0, "height": 0.0})
    cloth: Mapping[str, float] = field(
        default_factory=lambda: {"thickness": 0.0, "stretch": 0.0, "stretch_across": 0.0}
    )
    notches: int = 2
    notch_depth: float = 3.0
    notch_form: str = "slit"
    notch_width: float = 3.0
    grain: float = 90.0
    arrow: str = "grain"
    wire: Mapping[str, float] = field(default_factory=lambda: {"casing": 0.0, "play": 0.0, "spring": 0.0})
    pair: bool = False
    quantity: int = 1
    size: str = ""
    units: str = "mm"
    paper: str = "a4"
    material_width: float = 1400.0
    seam_tolerance: float = 0.5
    twist_limit: float = 3.0
    nest: bool = False

    def __post_init__(self) -> None:
        check_writers(self.formats)
        _one_of("units", self.units, UNITS)
        _one_of("paper", self.paper, PAPERS)
        for kind in ("wire", "ridge", "upper"):
            _at_least(f"allowance.{kind}", self.allowance.get(kind), 0.0)
        for part in ("casing", "play", "spring"):
            _at_least(f"wire.{part}", self.wire.get(part), 0.0)
        for way in ("width", "height"):
            _at_least(f"ease.{way}", self.ease.get(way), -50.0)
        for name in ("thickness", "stretch", "stretch_across"):
            _at_least(f"cloth.{name}", self.cloth.get(name), 0.0)
        _one_of("notch_form", self.notch_form, NOTCHES)
        _one_of("arrow", self.arrow, ARROWS)
        for name in ("notches", "notch_depth", "notch_width", "seam_tolerance", "twist_limit"):
            _at_least(name, getattr(self, name), 0.0)
        _at_least("quantity", self.quantity, 1)
        _at_least("material_width", self.material_width, 1.0)

    @property
    def by_stretch(self) -> bool:
        """Whether pieces are laid by the cloth's greatest stretch instead of its grain."""
        return self.arrow == "stretch"

    def allowed(self, kind: str) -> float:
        """The allowance of a kind of edge, the casing's cloth included."""
        return float(self.allowance[kind]) + (self.wire["casing"] if kind == "wire" else 0.0)

    def length(self, millimetres: float, digits: int = 1) -> str:
        """A length as labels show it, with its unit."""
        value = millimetres / UNITS[self.units]
        return f"{value:.{digits}f} mm" if self.units == "mm" else f"{value:.{digits + 1}f} in"

    def length_set(self, millimetres: float) -> str:
        """A length that a setting gives: where labels are in inches, in mm too, as the setting has it."""
        told = self.length(millimetres)
        return told if self.units == "mm" or not millimetres else f"{told} ({millimetres:g} mm)"

    def area(self, square_centimetres: float, digits: int = 1) -> str:
        """An area as tables show it, with its unit."""
        if self.units == "mm":
            return f"{square_centimetres:.{digits}f} cm²"
        return f"{square_centimetres * (10 / UNITS[self.units]) ** 2:.{digits}f} in²"


def _one_of(name: str, value: str, choices: Collection[str]) -> None:
    if value not in choices:
        raise ConfigError(f"pattern.{name}={value}: must be one of {', '.join(choices)}")


def _at_least(name: str, value: float | None, least: float) -> None:
    if value is None or not value >= least:
        raise ConfigError(f"pattern.{name}={value}: must be at least {least:g}")
