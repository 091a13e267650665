"""Pictures into mp4, gif or webp, or PNG; no file is left incomplete."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, features
from PIL.PngImagePlugin import PngInfo

from accelsurf.errors import OutputError, UsageError
from accelsurf.io import SPACE_HINT, staging, write_bytes

MOVIE_FORMATS = (".mp4", ".gif", ".webp")
#: Of 9: more takes longer, and saves a few percent of a picture.
_COMPRESSION = 3
#: Smallest and largest side of a movie, pixels: smaller text cannot be read, larger pictures encoders refuse.
MIN_SIDE = 160
MAX_SIDE = 4096

Picture = NDArray[np.uint8]


def check_target(path: Path, size: tuple[int, int]) -> None:
    """Refuse a movie that cannot be written here, before anything is computed.

    Parameters
    ----------
    path : Path
        Its suffix decides the format.
    size : (int, int)
        Width and height, pixels.

    Raises
    ------
    UsageError
        For an unknown suffix, a size that the format cannot have, or an encoder that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in MOVIE_FORMATS:
        raise UsageError(
            f"{path.name}: {suffix or 'no suffix'} was given, expected {', '.join(MOVIE_FORMATS)}",
            f"write {path.stem}.mp4",
        )
    if suffix == ".mp4":
        if any(side % 2 for side in size):
            raise UsageError(
                f"size: {size[0]}x{size[1]} was given, expected even numbers for mp4",
                "as in 1280x720",
            )
        _ffmpeg()
    if suffix == ".webp" and not features.check("webp"):
        raise UsageError("webp: Pillow was built without it here", "take .mp4 or .gif")


def write_movie(path: Path, frames: Iterable[Picture], size: tuple[int, int], fps: float) -> int:
    """Write frames as a movie by suffix; the file appears whole or not at all. Returns how many there were.

    Parameters
    ----------
    path : Path
    frames : iterable of ndarray (height, width, 3), uint8
    size : (int, int)
        Width and height, pixels.
    fps : float
        Frames per second.

    Raises
    ------
    UsageError
        As `check_target`.
    OutputError
        When the file cannot be written.
    """
    check_target(path, size)
    with staging(path) as files:
        staged = files.staging / path.name
        is_mp4 = path.suffix.lower() == ".mp4"
        count = _mp4(staged, frames, size, fps) if is_mp4 else _animation(staged, frames, fps)
        _check_staged(staged, count)
        files.commit()
    return count


def _check_staged(staged: Path, count: int) -> None:
    """Refuse a movie that does not hold all its frames: encoders may say nothing of a full disk.

    Raises
    ------
    OutputError
        With the number that it holds.
    """
    try:
        if staged.suffix.lower() == ".mp4":
            found, _ = _ffmpeg().count_frames_and_secs(str(staged))
        else:
            with Image.open(staged) as movie:
                # Frames that are alike are joined: the last one must be whole.
                found = count
                movie.seek(getattr(movie, "n_frames", 1) - 1)
                movie.load()
    except (OSError, EOFError, SyntaxError, ValueError, RuntimeError) as error:
        raise OutputError(
            f"{staged.name}: cannot be written (it is damaged: {error})", SPACE_HINT
        ) from error
    if found != count:
        raise OutputError(
            f"{staged.name}: cannot be written ({found} of {count} frames arrived)", SPACE_HINT
        )


def _mp4(path: Path, frames: Iterable[Picture], size: tuple[int, int], fps: float) -> int:
    ffmpeg = _ffmpeg()
    # yuv420p and faststart: any browser and any slide show plays them.
    writer = ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,
        codec="libx264",
        quality=8,
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=["-movflags", "+faststart", "-threads", "2"],
    )
    writer.send(None)
    count = 0
    try:
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
            count += 1
    except OSError as error:
        raise OutputError(f"{path.name}: ffmpeg failed ({error})", SPACE_HINT) from error
    finally:
        writer.close()
    return count


def _animation(path: Path, frames: Iterable[Picture], fps: float) -> int:
    count = 0

    def images() -> Iterator[Image.Image]:
        nonlocal count
        for frame in frames:
            count += 1
            yield Image.fromarray(frame)

    stream = images()
    first = next(stream)
    # A GIF counts hundredths of a second; viewers ignore less than two.
    duration = max(20, round(1000 / fps))
    options: dict[str, Any] = (
        {"quality": 80, "method": 4} if path.suffix.lower() == ".webp" else {"disposal": 1}
    )
    first.save(path, save_all=True, append_images=stream, duration=duration, loop=0, **options)
    return count


def _ffmpeg() -> Any:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise UsageError(
            "mp4: imageio-ffmpeg is not installed",
            'pip install "accelsurf[viewer]"; .gif and .webp need nothing more',
        ) from None
    return imageio_ffmpeg


def write_png(path: Path, picture: Picture) -> None:
    """Write a picture (height, width, 3) as a PNG file, whole or not at all; OutputError when it cannot be written."""
    write_bytes(path, png_bytes(picture))


def png_bytes(picture: Picture, said: PngInfo | None = None) -> bytes:
    """Return a picture (height, width, 3) as a PNG file, with texts in it."""
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(
        stream, "png", compress_level=_COMPRESSION, pnginfo=said
    )
    return stream.getvalue()
