"""Objects of a large image, run in groups, have the bytes of all at once in memory."""

from types import SimpleNamespace

import numpy as np
import pytest

from accelsurf.api.segment import segment_objects
from accelsurf.errors import AccelsurfError
from accelsurf.image.volume import Volume
from accelsurf.io import LazyVolume
from accelsurf.large import group_run, many_objects
from accelsurf.large.group_run import Boxes, MeetsOthers, VisitedBoxes, united
from accelsurf.large.many_objects import Groups, segment_many_objects
from accelsurf.large.windowed import LargeImage
from accelsurf.run.memory import PROCESS_BYTES
from tests.support.many_balls import BALLS, GEOMETRY, SHAPE, label_map, scene, write_table

FAST = {"max_steps": 80, "threads": 1}


@pytest.fixture(scope="module")
def image():
    return scene()


@pytest.fixture(scope="module")
def in_memory(image):
    return segment_objects(image, label_map(), **FAST)


def large(image, max_bytes=4 << 30):
    return LargeImage((LazyVolume.of_array(image),), max_bytes)


def in_groups(image, objects, margin=many_objects.MARGIN, max_bytes=4 << 30, **options):
    """What became of each object, and the groups that were run to the end, by their ids."""
    ended = []
    found = segment_many_objects(
        large(image, max_bytes),
        objects,
        margin=margin,
        on_group=lambda ids, _: ended.append(tuple(ids)),
        **{**FAST, **options},
    )
    return {one.id: one for one in found}, ended


def assert_same(one, want):
    """Whether an object is the other, to the last bit."""
    assert one.box == want.box and one.psi.tobytes() == want.psi.tobytes() and one.stop == want.stop
    assert one.image.tobytes() == want.image.tobytes() and one.terms == want.terms
    pairs = zip(one.history, want.history, strict=True)
    assert all(own._replace(seconds=0.0) == other._replace(seconds=0.0) for own, other in pairs)
    assert one.quality == want.quality and one.area_mm2 == want.area_mm2
    assert [rest.place for rest in one.plateaus] == [rest.place for rest in want.plateaus]
    if one.has_surface:
        assert one.surface.vertices.tobytes() == want.surface.vertices.tobytes()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("margin", [-2, 6, 60])
def test_groups_have_the_bytes_of_all_at_once(image, in_memory, margin):
    found, ended = in_groups(image, LazyVolume.of_array(label_map()), margin)
    assert list(found) == sorted(BALLS)
    for own, outcome in found.items():
        assert outcome.failure is None
        assert_same(outcome.object, in_memory.by_id[own])
    if margin == 60:
        assert ended == [tuple(sorted(BALLS))]
    else:
        assert ended[-1] == (31, 32), "the two met only on their way"
        assert (31,) in ended and (32,) in ended
        assert {(9,), (20, 21, 22), (47,)} < set(ended)


def test_the_scene_asks_for_what_groups_have_to_do(image, in_memory):
    """Alone, one that touches others would be another: a wrong group shows. What only comes near is the same alone."""
    for own, touches in ((21, True), (31, False), (32, False)):
        alone, among = (
            segment_objects(image, label_map((own,)), **FAST).by_id[own],
            in_memory.by_id[own],
        )
        assert (alone.psi.tobytes() != among.psi.tobytes() or alone.stop != among.stop) == touches


@pytest.mark.slow
def test_a_table_of_balls(image, tmp_path):
    table = write_table(tmp_path / "seeds.csv")
    want = segment_objects(image, table, **FAST)
    for outcome in in_groups(image, table)[0].values():
        assert_same(outcome.object, want.by_id[outcome.id])


@pytest.mark.slow
def test_balls_that_overlap_begin_apart_as_in_memory(image, tmp_path):
    (tmp_path / "seeds.csv").write_text(
        "id,x_vox,y_vox,z_vox,r_vox\n4,15,16,16,5\n3,21,16,16,5\n8,90,50,22,4\n"
    )
    want = segment_objects(image, str(tmp_path / "seeds.csv"), **FAST)
    found, ended = in_groups(image, str(tmp_path / "seeds.csv"), margin=0)
    assert sorted(ended) == [(3, 4), (8,)]
    for outcome in found.values():
        assert_same(outcome.object, want.by_id[outcome.id])


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "energy",  # the last one vanishes at once, from a box that is larger than the least window
    [
        "likelihood",
        "likelihood:model=histogram",
        "threshold:auto, + 0.1*threshold:learned,",
        "local-region + geodesic",
    ],
)
def test_energies_see_the_same(image, energy):
    ids = (9, 31, 32)
    options = {"energy": energy, "max_steps": 20, "presmooth": 0.6}
    want = segment_objects(image, label_map(ids), **{**FAST, **options})
    for outcome in in_groups(image, LazyVolume.of_array(label_map(ids)), **options)[0].values():
        assert_same(outcome.object, want.by_id[outcome.id])


def test_an_image_of_one_slice():
    volume, labels = scene(), label_map((31, 32, 9)).array
    flat = Volume(
        volume.array[17:18],
        group_run.cropped(GEOMETRY, (slice(17, 18), slice(0, 64), slice(0, 112))),
    )
    seeds = Volume(labels[17:18] + labels[22:23], flat.geometry)
    want = segment_objects(flat, seeds, **FAST)
    for outcome in in_groups(flat, LazyVolume.of_array(seeds))[0].values():
        assert outcome.object.length_mm == want.by_id[outcome.id].length_mm
        assert_same(outcome.object, want.by_id[outcome.id])


# ------------------------------------------------------------------------------------------------- what cannot be run


@pytest.mark.slow
def test_a_group_that_does_not_fit_is_named_and_the_others_go_on(image):
    """Windows of 80 columns fit: the rod's must be larger, as it goes on along x."""
    values = image.array.copy()
    values[15:22, 16:25, 30:] = 100.0
    # Beside the window a float32 image takes 12 bytes and its own 4, the object's box 36.
    long, fits = (
        image.with_array(values),
        PROCESS_BYTES + 16 * SHAPE[0] * SHAPE[1] * 80 + 36 * 42**3,
    )
    found, _ = in_groups(long, LazyVolume.of_array(label_map((9, 31, 47))), max_bytes=fits)
    failed = {own: outcome.failure for own, outcome in found.items() if outcome.object is None}
    assert (
        list(failed) == [47]
        and "object 47 needs a window of" in failed[47]
        and "of memory" in failed[47]
    )
    without = segment_objects(long, label_map((9, 31)), **FAST)
    for own in (9, 31):
        assert_same(found[own].object, without.by_id[own])


def test_one_that_came_to_a_start_that_failed_is_run_without_it(image, monkeypatch):
    run_group, ran = group_run.run_group, []

    def failing(large, starts, others):
        ran.append([one.id for one in starts])
        if any(one.id == 21 for one in starts):
            raise AccelsurfError("no", "nothing to do")
        return run_group(large, starts, others)

    monkeypatch.setattr(many_objects, "run_group", failing)
    found, _ = in_groups(image, LazyVolume.of_array(label_map((20, 21))), margin=-2)
    assert ran == [[20], [21], [20]] and found[21].failure == "no; nothing to do"
    assert_same(found[20].object, segment_objects(image, label_map((20,)), **FAST).by_id[20])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"levels": 2}, "levels"),
        ({"noise": 1.0}, "noise"),
        ({"mask": "m.nii"}, "mask"),
        ({"roi": "0,0,0,9,9,9"}, "roi"),
        ({"box": "0,0,0,9,9,9"}, "box"),
        ({"outside": "point:1,1,1"}, "outside"),
        ({"foreground": "ball:1,1,1,2", "energy": "likelihood"}, "foreground"),
        ({"energy": "likelihood:update=no"}, "update=no"),
        ({"energy": "partition"}, "partition is of clicks"),
        ({"edit": "step=3 smoothness=1"}, "edit"),
        ({"checkpoint": "5min"}, "checkpoint"),
    ],
)
def test_what_depends_on_all_objects_is_refused(image, options, named):
    with pytest.raises(AccelsurfError, match=named):
        in_groups(image, LazyVolume.of_array(label_map()), **options)


# ------------------------------------------------------------------------------------------------------------- groups


def test_groups_do_not_depend_on_their_order():
    rng = np.random.default_rng(0)
    low = rng.integers(0, 60, (40, 3))
    high = low + rng.integers(0, 14, (40, 3))
    singles = [(place,) for place in range(40)]
    want = united(singles, low, high)
    assert 1 < len(want) < 40 and sorted(place for group in want for place in group) == list(
        range(40)
    )
    assert united([singles[place] for place in rng.permutation(40)], low, high) == want
    assert united(want, low, high) == want
    there = np.flatnonzero((low < high).all(axis=1))
    for one in there:
        near = {
            place for place in there if np.all((low[place] < high[one]) & (high[place] > low[one]))
        }
        assert len({group for group in want if near & set(group)}) == 1


def test_boxes_that_touch_do_not_overlap_and_pairs_count():
    low, high = (
        np.array([[0, 0, 0], [4, 0, 0], [8, 0, 0]]),
        np.array([[4, 1, 1], [8, 1, 1], [9, 1, 1]]),
    )
    assert united([(0,), (1,), (2,)], low, high) == [(0,), (1,), (2,)]
    assert united([(0,), (1,), (2,)], low, high, [(2, 0)]) == [(0, 2), (1,)]


class Starts:
    """Boxes without anything in them."""

    def __init__(self, low, high):
        self.ids, self.low, self.high = np.arange(1, len(low) + 1), low, high


def test_thousands_of_objects_are_light_and_look_at_the_nearest():
    places = np.stack(np.meshgrid(*[np.arange(15) * 40] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    groups = Groups(Starts(places, places + 9))
    assert groups.waiting == [(place,) for place in range(15**3)]
    middle = 7 * (225 + 15 + 1)
    near = groups.others((middle,))
    assert len(near) == many_objects.MAX_OTHERS and middle not in near and near == sorted(near)
    assert {middle + step for step in (-225, -15, -1, 1, 15, 225)} < set(near)
    corner = groups.others((0,))
    assert {1, 15, 225} < set(corner) and places[corner].max() <= 160


def test_what_has_failed_meets_nobody_any_more():
    """Two are united by where they came; when they fail, the place where they were is nobody's."""
    first = np.array([[0, 0, 0], [30, 0, 0], [60, 0, 0], [90, 0, 0]])
    groups = Groups(Starts(first, first + 5))
    for place, (low, high) in enumerate(((0, 33), (25, 40), (45, 77), (75, 99))):
        groups.put((place,), np.array([[low, 0, 0]]), np.array([[high, 5, 5]]))
    assert groups.unite() == [(0,), (1,), (2,), (3,)] and groups.waiting == [(0, 1), (2, 3)]
    assert groups.others((2, 3)) == [0, 1]
    groups.put_failed((0, 1))
    groups.put((2, 3), np.array([[35, 0, 0], [75, 0, 0]]), np.array([[70, 5, 5], [99, 5, 5]]))
    assert groups.unite() == [] and groups.waiting == [] and groups.others((2, 3)) == []


def test_one_that_comes_to_a_start_is_united_with_it_whatever_the_boxes_say():
    groups = Groups(Starts(np.array([[0, 0, 0], [30, 0, 0]]), np.array([[5, 5, 5], [35, 5, 5]])))
    groups.put_near((0,), [1])
    with pytest.raises(ValueError, match="1 groups have not ended"):
        groups.unite()
    groups.put((1,), np.array([[31, 0, 0]]), np.array([[32, 1, 1]]))
    assert groups.unite() == [(0,), (1,)] and groups.waiting == [(0, 1)]


class Visitor:
    """An object that is where it is said to be."""

    def __init__(self):
        self.corner = (10, 0, 5)
        psi = np.full((20, 9, 9), 3.0)
        psi[4:7, 4:6, :3] = -3.0
        self.surface = SimpleNamespace(size=1, psi=psi, gamma=np.float32(3.0))
        self.band = np.array([16, 4, 9]), np.array([17, 6, 11])

    def extent(self):
        return self.band


def test_visited_boxes_are_of_all_steps_with_what_lies_deep_inside_at_the_end():
    one = Visitor()
    visited = VisitedBoxes(SimpleNamespace(objects=[one]), (100, 0, 1000))
    assert group_run.REACH == 3
    assert [side.tolist() for side in visited.boxes] == [[[113, 1, 1006]], [[120, 9, 1014]]]
    one.band = np.array([15, 5, 9]), np.array([18, 6, 10])
    visited.look()
    one.band, one.surface.size = (np.zeros(3, np.int64), np.ones(3, np.int64)), 0
    visited.look()
    assert [side.tolist() for side in visited.boxes] == [[[112, 1, 1006]], [[121, 9, 1014]]]
    visited.look_at_ends()
    assert [side.tolist() for side in visited.boxes] == [[[112, 1, 1005]], [[121, 9, 1014]]]
    near = np.array([[121, 0, 1000], [120, 8, 1013], [0, 0, 0]])
    with pytest.raises(MeetsOthers) as met:
        visited.refuse_near(Boxes(near, near + 1))
    assert met.value.places == (1,)
    visited.refuse_near(Boxes(near, near + 1))  # it has not become larger since
