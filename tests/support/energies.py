"""Grids, smooth fields and a short evolution by hand, for the tests of energies."""

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


def coordinates(grid):
    """(z, y, x) in mm from the middle of one of `GRIDS`."""
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(*GRIDS[grid], strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def smooth_field(grid, seed, width=5.0):
    """A random field, smooth over ``width`` mm, of size 1."""
    shape, spacing = GRIDS[grid]
    field = gaussian_filter(np.random.default_rng(seed).normal(size=shape), [width / h for h in spacing], mode="wrap")
    return field / np.abs(field).max()


def value(energy, psi, spacing):
    """(U, surface, area) of the surface psi = 0."""
    surface = LevelSet(psi, spacing, 4.0)
    energy.start(surface)
    fraction, area = surface.fraction_and_area()
    return energy.value(surface, fraction, area), surface, area


def evolve(energy, surface, steps):
    """Start an energy and make steps as the loop does; return the energy's value at the end."""
    flow = ConstantDensity()
    energy.start(surface)
    flow.start(surface)
    for _ in range(steps):
        fraction, area = surface.fraction_and_area()
        energy.value(surface, fraction, area)
        front = surface.front()
        curvature = surface.curvature(front)
        force = energy.force(surface, front, curvature)
        move = flow.move(StepInput(surface, front, force, curvature, area, 0.0), StepLimits(0.5))
        surface.advance(move.speed, move.dt)
        surface.remove_small()
        change = surface.redistance(flow.fields)
        flow.set_fields(change.fields)
        energy.follow(surface, change)
    return energy.value(surface, *surface.fraction_and_area())
