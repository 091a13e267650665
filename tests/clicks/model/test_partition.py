"""Objects that part the space between them: one model for all, which is what each would find alone."""

import numpy as np
import pytest
from scipy import ndimage
from skimage.segmentation import watershed

from accelsurf import segment_objects
from accelsurf.clicks.model.partition import BasinsOnce, partition_model
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.clicks import Click, Clicks
from tests.support.tissues import membrane_cells

SHAPE, SPACING = (16, 30, 30), (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def cells():
    return membrane_cells(SHAPE, 5, noise=0.2, seed=3)


@pytest.fixture(scope="module")
def clicks(cells):
    return Clicks(tuple(point("inside", at, own) for own, at in enumerate(cells[2], 1)), SHAPE)


def point(side, at, own=1):
    return Click(side, box_at(tuple(map(int, at)), (1, 1, 1)), np.ones((1, 1, 1), bool), own)


def whole(model):
    """Its object and F on all of the grid."""
    everywhere = whole_box(SHAPE)
    return model.inside_on(everywhere), model.field_on(everywhere)


def table(path, clicks):
    rows = [f"{id},{x},{y},{z},inside" for id, (z, y, x) in clicks]
    path.write_text("\n".join(["id,x_vox,y_vox,z_vox,side", *rows]))
    return str(path)


def mean_dice(labels, truth):
    return np.mean(
        [
            2
            * ((labels == id) & (truth == id)).sum()
            / ((labels == id).sum() + (truth == id).sum())
            for id in np.unique(truth[truth > 0])
        ]
    )


def test_objects_fill_the_space_and_none_overlap(cells, clicks):
    image, truth, _ = cells
    once, starts = BasinsOnce(), []
    for own in clicks.ids():
        start, field = whole(partition_model([image], SPACING, clicks.of(own), basins=once))
        alone = whole(partition_model([image], SPACING, clicks.of(own)))
        assert np.array_equal(start, alone[0]) and np.array_equal(field, alone[1])
        assert np.array_equal(start, field < 0) and start[tuple(cells[2][own - 1])]
        starts.append(start)
        same = start & (truth == own)
        assert 2 * same.sum() / (start.sum() + (truth == own).sum()) > 0.9
    assert np.sum(starts, axis=0).max() == 1 and (np.sum(starts, axis=0) == 1).mean() > 0.995


def test_what_objects_share_is_computed_once_for_the_same_clicks(cells, clicks):
    image = cells[0]
    images, once = [image], BasinsOnce()
    first = once.of(images, SPACING, clicks.of(1), None)
    assert once.of(images, SPACING, clicks.of(2), None) is first
    more = clicks.with_more([point("inside", (0, 0, 0), 2)])
    assert once.of(images, SPACING, more.of(2), None) is not first
    assert once.of([image.copy()], SPACING, more.of(2), None) is not once.of(
        images, SPACING, more.of(2), None
    )


def test_an_outside_click_takes_from_its_object_alone(cells, clicks):
    image, once = cells[0], BasinsOnce()
    before = partition_model([image], SPACING, clicks.of(1), basins=once)
    start = whole(before)[0]
    inside = np.argwhere(start)
    at = inside[np.argmax(np.abs(inside - cells[2][0]).sum(axis=1))]
    more = clicks.with_more([point("outside", at, 1)])
    after = partition_model([image], SPACING, more.of(1), basins=once)
    left = whole(after)[0]
    assert not left[tuple(at)] and left.sum() < start.sum()
    other = partition_model([image], SPACING, more.of(2), basins=once)
    assert (
        other.field.tobytes()
        == partition_model([image], SPACING, clicks.of(2), basins=once).field.tobytes()
    )


def test_what_is_no_object_and_a_mask(cells, clicks):
    """Of one object with the others clicked as no object (id 0), and within a mask."""
    image = cells[0]
    seen = Clicks(
        (clicks.clicks[1], *(one._replace(id=0) for one in clicks.clicks if one.id != 2)), SHAPE
    ).of(2)
    start = whole(partition_model([image], SPACING, seen))[0]
    assert (cells[1][start] == 2).mean() > 0.9
    mask = np.ones(SHAPE, bool)
    mask[:, 8:] = False
    bounded = whole(partition_model([image], SPACING, seen, mask=mask))[0]
    assert bounded.any() and not bounded[~mask].any()


def test_clicks_of_one_object_need_no_owner(cells, clicks):
    own, other = clicks.clicks[0], clicks.clicks[1]._replace(side="outside", id=1)
    plain = Clicks((own, other), SHAPE)
    same = [
        partition_model([cells[0]], SPACING, one).field.tobytes() for one in (plain, plain.of(1))
    ]
    assert same[0] == same[1]


def test_a_run_of_cells_ends_at_the_model_and_is_as_good_as_a_watershed(tmp_path):
    image, truth, centres = membrane_cells((24, 48, 48), 8, noise=0.3, seed=5)
    path = table(tmp_path / "clicks.csv", enumerate(centres, 1))
    result = segment_objects(image, path, preset="membrane-cells")
    assert {(cell.stop.reason, cell.stop.steps) for cell in result.objects} == {("converged", 0)}
    seeds = np.zeros(truth.shape, int)
    seeds[tuple(centres.T)] = np.arange(1, 9)
    flooded = max(
        mean_dice(watershed(ndimage.gaussian_filter(image, s), seeds), truth)
        for s in (0.5, 1.0, 1.5)
    )
    assert mean_dice(result.labels, truth) > flooded - 0.001
    moved = segment_objects(image, path, preset="membrane-cells", smoothness=0.1)
    assert all(cell.stop.steps > 0 for cell in moved.objects)


def test_what_is_no_object_has_an_appearance(tmp_path):
    """Two bright balls that touch, on dark ground that is clicked as no object."""
    z, y, x = np.indices((24, 32, 48)) - np.array([12.0, 16.0, 24.0])[:, None, None, None]
    truth = np.where(z**2 + y**2 + (x + 8) ** 2 < 64, 1, 0) + np.where(
        z**2 + y**2 + (x - 8) ** 2 < 64, 2, 0
    )
    image = 100.0 * (truth > 0) + np.random.default_rng(0).normal(0.0, 20.0, truth.shape)
    path = table(tmp_path / "clicks.csv", [(1, (12, 16, 16)), (2, (12, 16, 32)), (0, (3, 3, 3))])
    result = segment_objects(image, path, energy="partition:0", presmooth="0.5vox", smoothness=0)
    assert mean_dice(result.labels, truth) > 0.95 and result.labels[2, 2, 2] == 0


def test_the_ground_holds_far_from_its_click(tmp_path):
    """Two balls, near to the ground's click and far from it, keep their sizes."""
    z, y, x = np.indices((20, 20, 600)) - np.array([10.0, 10.0, 0.0])[:, None, None, None]
    truth = np.where(z**2 + y**2 + (x - 30) ** 2 < 36, 1, 0) + np.where(
        z**2 + y**2 + (x - 580) ** 2 < 36, 2, 0
    )
    blurred = ndimage.gaussian_filter(100.0 * (truth > 0), 1.5)
    image = blurred + np.random.default_rng(0).normal(0.0, 10.0, truth.shape)
    path = table(tmp_path / "clicks.csv", [(1, (10, 10, 30)), (2, (10, 10, 580)), (0, (10, 10, 5))])
    result = segment_objects(image, path, energy="partition:0", presmooth="0.5vox", smoothness=0)
    near, far = (int((result.labels == id).sum()) for id in (1, 2))
    assert abs(far / near - 1.0) < 0.15
