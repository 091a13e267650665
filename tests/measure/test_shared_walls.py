"""Walls that objects share: one set of triangles, no gap, no overlap, closed surfaces."""

from dataclasses import dataclass

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.measure import shared_walls


@dataclass
class Object:
    """What of a segmented object is needed."""

    id: int
    box: tuple
    psi: np.ndarray

    @property
    def labels(self):
        return (self.psi < 0).view(np.uint8)


def oblique(left_handed=False):
    q, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    return q * (np.sign(np.linalg.det(q)) * (-1 if left_handed else 1))


def cells(count, seed, shape=(13, 15, 17)):
    """Balls of a power diagram: where they meet, the wall is where their psi are equal."""
    rng = np.random.default_rng(seed)
    z, y, x = np.indices(shape)
    raw = []
    for _ in range(count):
        at = [rng.uniform(3, n - 4) for n in shape]
        raw.append(np.sqrt((z - at[0]) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2) - rng.uniform(2.5, 5))
    out = []
    for n, own in enumerate(raw):
        others = np.min([one for m, one in enumerate(raw) if m != n], axis=0)
        psi = np.maximum(own, 0.5 * (own - others)).astype(np.float32)
        psi[(psi < 0) & (own >= others)] = 0.01
        if (psi < 0).any():
            out.append(Object(n + 1, tuple(slice(0, m) for m in shape), psi))
    return out


def turned(faces):
    """Each triangle from its smallest corner on, turned round."""
    rows = faces[:, ::-1]
    first = rows.argmin(axis=1)
    return {tuple(np.roll(row, -k)) for row, k in zip(rows, first, strict=True)}


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize(("count", "seed"), [(2, 1), (5, 2), (9, 3)])
def test_surfaces_are_closed_and_share_their_walls(count, seed, left_handed):
    objects = cells(count, seed)
    geometry = Geometry(objects[0].psi.shape, (1.5, 0.5, 1.0), (3.0, 4.0, 5.0), oblique(left_handed))
    found = shared_walls.extract(objects, geometry)
    assert sorted(found) == [one.id for one in objects]
    places: dict = {}
    used = {}
    for own, surface in found.items():
        assert surface.is_closed and surface.volume > 0
        numbers = np.array([places.setdefault(tuple(point), len(places)) for point in surface.vertices.tolist()])
        used[own] = numbers[surface.faces]
    together = np.concatenate(list(used.values()))
    first = together.argmin(axis=1)
    directed = [tuple(np.roll(row, -k)) for row, k in zip(together, first, strict=True)]
    assert len(set(directed)) == len(directed)  # no triangle twice in one direction
    backwards = turned(together)
    outer = [row for row in directed if row not in backwards]
    # What is left without the walls is the closed surface of all together: volumes add up.
    corners = np.array(list(places))[np.array(outer)]
    corners = corners - corners.reshape(-1, 3).mean(axis=0)
    whole = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert sum(one.volume for one in found.values()) == pytest.approx(whole, rel=1e-9)
    assert len(outer) < len(directed)
    # Each object is as large as its voxels, but for the surface.
    cell = np.prod(geometry.spacing)
    for one in objects:
        voxels = cell * int(one.labels.sum())
        assert found[one.id].volume == pytest.approx(voxels, rel=0.35)


def test_a_ball_lies_where_its_psi_is_zero_and_a_cut_one_ends_at_the_border():
    z, y, x = np.indices((21, 23, 25))
    psi = (np.sqrt((z - 10.2) ** 2 + (y - 11.1) ** 2 + (x - 12.3) ** 2) - 6).astype(np.float32)
    geometry = Geometry(psi.shape, (1.0, 1.0, 1.0))
    ball = shared_walls.extract([Object(4, (slice(0, 21), slice(0, 23), slice(0, 25)), psi)], geometry)[4]
    far = np.linalg.norm(ball.vertices - [12.3, 11.1, 10.2], axis=1)
    assert abs(far - 6).max() < 0.1 and ball.volume == pytest.approx(4 / 3 * np.pi * 216, rel=0.02)
    full = np.full((4, 5, 6), -1.0, np.float32)
    box = Object(1, tuple(slice(0, n) for n in full.shape), full)
    surface = shared_walls.extract([box], Geometry(full.shape, (2.0, 1.0, 0.5)))[1]
    assert surface.is_closed and surface.volume == pytest.approx(4 * 2 * 5 * 6 * 0.5, rel=0.12)
    assert surface.bounds[0] == pytest.approx([-0.25, -0.5, -1.0])
    assert surface.bounds[1] == pytest.approx([2.75, 4.5, 7.0])


def test_an_object_in_its_own_box():
    (one, two) = cells(2, 1)[:2]
    geometry = Geometry(one.psi.shape, (1.0, 1.0, 1.0))
    whole = shared_walls.extract([one, two], geometry)
    where = np.argwhere(two.labels)
    low, high = np.maximum(where.min(axis=0) - 2, 0), np.minimum(where.max(axis=0) + 3, one.psi.shape)
    box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    small = shared_walls.extract([one, Object(two.id, box, two.psi[box].copy())], geometry)
    assert np.array_equal(whole[two.id].vertices, small[two.id].vertices)
    assert np.array_equal(whole[two.id].faces, small[two.id].faces)
