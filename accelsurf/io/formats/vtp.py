"""VTK's XML PolyData (.vtp): points and triangles. No library but VTK reads it, and VTK crashes on damaged files."""

from __future__ import annotations

import base64
import binascii
import re
import struct
import zlib
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats.mesh_header import MeshContent
from accelsurf.io.formats.xml_reading import parsed
from accelsurf.settings import budgets

_TYPES = {
    **{f"{sign}Int{bits}": f"{code}{bits // 8}" for sign, code in (("", "i"), ("U", "u")) for bits in (8, 16, 32, 64)},
    **{"Float32": "f4", "Float64": "f8", "String": "u1"},
}
_COMPRESSOR = "vtkZLibDataCompressor"
_SMALL = 1 << 21  # bytes that any file may unpack to, over the budget's factor
_DAMAGED = "the file is cut short or damaged"

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]


def read(content: bytes) -> MeshContent:
    """Read the polygons of a file; those of more than three corners become fans of triangles, lines are ignored.

    Parameters
    ----------
    content : bytes
        Of the file: arrays as text, base64 or appended, uncompressed or with zlib.

    Returns
    -------
    MeshContent
        Points, and the point numbers of the triangles, which are not checked.

    Raises
    ------
    InputError
        When the file is damaged, or holds triangle strips or another compression.
    """
    head, mark, rest = content.partition(b"<AppendedData")
    try:
        root = parsed(head + b"</VTKFile>" if mark else head)
        if root.tag != "VTKFile" or root.get("type") != "PolyData":
            raise InputError(f"an XML file of {root.tag} {root.get('type', '')} given, VTKFile PolyData expected")
        arrays = _Arrays(root, rest, len(content))
        pieces = [_piece(piece, arrays) for piece in root.iterfind("PolyData/Piece")]
        header = _header(head, root, arrays)
    except (
        ElementTree.ParseError,
        binascii.Error,
        struct.error,
        zlib.error,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        raise InputError(f"{_DAMAGED} ({error})") from None
    if not pieces:
        raise InputError("the file has no piece")
    starts = np.cumsum([0] + [len(points) for points, _ in pieces])
    triangles = np.concatenate([corners + start for (_, corners), start in zip(pieces, starts, strict=False)])
    return MeshContent(np.concatenate([points for points, _ in pieces]), triangles, header)


def _header(head: bytes, root: ElementTree.Element, arrays: _Arrays) -> str:
    """What comments and field data say of space and unit, a line each; 3D Slicer and accelsurf write them as fields."""
    lines = [comment.decode("utf-8", "replace") for comment in re.findall(rb"<!--(.*?)-->", head, re.DOTALL)]
    for array in root.iterfind("PolyData/FieldData/*"):
        name = array.get("Name", "").strip()
        if array.get("type") == "String" and name.upper() in ("SPACE", "UNIT"):
            lines.append(f"{name}={bytes(arrays.get(array)).partition(bytes(1))[0].decode('utf-8', 'replace')}")
    return "\n".join(lines)


def _piece(piece: ElementTree.Element, arrays: _Arrays) -> Triangles:
    if int(piece.get("NumberOfStrips", 0)):
        raise InputError("triangle strips given, triangles expected", hint="triangulate the mesh first")
    points = arrays.get(piece.find("Points/DataArray")).reshape(-1, 3).astype(np.float64)
    polygons = {array.get("Name"): arrays.get(array) for array in piece.iterfind("Polys/DataArray")}
    if len(points) != int(piece.get("NumberOfPoints", -1)):
        raise ValueError(f"{len(points)} points, {piece.get('NumberOfPoints')} announced")
    if int(piece.get("NumberOfPolys", 0)) == 0:
        return points, np.zeros((0, 3), np.int64)
    numbers, ends = polygons["connectivity"].astype(np.int64), polygons["offsets"].astype(np.int64)
    corners = np.diff(ends, prepend=0)
    if len(ends) != int(piece.get("NumberOfPolys", 0)) or ends[-1] != len(numbers) or corners.min() < 0:
        raise ValueError("its polygons do not end where they should")
    # A polygon of n corners is a fan of n - 2 triangles around its first corner.
    fans = np.maximum(corners - 2, 0)
    polygon = np.repeat(np.arange(len(ends)), fans)
    nth = np.arange(len(polygon)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = ends[polygon] - corners[polygon]
    return points, numbers[np.stack([first, first + nth + 1, first + nth + 2], axis=1)]


class _Arrays:
    """The arrays of a file, in any of the ways that VTK stores them.

    Parameters
    ----------
    root : Element
        The file's XML without its appended part.
    rest : bytes
        What follows ``<AppendedData``.
    size : int
        Bytes of the whole file.
    """

    def __init__(self, root: ElementTree.Element, rest: bytes, size: int) -> None:
        self._order = ">" if root.get("byte_order") == "BigEndian" else "<"
        self._size = np.dtype(self._order + ("u8" if root.get("header_type") == "UInt64" else "u4"))
        self._compressed = root.get("compressor") is not None
        if root.get("compressor", _COMPRESSOR) != _COMPRESSOR:
            raise InputError(f"arrays packed by {root.get('compressor')} given", hint="save the mesh uncompressed")
        tag, _, data = rest.partition(b">")
        data = data[data.find(b"_") + 1 :]
        self._base64 = b"base64" in tag
        self._appended = memoryview(data.partition(b"<")[0].strip() if self._base64 else data)
        self._unpacked_bytes, self._file_bytes = 0, size

    def get(self, array: ElementTree.Element | None) -> NDArray[Any]:
        """The values of one DataArray, flat."""
        if array is None:
            raise ValueError("an array is missing")
        kind = np.dtype(self._order + _TYPES[array.get("type", "")])
        form = array.get("format", "ascii")
        if form == "ascii":
            return np.array((array.text or "").split(), dtype=kind)
        if form == "binary":
            return np.frombuffer(self._unpacked(memoryview((array.text or "").strip().encode()), True), kind)
        return np.frombuffer(self._unpacked(self._appended[int(array.get("offset", "")) :], self._base64), kind)

    def _check_spent(self, more: int) -> None:
        """Refuse arrays that unpack to far more than the file has, once or by many that name the same bytes."""
        self._unpacked_bytes += more
        budgets.MESH_UNPACKED.check(self._unpacked_bytes, factor=self._file_bytes + _SMALL)

    def _unpacked(self, data: memoryview, encoded: bool) -> bytes:
        """The bytes of an array that begins where ``data`` begins; its own header says how many there are."""
        size = self._size.itemsize
        if not self._compressed:
            (length,) = self._sizes(data, 1, encoded)
            self._check_spent(length)
            data = _decoded(data, size + length) if encoded else data
            return bytes(_taken(data[size:], length))
        blocks, block, last = self._sizes(data, 3, encoded)
        if blocks * size > len(data):
            raise ValueError(_DAMAGED)
        lengths = self._sizes(data, 3 + blocks, encoded)[3:]
        # In base64 the header is encoded apart from what follows it.
        header = size * (3 + blocks)
        data = _decoded(data[-(-header // 3) * 4 :], sum(lengths)) if encoded else data[header:]
        out = []
        self._check_spent(max(blocks - 1, 0) * block + (last or block))
        for number, length in enumerate(lengths):
            unpacked = last if last and number == blocks - 1 else block
            out.append(_taken(zlib.decompressobj().decompress(_taken(data, length), unpacked + 1), unpacked))
            data = data[length:]
        return b"".join(out)

    def _sizes(self, data: memoryview, count: int, encoded: bool) -> list[int]:
        wanted = count * self._size.itemsize
        data = _decoded(data, wanted) if encoded else data
        return [int(n) for n in np.frombuffer(_taken(data, wanted), self._size)]


def _decoded(text: memoryview, count: int) -> memoryview:
    """The first ``count`` bytes of a base64 text."""
    return memoryview(base64.b64decode(text[: -(-count // 3) * 4], validate=True))[:count]


def _taken(data: bytes | memoryview, count: int) -> memoryview:
    data = memoryview(data)
    if len(data) < count:
        raise ValueError(f"{len(data)} bytes where {count} are announced")
    return data[:count]
