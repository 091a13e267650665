"""Objects and gaps a few voxels wide: redistancing leaves them where they are, at rest and on the move.

Displacements are free of the measure's own bias: at every grid edge that the exact surface crosses, the error of psi,
which is a distance, at the edge's two ends, interpolated to the crossing. Voxels, positive outwards.
"""

import numpy as np
import pytest

from accelsurf.levelset import LevelSet, Workers
from accelsurf.levelset.checkpoint import checkpoint_surface, restore_surface
from benchmarks.thin import DIRECTIONS, after_redistances, displacement, exact_distance, lattice

REDISTANCES = 50


@pytest.mark.sampled
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("kind", "size"), [("slab", 1.5), ("slab", 2), ("slab", 3), ("cylinder", 1), ("cylinder", 1.5)]
)
def test_thin_objects_and_gaps_stay_where_they_are(kind, size, sign):
    """In 50 redistances, with ``sign`` -1 as a gap; before, 0.1 to 0.7 voxel outwards."""
    for number in (0, 1, 4, 8):
        moved, flipped = after_redistances(kind, size, number, sign=sign, count=REDISTANCES)
        assert abs(moved.mean()) < 0.05
        assert np.abs(moved).max() < (0.08 if size == 1 else 0.05)
        assert flipped == 0


def drawn_sheet(seed, ratio):
    """Exact distance of a sheet of 1.5 to 2 voxels along or nearly along the coarsest axis, and the spacing."""
    draw = np.random.default_rng([seed, int(2 * ratio)])
    spacing = draw.permutation([ratio, draw.uniform(1, ratio) if draw.random() < 0.5 else 1.0, 1.0])
    normal = np.where(spacing == ratio, 1.0, draw.uniform(-0.5, 0.5, 3) * draw.integers(0, 2))
    at = lattice((28, 28, 28), tuple(spacing), draw.random(3))
    across = np.tensordot(normal / np.linalg.norm(normal), at, 1)
    return np.float32(np.abs(across) - 0.5 * draw.uniform(1.5, 2) * ratio), tuple(
        map(float, spacing)
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("ratio", [1.5, 2, 3, 4])
def test_thin_sheets_across_thick_slices_stay_where_they_are(ratio):
    """Voxels of the coarsest axis, of which sheets of 1.5 grew by up to 0.6."""
    for seed in range(6):
        exact, spacing = drawn_sheet(seed, ratio)
        sign = 1 if seed % 2 else -1
        surface = LevelSet(sign * exact, spacing)
        for _ in range(30):
            surface.redistance()
        moved, flipped = displacement(exact, sign * surface.psi, spacing, 8)
        moved *= min(spacing) / ratio
        assert abs(moved.mean()) < 0.03
        assert np.abs(moved).max() < 0.08
        assert flipped == 0


@pytest.mark.parametrize(("size", "most"), [(2.5, 0.03), (4, 0.02), (8, 0.01)])
def test_balls_stay_where_they_are(size, most):
    for number in (1, 4):
        moved, flipped = after_redistances("ball", size, number, count=REDISTANCES)
        assert np.abs(moved).max() < most
        assert flipped == 0


def test_inside_and_outside_turned_round_give_the_same_surface():
    """Not only the same displacement: the same psi but for the sign and rounding, in motion too."""
    for kind, size in (("slab", 2), ("cylinder", 1.5)):
        psi = exact_distance(kind, size, 4)
        surfaces = [LevelSet(sign * psi, (1, 1, 1)) for sign in (1, -1)]
        for _ in range(5):
            for sign, surface in zip((1, -1), surfaces, strict=True):
                surface.advance(np.full(surface.size, 0.05 * sign, np.float32), 1.0)
                surface.redistance()
        np.testing.assert_allclose(surfaces[0].psi, -surfaces[1].psi, atol=2e-6)


def test_a_cylinder_shrinks_and_grows_as_fast_as_told():
    """From radius 3 to 1 and, within what the upwind |grad psi| costs there, back."""
    for number in (0, 4):
        for first, last, most in ((3, 1, 0.09), (1, 3, 0.25)):
            surface = LevelSet(exact_distance("cylinder", first, number), (1, 1, 1))
            for _ in range(50):
                surface.advance(np.full(surface.size, (first - last) / 50, np.float32), 1.0)
                surface.redistance()
            moved, _ = displacement(
                exact_distance("cylinder", last, number), surface.psi, (1, 1, 1), 9
            )
            assert np.abs(moved).max() < most


@pytest.mark.parametrize(
    ("kind", "size", "most"), [("slab", 2, 0.12), ("cylinder", 1.5, 0.1), ("cylinder", 2, 0.05)]
)
def test_thin_objects_are_carried_as_they_are(kind, size, most):
    """50 steps of 0.05 voxel under a constant velocity; before, 0.15 to 0.7 voxel outwards."""
    for number in (0, 1, 4):
        direction = DIRECTIONS[number]
        velocity = direction if kind == "slab" else np.cross(direction, (0.48, 0.6, 0.64))
        velocity = velocity / np.linalg.norm(velocity)
        surface = LevelSet(exact_distance(kind, size, number), (1, 1, 1))
        for _ in range(50):
            surface.advect(np.tile(np.float32(velocity), (surface.size, 1)), 0.05)
            surface.redistance()
        exact = exact_distance(kind, size, number, shift=2.5 * velocity)
        moved, _ = displacement(exact, surface.psi, (1, 1, 1), 9)
        assert np.abs(moved).max() < most


def test_what_shrinks_to_nothing_is_gone():
    surface = LevelSet(exact_distance("ball", 2, 4), (1, 1, 1))
    for _ in range(30):
        surface.advance(np.full(surface.size, 0.1, np.float32), 1.0)
        surface.redistance()
    assert not surface.labels.any()
    assert surface.size == 0


@pytest.mark.threads
def test_residues_follow_from_the_band_alone():
    """A surface that is restored goes on with the same bytes; so do any numbers of threads."""
    psi = exact_distance("cylinder", 1.5, 8)
    results = []
    for threads in (1, 2, 3):
        with Workers(threads) as workers:
            surface = LevelSet(psi, (1, 1, 1), workers=workers)
            surface.redistance()
            if threads == 3:
                restored = LevelSet(psi + 1, (1, 1, 1), workers=workers)
                restore_surface(restored, checkpoint_surface(surface))
                surface = restored
            surface.advance(np.full(surface.size, 0.1, np.float32), 1.0)
            surface.redistance()
            results.append((surface.psi.tobytes(), surface.residues.tobytes()))
    assert results[0] == results[1] == results[2]


def test_residues_count_near_a_surface_alone():
    surface = LevelSet(lattice((12, 12, 12), (1, 1, 1), (0, 0, 0))[0], (1, 1, 1))
    # A plane is what the interpolant is exact for.
    assert not surface.residues.any()
