"""What a person meets first: what to do, nothing unasked for, what is known of a result, going on with one."""

import json
import time

import numpy as np
import pytest

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.opening import Opening
from accelsurf.viewer.core.opening import ImageToOpen, ServedFolder, finished_run
from accelsurf.viewer.core.recent_files import Hints, RecentFiles
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing


def two_balls():
    """Two bright balls in noise; voxels are mm, (x, y, z) of their middles are (14, 18, 12) and (40, 18, 12)."""
    z, y, x = np.indices((24, 36, 54))
    inside = (z - 12) ** 2 + (y - 18) ** 2 + np.minimum(abs(x - 14), abs(x - 40)) ** 2 < 8**2
    return Volume.from_array(
        (100.0 * inside + np.random.default_rng(0).normal(0, 5, inside.shape)).astype(np.float32)
    )


@pytest.fixture(scope="module")
def actions(tmp_path_factory):
    viewing.needs_graphics()
    volume = two_balls()
    scene = Scene(volume, size=(640, 360))
    with Session(volume, RunConfig(threads=1), name="balls") as session:
        session.ready.result(60)
        made = Actions(session, scene, tmp_path_factory.mktemp("out"))
        made.request("size", 640, 360)
        viewing.wait_until_idle(made)
        yield made
    scene.close()


def begun(actions):
    """What of an object is there: to be drawn, run, saved, named."""
    state = actions.state()
    return (
        state["has_begun"],
        state["can_run"],
        bool(actions.scene.frame.surfaces),
        bool(state["result"]),
    )


def test_nothing_is_there_before_it_is_asked_for(actions):
    assert begun(actions) == (False,) * 4 and actions.state()["tool"] == "size"
    assert not actions.scene.tiles.shows_space
    assert [row["word"] for row in actions.state()["object_rows"]] == ["not begun"]
    for name, values in (
        ("toggle", ()),
        ("step", ()),
        ("save", ()),
        ("set", ("preset", "mr-brain")),
    ):
        actions.request(name, *values)
        viewing.wait_until_idle(actions)
        assert begun(actions) == (False,) * 4, name
        assert ("there is no object yet" in actions.state()["message"]) == (name != "set"), (
            actions.state()["message"]
        )
    assert not list(actions.folder.iterdir())
    with pytest.raises(Exception, match="there is no object yet"):
        actions.session.add_click("outside", "point:14,18,12").result(60)
    actions.request("undo")  # the preset
    viewing.wait_until_idle(actions)


def test_the_first_click_inside_begins_what_can_be_run_judged_and_undone(actions):
    actions.session.add_click("inside", "ball:14,18,12,2").result(60)
    viewing.wait_until_idle(actions)
    assert begun(actions) == (True,) * 4 and actions.scene.tiles.shows_space
    status = actions.session.status
    assert status.settings.start == ("clicks",) and status.stop is not None
    assert actions.scene.frame.volume_mm3 == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.15)
    for _ in range(400):
        if actions.session.status.likelihoods:
            break
        actions.session.wait(1)
        viewing.time.sleep(0.02)
    volume, interval, likely, *uncertain_lines = actions.state()["result"]
    assert volume.startswith("volume ") and volume.endswith(" ml") and interval.startswith("95 %: ")
    assert likely.endswith("% likely to be good")
    assert likely == actions.session.status.likelihoods[1]
    assert [line.startswith("most doubtful at ") for line in uncertain_lines] == [True] * bool(
        actions.session.status.uncertain
    )
    actions.request("undo")
    viewing.wait_until_idle(actions)
    assert begun(actions) == (False,) * 4


def test_a_start_that_was_asked_for_is_there_at_once():
    for given in ({"start": "center"}, {"start": "ball:14,18,12,4"}, {"inside": "ball:14,18,12,2"}):
        with Session(two_balls(), RunConfig(threads=1, **given)) as session:
            session.ready.result(60)
            assert session.status.has_begun and session.status.word == "paused"


def test_hints_are_shown_until_they_are_not_wanted(tmp_path):
    file = tmp_path / "state" / "recent.json"
    hints = RecentFiles(file).hints
    assert hints.lines == list(Hints.TEXTS) and not RecentFiles(None).hints.lines
    hints.turn_off()
    assert hints.lines == [] == RecentFiles(file).hints.lines and not file.exists()


def test_the_mesh_is_saved_as_it_is_chosen(actions):
    actions.request("mesh", "obj<script>")
    assert "was given" in actions.message and actions.state()["mesh"] == "ply"
    actions.request("mesh", "stl")
    actions.session.add_click("inside", "ball:14,18,12,2").result(60)
    viewing.wait_until_idle(actions)
    actions.request("save")
    viewing.wait_until_idle(actions)
    assert (actions.folder / "balls_surface.stl").is_file() and not list(
        actions.folder.glob("*.ply")
    )
    config = RunConfig.from_toml(actions.folder / "balls_run.toml")
    assert config.mesh == ("stl",) and actions.state()["mesh"] == "stl"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """An image, and the folder of the result of a click in it."""
    folder = tmp_path_factory.mktemp("finished")
    io.write(two_balls(), folder / "balls.nii.gz")
    words = [
        "segment",
        str(folder / "balls.nii.gz"),
        "--inside",
        "ball:14,18,12,2",
        "-o",
        str(folder / "out"),
    ]
    assert execute([*words, "--quiet", "--threads", "1"]) == 0
    return folder


def test_a_finished_run_goes_on(result, tmp_path):
    given, config = finished_run(result / "out")
    image = given.path
    assert image == result / "balls.nii.gz" and finished_run(
        result / "out" / "balls_report.json"
    ) == (given, config)
    with Session(io.read(image), config, name="balls", source=image) as session:
        session.play().result(60)
        assert session.wait(120)
        session.save(tmp_path).result(60)
        same = "balls_seg.nii.gz"
        assert (
            io.read_labels(tmp_path / same).array.tobytes()
            == io.read_labels(result / "out" / same).array.tobytes()
        )
        session.add_click("inside", "ball:40,18,12,2").result(60)
        assert len(session.status.refinements) == 1


def opened_by(opening, name):
    """What an opener reads by a name; None where it says why not."""
    opening.request("open", str(name))
    end = time.monotonic() + 60
    found = None
    while found is None and opening.is_busy and time.monotonic() < end:
        time.sleep(0.01)
        found = opening.fetch()
    return found


@pytest.mark.parametrize("name", ["out", "out/balls_report.json"])
def test_a_result_opens_in_the_window_and_never_in_a_page(result, name):
    """Settings of a window are of another image; a result names files that a page may not read."""
    window = Opening(RunConfig(smoothness=3.0, roi="0:9,0:9,0:9"), RecentFiles(None))
    opened = opened_by(window, result / name)
    given, config = finished_run(result / name)
    assert opened.is_result and opened.source == given.path == result / "balls.nii.gz"
    assert opened.config == config
    with opened.session(begin=False) as session:
        assert session.origin == "saved"
    page = Opening(RunConfig(), RecentFiles(None), ServedFolder(result))
    alone = opened_by(page, name)  # a folder with one picture is an image of one slice
    assert page.failed if alone is None else not alone.is_result
    for opening in (window, page):
        opening.close()


def test_what_is_no_finished_run_is_an_image_or_one_line(result, tmp_path):
    assert finished_run(tmp_path) is None and finished_run(result / "balls.nii.gz") is None
    report = json.loads((result / "out" / "balls_report.json").read_text())
    for change, said in (
        (
            {"input": {"path": str(tmp_path / "gone.nii"), "sha256": "0"}},
            "is not there",
        ),
        ({"input": None}, "names no image"),
    ):
        (tmp_path / "a_report.json").write_text(json.dumps(report | change))
        with pytest.raises(InputError, match=said):
            finished_run(tmp_path)
    (tmp_path / "a_report.json").write_text(
        json.dumps(report | {"input": {**report["input"], "voxels_sha256": "0" * 64}})
    )
    given, config = finished_run(tmp_path)
    with pytest.raises(InputError, match="another image than that of the run.*voxels differ"):
        ImageToOpen(given.path, config, None, None, TrackConfig(), given).start_reading()()
    (tmp_path / "b_report.json").write_text(json.dumps(report))
    with pytest.raises(InputError, match="several results"):
        finished_run(tmp_path)
