import io as streams
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from matplotlib.text import Text
from PIL import Image, ImageColor

from accelsurf.grid.geometry import Geometry
from accelsurf.io import read_sequence
from accelsurf.output.pictures.canvas import GREEN, ORANGE, SKY, Canvas
from accelsurf.track.output import slices
from accelsurf.track.output.frames import FrameStore, TrackSet
from tests.support.trackings import Ball, dividing_cells, flat_cells, tracking


def set_of(made, folder) -> TrackSet:
    store = FrameStore(folder / "frames")
    for result in made.results:
        store.put(result)
    rows = tuple(store.frame_row(number) for number in store.numbers())
    return TrackSet("cells", made.sequence, rows, made.lineage, store)


def pixels_of(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(streams.BytesIO(png)).convert("RGB")).astype(int)


def is_color(pixels: np.ndarray, color: str) -> np.ndarray:
    return np.abs(pixels - np.array(ImageColor.getrgb(color))).max(axis=-1) < 30


def panel(pixels: np.ndarray, number: int) -> np.ndarray:
    """A panel of the first line of a film strip, with room for its rounding, below the title."""
    step = slices.PANEL + slices.GAP
    left, top = 14 + number * step, slices.TOP
    return pixels[top : top + 220, left : left + slices.PANEL]


def test_film_strip_shows_prediction_and_correction(tmp_path):
    pixels = pixels_of(slices.film_strip_png(set_of(flat_cells(), tmp_path)))
    counts = [
        [int(is_color(panel(pixels, n), color).sum()) for color in (SKY, ORANGE, GREEN)]
        for n in range(4)
    ]
    assert [sky > 100 for sky, _, _ in counts[1:]] == [
        True,
        True,
        False,
    ]  # what begins was not predicted
    assert [orange > 300 for _, orange, _ in counts] == [True, True, True, False]
    assert [green > 300 for _, _, green in counts[:3]] == [True] * 3
    # object 1 moves by 1 mm to the right, of 14 mm that are 320 pixels wide; its prediction is where it was before
    middle = [np.flatnonzero(is_color(panel(pixels, n), ORANGE)[:150].any(axis=0)) for n in (1, 2)]
    middle = [0.5 * (columns.min() + columns.max()) for columns in middle]
    predicted = np.flatnonzero(is_color(panel(pixels, 2), SKY)[:150, :160].any(axis=0))
    assert middle[1] - middle[0] == pytest.approx(slices.PANEL / _width_mm(tmp_path), abs=3)
    assert predicted.min() < middle[1] - 40


def _width_mm(folder) -> float:
    from accelsurf.track.output.slices import TrackView

    low, high = TrackView.of(set_of(flat_cells(), folder)).ranges[2]
    return 0.5 * (high - low)


@pytest.mark.parametrize("direction", [np.eye(3), np.diag([-1.0, -1.0, 1.0]), np.eye(3)[[1, 2, 0]]])
def test_contours_lie_on_the_objects_in_any_orientation(tmp_path, direction):
    geometry = Geometry((12, 20, 24), (2.0, 1.0, 1.0), (3.0, 4.0, 5.0), direction)
    made = tracking(geometry, [{1: Ball((4.0, 6.0, 7.0), 4.0)}, {1: Ball((6.0, 13.0, 16.0), 4.0)}])
    pixels = pixels_of(slices.film_strip_png(set_of(made, tmp_path)))
    left = (pixels.shape[1] - 2 * (slices.PANEL + slices.GAP) + slices.GAP) // 2
    first = left + slices.PANEL + slices.GAP  # the second panel, which has no legend
    own = pixels[slices.TOP : -64, first : first + slices.PANEL]
    found = np.argwhere(is_color(own, ORANGE))
    bright = np.argwhere(own.min(axis=-1) > 235)
    np.testing.assert_allclose(found.mean(axis=0), bright.mean(axis=0), atol=6)
    assert (bright.min(axis=0) > found.min(axis=0) - 12).all()
    assert (bright.max(axis=0) < found.max(axis=0) + 12).all()


def test_all_pictures_of_a_tracking_read_each_frame_for_their_view_once(tmp_path, monkeypatch):
    """Before its own panels a picture needs the part and the grey values that all share."""
    made = tracking(
        Geometry((1, 16, 40), (1.0, 1.0, 1.0)),
        [{1: Ball((0.0, 8.0, 8.0 + n), 3.0)} for n in range(16)],
    )
    tracks = set_of(made, tmp_path)
    unpacked, read = [], []
    drawn, frame = FrameStore.drawn, type(tracks.sequence).frame
    monkeypatch.setattr(
        FrameStore, "drawn", lambda self, n: (unpacked.append(n), drawn(self, n))[1]
    )
    monkeypatch.setattr(
        type(tracks.sequence), "frame", lambda self, n: (read.append(n), frame(self, n))[1]
    )
    slices.film_strip_png(tracks)
    shown = [row.frame for row in slices.picked(tracks.rows)]
    assert unpacked == [*range(16), *shown] and read == [0, *shown]
    for _ in range(2):  # two formats of a movie
        unpacked.clear(), read.clear()
        assert len(list(slices.movie_frames(tracks))) == 16
        assert unpacked == read == list(range(16))  # one reading for both halves
    assert tracks.extent == (slice(0, 1), slice(6, 11), slice(6, 26))


def test_film_strip_of_many_frames_has_the_first_and_the_last(tmp_path):
    geometry = Geometry((1, 16, 16), (1.0, 1.0, 1.0))
    made = tracking(geometry, [{1: Ball((0.0, 8.0, 8.0), 3.0)}] * 26)
    tracks = set_of(made, tmp_path)
    shown = [row.frame for row in slices.picked(tracks.rows)]
    assert (shown[0], shown[-1], len(shown)) == (0, 25, slices.MAX_FRAMES)
    assert pixels_of(slices.film_strip_png(tracks)).shape[1] > 4 * slices.PANEL


def test_pictures_of_no_object_can_be_drawn(tmp_path):
    tracks = set_of(tracking(flat_cells().sequence.geometry, [{}, {}]), tmp_path)
    assert not is_color(pixels_of(slices.film_strip_png(tracks)), ORANGE)[:, 200:].any()
    assert pixels_of(slices.curves_png(tracks)).shape == (*slices.CURVES_SIZE[::-1], 3)


@pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("um", 1e-3), ("nm", 1e-6)])
@pytest.mark.parametrize("file", [False, True])
def test_pictures_are_in_the_unit_of_the_sequence(tmp_path, monkeypatch, unit, mm, file):
    written = []
    png = Canvas.png
    monkeypatch.setattr(
        Canvas,
        "png",
        lambda self: (written.extend(self.figure.findobj(Text)), png(self))[1],
    )
    geometry = Geometry((8, 16, 16), (2 * mm, mm, mm), unit=unit)
    made = tracking(geometry, [{1: Ball((4.0, 8.0, 8.0), 2.5 * mm)}] * 2)
    tracks = set_of(made, tmp_path)
    if file:  # headers give their grid in mm, and the unit beside it
        stack = np.stack([frame.image.array for frame in made.results]).astype(np.uint8)
        tifffile.imwrite(
            tmp_path / "frames.tif",
            stack[:, :, None],
            imagej=True,
            metadata={"axes": "TZCYX", "spacing": 2, "unit": unit},
            resolution=(1, 1),
        )
        tracks = replace(tracks, sequence=read_sequence(tmp_path / "frames.tif"))
    slices.film_strip_png(tracks)
    slices.curves_png(tracks)
    texts = [text.get_text() for text in written]
    captions = [text for text in texts if text.startswith("frame ") and "z = " in text]
    assert len(captions) == 2 and all(text.endswith(f"z = 8 {unit}") for text in captions)
    assert f"volume ({unit}\u00b3)" in texts and f"2 {unit}" in texts  # the scale bar


def test_curves_have_a_gap_where_the_object_is_not_seen(tmp_path):
    geometry = Geometry((1, 16, 16), (1.0, 1.0, 1.0))
    frames = [{1: Ball((0.0, 8.0, 8.0), 3.0 + 0.1 * n, seen=n not in (4, 5))} for n in range(10)]
    pixels = pixels_of(slices.curves_png(set_of(tracking(geometry, frames), tmp_path)))
    drawn = is_color(pixels, ORANGE).any(axis=0)
    inner = drawn[90:870]
    gap = inner[round(3.2 / 9 * 780) : round(5.8 / 9 * 780)]
    assert not gap.any()
    assert inner[: round(2.9 / 9 * 780)].mean() > 0.95


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_movie_has_a_picture_for_each_frame(tmp_path, suffix):
    pytest.importorskip("imageio_ffmpeg")
    tracks = set_of(dividing_cells(), tmp_path)
    slices.write_track_movie(tracks, tmp_path / f"cells.{suffix}")
    if suffix == "gif":
        with Image.open(tmp_path / "cells.gif") as movie:
            assert (movie.n_frames, movie.size) == (5, slices.MOVIE_SIZE)
    else:
        import imageio_ffmpeg

        assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "cells.mp4"))[0] == 5


def test_movie_has_the_prediction_at_the_left_and_the_correction_at_the_right(tmp_path):
    pictures = list(slices.movie_frames(set_of(flat_cells(), tmp_path)))
    half = slices.MOVIE_SIZE[0] // 2
    left, right = pictures[1][:, :half].astype(int), pictures[1][:, half:].astype(int)
    assert [bool(is_color(side, SKY).sum() > 100) for side in (left, right)] == [True, False]
    assert [bool(is_color(side, ORANGE).sum() > 100) for side in (left, right)] == [False, True]
