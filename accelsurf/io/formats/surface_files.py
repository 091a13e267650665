"""Surface files, PLY, STL, OBJ and VTP, with the space and the unit that their headers say.

trimesh reads them, all but VTP. It writes no comment with the space of the points (``SPACE=RAS``, as 3D Slicer has it),
so they are written here; name and colour are the label's, if there is one.
"""

from __future__ import annotations

import io
import logging
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.arrays import Faces, Floats
from accelsurf.settings.labels import LabelEntry

_STL_HEADER, _STL_TRIANGLE = 80, 50  # bytes
#: Lines of text in which files say something of themselves.
_REMARKS = {
    "ply": re.compile(rb"^[ \t]*(?:comment|obj_info)\b(.*)$", re.MULTILINE),
    "stl": re.compile(rb"^[ \t]*(?:end)?solid\b(.*)$", re.MULTILINE | re.IGNORECASE),
    "obj": re.compile(rb"^[ \t]*#(.*)$", re.MULTILINE),
}
#: The spaces that are understood, by their letters: the short and the long name.
_SPACES: dict[str, Literal["LPS", "RAS", ""]] = {
    "LPS": "LPS",
    "LEFTPOSTERIORSUPERIOR": "LPS",
    "RAS": "RAS",
    "RIGHTANTERIORSUPERIOR": "RAS",
}
_MILLIMETRES = ("MM", "MILLIMETER", "MILLIMETERS", "MILLIMETRE", "MILLIMETRES")
#: A colour space is none of the world.
_STATED = (
    r"(?<![\w-])(?<!color )(?<!colour ){name}[ \t]*=[ \t]*[\"']?[ \t]*"
    r"((?:left|right)[ _-]+(?:anterior|posterior)[ _-]+(?:superior|inferior)|[\w+-]++)(?![ \t]*=)"
)


def _read(content: bytes, kind: str) -> MeshContent:
    """Read points and triangles; textures and materials, which are other files, are not looked for."""
    import trimesh

    with warnings.catch_warnings(), np.errstate(all="ignore"), _silent(trimesh.util.log):
        warnings.simplefilter("ignore")
        # numpy stops reading a line of numbers at the first that is none, and only warns.
        warnings.filterwarnings("error", message="string or file could not be read to its end")
        plain = _plain_obj(content) if kind == "obj" else content
        mesh = trimesh.load_mesh(io.BytesIO(plain), file_type=kind, process=False, validate=False)
    points, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points of {points.shape[-1]} coordinates")
    return MeshContent(points, triangles, _header(content, kind))


def _plain_obj(content: bytes) -> bytes:
    """Points and faces of an OBJ alone: no group or material, for each of which trimesh goes over all points.

    A negative number counts back from the points before its line; trimesh counts back from the last of the file.
    """
    lines, points = [], 0
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        word, _, numbers = line.strip().replace(b"\t", b" ").partition(b" ")
        if word == b"v":
            points += 1
            lines.append(b"v " + numbers)
        elif word == b"f":
            # Before a slash is the point, behind it are places in a picture and directions.
            numbers = re.sub(rb"/\S*", b"", numbers)
            if b"-" in numbers:
                corners = [int(corner) for corner in numbers.split()]
                numbers = b" ".join(b"%d" % (n if n > 0 else points + 1 + n) for n in corners)
            lines.append(b"f " + numbers)
    return b"\n".join(lines)


def _header(content: bytes, kind: str) -> str:
    """The header of a binary STL, or the comments and names of the file, a line each."""
    if kind == "stl" and len(content) >= _STL_HEADER + 4:
        (count,) = struct.unpack_from("<I", content, _STL_HEADER)
        if len(content) == _STL_HEADER + 4 + _STL_TRIANGLE * count:
            return content[:_STL_HEADER].decode("latin-1")
    text = content.partition(b"end_header")[0] if kind == "ply" else content
    return "\n".join(line.decode("latin-1") for line in _REMARKS[kind].findall(text))


read_ply, read_stl, read_obj = (partial(_read, kind=kind) for kind in ("ply", "stl", "obj"))


@contextmanager
def _silent(logger: logging.Logger) -> Iterator[None]:
    """Nothing logged for a moment: without a handler, Python prints warnings to the screen."""
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


def ply_bytes(vertices: Floats, faces: Faces, space: str, label: LabelEntry | None = None) -> bytes:
    """The bytes of a .ply file; ``space`` is LPS or RAS."""
    named = ""
    colored = ""
    points = vertices.astype("<f4")
    if label is not None:
        named = f"comment NAME={ascii_name(label.name)}\n"
        colored = "".join(f"property uchar {part}\n" for part in ("red", "green", "blue"))
        painted = np.empty(len(vertices), dtype=[("place", "<f4", 3), ("color", "u1", 3)])
        painted["place"], painted["color"] = points, label.color
        points = painted
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment SPACE={space}\ncomment UNIT=mm\n{named}"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n{colored}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return header.encode() + points.tobytes() + rows.tobytes()


def stl_bytes(vertices: Floats, faces: Faces, space: str, label: LabelEntry | None = None) -> bytes:
    """The bytes of a .stl file; ``space`` is LPS or RAS. The format keeps no name and no colour."""
    rows = np.zeros(
        len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")]
    )
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows["normal"] = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    rows["corners"] = corners
    # The first word must not be "solid": readers take that for the text format.
    header = f"accelsurf SPACE={space} UNIT=mm".encode().ljust(80)
    return header + np.uint32(len(faces)).astype("<u4").tobytes() + rows.tobytes()


def obj_bytes(vertices: Floats, faces: Faces, space: str, label: LabelEntry | None = None) -> bytes:
    """The bytes of a .obj file; ``space`` is LPS or RAS."""
    head = f"# accelsurf SPACE={space} UNIT=mm\n"
    if label is not None:
        head += f"o {'_'.join(label.name.split())}\n"
    points = ("v %.6f %.6f %.6f\n" * len(vertices)) % tuple(vertices.ravel().tolist())
    triangles = ("f %d %d %d\n" * len(faces)) % tuple((faces + 1).ravel().tolist())
    return (head + points + triangles).encode()


def vtp_bytes(vertices: Floats, faces: Faces, space: str, label: LabelEntry | None = None) -> bytes:
    """The bytes of a .vtp file; ``space`` is LPS or RAS."""
    return polydata(
        vertices, faces.ravel(), np.arange(3, 3 * len(faces) + 1, 3), "Polys", space, label
    )


def polydata(
    points: Floats,
    numbers: NDArray[np.integer],
    ends: NDArray[np.integer],
    kind: str,
    space: str,
    label: LabelEntry | None = None,
) -> bytes:
    """VTK's XML PolyData with raw appended arrays; written here so that saving a mesh does not load VTK.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        mm.
    numbers : ndarray, shape (m,)
        Point numbers of the cells, one cell after the other.
    ends : ndarray
        Where each cell ends in them.
    kind : {"Polys", "Lines"}
        Type of the cells.
    space : str
        "LPS" or "RAS".
    label : LabelEntry, optional
        Its name and colour, which become field data.
    """
    arrays = [points.astype("<f8"), numbers.astype("<i8"), ends.astype("<i8")]
    sorts = {"Verts": 0, "Lines": 0, "Strips": 0, "Polys": 0, kind: len(ends)}
    counts = " ".join(f'NumberOf{name}="{count}"' for name, count in sorts.items())
    blocks = [np.uint64(array.nbytes).astype("<u8").tobytes() + array.tobytes() for array in arrays]
    at = [0, len(blocks[0]), len(blocks[0]) + len(blocks[1])]
    field = "".join(
        f'<Array type="String" Name="{name}" NumberOfTuples="1" format="ascii">{_codes(value)}</Array>'
        for name, value in (
            ("SPACE", space),
            ("UNIT", "mm"),
            *((("NAME", ascii_name(label.name)),) if label else ()),
        )
    )
    if label is not None:
        red, green, blue = label.color
        field += (
            '<DataArray type="UInt8" Name="COLOR" NumberOfComponents="3" NumberOfTuples="1" format="ascii">'
            f"{red} {green} {blue}</DataArray>"
        )
    header = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<PolyData><FieldData>{field}</FieldData>\n<Piece NumberOfPoints="{len(points)}" {counts}>\n'
        f'<Points><DataArray type="Float64" Name="Points" NumberOfComponents="3" format="appended" offset="{at[0]}"/>'
        f'</Points>\n<{kind}><DataArray type="Int64" Name="connectivity" format="appended" offset="{at[1]}"/>'
        f'<DataArray type="Int64" Name="offsets" format="appended" offset="{at[2]}"/></{kind}>\n'
        '</Piece></PolyData>\n<AppendedData encoding="raw">_'
    )
    return header.encode() + b"".join(blocks) + b"</AppendedData></VTKFile>\n"


def _codes(text: str) -> str:
    """A string as VTK's XML stores it: character codes, ended by 0."""
    return " ".join(str(ord(letter)) for letter in text) + " 0"


def ascii_name(name: str) -> str:
    """A name in ASCII, for formats whose readers expect it; other letters become question marks.

    Examples
    --------
    >>> ascii_name("niño")
    'ni?o'
    """
    return name.encode("ascii", "replace").decode()


class MeshContent(NamedTuple):
    """A mesh as its file has it.

    Attributes
    ----------
    points : ndarray (n, 3)
        mm, in the space that the header says, LPS where it says none.
    triangles : ndarray (m, 3)
        Point numbers.
    header : str
        Header, comments and names of the file, with ``SPACE=`` and ``UNIT=`` among them.
    """

    points: NDArray[Any]
    triangles: NDArray[Any]
    header: str = ""


def is_ras(header: str, given: str = "") -> bool:
    """Test if the points of a mesh are RAS, not LPS.

    Parameters
    ----------
    header : str
        Header, comments and names of the file.
    given : {"", "lps", "ras"}
        Space given by the user. It counts where the header says nothing, or a space that is not understood.

    Raises
    ------
    InputError
        When the header and the user contradict each other, the header names several spaces or another one and the user
        none, or its unit is not mm.

    Examples
    --------
    >>> is_ras("3D Slicer output. SPACE=RAS"), is_ras("space = left-posterior-superior"), is_ras("", "ras")
    (True, False, True)
    """
    units = [word for word in _stated("UNIT", header) if word.upper() not in _MILLIMETRES]
    if units:
        raise InputError(
            f"its header says UNIT={units[0][:40]}, mm expected", "export the mesh in mm"
        )
    space = stated_space(header)
    if space:
        if given and given.upper() != space:
            raise InputError(
                f"its header says SPACE={space}, @{given} was given", f"leave @{given} out"
            )
        return space == "RAS"
    words = _stated("SPACE", header)
    if words and not given:
        said = " and ".join(dict.fromkeys(f"SPACE={word[:40]}" for word in words[:3]))
        raise InputError(
            f"its header says {said}, SPACE=LPS or SPACE=RAS expected",
            "say which it is, FILE@lps or FILE@ras, or export the mesh as LPS",
        )
    return given == "ras"


def stated_space(header: str) -> Literal["LPS", "RAS", ""]:
    """The space that a header says; empty where it says none, several, or one that is not understood."""
    spaces = {
        _SPACES.get("".join(re.findall("[A-Z]", word.upper())), "")
        for word in _stated("SPACE", header)
    }
    return spaces.pop() if len(spaces) == 1 else ""


def _stated(name: str, header: str) -> list[str]:
    """The words that a header gives after ``name =``."""
    return re.findall(_STATED.format(name=name), header, flags=re.IGNORECASE)
