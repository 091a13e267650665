"""Sequences written as OME-Zarr 0.5 with an axis of time, one level, a chunk within one frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from accelsurf.io.formats.ome_metadata import OWN_KEY, attributes_of
from accelsurf.io.formats.zarr_files import with_record
from accelsurf.io.formats.zarr_pyramid import chunk_shape
from accelsurf.io.formats.zarr_voxels import zarr_library
from accelsurf.io.headers import TIMES_KEY, split_name

if TYPE_CHECKING:
    from accelsurf.io.sequences.writing import FrameStack


def write_ome_zarr_frames(path: Path, frames: FrameStack) -> None:
    """Write the frames; a chunk of zeros takes no space."""
    zarr = zarr_library()
    from zarr.codecs import ZstdCodec

    shape = frames.geometry.shape
    group = zarr.create_group(path, zarr_format=3, attributes=_attributes(path, frames))
    array = group.create_array(
        "0",
        shape=(len(frames), *shape),
        chunks=(1, *chunk_shape(shape)),
        dtype=frames.dtype,
        compressors=[ZstdCodec(level=0, checksum=True)],
        fill_value=0,
        dimension_names=("t", "z", "y", "x"),
    )
    for number, values in enumerate(frames):
        array[number] = np.asarray(values, frames.dtype)
    group.attrs[OWN_KEY] = with_record(dict(group.attrs)[OWN_KEY], path, group)


def _attributes(path: Path, frames: FrameStack) -> dict[str, Any]:
    """Attributes of an image of one frame, with an axis of time before the others."""
    geometry, times = frames.geometry, frames.times
    metadata = {} if times.is_count or times.seconds else {TIMES_KEY: times.text}
    level = ("0", geometry.spacing, (0.0, 0.0, 0.0))
    attributes = attributes_of(geometry, [level], metadata, split_name(path)[0], "mean")
    image = attributes["ome"]["multiscales"][0]
    del image["type"]  # there are no coarser levels that were made in some way
    unit = {"unit": "second"} if times.unit == "s" else {}
    image["axes"].insert(0, {"name": "t", "type": "time", **unit})
    scale, translation = image["datasets"][0]["coordinateTransformations"]
    scale["scale"].insert(0, times.mean_step)
    translation["translation"].insert(0, times.values[0])
    return {"ome": attributes["ome"], OWN_KEY: attributes[OWN_KEY]}
