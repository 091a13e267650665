"""Frame: the box around the band, its place in the image, what the surface is coloured by; it changes nothing."""

import numpy as np
import pytest

from accelsurf import Volume
from accelsurf.evolution.records import StepFields
from accelsurf.grid import pyramid
from accelsurf.levelset import LevelSet
from accelsurf.output import tables
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame, ObjectState


def ball_volume(n=40, radius=11.0, spacing=(2.0, 1.0, 1.0), center=(19.0, 18.0, 21.0)):
    z, y, x = np.indices((n // 2, n, n)).astype(float)
    z, y, x = z * spacing[0], y * spacing[1], x * spacing[2]
    inside = (z - center[0]) ** 2 + (y - center[1]) ** 2 + (x - center[2]) ** 2 < radius**2
    return Volume.from_array(inside.astype(np.float32), spacing, origin=(5.0, -3.0, 7.0))


def frames_of(volume, **options):
    run = Run(
        volume, RunConfig(**{"start": "ball:24,17,26,6", "threads": 1, "max_steps": 12, **options})
    )
    with run:
        for step in run:
            (surface,) = Frame.of_run(run).surfaces
            yield step, surface


def test_psi_of_the_frame_is_psi_of_the_surface():
    for step, surface in frames_of(ball_volume(), levels=1):
        z, y, x = surface.offset
        nz, ny, nx = surface.psi.shape
        assert np.array_equal(surface.psi, step.surface.psi[z : z + nz, y : y + ny, x : x + nx])
        # The inside lies in the box, wherever the band is.
        assert (surface.psi < 0).sum() == step.surface.labels.sum()
        assert surface.record is step.record


def test_a_frame_is_a_copy():
    frames = []
    for _, surface in frames_of(ball_volume(), levels=1):
        frames.append(
            (
                surface,
                surface.psi.copy(),
                {k: q.values.copy() for k, q in surface.quantities.items()},
            )
        )
    assert len(frames) > 5
    for surface, psi, values in frames:
        assert np.array_equal(surface.psi, psi)
        assert all(
            np.array_equal(surface.quantities[key].values, value) for key, value in values.items()
        )
    first, last = frames[0][1], frames[-1][1]
    assert not np.array_equal(first.shape, last.shape) or not np.array_equal(first, last)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("flow", ["constant-density", "flowable-mass", "gradient", "sobolev"])
def test_making_frames_changes_nothing(flow):
    volume = ball_volume()
    options = {"start": "ball:24,17,26,6", "threads": 1, "max_steps": 12, "flow": flow}
    run = Run(volume, RunConfig(**options))
    with run:
        for _ in run:
            pass
    watched = list(frames_of(volume, flow=flow))
    psi = watched[-1][0].surface.psi
    assert np.array_equal(run.objects[0].surface.psi, psi)

    def trace(history):
        return tables.trace_csv([record._replace(seconds=0.0) for record in history])

    assert trace(run.history) == trace([step.record for step, _ in watched])


def test_coarse_frames_lie_where_the_image_is():
    volume = ball_volume(n=96, radius=28.0, center=(48.0, 46.0, 50.0), spacing=(2.0, 1.0, 1.0))
    levels = set()
    for step, surface in frames_of(volume, levels=2, start="ball:55,43,55,24", max_steps=40):
        levels.add(surface.record.level)
        assert surface.level.shape == step.surface.shape == surface.shape
        middle = np.average(np.argwhere(surface.psi < 0), axis=0)
        world = volume.geometry.index_to_world(surface.to_image(middle))
        assert np.allclose(surface.from_image(surface.to_image(middle)), middle)
        assert (
            np.linalg.norm(world - (55, 43, 55)) < 3.0
        )  # truth and start have their middles near there
    assert levels == {0, 1}


def test_signs_say_grow_and_shrink():
    """Inside the object a small ball must grow: outward speed and force above 0 on the surface."""
    surface = [surface for _, surface in frames_of(ball_volume(), levels=1, max_steps=3)][1]
    near = np.argwhere(np.abs(surface.psi) < 0.4)
    for name in ("speed", "force"):
        assert np.median(surface.sample(name, near)) > 0


def test_samples_are_linear_between_cells():
    step, surface = list(frames_of(ball_volume(), levels=1))[-3]
    cells, values = surface.quantities["speed"]
    slot = np.flatnonzero(np.diff(cells) == 1)[50]
    first = np.array(np.unravel_index(cells[slot], surface.shape)) - surface.offset
    for share in (0.0, 0.25, 1.0):
        wanted = (1 - share) * values[slot] + share * values[slot + 1]
        assert surface.sample("speed", [first + (0, 0, share)])[0] == pytest.approx(
            wanted, rel=1e-4
        )
    assert (
        surface.sample("speed", [-np.array(surface.offset)])[0] == 0.0
    )  # the volume's corner is in no band


def test_density_is_of_flowable_mass_only():
    volume = ball_volume()
    names = {
        flow: set(list(frames_of(volume, flow=flow))[-1][1].quantities)
        for flow in ("flowable-mass", "gradient")
    }
    assert names == {"flowable-mass": {"speed", "force", "density"}, "gradient": {"speed", "force"}}


def test_max_voxels_bounds_the_copy():
    run = Run(ball_volume(), RunConfig(start="ball:24,17,26,6", threads=1, max_steps=1))
    for _ in run:
        (whole,), (small,) = Frame.of_run(run).surfaces, Frame.of_run(run, max_voxels=1000).surfaces
        assert small.psi.size <= 1000 < whole.psi.size
        assert np.array_equal(
            small.psi, whole.psi[:: small.stride, :: small.stride, :: small.stride]
        )
        places = np.argwhere(small.psi < 0)
        assert np.allclose(small.to_image(places), whole.to_image(places * small.stride))


def test_no_surface_is_a_frame_too():
    z, y, x = np.indices((20, 20, 20)) - 10.0
    volume = Volume.from_array(np.where(z**2 + y**2 + x**2 < 16, 0.0, 1.0) + 0.0 * x)
    *_, (step, surface) = frames_of(
        volume, start="ball:10,10,10,3", smoothness=20, max_steps=200, levels=1
    )
    assert step.surface.size == 0 and not surface.has_surface and surface.psi.shape == (0, 0, 0)


def test_objects_in_boxes_lie_where_they_lie_in_the_whole_image():
    """A surface on a grid of its own is drawn, sampled and counted as the same surface on the whole grid."""
    volume = ball_volume()
    run = Run(volume, RunConfig(start="ball:24,17,26,6", threads=1, max_steps=4, levels=1))
    *_, step = run
    run.close()
    whole, fields, corner = step.surface, step.fields, (3, 4, 5)
    psi = np.ascontiguousarray(whole.psi[3:18, 4:36, 5:38])
    boxed = LevelSet(psi, volume.geometry.spacing, half_width=whole.requested_half_width)

    def to_box(cells):
        index = np.array(np.unravel_index(cells, whole.shape)).T - corner
        return np.ravel_multi_index(index.T, boxed.shape)

    inside = all_inside(fields.cells, whole.shape, corner, boxed.shape)
    own = StepFields(to_box(fields.cells[inside]), fields.force[inside], fields.speed[inside])
    objects = [
        ObjectState(1, step.record, whole, (0, 0, 0), fields),
        ObjectState(2, step.record, boxed, corner, own),
    ]
    frame = Frame.of(objects, pyramid.levels(volume.geometry.shape, volume.geometry.spacing, 1)[0])
    first, second = frame.surfaces
    assert [surface.id for surface in frame.surfaces] == [1, 2] and second.shape == psi.shape
    assert np.allclose(first.middle(), second.middle())
    labels = volume.array > 0
    assert first.overlap(labels) == second.overlap(labels)
    common, voxels = first.overlap(labels)
    assert frame.dice(labels, int(labels.sum())) == pytest.approx(
        4 * common / (2 * voxels + labels.sum())
    )
    near = np.argwhere(np.abs(first.psi) < 0.4)
    there = second.from_image(first.to_image(near))
    values = first.sample("speed", near)
    assert np.abs(values).max() > 0 and np.array_equal(second.sample("speed", there), values)


def all_inside(cells, shape, corner, box):
    """Which cells of a grid lie in a box of it."""
    index = np.array(np.unravel_index(cells, shape)).T - corner
    return ((index >= 0) & (index < box)).all(axis=1)
