"""Surface files with names and colours, and formats beyond PLY, STL and OBJ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from accelsurf.io import meshes
from accelsurf.io.meshes import MESH_READERS
from accelsurf.measure.surface_mesh import Surface
from accelsurf.settings.labels import LabelEntry
from accelsurf.settings.mesh_formats import MESH_FORMATS, mesh_formats

LIVER = LabelEntry(3, "left liver & <co>", (200, 100, 50))
CORNERS = np.array([[10.0, 20, 30], [11, 20, 30], [10, 22, 30], [10, 20, 33]])
TETRAHEDRON = Surface(
    CORNERS, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
)


@pytest.mark.sampled
@pytest.mark.parametrize(
    "kind", [name for name in mesh_formats("surface") if MESH_FORMATS[name].suffix in MESH_READERS]
)
@pytest.mark.parametrize("label", [None, LIVER])
def test_a_surface_is_read_back_in_place(
    kind: str, label: LabelEntry | None, tmp_path: Path
) -> None:
    one, two = tmp_path / f"one.{kind}", tmp_path / f"two.{kind}"
    TETRAHEDRON.write(one, label=label)
    TETRAHEDRON.write(two, label=label)
    assert one.read_bytes() == two.read_bytes()
    points, triangles = meshes.read_mesh(one)
    again = Surface(points, triangles.astype(np.int32))
    assert again.volume == pytest.approx(
        1.0, rel=1e-5
    )  # positive: the triangles still face outward
    np.testing.assert_allclose(again.bounds, TETRAHEDRON.bounds, atol=1e-5)


def test_glb_in_another_program_is_in_metres_with_the_head_up(tmp_path: Path) -> None:
    for space in ("lps", "ras"):
        path = tmp_path / f"{space}.glb"
        TETRAHEDRON.write(path, space, LIVER)
        scene = trimesh.load_scene(path)
        assert list(scene.graph.nodes_geometry) == [LIVER.name]
        seen: Any = scene.to_geometry()
        # Left, head, front: x, z, -y of LPS.
        np.testing.assert_allclose(
            seen.bounds, [[0.010, 0.030, -0.022], [0.011, 0.033, -0.020]], atol=1e-6
        )
        assert seen.volume == pytest.approx(1e-9, rel=1e-3)
        factor = next(iter(scene.geometry.values())).visual.material.baseColorFactor
        expected = [((part / 255 + 0.055) / 1.055) ** 2.4 * 255 for part in LIVER.color]
        np.testing.assert_allclose(factor[:3], expected, atol=1.0)


def test_names_and_colours_of_ply_obj_and_vtp(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    for kind in ("ply", "obj", "vtp"):
        TETRAHEDRON.write(tmp_path / f"one.{kind}", label=LIVER)
    painted: Any = trimesh.load_mesh(tmp_path / "one.ply")
    assert (painted.visual.vertex_colors[:, :3] == LIVER.color).all()
    assert "o left_liver_&_<co>\n" in (tmp_path / "one.obj").read_text()
    fields = pyvista.read(tmp_path / "one.vtp").field_data
    assert list(fields["NAME"]) == [LIVER.name]
    assert np.ravel(fields["COLOR"]).tolist() == list(LIVER.color)
