"""A sequence in the viewer: frames, tracked objects in them, and what stays with the run."""

import time

import numpy as np
import pytest

from accelsurf.errors import InputError
from accelsurf.settings.run_config import RunConfig
from accelsurf.track.output.files import TrackFiles
from accelsurf.track.output.outputs import TrackOutputs
from accelsurf.track.output.surfaces import SavedTracks
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.frames import FramesFeature
from accelsurf.viewer.core.sequence_view import MAX_FRAMES, SequenceView
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.shapes import dashed
from tests.support import viewing
from tests.support.trackings import dividing_cells, flat_cells


def saved(folder, made, also=("surfaces",)):
    with TrackOutputs(folder, "cells", made.sequence, TrackFiles(also=also)) as outputs:
        for result in made.results:
            outputs.add(result)
        outputs.finish(made.lineage)
    return SavedTracks(folder, "cells", made.sequence)


@pytest.fixture(scope="module")
def made():
    return dividing_cells()


@pytest.fixture(scope="module")
def tracks(made, tmp_path_factory):
    return saved(tmp_path_factory.mktemp("tracks"), made)


@pytest.fixture(params=[True, False], ids=["tracks", "alone"])
def actions(request, made, tracks):
    viewing.needs_graphics()
    view = SequenceView(made.sequence, 0, tracks if request.param else None)
    scene = Scene(made.sequence.frame(0), size=(640, 360))
    with Session(
        made.sequence.frame(0), RunConfig(threads=1, max_steps=2), name="cells"
    ) as session:
        session.ready.result(60)
        yield Actions(session, scene, frames=view)
    scene.close()


# -- files ------------------------------------------------------------------------------------------------------------


def test_surfaces_and_predictions_come_back_as_they_were_tracked(made, tracks):
    assert tracks.has_predictions
    predicted = 0
    for result in made.results:
        found = tracks.drawn(result.frame)
        assert [one.id for one in found] == [one.id for one in result.objects]
        for one, true in zip(found, result.objects, strict=True):
            assert ((one.surface.psi < 0) == (true.surface.psi < 0)).all()
            assert (one.predicted is None) == (true.predicted is None)
            predicted += true.predicted is not None
            path = tracks.paths(result.frame)[one.id]
            assert path[-1] == pytest.approx(true.centroid, abs=1e-4)
    assert predicted


def test_surfaces_are_the_same_bytes_again(made, tmp_path):
    for name in ("a", "b"):
        saved(tmp_path / name, made)
    for path in sorted((tmp_path / "a" / "cells_surfaces").iterdir()):
        assert path.read_bytes() == (tmp_path / "b" / "cells_surfaces" / path.name).read_bytes()


@pytest.mark.parametrize("per_frame", [True, False])
def test_without_surfaces_the_label_maps_are_drawn(made, tmp_path, per_frame):
    with TrackOutputs(tmp_path, "cells", made.sequence, TrackFiles(per_frame=per_frame)) as outputs:
        for result in made.results:
            outputs.add(result)
        outputs.finish(made.lineage)
    found = SavedTracks(tmp_path, "cells", made.sequence)
    assert not found.has_predictions
    result = made.results[-1]
    for one in found.drawn(result.frame):
        true = result.labels() == one.id
        inside = np.zeros(true.shape, bool)
        inside[one.surface.box] = one.surface.psi < 0
        assert true.any() and (inside == true).all()


def test_what_is_no_tracking_of_this_sequence_is_refused(made, tracks, tmp_path):
    with pytest.raises(InputError, match=r"cells_tracks.csv: there is no such file"):
        SavedTracks(tmp_path, "cells", made.sequence)
    saved(tmp_path, made)
    with pytest.raises(InputError, match="of another sequence"):
        SavedTracks(tmp_path, "cells", flat_cells().sequence)


# -- frames -----------------------------------------------------------------------------------------------------------


def test_three_frames_stay_in_memory(made, monkeypatch):
    """The last of those that were asked for; another one is read again."""
    read, frame = [], type(made.sequence).frame

    def counted(sequence, number):
        read.append(number)
        return frame(sequence, number)

    monkeypatch.setattr(type(made.sequence), "frame", counted)
    view = SequenceView(made.sequence)
    numbers = list(range(len(view)))
    assert len(numbers) > MAX_FRAMES
    for number in (*numbers, *numbers[-MAX_FRAMES:]):
        view.volume(number)
    assert read == numbers
    view.volume(0)
    assert read == [*numbers, 0]


def test_every_second_dash_of_a_circle_stays():
    turn = np.linspace(0, 2 * np.pi, 4801)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    lines = np.stack([ring[:-1], ring[1:]], axis=1)
    assert 0.45 < len(dashed(lines)) / len(lines) < 0.55
    assert len(dashed(lines[:0])) == 0


def test_keys_slider_and_play_move_over_the_frames(actions, made):
    count = len(made.sequence)
    assert actions.state()["frames"] == count and actions.state()["frame"] == 0
    actions.request("key", ".")
    assert actions.state()["frame"] == 1
    assert (actions.scene.volume.array == made.sequence.frame(1).array).all()
    shown = actions.scene.slice_tiles["axial"]
    assert (shown.image == made.sequence.frame(1).array).all()
    actions.request("frame", count - 1)
    actions.request("key", ".")
    assert actions.state()["frame"] == count - 1 and not actions.message
    actions.request("key", ",")
    assert actions.state()["frame"] == count - 2
    actions.request("frame", count)
    assert actions.message and actions.state()["frame"] == count - 2
    actions.request("key", "X")
    actions.collect_results()
    assert actions.state()["frame"] == count - 1 and actions.state()["frames_play"]
    actions.request("key", "X")
    assert not actions.state()["frames_play"]


def test_tracked_objects_keep_their_colour_and_predictions_are_drawn(actions, made, tracks):
    if actions.frames.tracks is None:
        pytest.skip("without tracks")
    colors = {}
    for number in range(len(made.sequence)):
        actions.request("frame", number)
        frame = actions.scene.frame
        assert [one.id for one in frame.surfaces] == [one.id for one in tracks.drawn(number)]
        assert len(frame.predicted) == sum(
            one.predicted is not None for one in tracks.drawn(number)
        )
        for one, style in zip(frame.surfaces, actions.scene.styles.of(frame), strict=True):
            assert colors.setdefault(one.id, style.color) == style.color
        assert f"frame {number} of" in actions.scene.space.title.text
    assert len(set(colors.values())) == len(colors) > 1
    actions.request("frame", 1)
    actions.scene.cursor = tracks.paths(1)[actions.scene.frame.surfaces[0].id][-1]
    with_both = actions.scene.screenshot()
    for tile in actions.scene.slice_tiles.values():
        tile.lines["predicted"][0].SetVisibility(False)
    actions.scene.tiles.redraw.mark_all()
    assert (actions.scene.screenshot() != with_both).any()


def test_the_run_is_steered_in_its_frame_alone(actions):
    actions.request("key", ".")
    for name in ("play", "step", "undo", "save"):
        actions.request(name)
        assert name in actions.message
    assert actions.session.status.step == 0
    actions.request("tool", "ball")
    actions.scene.tiles.lay_out("single", "axial")
    actions.scene.screenshot()
    actions.message = ""
    actions.request("press", 0.5, 0.5)
    assert actions.message
    actions.request("release")
    assert actions.session.status.undoable == 0


def test_the_run_is_drawn_again_in_its_frame(actions):
    view = None
    while view is None:
        view = actions.session.next_view()
    actions.request("frame", 1)
    actions.update(view)
    assert actions.scene.frame is not view.frame
    actions.request("frame", 0)
    assert (actions.scene.frame is view.frame) == (actions.frames.tracks is None)


def test_a_place_is_copied_as_a_correction(actions):
    actions.request("frame", 2)
    actions.request("key", "/")
    words = actions.state()["copied"][1]
    assert words.startswith('--correct "frame=2 inside=point:') and words.count(",") == 2


def test_a_frame_that_was_read_is_shown_quickly(actions):
    for number in (1, 2):
        actions.request("frame", number)
        actions.scene.screenshot()
    began = time.perf_counter()
    actions.request("frame", 1)
    assert time.perf_counter() - began < 2.0  # a bound for any machine; the record has the figures


def test_an_image_without_time_has_no_frames():
    viewing.needs_graphics()
    volume, _ = viewing.ball_image()
    scene = Scene(volume, size=(320, 180))
    with Session(volume, RunConfig(threads=1, max_steps=1)) as session:
        session.ready.result(60)
        made = Actions(session, scene)
        assert (
            made.state()["frames"] == 0
            and "," not in made.keys
            and made.feature(FramesFeature).shows_run
        )
        made.request("frame", 1)
        assert made.message == "frame: the image has no time"
    scene.close()
