"""One game through every client: the same gestures give the same labels, byte for byte."""

import shutil
from dataclasses import dataclass

import numpy as np
import pytest

import accelsurf
from accelsurf import cli
from accelsurf.serve.session import ImageSession
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import read_clicks
from accelsurf.viewer.actions.opening import Opening, ViewerSettings
from accelsurf.viewer.core.opening import OpenedImage
from accelsurf.viewer.core.recent_files import RecentFiles
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.page.page import Page
from tests.support import viewing
from tests.support.steering import views
from tests.viewer.test_strokes import place_of

SHAPE, SPACING = (20, 36, 40), (2.0, 1.0, 1.0)


@dataclass(frozen=True)
class Gesture:
    """A click on a side, or without one the undoing of the last."""

    side: str = ""
    where: str = ""


#: The press in the object, a cut, a stroke, a small cut, that taken back, and a ball at another place.
GAME = (
    Gesture("inside", "ball:14,17,18,3"),
    Gesture("outside", "ball:27,17,18,2"),
    Gesture("inside", "path:24,14,17,1.5;27,13,19,1.5"),
    Gesture("outside", "ball:10,20,20,1"),
    Gesture(),
    Gesture("outside", "ball:14,25,18,2"),
)


@pytest.fixture(scope="module")
def scan():
    """Two touching ellipsoids of one brightness in noise, in slices of 2 mm."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    first = ((x - 14) / 8) ** 2 + ((y - 17) / 9) ** 2 + ((z - 18) / 10) ** 2 < 1
    second = ((x - 27) / 7) ** 2 + ((y - 17) / 6) ** 2 + ((z - 18) / 8) ** 2 < 1
    image = 100.0 * (first | second) + np.random.default_rng(3).normal(0, 8, SHAPE)
    return accelsurf.Volume.from_array(image.astype(np.float32), SPACING)


def by_library(scan, game, folder):
    results = []
    for gesture in game:
        if not gesture.side:
            results.pop()
        elif not results:
            results.append(accelsurf.segment(scan, **{gesture.side: gesture.where}))
        else:
            results.append(accelsurf.refine(results[-1], **{gesture.side: gesture.where}))
        yield results[-1].labels


def by_interaction(scan, game, folder):
    found = accelsurf.Interaction(scan)
    for gesture in game:
        found.add(**{gesture.side: gesture.where}) if gesture.side else found.undo()
        yield found.labels


def by_command_line(scan, game, folder):
    image, out = folder / "scan.nii.gz", folder / "out"
    accelsurf.write(scan, image)
    for gesture in game:
        if not gesture.side:  # a result in a folder is taken back by a copy of it
            shutil.rmtree(out)
            shutil.copytree(folder / "before", out)
        elif not out.exists():
            words = ["segment", image, f"--{gesture.side}", gesture.where, "-o", out]
            assert cli.execute([str(word) for word in (*words, "--progress", "none")]) == 0
        else:
            shutil.rmtree(folder / "before", ignore_errors=True)
            shutil.copytree(out, folder / "before")
            words = ["refine", out, f"--{gesture.side}", gesture.where, "--overwrite"]
            assert cli.execute([str(word) for word in (*words, "--progress", "none")]) == 0
        yield accelsurf.read_labels(out / "scan_seg.nii.gz").array


def by_server(scan, game, folder):
    """Prompts of voxels, as a viewer sends the stroke of a brush."""
    session, shown = ImageSession(scan.array[None], SPACING), np.zeros(SHAPE, np.uint8)
    for gesture in game:
        if gesture.side:
            (click,) = read_clicks([gesture.where], gesture.side, scan)
            mask = np.zeros(SHAPE, np.uint8)
            mask[click.box] = click.mask
            session.scribble(mask, None, gesture.side)
        else:
            session.undo()
        answer = session.answer()
        if answer is not None:
            shown[answer.box] = answer.labels
        yield shown


def by_window(scan, game, folder):
    """The session of window and page; a press begins a run, which plays to its end."""
    with Session(scan, RunConfig()) as session:
        for gesture in game:
            done = (
                session.add_click(gesture.side, gesture.where) if gesture.side else session.undo()
            )
            done.result(60)
            assert session.wait(60)
            session.save(folder, ("labels",), overwrite=True).result(60)
            yield accelsurf.read_labels(folder / f"{session.name}_seg.nii.gz").array


CLIENTS = (by_library, by_interaction, by_command_line, by_server, by_window)


@pytest.fixture(scope="module")
def played(scan):
    return [labels.copy() for labels in by_interaction(scan, GAME, None)]


@pytest.mark.parametrize("client", CLIENTS)
def test_a_game_gives_the_same_labels_in_every_client(client, scan, played, tmp_path):
    for number, labels in enumerate(client(scan, GAME, tmp_path)):
        assert np.array_equal(labels > 0, played[number] > 0), f"gesture {number}"
    # Each gesture shows: none of the game leaves the labels as they are.
    assert all(not np.array_equal(a, b) for a, b in zip(played, played[1:], strict=False))


@pytest.mark.filterwarnings("ignore::pydantic.PydanticDeprecatedSince20")  # napari's own
def test_a_plug_in_of_napari_plays_the_same_game(scan, played):
    widget = pytest.importorskip("accelsurf.napari.widget", reason="napari is not installed")
    target = widget.Target(np.zeros(SHAPE, np.uint8), 1, False)
    object, found = widget.begun(scan, target), []
    for gesture in GAME:
        if gesture.side and not gesture.where.startswith("ball:"):
            break  # the plug-in has no strokes
        x, y, z, radius = (float(v) for v in gesture.where.partition(":")[2].split(","))
        place = np.array([z, y, x]) / SPACING
        press = widget.Press(gesture.side, place, radius)
        object = widget.answer(scan, target, object, press)
        found.append(widget.painted(target, object))
    assert len(found) == 2
    for number, labels in enumerate(found):
        assert np.array_equal(labels > 0, played[number] > 0), f"gesture {number}"


def test_the_page_plays_its_clicks_as_the_library_does(scan, tmp_path):
    """By the messages of its pointer, without a browser; a place in a picture is a click of its own."""
    trame = pytest.importorskip("trame.app", reason="the extra viewer is not installed")
    viewing.needs_graphics()
    opening, folder = Opening(RunConfig(), RecentFiles(None)), tmp_path / "saved"
    page = Page(opening, ViewerSettings(folder), tmp_path)
    page.open(OpenedImage(scan, RunConfig(), "scan"))
    messages = trame.get_server(f"accelsurf-{page.token[:8]}").controller.trigger_fn
    ask = messages("ask")
    session, object = page.actions.session, accelsurf.Interaction(scan)

    def show_when_idle():
        assert session.wait(60)
        for view in views(session):
            page.actions.update(view)
        page.actions.collect_results()
        page.actions.scene.render()
        assert not page.actions.message and not session.status.failed

    try:
        messages("shown")(960, 544, 1)
        show_when_idle()
        for number, gesture in enumerate(GAME):
            if gesture.side:
                kind, _, text = gesture.where.partition(":")
                places = [[float(part) for part in one.split(",")] for one in text.split(";")]
                ask("cursor", *places[0][:3])
                ask("radius", places[0][3])
                ask("tool", gesture.side)
                show_when_idle()
                ask("press", *place_of(page.actions, "axial", places[0][:3]))
                for place in places[1:]:
                    ask("move", *place_of(page.actions, "axial", place[:3]))
                ask("release")
            else:
                ask("undo")
            show_when_idle()
            status = session.status
            last = status.refinements[-1] if status.refinements else status.settings
            if gesture.side:
                (where,) = getattr(last, gesture.side)
                assert where.startswith(kind)
                object.add(**{gesture.side: where})
            else:
                object.undo()
            ask("save")
            show_when_idle()
            shown = accelsurf.read_labels(folder / "scan_seg.nii.gz").array
            assert np.array_equal(shown, object.labels), f"gesture {number}"
            assert shown.any()
    finally:
        page.close()


@pytest.mark.parametrize("steps", [1, 4, 9])
def test_a_click_on_a_surface_that_moves_ends_the_run_and_corrects_it(scan, steps, tmp_path):
    config = RunConfig(start="ball:14,17,18,3", energy="chan-vese", levels=1)
    with Session(scan, config) as session:
        session.play(steps).result(60)
        assert session.wait(60)
        session.add_click("outside", "ball:14,17,18,1").result(60)
        assert session.wait(60)
        status = session.status
        assert status.step == steps and status.stop is not None and len(status.refinements) == 1
        session.save(tmp_path, ("labels", "run"), overwrite=True).result(60)
        shown = accelsurf.read_labels(tmp_path / f"{session.name}_seg.nii.gz").array
        session.undo().result(60)
        assert session.wait(60) and not session.status.refinements
        session.single_step().result(60)  # it goes on from the surface that the click has changed
        assert session.wait(60) and session.status.stop is None and session.status.step == steps + 1
    (settings,) = tmp_path.glob("*.toml")
    again = accelsurf.segment(scan, config=RunConfig.from_toml(settings))
    assert np.array_equal(again.labels, shown)


def test_a_refused_click_on_a_surface_that_moves_changes_nothing(scan):
    config = RunConfig(start="ball:14,17,18,3", energy="chan-vese", levels=1)
    with Session(scan, config) as session:
        session.play(9).result(60)
        assert session.wait(60)
        session.go_to(4).result(60)
        assert session.wait(60)
        before = session.status
        with pytest.raises(accelsurf.InputError):
            session.add_click("outside", "ball:900,17,18,1").result(60)
        after = session.status
        assert (after.step, after.stop, after.refinements) == (4, None, ())
        assert after.checkpoints == before.checkpoints and max(after.checkpoints) == 9
        assert after.undoable == before.undoable
        session.go_to(9).result(60)
        assert session.wait(60) and session.status.step == 9


def test_a_correction_that_a_click_on_a_moving_surface_cannot_make_again_is_said(scan):
    wanted = ["inside=ball:14,17,18,1", "outside=ball:14,25,18,2 object=7"]
    config = RunConfig(start="ball:14,17,18,3", energy="chan-vese", levels=1, refine=wanted)
    with Session(scan, config) as session:
        session.play(4).result(60)
        assert session.wait(60) and session.status.stop is None
        session.add_click("outside", "ball:27,17,18,2").result(60)
        status = session.status
        assert "outside: ball:27,17,18,2: " in status.message
        assert "; correction 2 of 2 cannot be made again: " in status.message
        assert [len(each.outside) for each in status.refinements] == [0, 1]
