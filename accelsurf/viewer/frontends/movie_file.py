"""Movies of a run: frames off screen into mp4, gif or webp; nothing is left half written."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, features

from accelsurf import io
from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.evolution.records import StepRecord
from accelsurf.io.files import staging
from accelsurf.segmentation.run import Run
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.scene.scene import SIZE, Scene

FORMATS = (".mp4", ".gif", ".webp")
#: Smallest and largest side of a movie, pixels: below text cannot be read, above encoders give up.
MIN_SIDE, MAX_SIDE = 160, 4096

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Film:
    """How a run becomes a movie.

    Parameters
    ----------
    every : int
        Frames are drawn of each so many steps, of the first and of the last.
    fps : float
        Frames per second.
    orbit : float
        Degrees that the camera turns per second of movie; 0 stands still.
    hold : float
        Seconds that the last frame is shown longer; the camera goes on turning.
    size : (int, int)
        Width and height, pixels.

    Raises
    ------
    UsageError
        When one of them is out of bounds.
    """

    every: int = 1
    fps: float = 15.0
    orbit: float = 12.0
    hold: float = 2.0
    size: tuple[int, int] = SIZE

    def __post_init__(self) -> None:
        bounds = {"every": (1, 1e6), "fps": (0.1, 120.0), "orbit": (-3600.0, 3600.0), "hold": (0.0, 600.0)}
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(f"{name}: {value:g} was given, expected {low:g} to {high:g}")
        if any(not MIN_SIDE <= side <= MAX_SIDE for side in self.size):
            given = "x".join(str(side) for side in self.size)
            raise UsageError(f"size: {given} was given, expected sides of {MIN_SIDE} to {MAX_SIDE} pixels")


def check_target(path: Path, size: tuple[int, int]) -> None:
    """Refuse a movie that cannot be written here, before anything is computed.

    Raises
    ------
    UsageError
        For an unknown suffix, a size that the format cannot have, or an encoder that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise UsageError(f"{path.name}: {suffix or 'no suffix'} was given, expected {', '.join(FORMATS)}")
    if suffix == ".mp4":
        if any(side % 2 for side in size):
            raise UsageError(f"size: {size[0]}x{size[1]} was given, expected even numbers for mp4")
        _ffmpeg()
    if suffix == ".webp" and not features.check("webp"):
        raise UsageError("webp: Pillow was built without it here", "take .mp4 or .gif")


def pictures(
    run: Run, scene: Scene, film: Film, on_step: Callable[[StepRecord], bool | None] | None = None
) -> Iterator[Picture]:
    """Run, drawing as it goes.

    Parameters
    ----------
    run : Run
        Made ready; it is run to its end.
    scene : Scene
        Of the same image.
    film : Film
    on_step : callable, optional
        Called with each row; a true return value ends the run.

    Yields
    ------
    ndarray (height, width, 3), uint8
    """
    turn, evolution = film.orbit / film.fps, run.evolution
    with run.workers:
        for step in run:
            if on_step is not None and on_step(step.row):
                evolution.ask_to_stop()
            if step.row.step % film.every == 0 or evolution.stop is not None:
                scene.update(Frame.of(step, run.geometry, evolution.flow, first=run.prepared.first), evolution.history)
                yield scene.screenshot()
                scene.orbit(turn)
    for _ in range(math.ceil(film.hold * film.fps)):
        yield scene.screenshot()
        scene.orbit(turn)


def run_to_last(run: Run, scene: Scene, on_step: Callable[[StepRecord], bool | None] | None = None) -> None:
    """Run to the end and put its last frame into a scene; parameters as of `pictures`."""
    evolution = run.evolution
    with run.workers:
        for step in run:
            if on_step is not None and on_step(step.row):
                evolution.ask_to_stop()
            if evolution.stop is not None:
                scene.update(Frame.of(step, run.geometry, evolution.flow, first=run.prepared.first), evolution.history)


def write(path: Path, frames: Iterable[Picture], film: Film) -> int:
    """Write frames as a movie by suffix; the file appears whole or not at all. Returns how many there were.

    Raises
    ------
    UsageError
        As `check_target`.
    OutputError
        When the file cannot be written.
    """
    check_target(path, film.size)
    encode = _mp4 if path.suffix.lower() == ".mp4" else _animation
    with staging(path) as folder:
        draft = folder / path.name
        count = encode(draft, frames, film)
        os.replace(draft, path)
    return count


def _mp4(path: Path, frames: Iterable[Picture], film: Film) -> int:
    ffmpeg = _ffmpeg()
    # yuv420p and faststart: what any browser and any slide show plays.
    writer = ffmpeg.write_frames(
        str(path), film.size, fps=film.fps, codec="libx264", quality=8, macro_block_size=2,
        ffmpeg_log_level="error", output_params=["-movflags", "+faststart", "-threads", "2"],
    )
    writer.send(None)
    count = 0
    try:
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
            count += 1
    except OSError as error:
        raise OutputError(f"{path.name}: ffmpeg gave up ({error})", "is there space on the disk?") from error
    finally:
        writer.close()
    return count


def _animation(path: Path, frames: Iterable[Picture], film: Film) -> int:
    count = 0

    def images() -> Iterator[Image.Image]:
        nonlocal count
        for frame in frames:
            count += 1
            yield Image.fromarray(frame)

    stream = images()
    first = next(stream)
    # A GIF counts hundredths of a second; two are the least that viewers obey.
    duration = max(20, round(1000 / film.fps))
    options: dict[str, Any] = {"quality": 80, "method": 4} if path.suffix.lower() == ".webp" else {"disposal": 1}
    first.save(path, save_all=True, append_images=stream, duration=duration, loop=0, **options)
    return count


def _ffmpeg() -> Any:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise UsageError(
            "mp4: imageio-ffmpeg is not installed", 'pip install "accelsurf[viewer]"; .gif and .webp need nothing more'
        ) from None
    return imageio_ffmpeg


# -- from a result folder -----------------------------------------------------------------------------------


def run_of_folder(folder: Path) -> tuple[Path, RunConfig]:
    """The image and the settings of the run that left its results in a folder: with them it repeats, byte for byte.

    Parameters
    ----------
    folder : Path
        Where ``accelsurf segment`` wrote; it must hold one report.

    Raises
    ------
    InputError
        When there is no report or more than one, it tells of no run that can be repeated, or the image is not there
        or not the same any more.
    """
    reports = sorted(folder.glob("*_report.json"))
    if len(reports) != 1:
        found = "no report (NAME_report.json)" if not reports else f"{len(reports)} reports"
        raise InputError(f"{folder}: {found} there, expected one", "give the image and its settings instead")
    path = reports[0]
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        settings, source = document["config"], document["input"]
        image, checksum = Path(source["path"]), source["sha256"]
        if not isinstance(settings, dict):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError):
        told = f"{path}: not the report of a run that can be repeated"
        raise InputError(told, "run accelsurf segment anew") from None
    if str(settings.get("energy", "")).startswith("custom: "):
        raise InputError(f"{path}: the energy was one of your own ({settings['energy']})", "make the movie in Python")
    if not image.is_file():
        raise InputError(f"{path}: the image {image} is not there any more", "give the image and --config instead")
    if checksum is not None and io.sha256(image) != checksum:
        raise InputError(f"{image}: has changed, it is not the image of {path.name} any more", "run segment anew")
    return image, RunConfig(**settings)
