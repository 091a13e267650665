"""Meshes of a result as its settings want them: smoother or coarser, and their statistics.

Commands check the settings of meshes here before they load the modules that make them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from accelsurf.errors import UsageError
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.measure import MeshOptions, Surface


@dataclass
class MeshNotes:
    """Statistics and warnings of meshes that were made smoother or coarser.

    Attributes
    ----------
    statistics : dict of str to dict
        Number of faces, largest distance to the surface, whether closed, smallest angle; by the name of the file.
    warnings : list of str
    """

    statistics: dict[str, dict[str, Any]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def warn(self, lines: Iterable[str]) -> None:
        """Add warnings."""
        self.warnings.extend(lines)


def is_shaped(config: RunConfig) -> bool:
    """Test if the settings want another mesh than the surface as it was extracted."""
    return bool(config.mesh_smooth or config.mesh_faces or config.mesh_error)


def check_mesh_settings(config: RunConfig) -> None:
    """Refuse meshes that cannot be made coarser here, before anything is computed.

    Raises
    ------
    InputError
        When a package lacks.
    """
    if config.mesh_faces or config.mesh_error:
        from accelsurf.measure import mesh_library

        mesh_library("fast_simplification")


def options_of(config: RunConfig) -> MeshOptions:
    """Return the options of meshes from the settings."""
    from accelsurf.measure import MeshOptions

    return MeshOptions(config.mesh_smooth, config.mesh_faces, config.mesh_error)


def shaped(surface: Surface, config: RunConfig) -> tuple[Surface, dict[str, Any], tuple[str, ...]]:
    """Return a surface as the settings want it, its statistics for the report, and warnings.

    Where they cannot be had together, the surface stays as it was extracted, and a warning gives advice: a result is
    not thrown away for its mesh.

    Raises
    ------
    InputError
        When a package lacks.
    """
    from trimesh.triangles import angles

    from accelsurf.measure import ShapedMesh, is_sound, shape_mesh

    try:
        mesh = shape_mesh(surface, options_of(config))
    except UsageError as error:
        mesh = ShapedMesh(
            surface, 0.0, (f"{error.message}; the mesh is the surface as it is; {error.hint}",)
        )
    made = mesh.surface
    statistics = {
        "faces": len(made.faces),
        "largest_distance_mm": mesh.distance_mm,
        "closed": is_sound(made),
        "smallest_angle_deg": math.degrees(angles(made.vertices[made.faces]).min()),
    }
    return made, statistics, mesh.warnings
