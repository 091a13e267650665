import numpy as np
import pytest

from accelsurf.image.volume import Volume
from accelsurf.run.image_force import image_forces
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig

SHAPE = (32, 40, 48)
#: What the energies are shown with; the last shows no more than its band.
ENERGIES = (
    "chan-vese", "chan-vese:epsilon=0", "threshold:50,", "likelihood", "likelihood:histogram", "local-region:R=12",
    "chan-vese - 0.01*balloon", "geodesic",
)


def image(noise=4.0):
    z, y, x = np.indices(SHAPE)
    ball = (z - 15.5) ** 2 + (y - 19.5) ** 2 + (x - 23.5) ** 2 < 10**2
    return Volume.from_array((100.0 * ball + np.random.default_rng(1).normal(0, noise, SHAPE)).astype(np.float32))


def run_of(**settings):
    values = {"start": "ball:27,19,15,9", "levels": 1, "smoothness": 0.0, **settings}
    return Run(image(), RunConfig(**values))


@pytest.mark.parametrize("energy", ENERGIES)
def test_the_surface_moves_as_the_force_in_the_slice_says(energy):
    """Where psi fell in the first steps, the surface grew, and the force there was above 0; and the other way round.

    The area is left out of both: each energy has none, but for what geodesic is made of.
    """
    with run_of(energy=energy, flow="gradient", max_steps=3, epsilon=0.0) as run:
        before = run.objects[0].surface.psi.copy()
        (force,) = image_forces(run, [(0, 15)])
        for _ in range(3):
            run.step()
        moved = run.objects[0].surface.psi[15] - before[15]
    near = np.abs(before[15]) < 1.0
    grew, shrank = near & (moved < -0.3), near & (moved > 0.3)
    assert grew.sum() + shrank.sum() > 15
    assert np.isfinite(force[near]).all()
    right = (force[grew] > 0).sum() + (force[shrank] < 0).sum()
    assert right >= 0.95 * (grew.sum() + shrank.sum())


def test_looking_changes_nothing():
    ended = []
    for looks in (False, True):
        with run_of(energy="local-region:R=12 + 0.1*chan-vese", max_steps=12) as run:
            while run.step():
                if looks:
                    image_forces(run, [(0, 15), (1, 19), (2, 23)])
            ended.append(run.objects[0].surface.psi.tobytes())
    assert ended[0] == ended[1]


def test_beyond_the_region_of_interest_and_the_mask_nothing_is_known():
    with run_of(energy="threshold:50,", roi="5,6,4,40,34,28vox") as run:
        across, along = image_forces(run, [(0, 15), (2, 2)])
    known = np.isfinite(across)
    assert known[6:35, 5:41].all()
    assert known.sum() == known[6:35, 5:41].size
    assert across[19, 20] > 0 > across[8, 8]
    assert np.isnan(along).all() and along.shape == (32, 40)


def test_a_coarse_level_shows_each_voxel_the_nearest_of_its_own():
    with run_of(energy="threshold:50,", levels=2) as run:
        assert run.level == 1
        (force,) = image_forces(run, [(0, 15)])
    assert np.isfinite(force).all()
    assert force[19, 23] > 0 > force[2, 2]


def test_each_of_several_objects_has_its_own(tmp_path):
    table = tmp_path / "two.csv"
    table.write_text("id,x,y,z,r\n3,20,19,15,3\n7,40,30,15,4\n")
    with Run(image(), RunConfig(objects=str(table), energy="threshold:50,", max_steps=2)) as run:
        first, second, unknown = (image_forces(run, [(0, 15)], own)[0] for own in (3, 7, None))
    assert np.array_equal(first, unknown, equal_nan=True)
    assert first[19, 20] > 0 > second[30, 40]
    assert np.isnan(first).any(), "an object knows its own box alone"


def test_an_energy_of_ones_own_need_not_tell():
    from accelsurf.energies import Energy

    class Constant(Energy):
        def value(self, surface, fraction, area):
            return surface.volume(fraction)

        def force(self, surface, front, curvature):
            return front.astype(np.float32)

    with Run(image(), RunConfig(start="ball:23,19,15,9", levels=1), energy=Constant()) as run:
        assert image_forces(run, [(0, 15)]) is None
