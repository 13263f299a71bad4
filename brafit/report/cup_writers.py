"""Writers of files of the cup in 3D: brafit's own by their names, and what others must look like: docs/extending.md."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.errors import ConfigError
from brafit.pattern import Pattern, PatternWriter, Piece
from brafit.pattern.writers import OTHER_FILES, check_files, no_writer, written
from brafit.pattern.writers import WRITERS as PATTERN_WRITERS
from brafit.report.mesh import (
    PanelMesh,
    Place,
    panel_meshes,
    write_cup_glb,
    write_cup_obj,
    write_cup_ply,
    write_points_ply,
)
from brafit.report.stitches import write_stitches


@dataclass(frozen=True, eq=False)
class FormedCup:
    """A fitted cup as its files are made of it.

    Attributes:
        shape: edges, rulings and normals in the cup frame, mm. A panel is a ruled surface: exactly so, a writer has it
            from the edges and their tangents.
        place: from the cup frame to the frame of the scan, which files are written in.
        points, distances: of the scan, in its own frame, mm; signed, positive outside the cup.
        pieces: the sewing lines of the flat pieces, from the wire up.
        pattern: the same, finished.
    """

    shape: CupShape
    place: Place
    points: Float[ndarray, "n 3"]
    distances: Float[ndarray, " n"]
    pieces: Sequence[Piece]
    pattern: Pattern

    @cached_property
    def panels(self) -> list[PanelMesh]:
        """A triangle mesh of each panel, in the frame of the scan, with every vertex's place in the flat pattern."""
        return panel_meshes(self.shape, self.pieces, place=self.place)


class CupWriter(ABC):
    """Writes a cup into a folder.

    Attributes:
        files: names of all files that it writes, without folders.
    """

    files: tuple[str, ...]

    @abstractmethod
    def write(self, folder: Path, cup: FormedCup) -> None:
        """Write the files, each whole or not at all (`brafit.atomic`).

        Args:
            folder: made if it does not exist.
            cup: of one scan.
        """


class PlyWriter(CupWriter):
    """The cup, and the scan's points with their distances."""

    files = ("cup.ply", "points.ply")

    def write(self, folder: Path, cup: FormedCup) -> None:
        write_cup_ply(folder / "cup.ply", cup.shape, cup.place)
        write_points_ply(folder / "points.ply", cup.points, cup.distances)


class ObjWriter(CupWriter):
    """The cup with its flat pattern as texture, and the stitch list for programs that sew."""

    files = ("cup.obj", "stitches.json")

    def write(self, folder: Path, cup: FormedCup) -> None:
        write_cup_obj(folder / "cup.obj", cup.panels)
        write_stitches(folder / "stitches.json", cup.panels, cup.pattern, "cup.obj")


class GlbWriter(CupWriter):
    """The cup for viewers."""

    files = ("cup.glb",)

    def write(self, folder: Path, cup: FormedCup) -> None:
        write_cup_glb(folder / "cup.glb", cup.panels)


WRITERS: dict[str, CupWriter] = {"ply": PlyWriter(), "obj": ObjWriter(), "glb": GlbWriter()}
"""brafit's own, as `pattern.meshes` names them."""


def check_cup_writers(meshes: Iterable[object], formats: Iterable[str | PatternWriter] = ()) -> None:
    """Refuse what is no writer of cups.

    Args:
        meshes: names of `WRITERS`, and writers from outside of brafit.
        formats: the writers of patterns beside them.

    Raises:
        ConfigError: a name that no writer has, an object that is no writer, or two that write the same file.
    """
    others = [writer for writer in formats if not isinstance(writer, str)]
    seen = {file for writer in (*PATTERN_WRITERS.values(), *WRITERS.values()) for file in writer.files} | {*OTHER_FILES}
    for writer in others:
        if taken := {file for own in WRITERS.values() for file in own.files} & {*writer.files}:
            who = type(writer).__name__
            raise ConfigError(f"pattern.formats: {who} writes {min(taken)}, which something else writes")
        seen |= {*writer.files}
    for entry in meshes:
        if isinstance(entry, CupWriter):
            seen |= check_files("pattern.meshes", entry, seen)
        elif not (isinstance(entry, str) and entry in WRITERS):
            raise no_writer("pattern.meshes", entry, WRITERS, "brafit.report.cup_writers.CupWriter")


def write_cup(folder: Path, cup: FormedCup, meshes: Iterable[str | CupWriter]) -> list[Path]:
    """Write a cup's files, by brafit's own writers (names of `WRITERS`) and others.

    Args:
        folder: of the scan.
        cup: what is written.
        meshes: the writers.

    Returns:
        the files, in the order written.

    Raises:
        RuntimeError: a writer that left a file unwritten.
    """
    files: list[Path] = []
    for entry in meshes:
        writer = WRITERS[entry] if isinstance(entry, str) else entry
        writer.write(folder, cup)
        files += written(folder, writer)
    return files
