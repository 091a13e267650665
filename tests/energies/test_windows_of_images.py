"""Energies on a window around an object have the same bytes as on the whole image, which they know by its sums."""

import numpy as np
import pytest

from accelsurf.energies import (
    ChanVese,
    GaussianLikelihood,
    HistogramLikelihood,
    Parzen,
    RegionMoments,
)
from accelsurf.energies.likelihood import least_variance
from accelsurf.energies.region_sums import moments_of, sums_by_plane
from accelsurf.grid.boxes import box_at
from accelsurf.levelset import LevelSet, Workers

SHAPE, SPACING = (37, 49, 46), (1.3, 1.0, 1.1)
WINDOWS = {
    "all around": ((2, 3, 2), (31, 41, 39)),
    "one plane less": ((1, 0, 0), (36, 49, 46)),
    "rows": ((0, 3, 0), (37, 41, 46)),
    "columns": ((0, 0, 3), (37, 49, 39)),
}


def scan():
    rng = np.random.default_rng(4)
    z, y, x = np.indices(SHAPE)
    ball = np.sqrt((1.3 * (z - 17)) ** 2 + (y - 23.2) ** 2 + (1.1 * (x - 21)) ** 2) - 13.3
    image = np.where(ball < 0, 1.0, 0.2) + rng.normal(0, 0.3, SHAPE)
    return image.astype(np.float32), ball.astype(np.float32)


def makers(image):
    moments, parzen = RegionMoments(*sums_by_plane(image, moments_of)), Parzen.of_image(image)
    counts, least = sums_by_plane(image, parzen.histogram), least_variance(image)
    return {
        "chan-vese": lambda part: ChanVese(part, 0.1, whole=moments),
        "chan-vese smeared": lambda part: ChanVese(part, 0.1, epsilon=1.5, whole=moments),
        "gauss": lambda part: GaussianLikelihood(part, 0.1, whole=moments, min_variance=least),
        "histogram": lambda part: HistogramLikelihood(part, 0.1, parzen=parzen, whole=counts),
    }


def evolved(energy, psi, workers):
    """Energy, force and surface of some steps, by cells (z, y, x) of psi."""
    surface = LevelSet(psi, SPACING, workers=workers)
    assert surface.inside_beyond_band > 1000, "most of the inside is summed beyond the band"
    energy.start(surface)
    found = []
    for _ in range(4):
        fraction, area = surface.fraction_and_area()
        front = surface.front()
        found += [energy.state().tobytes(), energy.value(surface, fraction, area)]
        force = energy.force(surface, front, surface.curvature(front))
        found.append(force.tobytes())
        surface.advance((0.4 * np.sign(force)).astype(np.float32), 1.0)
        energy.follow(surface, surface.redistance())
    return found, surface.psi


@pytest.mark.sampled
@pytest.mark.parametrize("window", WINDOWS.values(), ids=WINDOWS)
@pytest.mark.parametrize("name", makers(scan()[0]))
@pytest.mark.threads
def test_a_window_has_the_bytes_of_the_whole(name, window):
    image, psi = scan()
    box, make = box_at(*window), makers(image)[name]
    with Workers(1) as one, Workers(3) as three:
        want, surface = evolved(make(image), psi, one)
        got, part = evolved(
            make(np.ascontiguousarray(image[box])), np.ascontiguousarray(psi[box]), three
        )
    assert got == want
    assert surface[box].tobytes() == part.tobytes()


def test_by_default_the_whole_is_the_image_at_hand():
    image, psi = scan()
    part = box_at(*WINDOWS["all around"])
    values = np.ascontiguousarray(image[part])
    with Workers(1) as workers:
        for name, bare in (
            ("chan-vese", ChanVese),
            ("gauss", GaussianLikelihood),
            ("histogram", HistogramLikelihood),
        ):
            own, _ = evolved(bare(values, 0.1), psi[part], workers)
            assert own == evolved(makers(values)[name](values), psi[part], workers)[0]
            assert own != evolved(makers(image)[name](values), psi[part], workers)[0]


def test_sums_of_some_voxels_do_not_depend_on_the_box():
    image, psi = scan()
    whole = sums_by_plane(image, moments_of, psi < 0)
    assert whole[0] == np.count_nonzero(psi < 0)
    exact = image[psi < 0].astype(np.float64)
    np.testing.assert_allclose(whole[1:], [exact.sum(), (exact**2).sum()], rtol=1e-13)
    for corner, shape in WINDOWS.values():
        box = box_at(corner, shape)
        assert sums_by_plane(image[box], moments_of, psi[box] < 0).tobytes() == whole.tobytes()
