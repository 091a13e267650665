"""What every picture shares: colours, lines, texts, and the bytes of the file.

Drawn with Pillow alone: a run waits for its picture, and a plotting library takes longer to load than to draw. Shapes
are drawn at twice the resolution and averaged, which smooths their edges; texts are drawn on top. Positions are pixels
from the upper left corner. Colours are Okabe and Ito's, which people with any colour vision can tell apart.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from accelsurf.report.fonts import runs_of

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
YELLOW = "#F0E442"
INK, GRID, PALE, DARK = "#222222", "#D9D9D9", "#999999", "#101010"
RUN_COLORS = (BLUE, VERMILION, GREEN, PURPLE)
#: The surface, and what it is compared with, in every picture of the program.
SURFACE, REFERENCE = ORANGE, SKY
#: Colours of objects with ids, again from the first when there are more; none is that of the reference.
OBJECT_COLORS = (SURFACE, GREEN, BLUE, VERMILION, PURPLE)
#: Lengths of dashes and gaps, pixels; none is a solid line.
Dashes = tuple[float, ...]
SOLID: Dashes = ()
RUN_DASHES: tuple[Dashes, ...] = (SOLID, (9, 4), (4, 3), (9, 3, 2, 3))
#: Shapes are drawn at so many times the resolution.
_FINE = 2
_COMPRESSION = 3

#: Left, top, right, bottom, pixels.
Box = tuple[float, float, float, float]


def object_color(position: int) -> str:
    """Return the colour of the object at this place in the order of ids; colours repeat after five objects.

    Examples
    --------
    >>> object_color(0) == SURFACE, object_color(5) == SURFACE
    (True, True)
    """
    return OBJECT_COLORS[position % len(OBJECT_COLORS)]


class _Text(NamedTuple):
    at: tuple[float, float]
    text: str
    size: int
    color: str
    anchor: str
    bold: bool
    upward: bool


class Canvas:
    """A white picture to draw on.

    Parameters
    ----------
    width, height : int
        Pixels.
    title : str, optional
        One line at the top, in the middle.

    Examples
    --------
    >>> canvas = Canvas(40, 30)
    >>> canvas.line([(0, 0), (39, 29)], BLUE, 2)
    >>> canvas.png()[1:4]
    b'PNG'
    """

    def __init__(self, width: float, height: float, title: str = "") -> None:
        self.width, self.height = max(int(width), 1), max(int(height), 1)
        self._picture = Image.new("RGB", (_FINE * self.width, _FINE * self.height), "white")
        self._pen = ImageDraw.Draw(self._picture)
        self._texts: list[_Text] = []
        if title:
            self.text((self.width / 2, 22), title, 17, anchor="mm")

    def line(self, points: ArrayLike, color: str, width: float, dashes: Dashes = SOLID) -> None:
        """Draw a line through points (n, 2), (right, down)."""
        places = np.asarray(points, float).reshape(-1, 2)
        for part in _dashed(places, dashes) if dashes else (places,):
            if len(part) > 1:
                self._pen.line((_FINE * part).ravel().tolist(), fill=color, width=max(round(_FINE * width), 1))

    def polygon(self, points: ArrayLike, color: str) -> None:
        """Fill a polygon with corners (n, 2)."""
        self._pen.polygon((_FINE * np.asarray(points, float)).ravel().tolist(), fill=color)

    def rectangle(self, box: Box, fill: str | None = None, outline: str | None = None, width: float = 1) -> None:
        """Draw a rectangle."""
        ends = [_FINE * value for value in box]
        self._pen.rectangle(ends, fill=fill, outline=outline, width=max(round(_FINE * width), 1))

    def circle(self, at: tuple[float, float], radius: float, fill: str) -> None:
        """Draw a disc."""
        (x, y), r = at, radius
        self._pen.ellipse([_FINE * value for value in (x - r, y - r, x + r, y + r)], fill=fill)

    def shade(self, box: Box, color: str, opacity: float) -> None:
        """Lay a colour over a rectangle."""
        left, top, right, bottom = (round(_FINE * value) for value in box)
        ends = max(left, 0), max(top, 0), min(right, self._picture.width), min(bottom, self._picture.height)
        if ends[0] < ends[2] and ends[1] < ends[3]:
            below = self._picture.crop(ends)
            self._picture.paste(Image.blend(below, Image.new("RGB", below.size, color), opacity), ends[:2])

    def image(self, pixels: NDArray[Any], box: Box, smooth: bool = False) -> None:
        """Draw pixels, (h, w) grey or (h, w, 3 or 4) colours, uint8, as large as the box."""
        left, top, right, bottom = (round(_FINE * value) for value in box)
        size = max(right - left, 1), max(bottom - top, 1)
        how = Image.Resampling.BICUBIC if smooth else Image.Resampling.NEAREST
        shown = Image.fromarray(np.ascontiguousarray(pixels)).resize(size, how)
        self._picture.paste(shown, (left, top), shown if shown.mode == "RGBA" else None)

    def text(
        self,
        at: tuple[float, float],
        text: str,
        size: int = 12,
        color: str = INK,
        anchor: str = "la",
        *,
        bold: bool = False,
        upward: bool = False,
    ) -> None:
        """Write lines of text.

        Parameters
        ----------
        at : (float, float)
            Where its anchor is.
        text : str
        size : int
            Height of the font, pixels.
        color : str
        anchor : str
            Two letters: l, m, r (left, middle, right) and a, m, d (top, middle, bottom).
        bold, upward : bool
            ``upward``: one line that runs from below to above.
        """
        lines = text.split("\n")
        step = 1.3 * size
        first = {"a": 0.0, "m": -0.5 * step * (len(lines) - 1), "d": -step * (len(lines) - 1)}[anchor[1]]
        for number, line in enumerate(lines):
            place = (at[0], at[1] + first + number * step)
            self._texts.append(_Text(place, line, size, color, anchor, bold, upward))

    def boxed_text(
        self,
        at: tuple[float, float],
        text: str,
        size: int = 12,
        color: str = "white",
        ground: str = "black",
        opacity: float = 0.55,
    ) -> None:
        """Write a line of bold text on a ground of its own, its middle at a place: readable on any grey."""
        half = 0.5 * text_width(text, size, bold=True) + 3
        self.shade((at[0] - half, at[1] - 0.68 * size, at[0] + half, at[1] + 0.68 * size), ground, opacity)
        self.text(at, text, size, color, "mm", bold=True)

    def pixels(self) -> NDArray[np.uint8]:
        """The picture, (height, width, 3)."""
        return np.asarray(self._drawn())

    def png(self) -> bytes:
        """The picture as a PNG file."""
        stream = io.BytesIO()
        self._drawn().save(stream, format="png", compress_level=_COMPRESSION)
        return stream.getvalue()

    def _drawn(self) -> Image.Image:
        picture = self._picture.reduce(_FINE)
        pen = ImageDraw.Draw(picture)
        for text in self._texts:
            _write(picture, pen, text)
        return picture


def text_width(text: str, size: int, bold: bool = False) -> float:
    """Width of one line of text, pixels."""
    return sum(font.getlength(part) for part, font in runs_of(text, size, bold))


def fitting(text: str, size: int, width: float) -> str:
    """Return a line of text, shortened in the middle if it is wider than ``width`` pixels.

    Examples
    --------
    >>> fitting("short", 12, 200), len(fitting("a" * 500, 12, 200)) < 40
    ('short', True)
    """
    if text_width(text, size) <= width:
        return text
    low, high = 0, len(text) // 2
    while low < high:  # the largest number of letters at each end that fits
        many = (low + high + 1) // 2
        low, high = (many, high) if text_width(f"{text[:many]}...{text[-many:]}", size) <= width else (low, many - 1)
    return f"{text[:low]}...{text[len(text) - low :]}"


def _write(picture: Image.Image, pen: ImageDraw.ImageDraw, text: _Text) -> None:
    """Draw one line of text."""
    runs = runs_of(text.text, text.size, text.bold)
    wide = sum(font.getlength(part) for part, font in runs)
    shift = {"l": 0.0, "m": 0.5, "r": 1.0}[text.anchor[0]]
    if text.upward:
        own = Image.new("L", (round(wide) + 4, round(1.5 * text.size)))
        _write_runs(ImageDraw.Draw(own), runs, 2.0, 0.75 * text.size, "m", 255)
        turned = own.transpose(Image.Transpose.ROTATE_90)
        at = round(text.at[0] - turned.width / 2), round(text.at[1] - (1 - shift) * turned.height)
        picture.paste(Image.new("RGB", turned.size, text.color), at, turned)
    else:
        _write_runs(pen, runs, round(text.at[0] - shift * wide), text.at[1], text.anchor[1], text.color)


def _write_runs(pen: ImageDraw.ImageDraw, runs: Sequence[Any], x: float, y: float, anchor: str, color: Any) -> None:
    for part, font in runs:
        pen.text((x, y), part, fill=color, font=font, anchor="l" + anchor)
        x += font.getlength(part)


def _dashed(points: NDArray[np.float64], dashes: Dashes) -> list[NDArray[np.float64]]:
    """The parts of a line that its dashes cover."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    if len(points) < 2 or along[-1] == 0:
        return []
    ends = np.cumsum(np.resize(dashes, max(2, 2 * int(np.ceil(along[-1] / sum(dashes)) * len(dashes) / 2))))
    parts, low = [], 0.0
    for number, high in enumerate(ends):
        if number % 2 == 0 and low < along[-1]:
            inner = points[(along > low) & (along < high)]
            first, last = (
                [np.interp(min(at, along[-1]), along, points[:, axis]) for axis in (0, 1)] for at in (low, high)
            )
            parts.append(np.concatenate([[first], inner, [last]]))
        low = high
    return parts
