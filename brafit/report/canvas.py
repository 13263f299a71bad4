"""Pictures in pixels, drawn by Pillow: filled shapes, lines and dots with smooth edges, and texts.

Shapes are drawn several times as large and made smaller in the end, which smooths their edges; texts are drawn at last.
All places and lengths are pixels of the finished picture, x to the right and y down.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

from brafit.geometry.polyline import running_length
from brafit.typeface import BOLD, PLAIN, typeface

Colour = tuple[int, int, int]

INK, SOFT, FAINT, WHITE = (34, 34, 34), (102, 102, 102), (221, 221, 221), (255, 255, 255)
_TURNED_FINER = 4
"""How many times as large texts that are not level are drawn."""


class Canvas:
    """An empty white picture.

    Args:
        finer: how many times as large shapes are drawn.
    """

    def __init__(self, width: int, height: int, finer: int = 2):
        self.width, self.height, self._finer = width, height, finer
        self._large = Image.new("RGB", (width * finer, height * finer), WHITE)
        self._draw = ImageDraw.Draw(self._large)
        self._texts: list[Callable[[Image.Image], None]] = []

    def shapes(
        self,
        polygons: Float[ndarray, "n k 2"],
        dots: Float[ndarray, "m 2"],
        radius: float,
        colours: Int[ndarray, "n+m 3"],
        order: Int[ndarray, " n+m"],
    ) -> None:
        """Fill polygons and dots, in the order given by their numbers, polygons first; dots all have one radius.

        Args:
            polygons: all of k corners, pixels.
            dots: their middles, pixels.
            radius: of the dots, pixels.
            colours: of polygons, then dots, 0 to 255.
            order: numbers of polygons and dots (those after the polygons), the first drawn first.
        """
        size = len(polygons)
        corners = (polygons * self._finer).reshape(size, -1).tolist()
        boxes = (np.concatenate((dots - radius, dots + radius), axis=1) * self._finer - (0, 0, 1, 1)).tolist()
        fills = list(map(tuple, colours.tolist()))
        polygon, ellipse = self._draw.polygon, self._draw.ellipse
        for i in order.tolist():
            if i < size:
                polygon(corners[i], fill=fills[i])
            else:
                ellipse(boxes[i - size], fill=fills[i])

    def fill(self, outline: Float[ndarray, "n 2"], colour: Colour) -> None:
        """Fill one polygon."""
        self._draw.polygon((outline * self._finer).ravel().tolist(), fill=colour)

    def line(
        self, points: Float[ndarray, "n 2"], colour: Colour, width: float, dashes: tuple[float, float] | None = None
    ) -> None:
        """A polyline, solid or in dashes: length of a dash and of the gap after it."""
        wide = max(1, round(width * self._finer))
        for part in [points] if dashes is None else _dashed(points, *dashes):
            self._draw.line((part * self._finer).ravel().tolist(), fill=colour, width=wide, joint="curve")

    def text(
        self,
        words: str,
        at: Float[ndarray, "2"] | Sequence[float],
        size: float,
        *,
        anchor: str = "mm",
        angle: float = 0.0,
        bold: bool = False,
        colour: Colour = INK,
    ) -> None:
        """A line of text, its letters `size` pixels high; not cut off at the sides while there is room.

        Args:
            words: one line.
            at: pixels from the upper left corner.
            size: height of the letters, pixels.
            anchor: what lies at `at`, as Pillow names it; of texts that are not level it is the middle.
            angle: of the line in degrees, to the left.
            bold: whether the face is bold.
            colour: red, green, blue, 0 to 255.
        """
        words = " ".join("".join(c if c.isprintable() else " " for c in words).split())
        if not words:
            return
        x, y = float(at[0]), float(at[1])
        if abs(angle) < 0.01:
            font = _font(bold, size)

            def level(picture: Image.Image) -> None:
                ImageDraw.Draw(picture).text((x, y), words, fill=colour, font=font, anchor=anchor)

            self._texts.append(level)
        else:
            mask = _turned(words, _font(bold, size * _TURNED_FINER), angle)

            def turned(picture: Image.Image) -> None:
                picture.paste(colour, (round(x - mask.width / 2), round(y - mask.height / 2)), mask)

            self._texts.append(turned)

    def png(self) -> bytes:
        """The picture as a PNG file."""
        picture = self._large.reduce(self._finer) if self._finer > 1 else self._large
        for draw in self._texts:
            draw(picture)
        file = io.BytesIO()
        picture.save(file, "PNG", compress_level=1)
        return file.getvalue()


def _dashed(points: Float[ndarray, "n 2"], dash: float, gap: float) -> list[Float[ndarray, "_ 2"]]:
    """The parts of a polyline that are drawn."""
    along = running_length(points)
    starts = np.arange(0.0, along[-1], dash + gap)
    parts = []
    for start, end in zip(starts, np.minimum(starts + dash, along[-1]), strict=True):
        inner = along[np.searchsorted(along, start, "right") : np.searchsorted(along, end, "left")]
        places = np.concatenate(([start], inner, [end]))
        parts.append(np.stack([np.interp(places, along, points[:, i]) for i in range(2)], axis=-1))
    return parts


def _turned(words: str, font: ImageFont.FreeTypeFont, angle: float) -> Image.Image:
    """A mask of a line of text that is not level, its middle in the middle."""
    left, top, right, bottom = font.getbbox(words, anchor="mm")
    half = int(max(-left, right, -top, bottom)) + 4
    mask = Image.new("L", (2 * half, 2 * half), 0)
    ImageDraw.Draw(mask).text((half, half), words, fill=255, font=font, anchor="mm")
    turned = mask.rotate(angle, Image.Resampling.BICUBIC)
    return turned.resize((-(-turned.width // _TURNED_FINER), -(-turned.height // _TURNED_FINER)), Image.Resampling.BOX)


@cache
def _faces(bold: bool, size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(typeface(BOLD if bold else PLAIN)), size / 10)


def _font(bold: bool, size: float) -> ImageFont.FreeTypeFont:
    """Sizes to a tenth of a pixel, so that a run needs few."""
    return _faces(bold, max(10, round(10 * size)))
