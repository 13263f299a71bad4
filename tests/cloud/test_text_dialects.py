"""A known cloud, written in every manner in which programs write tables, is read back digit for digit."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from breasts import cup_frame_points
from hypothesis import given, settings
from hypothesis import strategies as st

from brafit.cloud import read_cloud
from brafit.cloud.text import read_text
from brafit.errors import InputError

COUNT = 130
POINTS = cup_frame_points(COUNT) - [30.0, 80.0, 0.0]
NAMES = (
    ("x", "y", "z"),
    ("X", "Y", "Z"),
    ("X [mm]", "Y [mm]", "Z [mm]"),
    ("x(mm)", "y(mm)", "z(mm)"),
    ("x_mm", "y_mm", "z_mm"),
    ("Points:0", "Points:1", "Points:2"),
    ("pos_x", "pos_y", "pos_z"),
    ("X-Coordinate", "Y-Coordinate", "Z-Coordinate"),
)
MISSING = ("nan", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND", "1.#INF", "inf")


@dataclass(frozen=True)
class Dialect:
    """How a table is written."""

    encoding: str
    end: str
    last_end: bool
    mark: str
    comma: bool
    form: str
    quoted: bool
    names: tuple[str, ...] | None
    comment: str
    order: tuple[int, ...]
    index: str | None
    more: tuple[str, ...]
    trailing: bool
    empty: tuple[int, ...]
    missing: tuple[tuple[int, str], ...]

    def text(self) -> str:
        """The table of `POINTS`."""
        lines = [self._names()] if self.names else ["# made by hand"] * bool(self.comment)
        missing = dict(self.missing)
        for k, point in enumerate(POINTS):
            if k in self.empty:
                lines.append("" if self.mark.isspace() else self.mark.strip() * (len(self._row(k, [])) + 2))
            values = [self.spelt(value) for value in point]
            if k in missing:
                values[k % 3] = missing[k]
            lines.append(self._line(self._row(k, [values[axis] for axis in self.order])))
        return self.end.join(lines) + self.end * self.last_end

    def spelt(self, value: float) -> str:
        return (self.form % value).replace(".", "," if self.comma else ".")

    def _row(self, k: int, values: list[str]) -> list[str]:
        index = [] if self.index is None else [f"P{k}" if self.index == "words" else str(k + 1)]
        return [*index, *values, *self.more]

    def _line(self, cells: list[str]) -> str:
        return self.mark.join(f'"{cell}"' if self.quoted else cell for cell in cells) + self.mark * self.trailing

    def _names(self) -> str:
        assert self.names is not None
        index = [] if self.index in (None, "unnamed") else ["id"]
        names = [*index, *(self.names[axis] for axis in self.order), *(f"more{k}" for k in range(len(self.more)))]
        return self.comment + self._line(names)

    def expected(self) -> np.ndarray:
        values = np.array([[float(self.form % value) for value in point] for point in POINTS])
        for k, _ in self.missing:
            values[k, k % 3] = np.nan
        return values


@st.composite
def dialects(draw: st.DrawFn) -> Dialect:
    mark = draw(st.sampled_from([" ", "   ", "\t", ";", "; ", ",", ", ", "|"]))
    quoted, comma = draw(st.booleans()), draw(st.booleans())
    comma = comma and (quoted or "," not in mark)
    names = draw(st.none() | st.sampled_from(NAMES))
    index = draw(st.sampled_from([None, None, "numbers", "words"] + ["unnamed"] * (names is not None)))
    comment = draw(st.sampled_from(["", "//", "# "]))
    if comment and names and (quoted or index == "unnamed"):
        comment = ""
    rows = st.integers(0, COUNT - 1)
    return Dialect(
        encoding=draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])),
        end=draw(st.sampled_from(["\n", "\r\n", "\r"])),
        last_end=draw(st.booleans()),
        mark=mark,
        comma=comma,
        form=draw(st.sampled_from(["%.17g", "%.3f", "%+.4f", "%.8e", "%.1f"])),
        quoted=quoted,
        names=names,
        comment=comment,
        order=tuple(draw(st.permutations(range(3)))) if names else (0, 1, 2),
        index=index,
        more=draw(st.sampled_from([(), ("17",), ("17", "skin"), ("0", "0", "1")])),
        trailing=draw(st.booleans()) and not mark.isspace(),
        empty=tuple(draw(st.sets(rows, max_size=3))),
        missing=tuple(draw(st.dictionaries(rows, st.sampled_from(MISSING), max_size=3)).items()),
    )


@settings(max_examples=120, derandomize=True, deadline=None, database=None)
@given(dialects(), st.sampled_from([".csv", ".txt", ".xyz", ".asc", ".pts"]))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, dialect: Dialect, suffix: str) -> None:
    path = tmp_path_factory.getbasetemp() / f"dialect{suffix}"
    path.write_bytes(dialect.text().encode(dialect.encoding))
    found = read_text(path)
    positions = np.where(np.isfinite(found["positions"]), found["positions"], np.nan)
    np.testing.assert_array_equal(positions, dialect.expected())
    stated = dialect.names is not None and "mm" in dialect.names[0]
    assert ("unit" in found) == stated


def rows(points: np.ndarray = POINTS, mark: str = " ", more: str = "") -> list[str]:
    return [mark.join(f"{value:.3f}" for value in point) + more for point in points]


def refusal(path: Path, text: str) -> str:
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_cloud(path, apart=False)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize("head", ["", "x,y,z\n", '"x","y","z"\n'])
@pytest.mark.parametrize("form", ["%.3f", "%.1f", "%.5e", "%.4g"])
@pytest.mark.parametrize("mark", [",", ", "])
def test_a_comma_that_is_two_things_is_refused(tmp_path: Path, head: str, form: str, mark: str) -> None:
    lines = [mark.join((form % value).replace(".", ",") for value in point) for point in POINTS]
    line = refusal(tmp_path / "a.csv", head + "\n".join(lines))
    assert "the comma both parts its numbers and marks their decimals" in line
    assert line.endswith("Export it with decimal points, or with semicolons or tabs between the numbers.")


def test_whole_numbers_parted_by_commas_are_no_decimals(tmp_path: Path) -> None:
    """Coordinates in tenths of a millimetre, with colours."""
    points = np.round(10 * POINTS)
    colours = np.random.default_rng(0).integers(0, 256, size=(COUNT, 3))
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(f"{value:.0f}" for value in row) for row in np.hstack([points, colours])))
    np.testing.assert_array_equal(read_text(path)["positions"], points)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda lines: [*lines[:50], "1,5 2,5 3,5", *lines[51:]],
            "line 51: its numbers have decimal points and decimal",
        ),
        (lambda lines: [*lines[:50], "1,265.5 2.5 3.5", *lines[51:]], "line 51: '1,265.5' has marks of thousands"),
        (lambda lines: [*lines[:50], "1.5 2.5", *lines[51:]], "line 51 has 2 columns, most lines have 3"),
        (
            lambda lines: [*lines[:50], "1.5 2.5 3.5 1.5 2.5 3.5", *lines[51:]],
            "line 51 has 6 columns, most lines have 3",
        ),
        (lambda lines: [*lines[:50], "1.5 2_5 3.5", *lines[51:]], "line 51: '2_5' is no number"),
        (lambda lines: ["Scan of Anna", *lines], "its first line is neither numbers nor the names of columns x, y, z"),
        (
            lambda lines: ["a b c", *lines],
            "its first line is neither numbers nor the names of columns x, y, z: 'a b c'",
        ),
        (lambda lines: ["x y z x", *(f"{line} 1" for line in lines)], "two of its columns are named 'x'"),
        (lambda lines: ["x[mm] y[cm] z[mm]", *lines], "its columns are in different units: 'x[mm]', 'y[cm]', 'z[mm]'"),
        (lambda lines: ["x y z i", *lines], "its first line names 4 columns, 3 follow"),
    ],
)
def test_faults_are_named(tmp_path: Path, change, words: str) -> None:
    assert words in refusal(tmp_path / "a.xyz", "\n".join(change(rows())))


THOUSANDS = {
    "comma": lambda value: f"{value:,.3f}",
    "point": lambda value: f"{value:,.3f}".translate({44: ".", 46: ","}),
    "apostrophe": lambda value: f"{value:,.3f}".replace(",", "'"),
    "narrow blank": lambda value: f"{value:,.3f}".translate({44: "\u202f", 46: ","}),
}


@pytest.mark.parametrize("spelt", THOUSANDS.values(), ids=THOUSANDS)
@pytest.mark.parametrize("before", [[], ["7"]], ids=["", "index"])
@pytest.mark.parametrize("behind", [[], ["200", "10"]], ids=["", "colours"])
def test_marks_of_thousands_are_named(tmp_path: Path, spelt, before: list[str], behind: list[str]) -> None:
    """Also where other columns would do for the one in which all numbers have them: those that stand behind it."""
    rows_of = [[90.5, 1200.25 + k, 130.125] for k in range(COUNT)]
    lines = [
        "\t".join([*(str(k) for _ in before), *map(spelt, row), *behind]) for k, row in enumerate(rows_of, start=1)
    ]
    assert "has marks of thousands). Export it without them" in refusal(tmp_path / "a.txt", "\n".join(lines))


def test_a_unit_behind_a_number_is_named(tmp_path: Path) -> None:
    lines = [f"{x:.3f} {y:.3f}mm {z:.3f} 200 10" for x, y, z in POINTS]
    assert "mm' has its unit behind it). Export numbers only" in refusal(tmp_path / "a.txt", "\n".join(lines))
    path = tmp_path / "b.txt"
    path.write_text("\n".join(rows(more=" 10cm")))  # a label, say
    np.testing.assert_array_equal(read_text(path)["positions"], POINTS.round(3))


@pytest.mark.parametrize("unit", ["um", "\u00b5m", "ft", "px"])
def test_a_unit_that_is_not_read_is_not_passed_over(tmp_path: Path, unit: str) -> None:
    line = refusal(tmp_path / "a.csv", "\n".join([f"x [{unit}];y [{unit}];z [{unit}]", *rows(mark=";")]))
    assert "is in a unit that is not read). Export it in one of mm, cm, m, in." in line


def test_what_is_no_number_is_shown_where_columns_are_missing(tmp_path: Path) -> None:
    line = refusal(tmp_path / "a.txt", "\n".join(f"[{x:.3f}, {y:.3f}, {z:.3f}]" for x, y, z in POINTS))
    assert "3 columns of numbers are needed, it has 1: '[" in line


def test_a_line_that_is_no_point_is_no_damage(tmp_path: Path) -> None:
    """A line of means below the points, brackets about them, full-width digits: the copy is complete all the same."""
    points = rows(mark=",")
    below = refusal(tmp_path / "a.csv", "\n".join([*points, "Mittelwert,,"]))
    line = f"(line {len(points) + 1}: 'Mittelwert' is no number). Correct that line or take it out"
    assert line in below
    listed = refusal(tmp_path / "a.txt", "\n".join(f"[{row}]" for row in points))
    wide = "\n".join(points).translate(dict(zip(map(ord, "0123456789"), "０１２３４５６７８９", strict=True)))
    digits = refusal(tmp_path / "b.csv", f"x,y,z\n{wide}")
    assert "has other digits than 0 to 9). Export it with plain (half-width) digits" in digits
    assert not any("damaged" in told for told in (below, listed, digits))


def test_points_in_columns_are_called_that(tmp_path: Path) -> None:
    """As `numpy.savetxt` writes an array of 3 x n: a cloud of three points, it was said."""
    for mark in (" ", ","):
        columns = "\n".join(mark.join(f"{value:.18e}" for value in column) for column in POINTS.T)
        line = refusal(tmp_path / "a.txt", columns)
        assert f"(its table is 3 x {COUNT}: a point a column, not a point a row). Save it transposed" in line


@pytest.mark.parametrize("index", [True, False])
def test_columns_that_pandas_numbers_are_no_point(tmp_path: Path, index: bool) -> None:
    """`DataFrame(points).to_csv()`: the index was read as x, x as y."""
    path = tmp_path / "a.csv"
    before = [f"{k}," if index else "" for k in range(COUNT)]
    lines = ["," * index + "0,1,2", *map("".join, zip(before, rows(mark=","), strict=True))]
    path.write_text("\n".join(lines))
    np.testing.assert_array_equal(read_text(path)["positions"], POINTS.round(3))
    whole = ["0,1,2", *(f"{k},{k % 7},{k % 5}" for k in range(COUNT))]  # whole numbers: a point as any other
    path.write_text("\n".join(whole))
    assert len(read_text(path)["positions"]) == COUNT + 1


def test_lines_that_begin_with_a_per_cent_sign_are_comments(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("\n".join(["% written by Octave", "% x y z [mm]", *rows()]))
    np.testing.assert_array_equal(read_text(path)["positions"], POINTS.round(3))


def blocks(*sizes: int, counts: tuple[int, ...] | None = None) -> str:
    """A PTS file of several scans, with intensity and colour."""
    lines = iter(rows(more=" -500 1 2 3"))
    parts = [[str(count), *itertools.islice(lines, size)] for count, size in zip(counts or sizes, sizes, strict=True)]
    return "\n".join(itertools.chain(*parts)) + "\n"


@pytest.mark.parametrize("sizes", [(130,), (60, 70), (50, 0, 50, 30)])
def test_blocks_of_a_pts_file_are_one_cloud(tmp_path: Path, sizes: tuple[int, ...]) -> None:
    path = tmp_path / "a.pts"
    path.write_text(blocks(*sizes))
    np.testing.assert_array_equal(read_text(path)["positions"], POINTS.round(3))
    path.write_text(blocks(*sizes).replace("\n", "\n\n").replace("-500", "1.#QNAN"))
    np.testing.assert_array_equal(read_text(path)["positions"], POINTS.round(3))


@pytest.mark.parametrize(
    ("sizes", "counts", "words"),
    [
        ((60, 70), (61, 70), "its first line promises 61 points, 60 follow"),
        ((60, 70), (59, 70), "its first line promises 59 points, 60 follow"),
        ((60, 70), (60, 71), "its line 62 promises 71 points, 70 follow"),
        ((60, 70), (60, 69), "its line 62 promises 69 points, 70 follow"),
    ],
)
def test_counts_that_do_not_fit_are_named(tmp_path: Path, sizes, counts, words: str) -> None:
    assert words in refusal(tmp_path / "a.pts", blocks(*sizes, counts=counts))


def test_a_pts_file_without_a_count_is_a_plain_table(tmp_path: Path) -> None:
    path = tmp_path / "a.pts"
    path.write_text("\n".join(rows()))
    np.testing.assert_array_equal(read_text(path)["positions"], POINTS.round(3))


def test_named_normals_and_flag_are_found_wherever_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{k % 2},0,{x},0,{y},1,{z},a" for k, (x, y, z) in enumerate(POINTS)]
    path.write_text("\n".join(["inside,Nx,X,Ny,Y,Nz,Z,label", *lines]))
    found = read_cloud(path)
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.normals is not None
    assert (found.normals == [0, 0, 1]).all()
    assert found.inside is not None
    np.testing.assert_array_equal(found.inside, np.arange(COUNT) % 2 == 1)


@pytest.mark.parametrize("units", ["cm;cm;cm;-", "[cm];[cm];[cm];", '"cm";"cm";"cm";"a.u."'])
def test_units_may_stand_below_the_names(tmp_path: Path, units: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["x;y;z;intensity", units, *rows(mark=";", more=";1")]))
    found = read_text(path)
    assert found["unit"] == ["cm"]
    np.testing.assert_array_equal(found["positions"], POINTS.round(3))


def test_a_late_change_of_spelling_is_read(tmp_path: Path) -> None:
    """What the first rows do not show: words for NaN, an empty cell, a number in quotes."""
    points = np.concatenate([POINTS, POINTS, POINTS])
    lines = rows(points, ",")
    lines[300], lines[310], lines[320] = "1.#QNAN,1,2", ",1,2", f'"{points[320, 0]}",' + lines[320].split(",", 1)[1]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    expected = points.round(3)
    expected[320, 0] = points[320, 0]
    expected[[300, 310]] = [np.nan, 1, 2]
    np.testing.assert_array_equal(read_text(path)["positions"], expected)
