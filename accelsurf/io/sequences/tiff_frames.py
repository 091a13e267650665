"""Sequences written as OME-TIFF: a page for each slice of each frame, times in the XML of the first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from accelsurf.io.formats.tiff_file import write_pages
from accelsurf.io.headers import TIMES_KEY

if TYPE_CHECKING:
    from accelsurf.io.sequences.writing import FrameStack

_OME_TYPES = {"float32": "float"}


def write_tiff_frames(path: Path, frames: FrameStack) -> None:
    """Write the pages, deflated.

    Raises
    ------
    UsageError
        When the file would pass 4 GiB, which a TIFF cannot hold.
    """
    with path.open("w+b") as file:
        pages = (page for frame in frames for page in frame)
        write_pages(
            file, pages, _xml(frames), "write an .ome.zarr, or a file for each frame: frame*.tif"
        )


def _xml(frames: FrameStack) -> str:
    """The OME-XML."""
    geometry, times = frames.geometry, frames.times
    (depth, height, width), (hz, hy, hx) = geometry.shape, geometry.spacing
    said: dict[str, Any] = {
        "ID": "Pixels:0",
        "DimensionOrder": "XYZCT",
        "Type": _OME_TYPES.get(frames.dtype.name, frames.dtype.name),
        "SizeX": width,
        "SizeY": height,
        "SizeZ": depth,
        "SizeC": 1,
        "SizeT": len(frames),
        "PhysicalSizeX": repr(hx),
        "PhysicalSizeXUnit": "mm",
        "PhysicalSizeY": repr(hy),
        "PhysicalSizeYUnit": "mm",
        "PhysicalSizeZ": repr(hz),
        "PhysicalSizeZUnit": "mm",
    }
    if times.seconds:
        said |= {"TimeIncrement": repr(times.seconds), "TimeIncrementUnit": "s"}
    pixels = " ".join(f"{key}={quoteattr(str(value))}" for key, value in said.items())
    planes = notes = ""
    if times.unit == "s":
        planes = "".join(
            f'<Plane TheC="0" TheT="{t}" TheZ="{z}" DeltaT="{time!r}" DeltaTUnit="s"/>'
            for t, time in enumerate(times.values)
            for z in range(depth)
        )
    elif not times.is_count:
        notes = (
            f'<StructuredAnnotations><CommentAnnotation ID="Annotation:0" Namespace="{TIMES_KEY}">'
            f"<Value>{times.text}</Value></CommentAnnotation></StructuredAnnotations>"
        )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
        f'<Image ID="Image:0"><Pixels {pixels}><Channel ID="Channel:0:0" SamplesPerPixel="1"/>'
        f'<TiffData IFD="0" PlaneCount="{len(frames) * depth}"/>{planes}</Pixels></Image>{notes}</OME>'
    )
