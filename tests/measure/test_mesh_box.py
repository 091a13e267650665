"""Vertices depend on psi around them, and by no bit on where the rest of the object ends."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.grid.geometry import Geometry
from accelsurf.measure.surface_mesh import crossings, extract_surface

SHAPE, PARTED = (28, 70, 30), 36


def drawn(seed):
    """A rough body far along y, an oblique geometry, and psi of the body beside each of four drawn balls."""
    random = np.random.default_rng(seed)
    at = np.indices(SHAPE)
    noise = ndimage.gaussian_filter(random.normal(size=SHAPE), 0.7)
    body = (
        np.sqrt(sum((a - b) ** 2 for a, b in zip(at, (14, 54, 15), strict=True))) - 8 + 2.4 * noise
    )
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    geometry = Geometry(
        SHAPE, tuple(random.choice([0.7, 0.9, 1.0, 3.0], 3)), random.normal(size=3) * 100, turn
    )
    fields = []
    for _ in range(4):
        centre = random.uniform((7, 9, 7), (21, 26, 23))
        ball = np.sqrt(sum((a - b) ** 2 for a, b in zip(at, centre, strict=True)))
        near = np.minimum(body, ball - random.uniform(2, 6))
        fields.append(np.where(at[1] < PARTED, near, body).astype(np.float32))
    return geometry, fields


@pytest.mark.parametrize("seed", [0, 1, 3, 4, 5, 6, 7])
def test_vertices_far_from_a_change_are_the_same_bytes(seed):
    geometry, fields = drawn(seed)
    kept, have_inner = set(), False
    for psi in fields:
        vertices = extract_surface(psi, geometry).vertices
        far = geometry.world_to_index(vertices)[:, 1] > PARTED + 3
        kept.add(vertices[far].tobytes())
        places, _ = crossings(psi, geometry)
        have_inner |= bool(((places % 1 > 0).sum(axis=1) > 1).any())
    assert len(kept) == 1 and have_inner
