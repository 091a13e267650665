"""Second looks at inputs of several files and at sequences, which know nothing of accelsurf."""

import gzip
import io
import json
import struct
import warnings
import zlib

import numpy as np

from tests.fuzz.folders import CHUNK
from tests.fuzz.independent import look
from tests.fuzz.inputs import SHAPE, VALUES


def quietly(function, *arguments):
    """What another program says; None where it fails."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return function(*arguments)
    except Exception:
        return None


# -- frames


def frames(content: bytes, suffix: str):
    """Array (t, z, y, x) of a sequence in one file, or None."""
    return quietly(_frames, content, suffix)


def _frames(content: bytes, suffix: str):
    import nibabel
    import tifffile

    if suffix in (".nii", ".nii.gz"):
        content = gzip.decompress(content) if suffix == ".nii.gz" else content
        kind = (
            nibabel.Nifti2Image
            if content[:4] in (b"\x1c\2\0\0", b"\0\0\2\x1c")
            else nibabel.Nifti1Image
        )
        values = np.asanyarray(kind.from_bytes(content).dataobj)
        return values.T if values.ndim == 4 else None
    if suffix == ".npy":
        values = np.load(io.BytesIO(content), allow_pickle=False)
        return values if values.ndim == 4 else None
    if suffix == ".tif":
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            series = file.series[0]
            return series.asarray() if series.axes == "TZYX" else None
    return None


# -- chunks


def chunk(content: bytes, codec: str):
    """Values of a chunk of the small image, None where it is damaged, and whether a checksum protects it."""
    size = int(np.prod(CHUNK)) * 2
    raw = quietly(_unpacked, content, codec.partition("-")[2], size)
    return None if raw is None or len(raw) != size else np.frombuffer(raw, "<i2").reshape(CHUNK)


def _unpacked(content: bytes, codec: str, size: int) -> bytes | None:
    import numcodecs

    match codec:
        case "none":
            return content
        case "gzip":
            return gzip.decompress(content)
        case "zlib":
            return zlib.decompress(content)
        case "zstd" | "zstd-checksum":
            return bytes(numcodecs.Zstd().decode(content))
        case "blosc" | "blosc-lz4" | "blosc-zstd":
            unpacked, block, packed = struct.unpack_from("<III", content, 4)
            if (unpacked, packed) != (size, len(content)) or not 0 < block <= size:
                return None
            return bytes(numcodecs.Blosc().decode(content))
    return None  # checksums: nothing but what was written is right


def spacing_of_zarr(content: dict[str, bytes]):
    """Spacing (z, y, x) in mm of the first level as its metadata say, or None where that is not plain."""
    return quietly(_spacing_of_zarr, content)


def _spacing_of_zarr(content: dict[str, bytes]):
    attributes = (
        json.loads(content["zarr.json"])["attributes"]["ome"] if "zarr.json" in content else None
    )
    scales = (attributes or json.loads(content[".zattrs"]))["multiscales"]
    (found,) = scales
    if [axis["name"] for axis in found["axes"]] != ["z", "y", "x"] or found.get(
        "coordinateTransformations"
    ):
        return None
    units = [
        {"millimeter": 1.0, "micrometer": 1e-3, "meter": 1e3}[axis["unit"]]
        for axis in found["axes"]
    ]
    scale = next(
        one for one in found["datasets"][0]["coordinateTransformations"] if one["type"] == "scale"
    )["scale"]
    return tuple(float(part) * unit for part, unit in zip(scale, units, strict=True))


# -- slices


def slice_of(content: bytes):
    """Values of a DICOM slice and the world points of its pixels, or None."""
    return quietly(_slice_of, content)


def _slice_of(content: bytes):
    import pydicom

    dataset = pydicom.dcmread(io.BytesIO(content))
    values = dataset.pixel_array.astype(np.float64)
    values = values * float(dataset.get("RescaleSlope", 1)) + float(
        dataset.get("RescaleIntercept", 0)
    )
    return values if values.ndim == 2 else None


def header_of(files) -> str:
    """The name of the header among the files of an image."""
    ends = (".nhdr", ".nrrd", ".mhd", ".hdr", ".hdr.gz")
    return next(name for name in files if name.endswith(ends))


def paired(files: dict[str, bytes]):
    """Voxels and spacing of a header with its data file."""
    header = header_of(files)
    if (
        not header.endswith((".nhdr", ".nrrd", ".mhd"))
        or len(files) > 2
        or b"LIST" in files[header]
    ):
        return None
    data = next(content for name, content in files.items() if name != header)
    return look(files[header], ".mhd" if header.endswith(".mhd") else ".nrrd", data)


def halves(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two chunks of the small image."""
    assert values.shape == SHAPE == VALUES.shape
    return values[: CHUNK[0]], values[CHUNK[0] :]
