"""Energies against their forces: dU under a small perturbation of the surface is the work of the force on it."""

import numpy as np
from scipy.ndimage import gaussian_filter

from accelsurf.flows import ConstantDensity, StepInput, StepLimits
from accelsurf.levelset import LevelSet

#: Grids (shape, spacing): nearly isotropic, thick slices, a single slice.
GRIDS = {
    "3D": ((40, 44, 42), (1.0, 0.9, 1.1)),
    "thick slices": ((26, 44, 48), (2.0, 1.0, 0.9)),
    "one slice": ((1, 96, 100), (3.0, 0.5, 0.45)),
}
#: Radius (mm) of the ball that is perturbed.
RADIUS = 13.0


def coordinates(grid):
    """(z, y, x) of the voxels in mm from the middle of the grid."""
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(*GRIDS[grid], strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def smooth_field(grid, seed, width=5.0):
    """A random field, smooth over ``width`` mm, of size 1."""
    shape, spacing = GRIDS[grid]
    field = gaussian_filter(
        np.random.default_rng(seed).normal(size=shape), [width / h for h in spacing], mode="wrap"
    )
    return field / np.abs(field).max()


def value(energy, psi, grid):
    """U of a surface that an energy starts on, the surface, and the area in each voxel of its band."""
    surface = LevelSet(psi, GRIDS[grid][1], 4.0)
    energy.start(surface)
    fraction, area = surface.fraction_and_area()
    return energy.value(surface, fraction, area), surface, area


def derivative_and_work(energy, grid, seed, step):
    """Of a smooth outward perturbation eta: dU measured by differences, and f eta dA (n,) at the voxels that are cut.

    eta has a part of one sign, so that the derivative is not a small difference of large numbers. Both agree where the
    force is the derivative: eta is along the outward normal, f along the inward one.
    """
    z, y, x = coordinates(grid)
    psi = np.sqrt(z**2 + y**2 + x**2) - RADIUS - smooth_field(grid, 7)
    eta = 0.6 + smooth_field(grid, seed)
    distance = value(energy, psi, grid)[1].psi.copy()
    up, down = (value(energy, distance - sign * step * eta, grid)[0] for sign in (1, -1))
    _, surface, area = value(energy, distance, grid)
    front = surface.front()
    force = energy.force(surface, front, surface.curvature(front))
    return (up - down) / (2 * step), force * eta.ravel()[surface.band.cells] * area


def assert_derivative(energy, grid, seed, step, tolerance=0.02):
    """The measured derivative is the work, up to ``tolerance`` of the work without its signs."""
    measured, work = derivative_and_work(energy, grid, seed, step)
    total, scale = work.sum(), np.abs(work).sum()
    assert abs(measured - total) <= tolerance * scale, f"off by {(measured - total) / scale:+.3%}"
    # Far from cancelling, so that a wrong sign or factor could not pass.
    assert np.sign(measured) == np.sign(total) and abs(total) > 0.2 * scale


def value_after_steps(energy, surface, steps=25):
    """U of a surface that constant density moved so many steps while the energy followed, and U summed afresh."""
    flow = ConstantDensity()
    energy.start(surface)
    flow.start(surface)
    for _ in range(steps):
        fraction, area = surface.fraction_and_area()
        energy.value(surface, fraction, area)
        front = surface.front()
        curvature = surface.curvature(front)
        force = energy.force(surface, front, curvature)
        plan = flow.move(StepInput(surface, front, force, curvature, area, 0.0), StepLimits(0.5))
        surface.advance(plan.speed, plan.dt)
        surface.remove_small()
        change = surface.redistance(flow.fields)
        flow.set_fields(change.fields)
        energy.follow(surface, change)
    fraction, area = surface.fraction_and_area()
    updated = energy.value(surface, fraction, area)
    energy.start(surface)
    return updated, energy.value(surface, fraction, area)
