"""glTF 2.0 in one file, .glb: surfaces with a name and a colour.

glTF is in metres, with y up and z to the front. The vertices stay in mm as they are; the matrix of their node turns
and scales them: x to the patient's left, y to the head, z to the front. So every program shows the patient upright,
whether the points are stored as LPS or as RAS.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.io.formats.surface_files import MeshContent, stated_space
from accelsurf.settings import budgets
from accelsurf.settings.labels import LabelEntry

Floats = NDArray[np.float64]
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
#: From LPS in mm to glTF.
FROM_LPS = np.array([[1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, -1e-3, 0, 0], [0, 0, 0, 1]])
_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
#: Nodes below one another.
MAX_DEPTH = 64


def glb_bytes(vertices: Floats, faces: NDArray[np.int32], space: str, label: LabelEntry | None = None) -> bytes:
    """Return the bytes of a .glb file; ``space`` is LPS or RAS."""
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    name = "surface" if label is None else label.name
    look = None
    if label is not None:
        material = PBRMaterial(name, baseColorFactor=[*label.color, 255], metallicFactor=0.0, roughnessFactor=0.8)
        look = TextureVisuals(material=material)
    mesh = trimesh.Trimesh(vertices, faces, process=False, validate=False, visual=look)

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"] |= {"generator": "accelsurf", "extras": {"space": space, "unit": "mm"}}
        if label is not None:  # trimesh rounds colours to bytes, too coarse for dark ones once they are linear
            tree["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [*_linear(label.color), 1.0]

    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name=name, geom_name=name, transform=_from_stored(space))
    return bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=False, tree_postprocessor=describe))


def _from_stored(space: str) -> Floats:
    """From points as they are stored to glTF's."""
    return FROM_LPS @ np.diag([-1.0, -1.0, 1.0, 1.0]) if space == "RAS" else FROM_LPS


def _linear(color: tuple[int, int, int]) -> list[float]:
    """Intensities 0 to 1 of a colour, which glTF wants linear, not as screens have them (sRGB)."""
    parts = np.array(color) / 255.0
    return [round(x, 6) for x in np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4).tolist()]


def read_glb(content: bytes) -> MeshContent:
    """Points in mm and triangles of all meshes of the scene, each where its nodes put it.

    The nodes say where the points are in glTF's space; the header says which space they are stored in.

    Raises
    ------
    ValueError
        Or another error, for a damaged file, and for what is not supported: data in other files, packed or sparse
        data, lines, strips of triangles.
    """
    contents, data = _chunks(content)
    if needed := contents.get("extensionsRequired"):
        raise ValueError(f"needs the glTF extension {needed[0]}")
    scene = contents["scenes"][contents.get("scene", 0)]
    meshes: list[tuple[Floats, NDArray[np.int64]]] = []
    visited: set[int] = set()
    header = _header(contents)
    above = np.linalg.inv(_from_stored(stated_space(header)))
    rows = 0
    stack = [(number, above, 0) for number in reversed(scene.get("nodes", []))]
    while stack:
        number, matrix, depth = stack.pop()
        if number in visited or depth > MAX_DEPTH:
            raise ValueError("nodes that contain themselves")
        visited.add(number)
        node = contents["nodes"][number]
        matrix = matrix @ _matrix(node)
        if "mesh" in node:
            for primitive in contents["meshes"][node["mesh"]]["primitives"]:
                points, triangles = _primitive(contents, data, primitive)
                rows += len(points) + len(triangles)
                budgets.MESH_COPIES.check(rows, factor=len(content) + (1 << 20))
                meshes.append((points @ matrix[:3, :3].T + matrix[:3, 3], triangles))
        stack += [(child, matrix, depth + 1) for child in reversed(node.get("children", []))]
    return MeshContent(*_joined(meshes), header)


def _header(contents: dict[str, Any]) -> str:
    """The space that the file says in its extras."""
    extras = contents["asset"].get("extras")
    if not isinstance(extras, dict):
        return ""
    return "\n".join(f"SPACE={value}" for name, value in extras.items() if name.upper() == "SPACE")


def _joined(meshes: list[tuple[Floats, NDArray[np.int64]]]) -> tuple[Floats, NDArray[np.int64]]:
    """Join several meshes."""
    if not meshes:
        raise ValueError("there is no mesh in it")
    first = np.cumsum([0] + [len(points) for points, _ in meshes[:-1]])
    triangles = [corners + n for (_, corners), n in zip(meshes, first, strict=True)]
    return np.concatenate([points for points, _ in meshes]), np.concatenate(triangles)


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The description, and the data that it speaks of."""
    magic, version, total = struct.unpack_from("<III", content)
    if magic != _MAGIC or version != 2 or total > len(content):
        raise ValueError("no complete glTF 2.0 in one file")
    length, kind = struct.unpack_from("<II", content, 12)
    if kind != _JSON or 20 + length > total:
        raise ValueError("no description in it")
    contents = json.loads(content[20 : 20 + length])
    at = 20 + length
    if at + 8 > total:
        return contents, b""
    length, kind = struct.unpack_from("<II", content, at)
    if kind != _BIN or at + 8 + length > total:
        raise ValueError("its data is cut short")
    return contents, content[at + 8 : at + 8 + length]


def _matrix(node: dict[str, Any]) -> Floats:
    """From the coordinates of a node to those of the node above."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _primitive(contents: dict[str, Any], data: bytes, primitive: dict[str, Any]) -> tuple[Floats, NDArray[np.int64]]:
    if primitive.get("mode", 4) != 4:
        raise ValueError("lines, points or strips in it, triangles expected")
    points = _values(contents, data, primitive["attributes"]["POSITION"], {5126: "<f4"}, 3).astype(np.float64)
    if "indices" in primitive:
        corners = _values(contents, data, primitive["indices"], _INDEX_TYPES, 1).astype(np.int64)
    else:
        corners = np.arange(len(points))
    triangles = corners.reshape(-1, 3)
    if triangles.size and triangles.max() >= len(points):
        raise ValueError(f"its triangles name point {triangles.max()}, it has {len(points)}")
    return points, triangles


def _values(
    contents: dict[str, Any], data: bytes, number: int, types: dict[int, str], width: int
) -> NDArray[Any]:
    """The values of an accessor, (count, width), or (count,) for a width of 1."""
    accessor = contents["accessors"][number]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise ValueError("sparse data in it")
    view = contents["bufferViews"][accessor["bufferView"]]
    if view.get("buffer", 0) != 0 or "uri" in contents["buffers"][0]:
        raise ValueError("its data is in another file; save it as one .glb")
    dtype, count = np.dtype(types[accessor["componentType"]]), int(accessor["count"])
    begin = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
    size = dtype.itemsize * width
    step = int(view.get("byteStride", 0)) or size
    if begin < 0 or count < 1 or step < size or begin + (count - 1) * step + size > len(data):
        raise ValueError("values beyond its data")
    shape, strides = ((count, width), (step, dtype.itemsize)) if width > 1 else ((count,), (step,))
    return np.ndarray(shape, dtype, data, begin, strides)
