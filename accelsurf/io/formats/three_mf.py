"""3MF, the format of 3D printers: a zip archive with surfaces in XML, in mm, with names and colours."""

from __future__ import annotations

import io
import zipfile
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from accelsurf.io.formats.glb import joined
from accelsurf.io.memory import available_memory
from accelsurf.settings import budgets
from accelsurf.settings.labels import LabelEntry

Floats = NDArray[np.float64]
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
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


def read(content: bytes) -> tuple[Floats, NDArray[np.int64]]:
    """Points in mm and triangles of all objects that the file builds.

    Raises
    ------
    ValueError
        Or another error, for a damaged file, and for objects that are made of others.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        names = [name for name in archive.namelist() if name.lower().endswith(".model")]
        if not names:
            raise ValueError("there is no model in it")
        entry = archive.getinfo(_MODEL if _MODEL in names else names[0])
        budgets.MESH_FILE.check(entry.file_size * budgets.MESH_BYTES_PER_FILE_BYTE, factor=available_memory())
        text = archive.read(entry)
    if b"<!DOCTYPE" in text or b"\0" in text:
        raise ValueError("entities or another encoding than UTF-8 in its XML")
    root = ElementTree.fromstring(text)
    scale = _UNITS[root.get("unit", "millimeter")]
    spaces = f"{{{_CORE}}}"
    objects = {one.get("id"): one for one in root.iter(f"{spaces}object")}
    meshes = []
    for item in root.iter(f"{spaces}item"):
        one = objects[item.get("objectid")]
        if one.find(f"{spaces}mesh") is None:
            raise ValueError("an object that is made of others in it; export it as one mesh")
        points, triangles = _mesh(one, spaces)
        if transform := item.get("transform"):
            rows = np.array(transform.split(), np.float64).reshape(4, 3)
            points = points @ rows[:3] + rows[3]
        meshes.append((points * scale, triangles))
    return joined(meshes)


def _mesh(one: ElementTree.Element, spaces: str) -> tuple[Floats, NDArray[np.int64]]:
    def table(name: str, keys: tuple[str, ...], dtype: Any) -> NDArray[Any]:
        return np.array([[row.attrib[key] for key in keys] for row in one.iter(f"{spaces}{name}")]).astype(dtype)

    return table("vertex", ("x", "y", "z"), np.float64), table("triangle", ("v1", "v2", "v3"), np.int64)
