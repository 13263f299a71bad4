"""A fitted cup with all that can be made of it: patterns, surface, distances, files."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Int32, UInt8
from numpy import ndarray

from brafit.atomic import write_bytes
from brafit.cup.shape import CupShape
from brafit.cup.wire import Wire
from brafit.errors import InputError
from brafit.fitting import CupFit, Target
from brafit.fitting.certainty import outline_deviation
from brafit.fitting.result import EdgeDeviations, Survey
from brafit.landmarks import CupFrame
from brafit.pattern import (
    Pattern,
    PatternOptions,
    Piece,
    Side,
    finish,
    marks_on,
    pieces_from_panels,
    write_patterns,
)
from brafit.pattern.writers import OTHER_FILES, WRITERS
from brafit.remarks import on_paper
from brafit.report import cup_writers
from brafit.report.dimensions import Dimension, dimensions, survey_of
from brafit.report.mesh import PanelMesh, mesh_view, panel_meshes
from brafit.report.paper import PaperPanel, paper_gap, paper_panels
from brafit.report.row import fitted_row
from brafit.report.table import write_fit_json

FILES = (
    *(name for writer in (*WRITERS.values(), *cup_writers.WRITERS.values()) for name in writer.files),
    *(name for name in OTHER_FILES if name != "fit.json"),
)
"""Every file of brafit's own that a result may consist of, besides fit.json."""


@dataclass(frozen=True, eq=False)
class Result:
    """One fitted cup.

    Attributes:
        fit: the fit: shape, flat panels and figures, in the cup frame.
        target: what was fitted, in the cup frame, mm.
        side: the wearer's side; right cups are mirrored in the cup frame.
        frame: leads from the cup frame to the frame of the points that were given.
        options: how patterns are finished and which files are written.
        sources: for each input, what was given and what was taken in its place.
        model: cup, solver, panels and terms, by their keys in summary.csv.
        facts: what is known of the scan, as further entries of fit.json; `notes` stand in the report.
    """

    fit: CupFit
    target: Target
    side: Side
    frame: CupFrame
    options: PatternOptions = field(default_factory=PatternOptions)
    sources: Mapping[str, str] = field(default_factory=dict)
    model: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.target.name

    @property
    def shape(self) -> CupShape:
        """Edges and rulings in the cup frame, mm."""
        return self.fit.shape

    @property
    def panels(self) -> int:
        """How many panels the cup has, such as `cup.panels=auto` chose."""
        return len(self.fit.panels)

    @property
    def figures(self) -> dict[str, float]:
        """The measured figures by their names in fit.json."""
        return self.fit.figures

    @cached_property
    def apex(self) -> Float[ndarray, "3"]:
        """The bust point in the cup frame: as given, or guessed from the points, see `Target.bust_point`."""
        return self.target.bust_point

    @cached_property
    def pieces(self) -> list[Piece]:
        """The sewing lines of the flat pieces, from the wire up."""
        marks = marks_on(self.shape, self.apex, self.target.strap_point)
        return pieces_from_panels(self.fit.panels, self.side, marks)

    @cached_property
    def _pattern(self) -> Pattern:
        return finish(
            self.pieces,
            self.options,
            name=self.name,
            side=self.side,
            date=date.today().isoformat(),
            figures=self.fit.figures,
            fit_warnings=on_paper(self.fit.warnings, self.facts),
        )

    def patterns(self) -> Pattern:
        """The flat pieces, finished: sewing and cut lines, notches, grain lines, labels, warnings; mm.

        Its `warnings` are of the pieces, `fit_warnings` those of the fit and its marks that were guessed; files show
        both.
        """
        return self._pattern

    def surface(self, strips: int = 8) -> list[PanelMesh]:
        """A triangle mesh of each panel in the given points' frame, with every vertex's place in the flat pattern.

        Args:
            strips: rows of triangles across each panel.
        """
        return panel_meshes(self.shape, self.pieces, strips, self.frame.to_scan)

    def distance(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
        """Signed distance in mm of points, in the given points' frame, from the cup; positive outside."""
        inside = torch.as_tensor(self.frame.to_cup(np.asarray(points, float)), dtype=torch.float64)
        return self.shape.distances(inside).numpy()

    def dimensions(self) -> list[Dimension]:
        """Finished dimensions of pieces and cup."""
        return list(self._dimensions)

    @cached_property
    def _dimensions(self) -> list[Dimension]:
        marks = (self.apex, self.target.strap_point)
        return dimensions(self.fit, self.patterns(), *marks, self._survey)

    @cached_property
    def _survey(self) -> Survey:
        """Of the whole batch at once, or of this cup now."""
        if self.fit.survey is not None:
            return self.fit.survey
        return survey_of(self.fit, self.fit.alternatives, self.apex, self.target.strap_point)

    @property
    def _outlines(self) -> Sequence[EdgeDeviations]:
        known = self._survey.outlines
        return known or (outline_deviation(self.fit.panels, self.fit.alternatives) if self.fit.alternatives else ())

    def pictures(self) -> dict[str, bytes]:
        """PNG files: `patterns`, the finished pieces, and `fit`, cup and points from three sides."""
        from brafit.report.pictures import fit_picture, pattern_picture

        fit = fit_picture(self.target.points, self.fit.distances, self.shape, self.name, self.side)
        return {"patterns": pattern_picture(self.patterns(), self.name), "fit": fit}

    def mesh_view(self) -> tuple[Float32[ndarray, "v 3"], UInt8[ndarray, "v 3"], Int32[ndarray, "f 3"]]:
        """Cup and points as they are worn, as one mesh to look at: vertices, colours, faces."""
        return mesh_view(self.shape, self.target.points, self.fit.distances, self.side)

    def row(self) -> dict[str, Any]:
        """This cup's row of summary.csv."""
        neckline = self.target.neckline is not None
        row = fitted_row(self.fit, self.side, len(self.target.points), self.model, neckline, self.options.wire)
        return row | {"warning_count": len(self.fit.warnings) + len(self.patterns().warnings)}

    def save(self, folder: str | Path, extra: Mapping[str, Any] | None = None) -> list[Path]:
        """Write fit.json, the patterns, meshes and pages that the options ask for.

        Args:
            folder: of the scan; it is made if it is missing.
            extra: further entries of fit.json.

        Returns:
            the files, in the order written. Files of an earlier result that are not asked for now are removed.

        Raises:
            ConfigError: the options ask for files that no writer makes, or two make.
            InputError: the folder cannot be made.
        """
        folder, facts = Path(folder), {**self.facts, **(extra or {})}
        cup_writers.check_cup_writers(self.options.meshes, self.options.formats)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            cause = f"this folder cannot be made ({error.strerror or error})"
            raise InputError(folder, cause, "Save to a folder that can be written to") from None
        written = self._write_patterns(folder)
        written += cup_writers.write_cup(folder, self._formed, self.options.meshes)
        if self.options.report:
            written += self._write_pages(folder, [file.name for file in written], facts.get("notes", ()))
        for name in result_files(folder):
            if folder / name not in written:
                (folder / name).unlink(missing_ok=True)
        pattern = self.patterns()
        details = {
            "code": self.fit.code.name,
            "warnings": [str(warning) for warning in self.fit.warnings],
            "warning_codes": [warning.code for warning in self.fit.warnings],
            "edges_mm": {piece.name: {line.name: line.length for line in piece.sew} for piece in pattern.pieces},
            "frame": {"origin": self.frame.origin, "axes": self.frame.axes},
            "wire": wire_entry(self.fit.wire or Wire.from_polyline(self.target.wire)),
            "parameters": self.fit.parameters,
            "conditions": self.fit.conditions,
            "choice": self.fit.choice,
            "pattern": {
                "warnings": [str(warning) for warning in pattern.warnings],
                "warning_codes": [warning.code for warning in pattern.warnings],
                "seams_mm": pattern.seams,
                "notches_mm": {piece.name: _notches(piece) for piece in pattern.pieces},
                "paper_cup_mm": self._paper_gap,
                "dimensions": [[d.part, d.name, d.value, d.unit, d.sd] for d in self.dimensions()],
            },
            "sources": self.sources,
            "files": [file.name for file in written],
        }
        path = folder / "fit.json"
        write_fit_json(path, self.row(), details | facts)
        return [*written, path]

    @cached_property
    def _papers(self) -> list[PaperPanel]:
        return paper_panels(self.shape, self.fit.panels)

    @cached_property
    def _paper_gap(self) -> float:
        return paper_gap(self.shape, self._papers)

    @property
    def _note(self) -> str:
        """The second line of pattern files."""
        count = f"{self.panels} panel{'s' * (self.panels > 1)}"
        sides = "left and right" if self.options.pair else self.side
        return ", ".join(str(words) for words in (f"{sides} cup", self.model.get("cup"), count) if words)

    @cached_property
    def _drawing(self) -> bytes:
        """The pattern as SVG."""
        from brafit.pattern.svg import svg_bytes

        return svg_bytes([self.patterns()], self.name, self._note)

    def _write_patterns(self, folder: Path) -> list[Path]:
        formats, drawing = self.options.formats, folder / "patterns.svg"
        if "svg" in formats:  # drawn once, for the report as well
            write_bytes(drawing, self._drawing)
        others = [name for name in formats if name != "svg"]
        written = write_patterns(folder, [self.patterns()], self.name, self._note, others)
        return [drawing, *written] if "svg" in formats else written

    @property
    def _formed(self) -> cup_writers.FormedCup:
        place, pattern = self.frame.to_scan, self.patterns()
        points = place(self.target.points)
        return cup_writers.FormedCup(self.shape, place, points, self.fit.distances, self.pieces, pattern)

    def _write_pages(self, folder: Path, files: Sequence[str], notes: Sequence[str]) -> list[Path]:
        from brafit.report.page import ScanPage, write_report
        from brafit.report.pictures import thumbnail

        content = ScanPage(
            row=self.row(),
            side=self.side,
            shape=self.shape,
            papers=self._papers,
            gap=self._paper_gap,
            points=self.target.points,
            distances=self.fit.distances,
            pattern=self.patterns(),
            drawing=self._drawing,
            dimensions=self.dimensions(),
            band=(self.pieces, outlines) if (outlines := self._outlines) else None,
            sources=self.sources,
            files=[*files, "fit.json"],
            warnings=[*map(str, (*self.fit.warnings, *self.patterns().warnings))],
            notes=notes,
        )
        write_report(folder / "report.html", content)
        picture = thumbnail(self.target.points, self.fit.distances, self.shape, self.side)
        write_bytes(folder / "thumbnail.png", picture)
        return [folder / "report.html", folder / "thumbnail.png"]


def wire_entry(wire: Wire) -> dict[str, Any]:
    """The smooth wire of a fit (one, no more) as fit.json has it: with the parameters it makes the cup again."""
    return {"mm_per_unit": float(wire.scale), "series": wire.coefficients[0].numpy().round(15)}


def result_files(folder: Path) -> set[str]:
    """Names of the files that an earlier result may have left in a folder: FILES, and those that its fit.json names."""
    named: object = None
    with contextlib.suppress(OSError, ValueError):
        content = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
        named = content.get("files") if isinstance(content, dict) else None
    others = named if isinstance(named, list) else []
    return {
        *FILES,
        *(str(name) for name in others if str(name) not in ("", "..") and Path(str(name)).name == str(name)),
    }


def _notches(piece: Any) -> list[dict[str, Any]]:
    return [
        {"edge": n.edge, "mark": n.name or "notch", "from_inner_end": n.distance, "cuts": len(n.ticks) * n.is_cut}
        for n in piece.notches
    ]
