"""``accelsurf look``: slices of an image with a grid in mm, without a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from accelsurf.cases import say
from accelsurf.cli.options import (
    FILES,
    IMAGE,
    File,
    Overwrite,
    required,
    run_config,
    settings_class,
)
from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.image.grey_window import parse_window
from accelsurf.image.volume import Volume
from accelsurf.io import (
    WARNING_KEY,
    InputFiles,
    import_nibabel_for,
    is_store,
    open_channels,
    read_channels,
    size_question,
    split_name,
    write_bytes,
)
from accelsurf.output import inputs_of, make_writable
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.wording import voxel_text
from accelsurf.text.coordinates import coordinates_of, place_text
from accelsurf.text.starts import extent_hint

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from accelsurf.grid.geometry import Geometry

#: Most voxels of a level of a store: the finest level within this limit is shown, unless told.
MAX_VOXELS = 1 << 27
#: It chooses the level itself.
ReadWithoutLevel = settings_class(
    "ReadWithoutLevel", leave_out=("level",), groups=(SettingGroup.IMAGE,)
)


def look(
    input: Annotated[Path | None, Parameter(name=("IMAGE", "--input", "-i"), group=FILES)] = None,
    *,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"), group=FILES)] = None,
    at: str | None = None,
    window: str = "auto",
    labels: File = None,
    level: Annotated[
        int | None, Parameter(group=IMAGE, show_default="the finest that is not too large")
    ] = None,
    overwrite: Overwrite = False,
    reading: ReadWithoutLevel | None = None,  # type: ignore[valid-type]
) -> int:
    """Look at an image: three slices with a grid in mm, without a run.

    Where to click can be read off the picture: its scales are the coordinates of --inside and --start, with the ending
    that is written below them (um, or grid for an oblique image). Prints the size of the image, its voxels and its
    values, where the slices meet as options take it, and the name of the picture.

    Parameters
    ----------
    input
        The image.
    output
        The picture, a PNG file, or the folder for it; NAME_look.png in the present folder by default, where a picture
        that look made and nobody has changed since is replaced.
    at
        Where the three slices meet: X,Y,Z in world mm (LPS), or with a unit (um), or vox (voxel indices), or grid (the
        scales of the picture) at the end; the middle of the labels, else of the image, by default.
    window
        Values that are black to white: LEVEL,WIDTH, auto, or of a CT soft-tissue, bone, lung or brain.
    labels
        A label map on the same grid, drawn as contours.
    level
        Level of an image that is stored as a pyramid (OME-Zarr); 0 is the finest.
    overwrite
        Replace a picture that exists.
    """
    from accelsurf.output import is_own_picture

    source = required(input, "IMAGE")
    shown = parse_window(window)
    path = _picture(source, output)
    InputFiles(inputs_of(source, None, labels)).refuse([path])
    if path.exists() and not overwrite and not (output is None and is_own_picture(path)):
        raise OutputError(f"{path}: exists already", "choose another with -o, or add --overwrite")
    volumes, grid = _read(source, level, run_config(reading).reading)
    _say_notes(volumes, source)
    from accelsurf.output import look_png  # loads modules that draw

    geometry = volumes[0].geometry
    place = None if at is None else typed_place(at, grid)
    drawn = None if labels is None else _labels(labels, geometry)
    make_writable(path.parent)
    head = f"{source.name}: {_said_of(volumes)}"
    write_bytes(path, look_png(volumes, head, at=place, window=shown, labels=drawn))
    print(
        f"size     {_said_of(volumes)}" + (f", {len(volumes)} channels" if len(volumes) > 1 else "")
    )
    for number, volume in enumerate(volumes, 1):
        which = f" of channel {number}" if len(volumes) > 1 else ""
        print(f"values   {_values(volume.array)}{which}")
    print(f"at       {_met(volumes[0], place, drawn)}")
    print(f"picture  {path.absolute()}")
    return 0


def _say_notes(volumes: list[Volume], source: Path) -> None:
    """Print the warnings about the files of an image."""
    notes = [volume.metadata.get(WARNING_KEY, "") for volume in volumes]
    for note in dict.fromkeys([*notes, size_question(volumes[0], source)]):
        if note:
            say(f"warning: {note}")


def _met(volume: Volume, at: Sequence[float] | None, labels: NDArray[Any] | None) -> str:
    """The place where the slices meet, as options take it."""
    from accelsurf.output import voxel_shown

    voxel = voxel_shown(volume.geometry, at, labels)
    return place_text(volume.geometry.index_to_world(voxel).tolist(), volume.geometry)


def _values(array: NDArray[Any]) -> str:
    """From where to where the values go, and how many are none."""
    import numpy as np

    if array.dtype.kind != "f":
        return f"{array.min()} to {array.max()}"
    finite = np.isfinite(array)
    nans = int(np.isnan(array).sum())
    others = {"NaN": nans, "infinite": int(array.size - finite.sum()) - nans}
    said = [
        f"{count} voxel{'s are' if count > 1 else ' is'} {noun}"
        for noun, count in others.items()
        if count
    ]
    if finite.any():
        known = array[finite]
        said.insert(0, f"{known.min():.6g} to {known.max():.6g}")
    return ", ".join(said)


def _said_of(volumes: list[Volume]) -> str:
    """Size of an image, and of its voxels in the unit of the file."""
    grid = volumes[0].geometry
    size = " x ".join(str(n) for n in grid.size)
    return f"{size} voxels of {voxel_text(grid.spacing_xyz, grid.unit)}"


def _read(source: Path, level: int | None, requested: ReadOptions) -> tuple[list[Volume], Geometry]:
    """Return the channels of an image, or of a level of a store, and the grid that indices belong to.

    That is the grid of the level that was requested, else of the finest.
    """
    import math

    from accelsurf.cli.large_image import whole_volume

    import_nibabel_for(source)
    if level is None and not is_store(source):
        volumes = read_channels(source, requested)
        return volumes, volumes[0].geometry
    opened = open_channels(source, replace(requested, level=level or 0))
    layout = opened[0].layout
    shown = level
    if shown is None:
        small = (n for n, grid in enumerate(layout.levels) if math.prod(grid.shape) <= MAX_VOXELS)
        shown = next(small, len(layout.levels) - 1)
        opened = open_channels(source, replace(requested, level=shown))
    if len(layout.levels) > 1 or requested.time_index is not None:
        time = requested.time_index
        moment = f", time point {time} of {layout.time_points}" if time is not None else ""
        print(f"level    {shown} of 0 to {len(layout.levels) - 1}{moment}")
    return [whole_volume(channel) for channel in opened], layout.levels[level or 0]


def _labels(path: Path, geometry: Geometry) -> NDArray[Any]:
    """A label map on the image's grid.

    Raises
    ------
    InputError
        When it lies on another one.
    """
    from accelsurf import io

    known = io.read_labels(path, grid=geometry)
    if not known.geometry.matches(geometry):
        difference = known.geometry.difference(geometry)
        raise InputError(
            f"{path}: on another grid than the image ({difference})", "give labels of this image"
        )
    return known.array


def _picture(source: Path, output: Path | None) -> Path:
    """The file of the picture.

    Raises
    ------
    UsageError
        When it would not be a PNG.
    """
    name = f"{split_name(source)[0]}_look.png"
    if output is None:
        return Path(name)
    if output.is_dir() or not output.suffix:
        return output / name
    if output.suffix.lower() != ".png":
        raise UsageError(f"-o: {output} was given, expected a file .png or a folder")
    return output


def typed_place(text: str, geometry: Geometry) -> tuple[float, float, float]:
    """The world place, mm, that was typed.

    Raises
    ------
    UsageError
        When it is none, or lies outside the image.
    """
    import numpy as np

    from accelsurf.text.coordinates import SUFFIXES

    found = coordinates_of(text)
    if found is None or len(found.numbers) != 3 or not np.isfinite(found.numbers).all():
        raise UsageError(
            f"--at: {text[:40]!r} was given, expected X,Y,Z in mm (world, LPS)",
            f"or with {SUFFIXES}, as 12,40,7vox",
        )
    found = found.on(geometry)
    index = np.array(found.numbers[::-1]) if found.vox else geometry.world_to_index(found.numbers)
    if not ((index >= -0.5) & (index <= np.array(geometry.shape) - 0.5)).all():
        raise UsageError(
            f"--at: {text} lies outside of the image",
            extent_hint(geometry),
        )
    x, y, z = (float(v) for v in geometry.index_to_world(index))
    return x, y, z
