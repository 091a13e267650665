"""Press in an object, drag outwards until it fits; clicks that say what is inside and what is not."""

import time

import numpy as np
import pytest

from accelsurf import io
from accelsurf.api.segment import segment
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.size_drag import Dragging, SizeDrag
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.shapes import contour
from tests.support import viewing
from tests.support.viewing import look

SHAPE, SPACING = (20, 36, 40), (2.0, 1.0, 1.0)
#: Wider than the window that a press is read in first.
WIDE = (60, 100, 100)
PRESS, SMALL_PRESS = "ball:18,18,20,3", "ball:18,18,20,1.2"


def scan(noise=4.0, shape=SHAPE):
    """A ball of radius 10 mm at (18, 18, 20) mm in noise."""
    z, y, x = np.indices(shape) * np.array(SPACING)[:, None, None, None]
    own = (x - 18) ** 2 + (y - 18) ** 2 + (z - 20) ** 2 < 100
    image = 100.0 * own + np.random.default_rng(0).normal(0, noise, shape)
    return Volume(image.astype(np.float32), Geometry(shape, SPACING)), own


@pytest.fixture(scope="module")
def pressed():
    volume, own = scan()
    with Session(volume, RunConfig(start=PRESS)) as session:
        yield session.press(PRESS).result(), own


def inside_of(drag, volume_mm3, shape=SHAPE):
    out = np.zeros(shape, bool)
    here = tuple(
        slice(first, first + n)
        for first, n in zip(drag.first[1:], drag.times.shape[1:], strict=True)
    )
    for index in range(shape[0]):
        plane = drag.plane(0, index, volume_mm3)
        if plane is not None:
            out[index][here] = plane < 0
    return out


def test_a_drag_shows_the_object_when_its_size_is_right(pressed):
    drag, own = pressed
    assert drag.click == PRESS
    shown = inside_of(drag, 4 / 3 * np.pi * 1000)
    assert 2 * (shown & own).sum() / (shown.sum() + own.sum()) > 0.95
    for axis in (1, 2):  # the same voxels, in slices across the other axes
        assert np.array_equal(
            drag.plane(axis, 18, 4189.0) < 0, np.take(inside_of(drag, 4189.0), 18, axis=axis)
        )


def test_a_farther_drag_is_a_larger_object_and_the_press_is_in_every_one(pressed):
    drag, _ = pressed
    sizes = [drag.volume_of(mm) for mm in (0.0, 2.0, 5.0, 9.0, 14.0, 1e6)]
    assert sizes == sorted(sizes) and sizes[3] == pytest.approx(4 / 3 * np.pi * 729)
    assert sizes[-1] <= np.prod(SHAPE) * np.prod(SPACING)
    before = np.zeros(SHAPE, bool)
    for size in sizes:
        shown = inside_of(drag, size)
        assert (shown | ~before).all() and shown[10, 18, 18]
        before = shown
    assert int(inside_of(drag, 2000.0).sum()) * 2.0 == pytest.approx(2000.0, rel=0.02)


def test_more_is_computed_when_a_drag_comes_near_the_end_of_what_is_known():
    volume, own = scan(shape=WIDE)
    with Session(volume, RunConfig(start=SMALL_PRESS)) as session:
        dragging = Dragging(session.press, SMALL_PRESS)
        session.wait(60)
        small = dragging.at(3.0)
        end = (0.75 * small.most_mm3 / np.pi) ** (
            1 / 3
        )  # the ball as large as the window has room for
        assert not small.is_near_end(0.5 * end) and small.is_near_end(end)
        assert small.volume_of(1.1 * end) == small.most_mm3
        shown = small.times.copy()
        for _ in range(4):
            found = dragging.at(end)
            session.wait(60)
        assert found.most_mm3 > 1.5 * small.most_mm3 and not found.is_near_end(end)
        assert found.volume_of(1.1 * end) == pytest.approx(1.331 * small.most_mm3, rel=1e-6)
        larger = inside_of(found, 4189.0, WIDE)
        assert 2 * (larger & own).sum() / (larger.sum() + own.sum()) > 0.9
        # What was known before does not change.
        assert np.array_equal(small.times, shown)


def test_releasing_begins_the_run_that_the_same_settings_before_picture(tmp_path):
    volume, own = scan()
    with Session(volume, RunConfig(start="ball:5,5,5,2", max_steps=60, levels=1)) as session:
        drag = session.press(PRESS).result()
        session.release(10.0).result()  # where it fits: the size counts
        settings = session.status.settings
        assert (
            settings.inside == (PRESS,)
            and settings.size == drag.size_text(10.0)
            and settings.energy == "seeded"
        )
        session.play()
        assert session.wait(120)
        session.save(tmp_path, ["run", "labels"]).result()
        session.undo().result()
        assert (
            session.status.settings.start == ("ball:5,5,5,2",)
            and session.status.settings.inside == ()
        )
        with pytest.raises(UsageError, match="nothing was pressed"):
            session.release(10.0).result()
    config = RunConfig.from_toml(next(tmp_path.glob("*.toml")))
    result = segment(volume, config=config)
    assert 2 * (result.labels & own).sum() / (result.labels.sum() + own.sum()) > 0.95
    assert np.array_equal(io.read(next(tmp_path.glob("*_seg.*"))).array, result.labels)


def test_letting_go_plays_the_run_to_its_end_and_is_one_change():
    volume, own = scan()
    with Session(volume, RunConfig(start="ball:5,5,5,2", max_steps=60, levels=1)) as session:
        session.press(PRESS).result()
        session.release(10.0).result()
        assert session.wait(120)
        status = session.status
        assert (
            status.step > 0
            and status.stop is not None
            and len(status.changes) == status.undoable == 1
        )
        inside = look(session, lambda run: run.objects[0].surface.psi < 0).result()
        assert 2 * (inside & own).sum() / (inside.sum() + own.sum()) > 0.95
        session.undo().result()
        assert session.wait(60) and session.status.undoable == session.status.step == 0
        assert (
            session.status.settings.start == ("ball:5,5,5,2",)
            and session.status.settings.inside == ()
        )


def test_a_press_outside_or_of_several_objects_is_refused(tmp_path):
    volume, _ = scan()
    with Session(volume, RunConfig(start=PRESS)) as session:
        with pytest.raises(InputError, match="no voxel centre is inside it"):
            session.press("ball:900,0,0,2").result()
        with pytest.raises(UsageError, match="expected ball"):
            session.press("point:1,2,3").result()
    labels = np.zeros(SHAPE, np.uint8)
    labels[9:12, 15:20, 15:20], labels[9:12, 15:20, 2:5] = 5, 6
    io.write_labels(volume.with_array(labels), tmp_path / "starts.nii.gz")
    config = RunConfig(objects=str(tmp_path / "starts.nii.gz"), levels=1, threads=1)
    with Session(volume, config) as session, pytest.raises(UsageError, match="there are several"):
        session.press(PRESS).result()


def test_a_click_while_it_moves_corrects_the_surface_and_is_marked():
    volume, own = scan()
    with Session(volume, RunConfig(inside=PRESS, levels=1)) as session:
        session.play(5).result()
        assert session.wait(60)
        session.add_click("outside", "ball:18,18,25,3").result()
        (correction,) = session.status.refinements
        assert correction.outside == ("ball:18,18,25,3",) and session.status.step == 5
        session.wait(60)
        session.next_view()
        session.wait(10)
        deadline = time.monotonic() + 10
        while (view := session.next_view()) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        marks = [(mark.side, mark.place[1:]) for mark in view.frame.clicks]
        assert marks == [("inside", (18, 18)), ("outside", (18, 18))]
        (surface,) = view.frame.surfaces
        z, y, x = (int(v) for v in np.rint(surface.from_image([13, 18, 18])))
        assert surface.psi[z, y, x] > 0 and own[13, 18, 18]


def test_a_slice_at_256_cubed_is_shown_within_50_milliseconds():
    n = 256
    axis = (np.arange(n, dtype=np.float32) - 128) ** 2
    squares = axis[:, None, None] + axis[:, None] + axis
    times = np.minimum(np.sqrt(squares) / 60.0, 1.0).astype(np.float32)
    drag = SizeDrag("ball:0,0,0,1", times, (0, 0, 0), 1.0, 1e6)
    took = []
    for mm in np.linspace(10, 58, 12):
        began = time.perf_counter()
        volume = drag.volume_of(float(mm))
        lines = [contour(drag.plane(axis, 128, volume)) for axis in range(3)]
        took.append(time.perf_counter() - began)
        radii = np.linalg.norm(lines[0].reshape(-1, 2) - 128, axis=1)
        assert np.abs(radii - mm).max() < 1.0
    assert np.median(took) < 0.05  # 3 ms on an idle machine


def test_while_a_size_is_dragged_the_slices_alone_are_drawn(pressed):
    viewing.needs_graphics()
    drag, _ = pressed
    scene = Scene(scan()[0], size=(640, 360))
    scene.tiles.smooth_edges(False)
    scene.cursor = (18.0, 18.0, 20.0)
    slices = (
        slice(None),
        slice(320, None),
    )  # the right half, with the chart in one of its quarters
    space = (slice(None), slice(None, 320))
    before = scene.screenshot()
    scene.mark_size(drag, 6.0)
    scene.space.renderer.camera.Azimuth(40)  # would change the picture in 3D, were it drawn
    first = scene.screenshot()
    assert np.array_equal(first[space], before[space]) and not np.array_equal(
        first[slices], before[slices]
    )
    scene.mark_size(drag, 9.0)
    second = scene.screenshot()
    assert np.array_equal(second[space], before[space]) and not np.array_equal(
        second[slices], first[slices]
    )
    scene.tiles.smooth_edges(
        True
    )  # while the button is held: a new picture, in which nothing may be missing
    scene.space.look_from("corner")
    assert (scene.screenshot()[space].std(axis=(0, 1)) > 0).all()
    scene.tiles.smooth_edges(False)
    scene.mark_size(None)
    assert np.array_equal(scene.screenshot(), before)
    scene.space.look_from("front")
    assert not np.array_equal(scene.screenshot()[space], before[space])
    scene.close()
