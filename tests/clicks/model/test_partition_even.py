"""In an even image each voxel belongs to the nearest click."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.clicks.model.partition import basins_of
from accelsurf.grid.clicks import Click

#: Share of voxels that may go to another click than the nearest, which 6 neighbours do not always tell, and how much
#: farther it may be, of the largest spacing. Back to the earliest neighbour it was a tenth of the voxels, and 1.1.
MOST, FARTHER = 2e-3, 0.1


def drawn_clicks(random, shape, spacing, radius, count=8):
    """Clicks of several owners at drawn places that share no voxel: points, or balls of a radius in mm."""
    at, taken, clicks = np.indices(shape), np.zeros(shape, bool), []
    while len(clicks) < count:
        centre = random.integers(0, shape)
        mask = (
            sum(((a - c) * h) ** 2 for a, c, h in zip(at, centre, spacing, strict=True))
            <= radius**2
        )
        if not (mask & taken).any():
            taken |= mask
            (box,) = ndimage.find_objects(mask.astype(int))
            clicks.append(Click("inside", box, mask[box], len(clicks) + 1))
    return clicks


@pytest.mark.parametrize("radius", [0.0, 3.0])
@pytest.mark.parametrize(
    ("shape", "spacing"),
    [
        ((24, 30, 30), (1.0, 1.0, 1.0)),
        ((12, 36, 36), (3.0, 1.0, 1.0)),
        ((9, 40, 40), (5.0, 1.0, 1.0)),
        ((20, 30, 24), (0.8, 0.5, 2.0)),
        ((1, 60, 60), (4.0, 1.0, 1.0)),
    ],
)
def test_where_nothing_differs_the_nearest_click_has_the_voxel(shape, spacing, radius):
    random = np.random.default_rng(int(10 * sum(spacing) + radius))
    clicks = drawn_clicks(random, shape, spacing, radius)
    found = basins_of([np.full(shape, 7.0, np.float32)], spacing, clicks, None)
    distances = []
    for click in clicks:
        others = np.ones(shape, bool)
        others[click.box] &= ~click.mask
        distances.append(ndimage.distance_transform_edt(others, sampling=spacing))
    distance = np.stack(distances)
    own = np.take_along_axis(distance, found.labels[None] - 1, 0)[0]
    farther = own - distance.min(axis=0)
    assert (farther > 1e-4).mean() <= MOST
    assert farther.max() <= FARTHER * max(spacing)


def test_a_front_goes_around_what_it_may_not_pass():
    """A straight way is no way through a wall: the voxel behind it belongs to the click on its side."""
    shape = (1, 41, 41)
    image = np.zeros(shape, np.float32)
    image[0, :36, 20] = 100.0
    image[0, :, :20] += np.random.default_rng(0).normal(0, 1e-3, (41, 20)).astype(np.float32)
    one, other = (
        Click("inside", tuple(slice(k, k + 1) for k in at), np.ones((1, 1, 1), bool), id)
        for id, at in ((1, (0, 5, 17)), (2, (0, 5, 38)))
    )
    labels = basins_of([image], (1.0, 1.0, 1.0), [one, other], None).labels[0]
    assert (labels[:30, :20] == 1).all() and (labels[:30, 21:] == 2).all()
