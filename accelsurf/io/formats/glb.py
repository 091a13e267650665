"""glTF 2.0 in one file, .glb: surfaces with a name and a colour.

glTF is in metres, with y up and z to the front. The vertices stay in mm as they are; the matrix of their node turns
and scales them: x to the patient's left, y to the head, z to the front. So every program shows the patient upright,
whether the points are stored as LPS or as RAS.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.settings.labels import LabelEntry

#: From LPS in mm to glTF.
FROM_LPS = np.array([[1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, -1e-3, 0, 0], [0, 0, 0, 1]])


def glb_bytes(
    vertices: Floats, faces: NDArray[np.int32], space: str, label: LabelEntry | None = None
) -> bytes:
    """Return the bytes of a .glb file; ``space`` is LPS or RAS."""
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    name = "surface" if label is None else label.name
    look = None
    if label is not None:
        material = PBRMaterial(
            name, baseColorFactor=[*label.color, 255], metallicFactor=0.0, roughnessFactor=0.8
        )
        look = TextureVisuals(material=material)
    mesh = trimesh.Trimesh(vertices, faces, process=False, validate=False, visual=look)

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"] |= {"generator": "accelsurf", "extras": {"space": space, "unit": "mm"}}
        if (
            label is not None
        ):  # trimesh rounds colours to bytes, too coarse for dark ones once they are linear
            tree["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [
                *_linear(label.color),
                1.0,
            ]

    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name=name, geom_name=name, transform=_from_stored(space))
    return bytes(
        trimesh.exchange.gltf.export_glb(scene, include_normals=False, tree_postprocessor=describe)
    )


def _from_stored(space: str) -> Floats:
    """From points as they are stored to glTF's."""
    return FROM_LPS @ np.diag([-1.0, -1.0, 1.0, 1.0]) if space == "RAS" else FROM_LPS


def _linear(color: tuple[int, int, int]) -> list[float]:
    """Intensities 0 to 1 of a colour, which glTF wants linear, not as screens have them (sRGB)."""
    parts = np.array(color) / 255.0
    return [
        round(x, 6)
        for x in np.where(
            parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4
        ).tolist()
    ]
