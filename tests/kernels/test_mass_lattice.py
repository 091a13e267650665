"""Masses on the coarse lattice: nothing is lost, and what is read has the weights of what was added."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.kernels import windows
from tests.support import reference

SPACING = (1.0, 0.5, 2.0)


def scene(shape: tuple[int, int, int], seed: int = 0):
    rng = np.random.default_rng(seed)
    n = int(np.prod(shape))
    _, band = reference.whole_band(np.ones(shape), rng.uniform(-1.5, 1.5, (n, 3)) * SPACING)
    stride = np.array([6.0, 8.0, 3.0])
    nodes = tuple(3 + int(np.ceil((m - 1) / s)) for m, s in zip(shape, stride, strict=True))
    return reference.grid_of(shape, SPACING), band, stride, np.zeros(nodes), rng


@pytest.mark.parametrize("shape", [(13, 9, 12), (1, 20, 7), (2, 1, 5)])
def test_all_mass_is_on_the_lattice_with_its_centre(shape):
    grid, band, stride, lattice, rng = scene(shape)
    mass = rng.random(band.cells.size)
    velocity, dt = rng.standard_normal((mass.size, 3)).astype(np.float32), 0.4
    windows.deposit(grid, band, mass, (velocity, dt), stride, lattice)
    assert lattice.sum() == pytest.approx(mass.sum()) and lattice.min() >= 0.0
    at = np.argwhere(np.ones(shape, bool)) + (band.to_closest + dt * velocity) / SPACING
    middle = 0.5 * (np.array(shape) - 1.0)
    place = np.clip(at - middle, -middle, middle) / stride
    for axis in range(3):
        others, m = tuple(a for a in range(3) if a != axis), lattice.shape[axis]
        centre = (lattice.sum(axis=others) * (np.arange(m) - 0.5 * (m - 1))).sum()
        assert centre == pytest.approx((mass * place[:, axis]).sum(), rel=1e-5)


@pytest.mark.parametrize("shape", [(13, 9, 12), (2, 20, 7)])
def test_the_mirrored_volume_has_the_mirrored_lattice(shape):
    """The nodes lie about the middle of the volume, wherever that is between the voxels."""
    grid, band, stride, lattice, rng = scene(shape, 2)
    mass, rest = rng.random(band.cells.size), (np.zeros((band.cells.size, 3), np.float32), 0.0)
    windows.deposit(grid, band, mass, rest, stride, lattice)
    closest_points = band.to_closest.reshape(*shape, 3)
    for axis in range(3):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        _, turned = reference.whole_band(
            np.ones(shape), (np.flip(closest_points, axis) * sign).reshape(-1, 3)
        )
        other = np.zeros_like(lattice)
        mirrored = np.ascontiguousarray(np.flip(mass.reshape(shape), axis)).ravel()
        windows.deposit(grid, turned, mirrored, rest, stride, other)
        np.testing.assert_allclose(np.flip(other, axis), lattice, rtol=1e-9, atol=1e-12)


def test_what_is_read_is_the_transpose_of_what_is_added():
    grid, band, stride, lattice, rng = scene((13, 9, 12), 1)
    mass, ratio = rng.random(band.cells.size), rng.random(lattice.shape)
    rest = np.zeros((mass.size, 3), np.float32), 0.0
    windows.deposit(grid, band, mass, rest, stride, lattice)
    out = np.empty(mass.size, np.float32)
    windows.lattice_factors(0, mass.size, grid, band, ratio, stride, out)
    assert (mass * out).sum() == pytest.approx((lattice * ratio).sum(), rel=1e-5)
    part = np.full(mass.size, np.nan, np.float32)
    windows.lattice_factors(5, 20, grid, band, ratio, stride, part)
    np.testing.assert_array_equal(part[5:20], out[5:20])
    assert np.isnan(part[:5]).all() and np.isnan(part[20:]).all()


def test_outflow_is_that_through_the_faces_of_the_border():
    shape = (1, 4, 5)
    grid, cells = reference.grid_of(shape, SPACING), np.arange(20)
    velocity = np.tile(np.array([3.0, 1.0, 2.0], np.float32), (20, 1))
    out = np.full(20, np.nan, np.float32)
    windows.border_outflow(0, 20, grid, cells, (velocity, 0.1), out)
    want = np.zeros((4, 5))
    want[0] -= 0.1 / 0.5
    want[-1] += 0.1 / 0.5
    want[:, 0] -= 0.2 / 2.0
    want[:, -1] += 0.2 / 2.0
    np.testing.assert_allclose(out.reshape(4, 5), want, rtol=1e-6)
