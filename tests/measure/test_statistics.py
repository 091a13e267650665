"""Figures of boxes and ellipsoids that are known exactly."""

import numpy as np
import pytest

from accelsurf import segment
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.measure.statistics import object_statistics

SPACING = (2.0, 0.5, 1.0)


def turned():
    q, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def start_only(inside, geometry):
    """An object as a run of no steps leaves it."""
    image = Volume(np.where(inside, 7.0, 1.0).astype(np.float32), geometry)
    result = segment(image, start=inside.astype(np.uint8), max_steps=0, levels=1)
    return result.objects[0], image.array


def test_a_box_has_the_lengths_of_its_edges():
    geometry = Geometry((12, 40, 24), SPACING, (5.0, -3.0, 8.0), turned())
    inside = np.zeros(geometry.shape, bool)
    inside[3:8, 10:30, 6:16] = True  # 10 mm, 10 mm, 10 mm
    inside[3, 10, 6] = inside[7, 29, 15] = True
    one, values = start_only(inside, geometry)
    values = values + np.arange(24, dtype=np.float32)  # grows along x
    own = one.labels > 0
    found = object_statistics(one, values)
    assert np.array_equal(own, inside)
    assert found["voxels"] == 5 * 20 * 10
    assert found["box_first"] == [6, 10, 3] and found["box_last"] == [15, 29, 7]
    assert found["centroid_mm"] == pytest.approx(
        geometry.index_to_world((5.0, 19.5, 10.5)).tolist()
    )
    assert found["diameter_mm"] == pytest.approx(np.sqrt(300), abs=1e-9)
    assert found["diameter_axial_mm"] == pytest.approx(np.sqrt(200), abs=1e-9)
    # A filled block of edge a has the variance a^2/12: 2 sqrt(5/12) a, in any direction.
    assert found["axes_mm"] == pytest.approx([2 * np.sqrt(5 / 12) * 10] * 3, rel=1e-9)
    assert (found["min"], found["max"], found["mean"]) == (13.0, 22.0, 17.5)
    assert found["p50"] == 17.5 and found["sd"] == pytest.approx(np.arange(10).std())


def test_an_ellipsoid_has_its_axes_and_directions():
    geometry = Geometry((40, 90, 60), (1.0, 0.5, 0.75), (0.0, 0.0, 0.0), turned())
    index = np.indices(geometry.shape)
    z, y, x = (
        (axis - (n - 1) / 2) * h
        for axis, n, h in zip(index, geometry.shape, (1, 0.5, 0.75), strict=True)
    )
    inside = (x / 18) ** 2 + (y / 12) ** 2 + (z / 8) ** 2 < 1
    one, values = start_only(inside, geometry)
    found = object_statistics(one, values)
    assert found["axes_mm"] == pytest.approx([36, 24, 16], rel=0.01)
    directions = np.array(found["axes_directions"])
    for place, axis in enumerate((0, 1, 2)):
        assert abs(directions[place] @ geometry.direction[:, axis]) == pytest.approx(1, abs=1e-3)
    assert found["diameter_mm"] == pytest.approx(36, abs=1.5)
    ball = (6 * found["volume_mm3"] / np.pi) ** (1 / 3)
    assert found["sphere_mm"] == pytest.approx(ball) and 0.8 < found["sphericity"] < 0.96
    assert found["volume_ml"] * 1000 == found["volume_mm3"]


@pytest.mark.parametrize("shape", [(1, 12, 12), (12, 1, 12), (12, 12, 1)])
def test_an_object_of_one_slice_has_a_diameter(shape):
    inside = np.zeros(shape, bool)
    inside[tuple(slice(3, 9) if n > 1 else slice(None) for n in shape)] = True
    one, values = start_only(inside, Geometry(shape, (1.0, 1.0, 1.0)))
    assert object_statistics(one, values)["diameter_mm"] == pytest.approx(np.sqrt(72))
