"""Frame: the box around the band, its place in the image, what the surface is coloured by; it changes nothing."""

import numpy as np
import pytest

from accelsurf import Volume
from accelsurf.report import tables
from accelsurf.segmentation.run import Run
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame


def ball_volume(n=40, radius=11.0, spacing=(2.0, 1.0, 1.0), center=(19.0, 18.0, 21.0)):
    z, y, x = np.indices((n // 2, n, n)).astype(float)
    z, y, x = z * spacing[0], y * spacing[1], x * spacing[2]
    inside = (z - center[0]) ** 2 + (y - center[1]) ** 2 + (x - center[2]) ** 2 < radius**2
    return Volume.from_array(inside.astype(np.float32), spacing, origin=(5.0, -3.0, 7.0))


def frames_of(volume, **options):
    run = Run(volume, RunConfig(**{"start": "ball:24,17,26,6", "threads": 1, "max_steps": 12, **options}))
    with run.workers:
        for step in run.evolution:
            yield step, Frame.of(step, volume.geometry, run.evolution.flow)


def test_psi_of_the_frame_is_psi_of_the_surface():
    for step, frame in frames_of(ball_volume(), levels=1):
        z, y, x = frame.offset
        nz, ny, nx = frame.psi.shape
        assert np.array_equal(frame.psi, step.surface.psi[z : z + nz, y : y + ny, x : x + nx])
        # The inside lies in the box, wherever the band is.
        assert (frame.psi < 0).sum() == step.surface.labels.sum()
        assert frame.row is step.row


def test_a_frame_is_a_copy():
    kept = []
    for _, frame in frames_of(ball_volume(), levels=1):
        kept.append((frame, frame.psi.copy(), {k: q.values.copy() for k, q in frame.quantities.items()}))
    assert len(kept) > 5
    for frame, psi, values in kept:
        assert np.array_equal(frame.psi, psi)
        assert all(np.array_equal(frame.quantities[key].values, value) for key, value in values.items())
    assert not np.array_equal(kept[0][1].shape, kept[-1][1].shape) or not np.array_equal(kept[0][1], kept[-1][1])


@pytest.mark.parametrize("flow", ["constant-density", "flowable-mass", "gradient", "sobolev"])
def test_looking_changes_nothing(flow):
    volume = ball_volume()
    options = {"start": "ball:24,17,26,6", "threads": 1, "max_steps": 12, "flow": flow}
    run = Run(volume, RunConfig(**options))
    with run.workers:
        for _ in run.evolution:
            pass
    looked = list(frames_of(volume, flow=flow))
    psi = looked[-1][0].surface.psi
    assert np.array_equal(run.evolution.surface.psi, psi)

    def told(history):
        return tables.trace_csv([row._replace(seconds=0.0) for row in history])

    assert told(run.evolution.history) == told([step.row for step, _ in looked])


def test_coarse_frames_lie_where_the_image_is():
    volume = ball_volume(n=96, radius=28.0, center=(48.0, 46.0, 50.0), spacing=(2.0, 1.0, 1.0))
    levels = set()
    for step, frame in frames_of(volume, levels=2, start="ball:55,43,55,24", max_steps=40):
        levels.add(frame.row.level)
        assert frame.grid.shape == step.surface.shape
        middle = np.average(np.argwhere(frame.psi < 0), axis=0)
        world = volume.geometry.index_to_world(frame.to_image(middle))
        assert np.allclose(frame.from_image(frame.to_image(middle)), middle)
        assert np.linalg.norm(world - (55, 43, 55)) < 3.0  # truth and start have their middles near there
    assert levels == {0, 1}


def test_signs_say_grow_and_shrink():
    """Inside the object a small ball must grow: outward speed and force above 0 on the surface."""
    frame = [frame for _, frame in frames_of(ball_volume(), levels=1, max_steps=3)][1]
    near = np.argwhere(np.abs(frame.psi) < 0.4)
    for name in ("speed", "force"):
        assert np.median(frame.sample(name, near)) > 0


def test_samples_are_linear_between_cells():
    step, frame = list(frames_of(ball_volume(), levels=1))[-3]
    cells, values = frame.quantities["speed"]
    slot = np.flatnonzero(np.diff(cells) == 1)[50]
    first = np.array(np.unravel_index(cells[slot], frame.grid.shape)) - frame.offset
    for share in (0.0, 0.25, 1.0):
        wanted = (1 - share) * values[slot] + share * values[slot + 1]
        assert frame.sample("speed", [first + (0, 0, share)])[0] == pytest.approx(wanted, rel=1e-4)
    assert frame.sample("speed", [-np.array(frame.offset)])[0] == 0.0  # the volume's corner is in no band


def test_density_is_of_flowable_mass_only():
    volume = ball_volume()
    names = {flow: set(list(frames_of(volume, flow=flow))[-1][1].quantities) for flow in ("flowable-mass", "gradient")}
    assert names == {"flowable-mass": {"speed", "force", "density"}, "gradient": {"speed", "force"}}


def test_most_voxels_bounds_the_copy():
    volume = ball_volume()
    for step in Run(volume, RunConfig(start="ball:24,17,26,6", threads=1, max_steps=1)).evolution:
        whole = Frame.of(step, volume.geometry)
        small = Frame.of(step, volume.geometry, most_voxels=1000)
        assert small.psi.size <= 1000 < whole.psi.size
        assert np.array_equal(small.psi, whole.psi[:: small.step, :: small.step, :: small.step])
        places = np.argwhere(small.psi < 0)
        assert np.allclose(small.to_image(places), whole.to_image(places * small.step))


def test_no_surface_is_a_frame_too():
    z, y, x = np.indices((20, 20, 20)) - 10.0
    volume = Volume.from_array(np.where(z**2 + y**2 + x**2 < 16, 0.0, 1.0) + 0.0 * x)
    *_, (step, frame) = frames_of(volume, start="ball:10,10,10,3", smoothness=20, max_steps=200, levels=1)
    assert step.surface.size == 0 and not frame.has_surface and frame.psi.shape == (0, 0, 0)
