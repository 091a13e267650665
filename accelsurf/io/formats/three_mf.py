"""3MF, the format of 3D printers: a zip archive with surfaces in XML, in mm, with names and colours."""

from __future__ import annotations

import io
import zipfile
from array import array
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from accelsurf.io.formats.glb import joined
from accelsurf.io.formats.mesh_header import MeshContent
from accelsurf.io.formats.xml_reading import NoEntities, feed
from accelsurf.io.memory import available_memory
from accelsurf.settings import budgets
from accelsurf.settings.labels import LabelEntry

Floats = NDArray[np.float64]
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_SPACE = f"{{{_CORE}}}"
_VERTEX, _TRIANGLE = f"{_SPACE}vertex", f"{_SPACE}triangle"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_MODEL = "3D/3dmodel.model"
_TYPES = (
    f'<?xml version="1.0" encoding="UTF-8"?>\n<Types xmlns="{_PACKAGE}/content-types">'
    f'<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    f'<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>\n'
)
_RELATIONS = (
    f'<?xml version="1.0" encoding="UTF-8"?>\n<Relationships xmlns="{_PACKAGE}/relationships">'
    f'<Relationship Target="/{_MODEL}" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    f"</Relationships>\n"
)
#: An item counts as so many points and triangles beside those of its mesh.
_ITEM_ROWS = 16
_SMALL = 1 << 16  # bytes that any file may unpack to, over the budget's factor
#: mm of each unit.
_UNITS = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1000.0}


def write(vertices: Floats, faces: NDArray[np.int32], space: str, label: LabelEntry | None = None) -> bytes:
    """The bytes of a .3mf file; ``space`` is LPS or RAS."""
    material, look = "", ""
    if label is not None:
        name, color = quoteattr(label.name), "#{:02X}{:02X}{:02X}".format(*label.color)
        material = f'<basematerials id="2"><base name={name} displaycolor="{color}"/></basematerials>\n'
        look = f' name={name} pid="2" pindex="0"'
    points = ('<vertex x="%.6f" y="%.6f" z="%.6f"/>\n' * len(vertices)) % tuple(vertices.ravel().tolist())
    triangles = ('<triangle v1="%d" v2="%d" v3="%d"/>\n' * len(faces)) % tuple(faces.ravel().tolist())
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}">\n'
        f'<metadata name="Application">accelsurf</metadata>\n<metadata name="Description">SPACE={space}</metadata>\n'
        f'<resources>\n{material}<object id="1" type="model"{look}><mesh>\n<vertices>\n{points}</vertices>\n'
        f'<triangles>\n{triangles}</triangles>\n</mesh></object>\n</resources>\n<build><item objectid="1"/></build>\n'
        "</model>\n"
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, text in (("[Content_Types].xml", _TYPES), ("_rels/.rels", _RELATIONS), (_MODEL, model)):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))  # a fixed date: the same mesh gives the same bytes
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            archive.writestr(entry, text.encode(), compresslevel=6)
    return packed.getvalue()


def read(content: bytes) -> MeshContent:
    """Points in mm and triangles of all objects that the file builds.

    Raises
    ------
    ValueError
        Or another error, for a damaged file, and for objects that are made of others.
    InputError
        When its XML is packed too much, defines entities, or its items repeat meshes too often.
    """
    model = _Model()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        names = [name for name in archive.namelist() if name.lower().endswith(".model")]
        if not names:
            raise ValueError("there is no model in it")
        entry = archive.getinfo(_MODEL if _MODEL in names else names[0])
        budgets.MESH_XML.check(entry.file_size, factor=len(content) + _SMALL)
        budgets.MESH_FILE.check(entry.file_size * budgets.MESH_BYTES_PER_FILE_BYTE, factor=available_memory())
        with archive.open(entry) as stream:
            feed(stream, model)
    scale = _UNITS[model.unit]
    meshes = {name: mesh.arrays() for name, mesh in model.meshes.items()}
    rows = sum(_ITEM_ROWS + meshes[name].rows for name, _ in model.items if name in meshes)
    budgets.MESH_COPIES.check(rows - sum(mesh.rows for mesh in meshes.values()), factor=len(content) + (1 << 20))
    built = []
    for name, transform in model.items:
        if name not in meshes:
            raise ValueError("an object without a mesh, perhaps made of others, in it; export it as one mesh")
        points, triangles = meshes[name]
        if transform:
            matrix = np.array(transform.split(), np.float64).reshape(4, 3)
            points = points @ matrix[:3] + matrix[3]
        built.append((points * scale, triangles))
    return MeshContent(*joined(built), "\n".join(" ".join(remark.split()) for remark in model.remarks))


class _Mesh(NamedTuple):
    """Points (n, 3) and triangles (m, 3) of an object."""

    points: Floats
    triangles: NDArray[np.int64]

    @property
    def rows(self) -> int:
        """How many there are together."""
        return len(self.points) + len(self.triangles)


class _MeshText:
    """Numbers of the mesh of an object, as they come."""

    def __init__(self) -> None:
        self.points, self.corners = array("d"), array("q")

    def arrays(self) -> _Mesh:
        points, corners = np.frombuffer(self.points, np.float64), np.frombuffer(self.corners, np.int64)
        return _Mesh(points.reshape(-1, 3), corners.reshape(-1, 3))


class _Model(NoEntities):
    """The parts of a model that matter, as a parser of XML meets them; nothing else is kept.

    Attributes
    ----------
    unit : str
        One of `_UNITS`.
    meshes : dict of str to _MeshText
        By the objects' names.
    items : list of (str, str)
        What is built: an object's name, and where it is put.
    remarks : list of str
        Metadata, ``name=text``.
    """

    def __init__(self) -> None:
        self.unit = "millimeter"
        self.meshes: dict[str, _MeshText] = {}
        self.items: list[tuple[str, str]] = []
        self.remarks: list[str] = []
        self._object, self._is_remark = "", False
        self._mesh: _MeshText | None = None

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Note a part of the model."""
        self._is_remark = False
        if tag == _VERTEX and self._mesh is not None:
            self._mesh.points.extend((float(attributes["x"]), float(attributes["y"]), float(attributes["z"])))
        elif tag == _TRIANGLE and self._mesh is not None:
            self._mesh.corners.extend((int(attributes["v1"]), int(attributes["v2"]), int(attributes["v3"])))
        elif tag == f"{_SPACE}item":
            self.items.append((attributes["objectid"], attributes.get("transform", "")))
        elif tag == f"{_SPACE}mesh":
            self._mesh = self.meshes[self._object] = _MeshText()
        elif tag == f"{_SPACE}object":
            self._object, self._mesh = attributes["id"], None
        elif tag == f"{_SPACE}metadata":
            self.remarks.append(f"{attributes.get('name', '').rpartition(':')[2]}=")
            self._is_remark = True
        elif tag == f"{_SPACE}model":
            self.unit = attributes.get("unit", self.unit)

    def data(self, text: str) -> None:
        """Note the text of metadata."""
        if self._is_remark:
            self.remarks[-1] += text
