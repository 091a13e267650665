"""Meshes that trimesh reads: PLY, STL, OBJ."""

from __future__ import annotations

import io
import logging
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np

from accelsurf.io.formats.mesh_header import MeshContent

_STL_HEADER, _STL_TRIANGLE = 80, 50  # bytes
#: Lines of text in which files say something of themselves.
_REMARKS = {
    "ply": re.compile(rb"^[ \t]*(?:comment|obj_info)\b(.*)$", re.MULTILINE),
    "stl": re.compile(rb"^[ \t]*(?:end)?solid\b(.*)$", re.MULTILINE | re.IGNORECASE),
    "obj": re.compile(rb"^[ \t]*#(.*)$", re.MULTILINE),
}


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
    """The header of a binary STL, or what comments and names of the file say, a line each."""
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
