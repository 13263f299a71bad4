"""The page that `compare_peers.py` prints: what is compared, the tables, and what they say; figures are the run's."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from importlib.metadata import PackageNotFoundError, version
from types import SimpleNamespace

from flattenings import ARAP_STEPS, FILTER, FILTER_EDGE, LONG_FILTER, METHODS, SLIM_STEPS

OURS, PAPER = "brafit", "the paper's solver"
ORDER = (*METHODS, FILTER, LONG_FILTER, PAPER, OURS)
"""Rows of one number of panels."""
LONGER = 20
"""Times the evaluations that the filter gets on the sphere besides."""
DEVELOPABLE = 0.1
"""Strain (per cent) below which a part counts as developable at every triangle."""
WIRE = 200.0
"""Length of a wire, mm, at which shares of it are told in millimetres."""


def column(heading: str, largest: bool = False) -> float:
    """A figure and its heading; of several breasts the median is told, or the largest."""
    return field(metadata={"heading": heading, "largest": largest})


@dataclass(frozen=True)
class Figures:
    """What is told of one cut pattern, or of those of several breasts; per cent, millimetres, CPU seconds."""

    seconds: float = column("CPU s")
    strain_max: float = column("strain %: largest", largest=True)
    strain_most: float = column("on 95 %")
    strain_mean: float = column("mean")
    wire: float = column("wire off %")
    seams: float = column("seams off %")
    apart: float = column("seam sides differ mm")
    rms: float = column("distance mm: RMS")
    farthest: float = column("largest", largest=True)
    spread: float = column("rescans apart mm")

    @property
    def developable(self) -> bool:
        return self.strain_max < DEVELOPABLE

    @staticmethod
    def largest() -> list[bool]:
        """Of which figures the largest of several is told."""
        return [column.metadata["largest"] for column in fields(Figures)]


@dataclass(frozen=True)
class Missing:
    """A package that a row needs and that is not installed."""

    package: str


Table = dict[tuple[str, int], Figures | Missing]
"""Figures by method and number of panels."""


@dataclass(frozen=True)
class Setting:
    """What is compared, see the help of `compare_peers.py`.

    Attributes:
        panels: numbers of panels.
        rescans, noise: how many of each, and their noise, mm.
        evaluations: of MeshLab's filter.
        patience: CPU seconds of the paper's solver.
        points: of every scan.
    """

    panels: tuple[int, ...]
    rescans: int
    noise: float
    evaluations: int
    patience: float
    points: int


def page(tables: Mapping[str, Table], setting: Setting, seconds: float, surface: float) -> str:
    """The page in Markdown.

    Args:
        tables: by their headings, the sphere's first; the last one is what the text speaks of.
        setting: how they were made.
        seconds: CPU time of all.
        surface: of a scan's smooth surface, CPU s.
    """
    sphere = next(iter(tables.values()))
    *_, (heading, table) = tables.items()
    parts = [*introduction(setting, seconds), *columns(setting, surface)]
    parts += [f"## {heading}\n\n{rows(table)}" for heading, table in tables.items()]
    return "\n\n".join([*parts, *reading(table, heading, setting), *of_patience(sphere), *of_the_paper(sphere)]) + "\n"


def filled(text: str) -> str:
    """A paragraph, or an entry of a list, in lines of a page."""
    indent = "  " if text.startswith("- ") else ""
    words = " ".join(text.split())
    return textwrap.fill(words, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def introduction(setting: Setting, seconds: float) -> list[str]:
    """What is compared."""
    *first, last = map(str, setting.panels)
    counts = f"{', '.join(first)} and {last}" if first else last
    entries = [
        f"""- **LSCM, ARAP, SLIM** of {named("libigl")}: a smooth surface is laid through the points, from the wire to
        the neckline, made into triangles and cut along the ridges of brafit's cup of as many panels, seen from within
        the breast. LSCM holds each part's two tips and is scaled to the surface's area; ARAP ({ARAP_STEPS} steps) and
        SLIM ({SLIM_STEPS} steps, symmetric Dirichlet energy) start from it.""",
        f"""- **Developability filter** of {named("pymeshlab")}, `apply_coord_developability_of_mesh`: it moves that
        surface, made anew of even triangles with edges of {FILTER_EDGE:g} mm, with at most {setting.evaluations}
        evaluations of its energy, and once, on the sphere, with {LONGER} times as many. Our triangles move along with
        those; the moved surface is cut along the same lines, and its parts are flattened by ARAP. *Wire off* is from
        the wire as it was given.""",
        f"""- **The paper's solver**, on the sphere alone: the paper's cup by Nelder-Mead inside a multiplier method,
        stopped after {setting.patience:g} CPU seconds. It is told the points and the pole, brafit the points and the
        upper line; and brafit is asked for smooth edges too.""",
        "- **brafit** with its default settings, each scan by itself (in a batch it takes less, see"
        " [figures.md](figures.md)).",
    ]
    return [
        "# Flattening, other solvers, and brafit",
        filled(
            f"""Who has the surface of a breast can cut it along lines and flatten the parts. What that gives stands
            here beside brafit's cups of {counts} panels. One run prints this page, in {seconds / 60:.1f} CPU
            minutes:"""
        ),
        "```sh\npython scripts/compare_peers.py FOLDER\n```",
        filled(
            f"""With `--write` it goes into a file as well. FOLDER holds breast scans with their landmark files, of each
            of which {setting.points} points are drawn. libigl and pymeshlab are needed for this comparison only."""
        ),
        "\n".join(filled(entry) for entry in entries),
    ]


def columns(setting: Setting, surface: float) -> list[str]:
    """What the columns say."""
    entries = [
        f"""- *CPU s*: of flattening, or of the fit. The surface takes another {shown(surface)}, which a mesh of the
        breast would save, and somebody has to say where to cut it; here that is taken from brafit's fit.""",
        """- *Strain*: of every triangle's map from the surface to the flat piece the principal stretches less 1, the
        larger one by size: the largest of all triangles, what is not exceeded on 95 % of the area, the mean over the
        area. For flattening the surface is the breast, for the others their own cup.""",
        """- *Wire off, seams off*: by how much the flat edge differs from its length in space, of seams the worst one.
        *Seam sides differ*: the two flat edges that are sewn together, the worst pair.""",
        "- *Distance*: of the scan's points from the surface that is laid flat.",
        f"""- *Rescans apart*: of {setting.rescans} scans of the same breast with other points and noise of
        {setting.noise:g} mm, how far the outlines of the others lie from the first one's at their worst place, median.
        brafit finds its seams anew in each of them; for flattening, the lines stay those that were drawn for the scan
        without noise, as a pattern maker would keep them.""",
        f"- *Developable*: no triangle is strained by {DEVELOPABLE:g} % or more.",
    ]
    last = "Of several breasts medians are told, in columns that say *largest* the largest of all."
    return ["\n".join(filled(entry) for entry in entries), last]


def named(package: str) -> str:
    """A package with its version."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return package


def rows(table: Table) -> str:
    """A table in Markdown, fewest panels first."""
    heads = ["panels", "", *(one.metadata["heading"] for one in fields(Figures)), "developable"]
    lines = [heads, ["---"] * len(heads)]
    for (method, panels), figures in sorted(table.items(), key=lambda row: (row[0][1], ORDER.index(row[0][0]))):
        lines.append([str(panels), method, *cells(figures)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cells(figures: Figures | Missing) -> Iterator[str]:
    """The cells of a row."""
    if isinstance(figures, Missing):
        yield f"not installed: `pip install {figures.package}`"
        yield from [""] * len(fields(Figures))
        return
    for one in fields(Figures):
        yield shown(getattr(figures, one.name))
    yield "yes" if figures.developable else "no"


def shown(value: float) -> str:
    """A figure with two decimals, a small one with one digit."""
    if math.isnan(value):
        return "not measured"
    return f"{value:.2f}" if value >= 0.1 or value == 0 else f"{value:.1g}"


def told(figures: Figures) -> SimpleNamespace:
    """All figures as texts, by their names."""
    return SimpleNamespace(**{one.name: shown(getattr(figures, one.name)) for one in fields(Figures)})


def reading(table: Table, heading: str, setting: Setting) -> list[str]:
    """What a table says of flattening and of the filter."""
    some = sorted(setting.panels)[len(setting.panels) // 2]
    rigid, own = table["ARAP", some], table[OURS, some]
    if isinstance(rigid, Missing) or isinstance(own, Missing):
        return ["libigl is not installed, so there is nothing to compare: `pip install libigl`."]
    a, b = told(rigid), told(own)
    about = heading[0].lower() + heading[1:]
    strained, away = by_panels(table, "ARAP", "strain_most", "%"), by_panels(table, OURS, "rms", "mm")
    enough = f"""Figures of {about}, {some} panels, ARAP against brafit. Flattening takes {a.seconds} CPU s, the fit
    {b.seconds}. What is laid flat is the breast itself, {a.rms} mm (RMS) off the scan's points, where the cup is
    {b.rms} mm off. For that the cloth has to give: by {a.strain_mean} % on average and by {a.strain_max} % at the
    worst place of all; on 95 % of the surface by at most {strained}. Cloth that stretches by so much in every direction
    and comes back takes that without a fold, if the pieces are cut a little smaller, so that it is stretched
    everywhere; many knits do. For a soft cup of such cloth flattening is enough, and it follows the body more closely
    than brafit's panels. ARAP or SLIM are the ones to take: LSCM keeps angles at the cost of lengths."""
    short = f"""Woven cloth, foam and lace that do not stretch cannot take up that strain: where a piece is too large it
    folds, where it is too small it pulls. The flat wire edge is {a.wire} % off its length,
    {shown(WIRE * rigid.wire / 100)} mm on a wire of {WIRE:g} mm, and the two sides of a seam differ by {a.apart} mm;
    somebody has to true both, and the cup is then no longer the one that was flattened. In brafit's pieces the strain
    is {b.strain_max} % at most, the wire edge is {b.wire} % off, and seam sides differ by {b.apart} mm. The price is
    the distance from the body: {away} (RMS)."""
    again = f"""Another scan of the same breast moves the outlines by {a.spread} mm where the surface is flattened along
    lines that stay, and by {b.spread} mm with brafit, which places the seams anew."""
    parts = ["## When flattening is enough", filled(enough), "## When it is not", filled(short), filled(again)]
    return [*parts, *of_the_filter(table, a, some)]


def by_panels(table: Table, method: str, name: str, unit: str) -> str:
    """One figure of a method with each number of panels."""
    found = sorted((panels, figures) for (own, panels), figures in table.items() if own == method)
    return ", ".join(f"{shown(getattr(figures, name))} {unit} with {panels} panels" for panels, figures in found)


def of_the_filter(table: Table, plain: SimpleNamespace, panels: int) -> list[str]:
    """What a table says of the developability filter."""
    filtered = table[FILTER, panels]
    if isinstance(filtered, Missing):
        return []
    own = told(filtered)
    text = f"""The developability filter leaves a mean strain of {own.strain_mean} % where ARAP alone leaves
    {plain.strain_mean} %, and moves the surface to {own.rms} mm (RMS) off the points. The parts are
    {"developable then" if filtered.developable else "not developable then"}: it seeks patches and creases of its own,
    which need not lie where the seams are."""
    return [filled(text)]


def of_patience(table: Table) -> list[str]:
    """What the table of the sphere says of the filter with more evaluations."""
    longer, plain = table.get((LONG_FILTER, 2)), table.get(("ARAP", 2))
    if not isinstance(longer, Figures) or not isinstance(plain, Figures):
        return []
    a, b = told(longer), told(plain)
    text = f"""With {LONGER} times the evaluations, {a.seconds} CPU s on the sphere, the mean strain is
    {a.strain_mean} % and the largest {a.strain_max} % (without the filter {b.strain_mean} and {b.strain_max} %), and
    the surface is {a.rms} mm (RMS) off the points."""
    return [filled(text)]


def of_the_paper(table: Table) -> list[str]:
    """What the table of the sphere says of the paper's solver."""
    paper, ours = table.get((PAPER, 2)), table.get((OURS, 2))
    if not isinstance(paper, Figures) or not isinstance(ours, Figures):
        return []
    a, b = told(paper), told(ours)
    text = f"""On the sphere the paper's solver was {a.rms} mm (RMS) off the points after {a.seconds} CPU s, and its
    pieces are strained by up to {a.strain_max} %; brafit's cup of 2 panels is {b.rms} mm off after {b.seconds}."""
    return [filled(text)]
