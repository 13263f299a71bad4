import sys
from subprocess import run
from typing import Any

import numpy as np
import pytest
from lunes import lune_cup, lune_flat, sphere_points

from brafit.pattern import Pattern, PatternOptions, finish, pieces_from_panels
from brafit.report.colour import distance_colours, distance_limit
from brafit.report.figures import (
    cup_figure,
    figure_image,
    fit_figure,
    flat_figure,
    pattern_figure,
    save_figure,
    thumbnail_figure,
)

TITLE = 'any $name^{ "Ü" 胸 \x07'


def finished(**options) -> Pattern:
    return finish(pieces_from_panels(lune_flat(2)), PatternOptions(**options), name="lune", side="left")


def figures():
    pieces, (points, distances) = pieces_from_panels(lune_flat(2)), sphere_points(300)
    return {
        "pattern": pattern_figure(finished(), TITLE),
        "thumbnail": thumbnail_figure(points, distances, lune_cup(2)),
        "fit": fit_figure(points, distances, lune_cup(2), TITLE),
        "fit of the right one": fit_figure(points, distances, lune_cup(2), TITLE, side="right"),
        "cup": cup_figure(lune_cup(2, n=41), points, TITLE, "mm"),
        "flat": flat_figure(pieces, TITLE),
    }


def test_every_figure_draws_with_any_title():
    for name, figure in figures().items():
        image = figure_image(figure, dpi=40)
        assert image.shape[2:] == (3,), name
        assert image.std() > 5, name


def test_pattern_figure_has_one_scale_for_both_axes_and_true_millimetres():
    pattern = finished()
    figure = pattern_figure(pattern, "x")
    figure_image(figure, dpi=50)
    axes = figure.axes[0]
    lengths = [np.linalg.norm(np.diff(line.get_xydata(), axis=0), axis=1).sum() for line in axes.lines]
    expected = [line.length for piece in pattern.pieces for line in piece.sew]
    np.testing.assert_allclose([length for length in lengths if length > 20], expected, atol=0.05)
    (ax, ay), (bx, by) = axes.transData.transform([(0, 0), (10, 10)])
    assert bx - ax == pytest.approx(by - ay, rel=1e-6)
    legend: Any = axes.get_legend()
    assert {text.get_text() for text in legend.get_texts()} == {"wire", "ridge (seam)", "upper edge"}


def test_right_cups_are_drawn_as_mirror_images():
    points, distances = sphere_points(200)
    points = points[points[:, 1] > 60]  # lopsided
    distances = distances[: len(points)]
    left, right = (
        figure_image(fit_figure(points, distances, lune_cup(2), "", side), dpi=60) for side in ("left", "right")
    )
    assert np.abs(left.astype(int) - right).mean() > 1


def test_fit_without_any_finite_distance_still_draws():
    points, distances = sphere_points(50)
    figure_image(fit_figure(points, np.full_like(distances, np.nan), lune_cup(2), "x"), dpi=30)


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_saved_figures_are_whole(tmp_path, suffix):
    path = tmp_path / "new folder" / f"figure.{suffix}"
    save_figure(flat_figure(pieces_from_panels(lune_flat(1)), TITLE), path, dpi=40)
    assert path.stat().st_size > 2000
    assert list(path.parent.iterdir()) == [path]


def test_colours_run_from_blue_over_grey_to_red_and_stop_at_the_ends():
    colours = distance_colours(np.array([-9.0, -2.0, 0.0, 2.0, 9.0, np.nan]), 2.0).astype(int)
    assert (colours[0] == colours[1]).all()
    assert (colours[3] == colours[4]).all()
    assert colours[1][2] > colours[1][0]
    assert colours[3][0] > colours[3][2]
    assert np.ptp(colours[2]) < 10
    assert (colours[5] == 0).all()


@pytest.mark.parametrize(
    ("values", "limit"), [([0.0], 1.0), ([], 1.0), ([2.9, -1.0], 3.0), ([0.02] * 9, 0.02), ([7.0], 8.0)]
)
def test_colour_scale_ends_at_a_round_number(values, limit):
    assert distance_limit(np.array(values, float)) == pytest.approx(limit)


def test_no_window_system_and_no_needless_import():
    program = (
        "import sys, brafit.pattern, brafit.report.table, brafit.report.mesh\n"
        "assert not {'matplotlib', 'tensorboard', 'open3d'} & set(sys.modules)\n"
        "import brafit.report.figures, brafit.report.tensorboard\n"
        "assert not {'matplotlib.pyplot', 'tensorboard', 'open3d'} & set(sys.modules)\n"
    )
    run([sys.executable, "-c", program], check=True)
