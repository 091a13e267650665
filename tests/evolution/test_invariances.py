"""What must not matter: order of the axes, unit of length, scale of the image, which side is inside, place of the grid.

A body without symmetry about an oblique axis in 3D, an egg in the plane. `benchmarks.lagrangian` has finer grids.
"""

from __future__ import annotations

import numpy as np
import pytest

import accelsurf
from accelsurf.settings.run_config import RunConfig
from tests.support.follow import lattice
from tests.support.invariances import body, differences, rotations, shifts, spread
from tests.support.lagrangian import Law
from tests.support.lagrangian_cases import TILTED, lopsided

#: Rounding of float32, in voxels: 20 steps, each of which rounds psi to 1e-7 of its value.
ROUNDING = 5e-6
#: Flowable mass divides by the masses of few cells where it balances them, which raises rounding.
ROUNDING_OF_MASS = 5e-5
FEW = ("mirrored along y", "axes in the order xzy", "lengths x 0.001", "inside out")


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("model", "names"), [("constant-density", ()), ("flowable-mass", FEW)])
def test_the_same_problem_in_other_words_gives_the_same_surface(
    model: str, names: tuple[str, ...]
) -> None:
    """Mirrors, orders of the axes, lengths x 2 and x 0.001, inside and outside turned round: to rounding."""
    found = differences(body(24), Law(model, alpha=0.03), 1.0, names)
    assert len(found) == (len(names) or 11)
    assert max(found.values()) <= (ROUNDING_OF_MASS if names else ROUNDING), found
    # Powers of two and signs are exact.
    assert found["inside out"] == 0.0 and found.get("lengths x 2", 0.0) == 0.0


@pytest.mark.sampled(1)
@pytest.mark.parametrize("model", ["constant-density", "flowable-mass"])
def test_the_place_of_the_grid_matters_little(model: str) -> None:
    """Shifts within a voxel: .003 h at any point; any rotation: .006 h (flowable .009 h); 32 pixels."""
    law = Law(model, alpha=0.03)
    moved, turned = (
        spread(frames, law, 32, 1.5, False) for frames in (shifts(32, 4), rotations(False, 4))
    )
    print(f"\n{model}: shifts {moved}, rotations {turned} (mean, largest; voxels)")
    assert moved[1] <= 0.004 and moved[0] <= 0.0015
    assert turned[1] <= 0.012 and turned[0] <= 0.003


@pytest.mark.parametrize("scale", [(64.0, 0.0), (37.5, -1000.0), (1e-3, 0.01)])
def test_the_scale_of_the_image_does_not_matter(scale: tuple[float, float]) -> None:
    """a I + b: the whole pipeline, from the image to the surface."""
    own = TILTED.inwards(lattice(32, flat=True).points.reshape(3, -1).T, False)
    image = np.tanh(-2.0 * lopsided(own)).reshape(1, 32, 32)
    config = RunConfig(start="ball:15,15,0,8vox", levels=1, max_steps=60)
    first, other = (
        accelsurf.segment(one, spacing=1.0, config=config)
        for one in (image, scale[0] * image + scale[1])
    )
    psi = [result.objects[0].psi for result in (first, other)]
    near = np.abs(psi[0]) < 1.0
    assert 100 < first.volume_mm3 < 900
    assert np.abs(psi[0] - psi[1])[near].max() <= 1e-3
