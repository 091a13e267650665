"""Draw the moving picture of the README: a press, a drag that says the size, and a correction, in a public scan.

python -m benchmarks.moving_picture [-o FILE]

The scan lies in the folder that ACCELSURF_VOLUMES names (docs/explanation/real-scans.md). Every outline is what the
program found at that moment: during the drag the model of the click for an object of that size, after the release the
surface.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.measure import find_contours

import accelsurf
from accelsurf import io
from accelsurf.clicks.model import Scene, click_model
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Clicks
from accelsurf.image.volume import Volume
from accelsurf.text.clicks import read_clicks

SCAN, RADIUS = "ct_abdomen_hires.nii.gz", 12.0
#: World places (x, y, z), mm: the press in the liver; what is too much after it.
PRESS, OUTSIDE = (-90.0, -150.0, -784.0), (-80.0, -250.0, -784.0)
#: Volumes that the drag passes, ml, and the level and width of the picture, HU.
SIZES, LEVEL, WIDTH = (10, 40, 100, 200, 320, 440, 560, 680), 43.0, 324.0
#: Columns and rows of the slice that are shown.
COLUMNS, ROWS = slice(60, 400), slice(145, 405)
SIDE, COLOUR, MARK = 440, (255, 196, 0), (80, 200, 255)
BELOW, PAUSE = 34, 110


class Frame(NamedTuple):
    """A frame: labels that are outlined, a place of the cursor (x, y, z), words below, and how long it stands, ms."""

    labels: NDArray[np.bool_] | None
    cursor: Sequence[float]
    words: str
    ms: int = PAUSE
    #: Clicks so far: places, and colours.
    marks: tuple[tuple[Sequence[float], tuple[int, int, int]], ...] = ()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images/click.gif"))
    options = parser.parse_args()
    scans = os.environ.get("ACCELSURF_VOLUMES")
    if not scans:
        sys.exit("ACCELSURF_VOLUMES is not set: name the folder with the scans")
    image = io.read(Path(scans) / SCAN)
    drawn = [drawn_frame(image, frame) for frame in frames(image)]
    shown = [each.quantize(48, dither=Image.Dither.NONE) for each, _ in drawn]
    shown[0].save(
        options.output,
        save_all=True,
        append_images=shown[1:],
        duration=[ms for _, ms in drawn],
        loop=0,
    )
    print(
        f"written: {options.output}, {options.output.stat().st_size / 1e6:.2f} MB, {len(drawn)} frames"
    )


def frames(image: Volume) -> list[Frame]:
    """The frames, each with what the program shows then."""
    press = ("ball:" + ",".join(map(str, (*PRESS, RADIUS))),)
    out = [
        Frame(None, at, "Press in the object,") for at in way((-20.0, -60.0, PRESS[2]), PRESS, 8)
    ]
    scene = Scene((image.as_float32(),), image.geometry.spacing)
    clicks = Clicks(tuple(read_clicks(press, "inside", image)), image.geometry.shape)
    marks = ((PRESS, COLOUR),)
    for n, ml in enumerate(SIZES):
        model = click_model(scene, clicks, size_mm3=1000.0 * ml)
        at = (PRESS[0] + 5.0 + 4.0 * n, PRESS[1] + 2.0 * n, PRESS[2])
        labels = model.inside_on(whole_box(image.geometry.shape))
        out.append(Frame(labels, at, f"and draw its size out: {ml} ml.", 220, marks))
    size = f"{SIZES[-1]}ml"
    result = accelsurf.segment(image, inside=press, size=size, keep_state="yes")
    found = result.labels > 0
    out.append(
        Frame(found, out[-1].cursor, f"Release: {result.volume_mm3 / 1000:.0f} ml.", 1500, marks)
    )
    words = "Click where it is wrong:"
    out += [Frame(found, at, words, PAUSE, marks) for at in way(out[-1].cursor, OUTSIDE, 8)]
    marks = (*marks, (OUTSIDE, MARK))
    out.append(Frame(found, OUTSIDE, words, 500, marks))
    better = accelsurf.refine(result, outside=("ball:" + ",".join(map(str, (*OUTSIDE, 4.0))),))
    out.append(Frame(better.labels > 0, OUTSIDE, "it moves there, and nowhere else.", 2600, marks))
    return out


def way(start: Sequence[float], end: Sequence[float], count: int) -> list[NDArray[np.float64]]:
    """Places from one to another, slower towards the end."""
    part = 1.0 - (1.0 - np.linspace(0.0, 1.0, count)) ** 2
    return [np.asarray(start) + p * (np.asarray(end) - np.asarray(start)) for p in part]


def drawn_frame(image: Volume, frame: Frame) -> tuple[Image.Image, int]:
    """A frame in colours, and how long it stands."""
    geometry = image.geometry
    z = round(float(geometry.world_to_index(np.asarray(PRESS))[0]))
    values = image.array[z, ROWS, COLUMNS].astype(np.float32)
    grey = np.clip((values - LEVEL) / WIDTH + 0.5, 0.0, 1.0)
    scale = SIDE / max(grey.shape)
    size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
    picture = (
        Image.fromarray((255 * grey).astype(np.uint8))
        .resize(size, Image.Resampling.BILINEAR)
        .convert("RGB")
    )
    whole = Image.new("RGB", (size[0], size[1] + BELOW), (24, 24, 24))
    whole.paste(picture, (0, 0))
    pen = ImageDraw.Draw(whole)

    def pixel(place: Sequence[float]) -> tuple[float, float]:
        _, y, x = geometry.world_to_index(np.asarray(place))
        return (float(x) - COLUMNS.start + 0.5) * scale, (float(y) - ROWS.start + 0.5) * scale

    if frame.labels is not None:
        for line in find_contours(
            np.pad(frame.labels[z, ROWS, COLUMNS].astype(np.float32), 1), 0.5
        ):
            pen.line(
                [((x - 0.5) * scale, (y - 0.5) * scale) for y, x in line], fill=COLOUR, width=2
            )
    for place, colour in frame.marks:
        x, y = pixel(place)
        pen.ellipse((x - 4, y - 4, x + 4, y + 4), fill=colour, outline=(0, 0, 0))
    x, y = pixel(frame.cursor)
    arrow = [(0, 0), (0, 17), (4, 13), (8, 20), (11, 19), (7, 12), (12, 12)]
    pen.polygon([(x + dx, y + dy) for dx, dy in arrow], fill=(255, 255, 255), outline=(0, 0, 0))
    pen.text((10, size[1] + 7), frame.words, fill=(235, 235, 235), font=ImageFont.load_default(17))
    return whole, frame.ms


if __name__ == "__main__":
    main()
