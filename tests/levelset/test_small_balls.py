"""Small balls on their way through the level set, as a result of the program has it: what of their volume is left."""

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import LevelSet
from accelsurf.measure.surface_mesh import extract_surface

CUBIC, UNEQUAL = ((1.0, 1.0, 1.0),), ((3.0, 1.0, 1.0), (5.0, 1.0, 1.0), (2.0, 0.5, 0.5))


@pytest.mark.parametrize(
    ("radius", "most_cubic", "most_unequal"),
    [(1.0, 0.28, 0.1), (1.25, 0.08, 0.04), (1.5, 0.035, 0.015), (2.0, 0.01, 0.006)],
)
def test_the_mesh_of_a_small_ball_lacks_no_more_than_the_pages_say(
    radius, most_cubic, most_unequal
):
    """Radius in voxels of the coarsest axis. Distances have their tip within the stencil of the surface there."""
    random = np.random.default_rng(int(100 * radius))
    for spacings, most in ((CUBIC, most_cubic), (UNEQUAL, most_unequal)):
        for spacing in spacings:
            size = radius * max(spacing)
            shape = tuple(int(2 * size / h) + 12 for h in spacing)
            for _ in range(6):
                middle = (np.array(shape) - 1) / 2 + random.uniform(-0.5, 0.5, 3)
                at = (np.indices(shape).transpose(1, 2, 3, 0) - middle) * np.array(spacing)
                psi = (np.linalg.norm(at, axis=3) - size).astype(np.float32)
                mesh = extract_surface(LevelSet(psi, spacing).psi, Geometry(shape, spacing))
                assert mesh.is_closed
                assert mesh.volume == pytest.approx(4 / 3 * np.pi * size**3, rel=most)
