"""The client that viewers use, against the server: each kind of prompt gives the labels of the library."""

import gc
import os
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

import accelsurf
from tests.serve.conftest import KEY

pytestmark = pytest.mark.program

remote = pytest.importorskip(
    "nnInteractive.inference.remote", reason="nninteractive-client is not installed"
)


def phantom(name):
    """Image, spacing, truth and a voxel deep in it."""
    if name == SCAN:
        folder = Path(os.environ["ACCELSURF_VOLUMES"])
        image, labels = (
            accelsurf.read(folder / f"fluo_nuclei1136{end}.nii.gz") for end in ("", "_ref")
        )
        truth = labels.array == 26  # one that is whole
        depth = ndimage.distance_transform_edt(truth, sampling=image.geometry.spacing)
        middle = np.unravel_index(int(depth.argmax()), depth.shape)
        return image.as_float32(), image.geometry.spacing, truth, tuple(int(at) for at in middle)
    random, shape, spacing, middles = {
        "thick slices": (1, (20, 44, 40), (2.0, 1.0, 1.0), [(10, 22, 20)]),
        "two that touch": (2, (26, 28, 42), (1.0, 1.0, 1.0), [(13, 14, 13), (13, 14, 29)]),
        "flat along the last axis": (3, (48, 52, 1), (0.5, 0.5, 1.0), [(24, 26, 0)]),
    }[name]
    places = np.indices(shape)
    radius = 9.0 * min(spacing)
    balls = [
        sum(((axis - at) * h) ** 2 for axis, at, h in zip(places, middle, spacing, strict=True))
        < radius**2
        for middle in middles
    ]
    image = 100.0 * np.any(balls, axis=0) + np.random.default_rng(random).normal(0, 8, shape)
    return image.astype(np.float32), spacing, balls[0], middles[0]


#: A client that could not begin leaves its connection to the garbage.
LEFT_OPEN = pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)
#: Noisy nuclei that touch, from the tests of plant-seg.
SCAN = "public scan"
NEEDS_SCAN = pytest.mark.skipif("ACCELSURF_VOLUMES" not in os.environ, reason="needs the scans")
PHANTOMS = ("thick slices", "two that touch", "flat along the last axis")


class Viewer:
    """A viewer: the client, and the labels that it shows."""

    def __init__(self, server, name):
        self.image, self.spacing, self.truth, self.middle = phantom(name)
        self.client = remote.nnInteractiveRemoteInferenceSession(server.address, api_key=KEY)
        self.client.set_image(self.image[np.newaxis], {"spacing": np.array(self.spacing)})
        self.labels = np.zeros(self.image.shape, np.uint8)
        self.client.set_target_buffer(self.labels)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.client.close()

    @property
    def slice_axis(self):
        """Axis across which outlines are drawn."""
        return self.image.shape.index(1) if 1 in self.image.shape else 0

    def in_slice(self, mask):
        """Box and crop of a mask's part in the slice of the middle, as viewers send them."""
        only = np.zeros(mask.shape, bool)
        place = [slice(None)] * 3
        place[self.slice_axis] = slice(
            self.middle[self.slice_axis], self.middle[self.slice_axis] + 1
        )
        only[tuple(place)] = mask[tuple(place)]
        box = [[int(p.min()), int(p.max()) + 1] for p in np.nonzero(only)]
        return box, only[tuple(slice(*side) for side in box)].astype(np.uint8)

    def dice(self):
        both = np.count_nonzero((self.labels > 0) & self.truth)
        return 2 * both / (np.count_nonzero(self.labels) + np.count_nonzero(self.truth))


def library(viewer, masks, together=False):
    """Labels by the library alone: clicks of masks on sides, with the first axis of one place first.

    Each is a gesture of its own, or all are one.
    """
    axes = (2, 0, 1) if viewer.image.shape[2] == 1 else (0, 1, 2)
    spacing = tuple(viewer.spacing[axis] for axis in axes)
    found = accelsurf.Interaction(
        np.ascontiguousarray(viewer.image.transpose(axes)), spacing=spacing
    )
    clicks = []
    for side, mask in masks:
        turned = mask.transpose(axes)
        box = ndimage.find_objects(turned.astype(np.uint8))[0]
        clicks.append(accelsurf.Click(side, box, np.ascontiguousarray(turned[box])))
    for gesture in [clicks] if together else [[click] for click in clicks]:
        sides = [[c for c in gesture if c.side == side] for side in ("inside", "outside")]
        found.add(*sides)
    return found.labels.transpose(np.argsort(axes))


def ball(viewer, middle, radius):
    axes = np.indices(viewer.image.shape)
    apart = sum(((a - m) * h) ** 2 for a, m, h in zip(axes, middle, viewer.spacing, strict=True))
    return apart <= radius**2


def outlined(viewer, box, crop):
    """Masks of an outline: a ball at its deepest place, the rim of two voxels, the rest of the slice."""
    drawn, there = np.zeros(viewer.image.shape, bool), np.zeros(viewer.image.shape, bool)
    drawn[tuple(slice(*side) for side in box)] = crop > 0
    place = [slice(None)] * 3
    place[viewer.slice_axis] = slice(*box[viewer.slice_axis])
    there[tuple(place)] = True
    step = min(h for h, n in zip(viewer.spacing, viewer.image.shape, strict=True) if n > 1)
    wide = np.ones([1 if axis == viewer.slice_axis else 5 for axis in range(3)], bool)
    spacing = [h for axis, h in enumerate(viewer.spacing) if axis != viewer.slice_axis]
    flat = ndimage.distance_transform_edt(
        np.squeeze(drawn[tuple(place)], viewer.slice_axis), sampling=spacing
    )
    deepest = np.argwhere(flat >= flat.max() * (1 - 1e-6))
    nearest = deepest[np.argmin(((deepest - deepest.mean(axis=0)) ** 2).sum(axis=1))]
    middle = np.insert(nearest, viewer.slice_axis, box[viewer.slice_axis][0])
    rim = ndimage.binary_dilation(drawn, wide) & ~drawn & there
    rest = there & ~drawn & ~rim
    inside = ball(viewer, middle, min(0.5 * flat.max(), 7.4 * step))
    return [
        (side, mask)
        for side, mask in (("inside", inside), ("outside", rim), ("outside", rest))
        if mask.any()
    ]


@pytest.mark.parametrize("name", [*PHANTOMS, pytest.param(SCAN, marks=NEEDS_SCAN)])
def test_points(server, name):
    with Viewer(server, name) as viewer:
        viewer.client.add_point_interaction(viewer.middle, True)
        step = min(h for h, n in zip(viewer.spacing, viewer.image.shape, strict=True) if n > 1)
        clicks = [("inside", ball(viewer, viewer.middle, 4.0 * step))]
        assert np.array_equal(viewer.labels, library(viewer, clicks))
        first = viewer.labels.copy()
        other = tuple(int(i) for i in np.argwhere(~viewer.truth)[-1])
        viewer.client.add_point_interaction(other, False)
        depth = ndimage.distance_transform_edt(first == first[other], sampling=viewer.spacing)[
            other
        ]
        clicks.append(("outside", ball(viewer, other, min(0.99 * depth, 4.0 * step))))
        assert np.array_equal(viewer.labels, library(viewer, clicks))
        assert viewer.dice() > 0.6


@pytest.mark.parametrize("name", [*PHANTOMS, pytest.param(SCAN, marks=NEEDS_SCAN)])
@pytest.mark.parametrize("kind", ["bbox", "lasso"])
def test_outlines(server, name, kind):
    with Viewer(server, name) as viewer:
        box, crop = viewer.in_slice(viewer.truth)
        if kind == "bbox":
            viewer.client.add_bbox_interaction([[float(a), float(b)] for a, b in box], True)
            crop = np.ones_like(crop)
        else:
            viewer.client.add_lasso_interaction(crop, True, interaction_bbox=box)
        assert np.array_equal(viewer.labels, library(viewer, outlined(viewer, box, crop), True))
        assert viewer.dice() > 0.7
        around = [slice(None)] * 3
        around[viewer.slice_axis] = slice(*box[viewer.slice_axis])
        here = np.zeros(viewer.image.shape, bool)
        here[tuple(slice(*side) for side in box)] = crop > 0
        assert not viewer.labels[tuple(around)][~here[tuple(around)]].any()


@pytest.mark.parametrize("name", [*PHANTOMS, pytest.param(SCAN, marks=NEEDS_SCAN)])
def test_scribbles(server, name):
    with Viewer(server, name) as viewer:
        box, crop = viewer.in_slice(ball(viewer, viewer.middle, 3.0 * min(viewer.spacing)))
        viewer.client.add_scribble_interaction(crop, True, interaction_bbox=box)
        drawn = np.zeros(viewer.image.shape, np.uint8)
        drawn[tuple(slice(*side) for side in box)] = crop
        assert np.array_equal(viewer.labels, library(viewer, [("inside", drawn > 0)]))
        beyond = np.zeros(viewer.image.shape, np.uint8)
        beyond[tuple(i for i in np.argwhere(~viewer.truth)[0])] = 1
        viewer.client.add_scribble_interaction(beyond, False)  # of the whole image's size
        assert np.array_equal(
            viewer.labels, library(viewer, [("inside", drawn > 0), ("outside", beyond > 0)])
        )


@pytest.mark.parametrize(
    "name", ["thick slices", "flat along the last axis", pytest.param(SCAN, marks=NEEDS_SCAN)]
)
def test_labels_to_begin_at_are_corrected_by_clicks(server, name):
    with Viewer(server, name) as viewer:
        cut = viewer.truth & (np.indices(viewer.image.shape)[1] > viewer.middle[1] - 4)
        viewer.client.add_initial_seg_interaction(cut.astype(np.uint8))
        assert np.array_equal(viewer.labels > 0, cut)
        before = viewer.dice()
        depth = ndimage.distance_transform_edt(viewer.truth & ~cut, sampling=viewer.spacing)
        missed = tuple(int(at) for at in np.unravel_index(int(depth.argmax()), depth.shape))
        viewer.client.add_point_interaction(missed, True)
        assert viewer.dice() > before
        assert viewer.labels[cut].all()
        assert viewer.client.undo()
        assert np.array_equal(viewer.labels > 0, cut)
        assert viewer.client.undo()
        assert not viewer.labels.any()


def test_every_prompt_is_undone_and_a_reset_forgets_all(server):
    with Viewer(server, "two that touch") as viewer:
        shown, random = [], np.random.default_rng(4)
        for number in range(12):
            shown.append(viewer.labels.copy())
            at = random.integers((5, 5, 5), np.array(viewer.image.shape) - 5)
            viewer.client.add_point_interaction(at, bool(viewer.truth[tuple(at)]) or number == 0)
        for before in reversed(shown):
            assert viewer.client.undo()
            assert np.array_equal(viewer.labels, before)
        assert not viewer.client.undo()
        viewer.client.add_point_interaction(viewer.middle, True)
        viewer.client.reset_interactions()
        assert not viewer.labels.any()
        assert not viewer.client.undo()


def test_prompts_wait_for_the_viewer_to_ask(server):
    with Viewer(server, "thick slices") as viewer:
        assert (
            viewer.client.add_point_interaction(viewer.middle, True, run_prediction=False) is None
        )
        assert not viewer.labels.any()
        assert viewer.client._predict() is not None
        assert viewer.dice() > 0.9
        assert viewer.client._predict() is None


def test_capabilities_say_what_there_is(server):
    with Viewer(server, "thick slices") as viewer:
        client = viewer.client
        assert client.ping()
        assert client.license == "BSD-3-Clause"
        client.set_do_autozoom(True)  # viewers ask it whatever is said
        with remote.nnInteractiveRemoteInferenceSession(server.address, api_key=KEY) as another:
            assert not another.do_autozoom
        named = {"points": True, "bbox2d": True, "bbox3d": False, "scribble": True, "lasso": True}
        assert client.supported_interactions == named
        assert client.supports_undo
        assert client.heartbeat() <= client.lease_status()["idle_timeout_seconds"] == 600.0


@LEFT_OPEN
def test_no_more_sessions_than_places_and_a_closed_one_is_free_again(server):
    with ExitStack() as stack:
        viewers = [
            stack.enter_context(Viewer(server, "flat along the last axis")) for _ in range(3)
        ]
        with pytest.raises(remote.ServerAtCapacityError, match="all 3 sessions are taken"):
            Viewer(server, "flat along the last axis")
        viewers.pop().client.close()
        viewers.append(stack.enter_context(Viewer(server, "flat along the last axis")))
        for viewer in viewers:  # sessions know nothing of each other
            viewer.client.add_point_interaction(viewer.middle, True)
            assert viewer.dice() > 0.9
    gc.collect()


def test_a_lease_that_has_ended_is_said_so(server):
    with Viewer(server, "flat along the last axis") as viewer:
        viewer.client._http.post("/release")
        with pytest.raises(remote.SessionExpiredError, match="unknown or has ended"):
            viewer.client.add_point_interaction(viewer.middle, True)


@LEFT_OPEN
def test_without_the_key_nothing_is_told(server):
    with pytest.raises(Exception, match="401"):
        remote.nnInteractiveRemoteInferenceSession(
            server.address, api_key="another key, as long as it"
        )
    gc.collect()
