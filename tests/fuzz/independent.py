"""A second look at an image file, which knows nothing of accelsurf: its voxels and voxel size, or None where it cannot.

Plain numpy for NIfTI, NRRD and MetaImage; Pillow and tifffile for pictures.
"""

import io
import math
import re
import struct
import warnings
import zlib

import numpy as np

_NIFTI = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
_NRRD = {
    **{
        "signed char": "i1",
        "int8": "i1",
        "uchar": "u1",
        "unsigned char": "u1",
        "uint8": "u1",
        "short": "i2",
    },
    **{
        "int16": "i2",
        "ushort": "u2",
        "unsigned short": "u2",
        "uint16": "u2",
        "int": "i4",
        "float": "f4",
        "double": "f8",
    },
    **{"int32": "i4", "uint": "u4", "unsigned int": "u4", "uint32": "u4"},
}
_META = {
    **{
        "MET_CHAR": "i1",
        "MET_UCHAR": "u1",
        "MET_SHORT": "i2",
        "MET_USHORT": "u2",
        "MET_INT": "i4",
        "MET_UINT": "u4",
    },
    **{"MET_FLOAT": "f4", "MET_DOUBLE": "f8", "MET_LONG": "i4", "MET_ULONG": "u4"},
}


def look(content: bytes, suffix: str, data: bytes):
    """Array (z, y, x) and spacing (x, y, z) or None, as another program would have them.

    Parameters
    ----------
    content : bytes
        Of the file.
    suffix : str
    data : bytes
        Of the file that a header may name.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _LOOKS[suffix](content, data)
    except Exception:  # whatever other programs make of a damaged file
        return None


def _nifti(content: bytes, data: bytes):
    if content[:2] == b"\x1f\x8b":
        unpack = zlib.decompressobj(31)
        content = unpack.decompress(content)
    order = "<" if struct.unpack("<i", content[:4])[0] in (348, 540) else ">"
    if struct.unpack(order + "i", content[:4])[0] == 348:
        dim = struct.unpack(order + "8h", content[40:56])
        kind = struct.unpack(order + "h", content[70:72])[0]
        pixdim = struct.unpack(order + "8f", content[76:108])
        offset, slope, intercept = struct.unpack(order + "3f", content[108:120])
        units, least = content[123], 352
    else:
        kind = struct.unpack(order + "h", content[12:14])[0]
        dim = struct.unpack(order + "8q", content[16:80])
        pixdim = struct.unpack(order + "8d", content[104:168])
        offset = struct.unpack(order + "q", content[168:176])[0]
        slope, intercept = struct.unpack(order + "2d", content[176:192])
        units, least = struct.unpack(order + "i", content[500:504])[0], 544
    size = [*dim[1 : dim[0] + 1]]
    while len(size) > 3 and size[-1] == 1:
        size.pop()
    if len(size) != 3:
        return None
    values = np.frombuffer(content, order + _NIFTI[kind], math.prod(size), max(int(offset), least))
    values = values.reshape(size[::-1])
    if slope != 0 and math.isfinite(slope) and (slope, intercept) != (1.0, 0.0):
        with np.errstate(all="ignore"):
            values = values.astype(np.float64) * slope + intercept
    unit = {1: 1000.0, 3: 0.001}.get(units & 7, 1.0)
    return values, tuple(h * unit for h in pixdim[1:4])


def _voxels(raw: bytes, kind: str, size: list[int]):
    return np.frombuffer(raw, kind, math.prod(size)).reshape(size[::-1])


def _nrrd(content: bytes, data: bytes):
    head, _, body = content.partition(b"\n\n")
    fields: dict[str, str] = {}
    for line in head.decode("latin-1").split("\n")[1:]:
        key, colon, value = line.partition(": ")
        if colon and not line.startswith("#"):
            fields.setdefault(key.strip().lower(), value.strip())
    if "data file" in fields or "datafile" in fields:
        body = data
    size = [int(n) for n in fields["sizes"].split()]
    kind = _NRRD[fields["type"].lower()]
    order = ">" if fields.get("endian", "little").lower() == "big" else "<"
    if "space directions" in fields:
        numbers = [float(v) for v in re.split(r"[(), ]+", fields["space directions"]) if v]
        spacing = np.linalg.norm(np.reshape(numbers, (3, 3)), axis=1).tolist()
    else:
        spacing = [float(v) for v in fields.get("spacings", "1 1 1").split()]
    match fields["encoding"].lower():
        case "raw":
            body = body[max(int(fields.get("byte skip", 0)), 0) :]
        case "gzip" | "gz":
            body = zlib.decompressobj(47).decompress(body)
        case _:
            return None
    return _voxels(body, order + kind, size), tuple(spacing)


def _meta(content: bytes, data: bytes):
    head, _, body = content.partition(b"ElementDataFile = LOCAL\n")
    fields: dict[str, str] = {}
    for line in head.decode("latin-1").split("\n"):
        key, sign, value = line.partition("=")
        fields.setdefault(key.strip(), value.strip())
    whole = content
    if not body:
        whole = body = data
    size = [int(n) for n in fields["DimSize"].split()]
    kind = _META[fields["ElementType"]]
    msb = fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "False"))
    order = ">" if msb[:1] in "Tt1" else "<"
    spacing = tuple(
        float(v) for v in fields.get("ElementSpacing", fields.get("ElementSize", "1 1 1")).split()
    )
    if fields.get("CompressedData", "False")[:1] in "Tt1":
        body = zlib.decompressobj(47).decompress(body)
    skip = int(fields.get("HeaderSize", 0))
    return _voxels(whole[skip:] if skip > 0 else body, order + kind, size), spacing


def _png(content: bytes, data: bytes):
    from PIL import Image

    with Image.open(io.BytesIO(content)) as image:
        if image.mode not in ("L", "I;16"):
            return None
        return np.asarray(image)[np.newaxis], None


def _tiff(content: bytes, data: bytes):
    import tifffile
    from PIL import Image

    with tifffile.TiffFile(io.BytesIO(content)) as file:
        pages = [page for page in file.pages if not page.subfiletype & 1]
        if (
            len(pages[0].shape) != 2
            or pages[0].photometric not in (0, 1)
            or pages[0].bitspersample == 1
        ):
            return None
        if pages[0].compression != 5:
            return np.stack([page.asarray() for page in pages]), None
    with Image.open(io.BytesIO(content)) as image:  # tifffile has no LZW of its own
        return (
            (np.asarray(image)[np.newaxis], None)
            if image.mode in ("L", "I;16") and len(pages) == 1
            else None
        )


def _mgh(content: bytes, data: bytes):
    import nibabel

    if content[:2] == b"\x1f\x8b":
        content = zlib.decompressobj(31).decompress(content)
    if struct.unpack_from(">h", content, 28)[0] != 1:
        return None  # no place is given: accelsurf and nibabel differ in what they take for it
    image = nibabel.MGHImage.from_bytes(content)
    values = np.asanyarray(image.dataobj)
    return (
        (values.T, tuple(float(h) for h in image.header.get_zooms()[:3]))
        if values.ndim == 3
        else None
    )


def _npy(content: bytes, data: bytes):
    values = np.load(io.BytesIO(content), allow_pickle=False)
    return (values, None) if values.ndim == 3 else None


_LOOKS = {
    **{
        ".nii": _nifti,
        ".nii.gz": _nifti,
        ".nrrd": _nrrd,
        ".nhdr": _nrrd,
        ".mha": _meta,
        ".mhd": _meta,
    },
    **{".png": _png, ".tif": _tiff},
    **{".mgh": _mgh, ".mgz": _mgh, ".npy": _npy},
}
