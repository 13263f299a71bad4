import io
import sys
from pathlib import Path
from subprocess import run

import numpy as np
import pytest
from lunes import lune_cup, lune_flat, sphere_points
from paper_figures import cup_figure, flat_figure
from PIL import Image

from brafit.pattern import Pattern, PatternOptions, finish, pieces_from_panels
from brafit.report.colour import STEPS, distance_colours, distance_limit
from brafit.report.figures import save_figure
from brafit.report.pictures import fit_picture, pattern_picture, thumbnail

TITLE = 'any $name^{ "Ü" 胸 \x07'


def finished(**options) -> Pattern:
    return finish(pieces_from_panels(lune_flat(2)), PatternOptions(**options), name="lune", side="left")


def pixels(png: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(png)) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB")).astype(int)


def saved(figure, path: Path) -> np.ndarray:
    save_figure(figure, path, dpi=40)
    return pixels(path.read_bytes())


def pictures(folder: Path) -> dict[str, np.ndarray]:
    pieces, (points, distances) = pieces_from_panels(lune_flat(2)), sphere_points(300)
    return {
        "pattern": pixels(pattern_picture(finished(), TITLE)),
        "thumbnail": pixels(thumbnail(points, distances, lune_cup(2))),
        "fit": pixels(fit_picture(points, distances, lune_cup(2), TITLE)),
        "fit of the right one": pixels(fit_picture(points, distances, lune_cup(2), TITLE, side="right")),
        "cup": saved(cup_figure(lune_cup(2, n=41), points, TITLE, "mm"), folder / "cup.png"),
        "flat": saved(flat_figure(pieces, TITLE), folder / "flat.png"),
    }


def test_every_picture_draws_with_any_title(tmp_path):
    for name, image in pictures(tmp_path).items():
        assert image.std() > 5, name


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_pattern_picture_has_one_scale_for_both_axes(panels):
    """The box about the wire's blue and the ridges' red line is as wide and as high as the pieces are."""
    made = finish(pieces_from_panels(lune_flat(panels)), PatternOptions(), name="lune", side="left")
    image = pixels(pattern_picture(made, "x"))[:-40]  # without the key
    wire = np.argwhere((np.abs(image - (11, 83, 148)) < 25).all(-1))
    lower = made.pieces[0].sew[0].curve.polyline()
    (low_y, low_x), (high_y, high_x) = wire.min(0), wire.max(0)
    scale = (high_x - low_x) / np.ptp(lower[:, 0])
    assert scale > 2
    assert high_y - low_y == pytest.approx(scale * np.ptp(lower[:, 1]), abs=5)


def test_right_cups_are_drawn_as_mirror_images():
    points, distances = sphere_points(200)
    points = points[points[:, 1] > 60]  # lopsided
    distances = distances[: len(points)]
    left, right = (pixels(thumbnail(points, distances, lune_cup(2), side)) for side in ("left", "right"))
    assert np.abs(left - right).mean() > 1
    # but for the light, which stays where it is: what is empty in one is empty in the other's mirror image
    empty = [np.all(image > 250, axis=-1) for image in (left, right)]
    assert np.mean(empty[0] == empty[1][:, ::-1]) > 0.97


def test_dots_have_the_colours_of_their_distances():
    points, distances = sphere_points(200)
    image = pixels(thumbnail(points, np.full_like(distances, 5.0), lune_cup(2)))
    red = (image[..., 0] - image[..., 2] > 70).sum()
    image = pixels(thumbnail(points, np.full_like(distances, -5.0), lune_cup(2)))
    blue = (image[..., 2] - image[..., 0] > 70).sum()
    assert min(red, blue) > 200


def test_a_point_behind_the_cup_is_hidden():
    points = np.array([(40.0, 80.0, 200.0), (40.0, 80.0, -200.0)])
    image = pixels(fit_picture(points, np.array([3.0, -3.0]), lune_cup(2), ""))
    front = image[60:430, 480:900]
    assert (front[..., 0] - front[..., 2] > 70).sum() > 9
    assert (front[..., 2] - front[..., 0] > 70).sum() == 0


def test_fit_without_any_finite_distance_still_draws():
    points, distances = sphere_points(50)
    assert fit_picture(points, np.full_like(distances, np.nan), lune_cup(2), "x")


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_saved_figures_are_whole(tmp_path, suffix):
    path = tmp_path / "new folder" / f"figure.{suffix}"
    save_figure(flat_figure(pieces_from_panels(lune_flat(1)), TITLE), path, dpi=40)
    assert path.stat().st_size > 2000
    assert list(path.parent.iterdir()) == [path]


def test_colours_are_the_same_steps_for_every_scan():
    """Grey where cup and point are as good as one, blue inside, red outside, darker at every step."""
    beyond = np.array([0.0, *(step * factor for step in STEPS for factor in (0.99, 1.01))])
    for way, most, least in ((1.0, 0, 2), (-1.0, 2, 0)):
        colours = distance_colours(way * beyond).astype(int)
        alone = np.concatenate([distance_colours(np.array([way * one])) for one in beyond])
        assert (colours == alone).all(), "whatever else is in the picture"
        assert len({tuple(colour) for colour in colours.tolist()}) == len(STEPS) + 1
        assert (colours[2::2] != colours[1::2]).any(axis=1).all()
        assert (np.diff(colours[::2].sum(1)) < 0).all(), "darker"
        assert (colours[2:, most] > colours[2:, least]).all()
        assert np.ptp(colours[0]) < 10
    assert (distance_colours(np.array([np.nan])) == 0).all()


@pytest.mark.parametrize(
    ("values", "limit"), [([0.0], 1.0), ([], 1.0), ([2.9, -1.0], 3.0), ([0.02] * 9, 0.02), ([7.0], 8.0)]
)
def test_axis_ends_at_a_round_number(values, limit):
    assert distance_limit(np.array(values, float)) == pytest.approx(limit)


def test_no_window_system_and_no_needless_import():
    program = (
        "import sys, brafit.pattern, brafit.report.table, brafit.report.mesh\n"
        "assert not {'matplotlib', 'tensorboard', 'open3d', 'PIL'} & set(sys.modules)\n"
        "import brafit.result, brafit.report.pictures, brafit.pattern.dxf, brafit.pattern.svg\n"
        "assert not {'matplotlib', 'tensorboard', 'open3d', 'reportlab', 'ezdxf'} & set(sys.modules)\n"
        "import brafit.report.figures\n"
        "assert not {'matplotlib.pyplot', 'tensorboard', 'open3d'} & set(sys.modules)\n"
    )
    run([sys.executable, "-c", program], check=True)
