"""A session of several objects: it runs, goes back, is changed by hand, and what it saves repeats it, byte for byte."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from accelsurf import cli, io, segment_objects
from accelsurf.cli import view
from accelsurf.errors import OutputError, UsageError
from accelsurf.run.run import Run
from accelsurf.settings.corrections import corrections_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.corrected_run import Corrections
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from tests.support import two_balls, viewing
from tests.support.steering import at, labels_of, views


def volume():
    return two_balls.image(two_balls.TOUCHING)


@pytest.fixture
def config(tmp_path):
    """Settings that start each object from a small cube in it."""
    path = tmp_path / "starts.nii.gz"
    io.write_labels(two_balls.starts(two_balls.TOUCHING), path)
    return RunConfig(objects=str(path), threads=1)


@pytest.fixture
def session(config):
    with Session(volume(), config) as made:
        made.ready.result(60)
        yield made


def repeated(toml, image=None):
    """The labels that the saved configuration gives."""
    return segment_objects(image or volume(), config=RunConfig.from_toml(toml)).labels


def test_what_is_saved_repeats_the_steered_run(session, tmp_path):
    assert session.status.objects == (3, 8)
    straight = labels_of(at(session, 12), tmp_path / "a")[0]
    session.go_to(5).result(60)
    assert session.wait(60) and session.status.step == 5
    assert labels_of(at(session, 12), tmp_path / "b")[0] == straight
    session.go_to(6).result(60)
    session.change(smoothness=0.2).result(60)
    at(session, 14)
    session.change(half_width=5).result(60)
    at(session, 17)
    paths = session.save(tmp_path / "saved").result(60)
    assert {
        "surface_run.toml",
        "surface_seg.nii.gz",
        "surface_objects.csv",
        "surface_trace.csv",
        "surface_preview.png",
        "surface_surface_3.ply",
        "surface_surface_8.ply",
        "surface_report.json",
        "surface_statistics.csv",
        "surface_statistics.json",
    } == {path.name for path in paths}
    assert [edit.step for edit in session.status.edits] == [6, 14]
    labels = io.read_labels(tmp_path / "saved/surface_seg.nii.gz").array
    assert set(np.unique(labels)) == {0, 3, 8}
    again = repeated(tmp_path / "saved/surface_run.toml")
    assert again.dtype == labels.dtype and again.tobytes() == labels.tobytes() != straight
    session.undo().result(60)
    assert session.wait(60) and session.status.step == 14 and len(session.status.edits) == 1


def test_files_of_others_are_not_replaced_and_those_of_the_session_are(session, tmp_path):
    other = tmp_path / "surface_surface_5.ply"
    other.write_bytes(b"precious")
    at(session, 2)
    with pytest.raises(OutputError, match="surface_surface_5.ply: exists already"):
        session.save(tmp_path).result(60)
    assert other.read_bytes() == b"precious"
    first = session.save(tmp_path, overwrite=True).result(60)
    assert other.read_bytes() == b"precious"  # no report lists it: it is somebody's
    other.unlink()
    meshes = {path.name: path.read_bytes() for path in first if path.suffix == ".ply"}
    at(session, 6)
    assert session.save(tmp_path).result(60) == first
    assert len(meshes) == 2 and all(
        (tmp_path / name).read_bytes() != old for name, old in meshes.items()
    )


def test_a_run_goes_on_after_it_converged_and_is_repeated(session, tmp_path):
    session.play().result(60)
    assert session.wait(120)
    first = session.status
    assert first.stop.reason == "converged"
    saved, toml = labels_of(session, tmp_path)
    assert repeated(toml).tobytes() == saved
    session.change(smoothness=0.3).result(60)
    at(session, first.step + 6)
    saved, toml = labels_of(session, tmp_path)
    assert repeated(toml).tobytes() == saved
    session.play().result(60)
    assert session.wait(120) and session.status.step > first.step + 6
    saved, toml = labels_of(session, tmp_path)
    assert repeated(toml).tobytes() == saved


def test_an_object_that_stood_still_while_others_moved_is_repeated_too(tmp_path):
    """The saved number of steps is that of the run, not of an object that has made fewer."""
    image, path = two_balls.image(two_balls.UNEQUAL), tmp_path / "starts.nii.gz"
    io.write_labels(two_balls.starts(two_balls.UNEQUAL), path)
    with Session(image, RunConfig(objects=str(path), threads=1)) as session:
        session.play().result(60)
        assert session.wait(120) and session.status.stop.reason == "converged"
        session.change(smoothness=0.3).result(60)
        at(session, session.status.step + 6)
        small, large = views(session)[-1].histories
        assert len(small) < len(large) - 5
        saved, toml = labels_of(session, tmp_path)
        assert repeated(toml, image).tobytes() == saved


def test_a_session_on_two_levels_is_repeated(config, tmp_path):
    with Session(volume(), config.replace(levels=2)) as two:
        two.play().result(60)
        assert two.wait(120) and two.status.stop.reason == "converged"
        end, straight = two.status.step, labels_of(two, tmp_path)
        assert repeated(straight[1]).tobytes() == straight[0]
        two.go_to(3).result(60)
        assert two.wait(60) and two.status.step == 3
        seen = views(two)[-1].frame
        assert seen.level == 1 and [surface.level.number for surface in seen.surfaces] == [1, 1]
        two.play(end).result(60)
        assert two.wait(120) and labels_of(two, tmp_path)[0] == straight[0]


@pytest.mark.parametrize("levels", [1, 2])
def test_a_click_without_an_object_is_for_the_nearest(config, levels):
    """Of surfaces that move, also on a coarse level, and of corrected ones."""
    places = [(f"ball:{x},{y},{z},2", id) for id, (z, y, x, _) in two_balls.TOUCHING.items()]
    places += [("point:2,14,12", 3), ("path:22,2,12,2;30,2,12,2", 8)]
    with Run(volume(), config.replace(levels=levels)) as run:
        corrections = Corrections(())
        assert [corrections.nearest(run, place) for place, _ in places] == [id for _, id in places]
        for _ in run:
            pass
        (correction,) = corrections_of({"inside": "ball:12,14,12,2", "object": 3})
        corrections.correct(run, correction, "")
        assert [corrections.nearest(run, place) for place, _ in places] == [id for _, id in places]


def test_bad_commands_change_nothing(session):
    at(session, 2)
    for call, message in (
        (lambda: session.start_from(["ball:12,14,12,4"]), "was given with objects"),
        (lambda: session.change(objects="others.nii.gz"), "objects cannot change while a run runs"),
    ):
        with pytest.raises(UsageError, match=message):
            call().result(60)
        assert session.status.failed and session.status.edits == () and session.status.step == 2


def test_one_object_without_an_id_is_named_by_nothing():
    with Session(volume(), RunConfig(start="ball:12,14,12,4", threads=1)) as session:
        at(session, 2)
        session.add_click("inside", "ball:15,14,12,4").result(60)
        assert session.status.objects == () and session.status.refinements[0].object is None
        assert session.status.message.startswith("inside: ball:15,14,12,4: ")


def test_views_have_a_surface_and_a_history_of_each(session):
    at(session, 7)
    view = views(session)[-1]
    assert [surface.id for surface in view.frame.surfaces] == [3, 8] and view.frame.step == 7
    assert [[record.step for record in history] for history in view.histories] == [
        list(range(8))
    ] * 2
    for surface, ball in zip(view.frame.surfaces, two_balls.TOUCHING.values(), strict=True):
        assert np.linalg.norm(surface.middle() - ball[:3]) < 2 and surface.corner != (0, 0, 0)
        near = np.argwhere(np.abs(surface.psi) < 0.5)
        assert np.abs(surface.sample("speed", near)).max() > 0


@pytest.mark.threads
def test_it_goes_back_to_any_step_with_little_memory_and_two_threads(config, tmp_path):
    before = threading.active_count()
    with Session(volume(), config.replace(threads=2), checkpoint_mb=1) as small:
        straight = {step: labels_of(at(small, step), tmp_path)[0] for step in range(3, 16)}
        assert len(small.status.checkpoints) < 10
        for step in (14, 6, 11, 3):
            small.go_to(step).result(60)
            assert small.wait(60) and small.status.step == step
            assert labels_of(small, tmp_path)[0] == straight[step]
    assert threading.active_count() == before


def test_the_command_opens_a_session_of_the_objects(config, tmp_path, monkeypatch):
    io.write(volume(), tmp_path / "scan.nii.gz")
    seen = []

    def objects_of(session):
        session.start_preparing()  # as the window does, with its first picture
        session.ready.result(60)
        return session.status.objects

    monkeypatch.setattr(view, "front_end", lambda page, begin: begin() or page)
    monkeypatch.setattr(
        view, "open_window", lambda opening, first, *_: seen.append(objects_of(first[1]))
    )
    assert cli.execute(["view", str(tmp_path / "scan.nii.gz"), "--objects", config.objects]) == 0
    assert seen == [(3, 8)]


def test_a_page_changes_the_object_that_was_asked_for(session, tmp_path):
    viewing.needs_graphics()
    scene = Scene(session.volume, size=(640, 360))
    try:
        handler = Actions(session, scene, tmp_path)
        handler.request("tool", "inside")
        for asked, own in (("8", 8), (3, 3), ("nearest", None)):
            handler.request("object", asked)
            assert handler.object_id == own and not handler.message
        for bad in ("5", 5, "", None, True, "3 or 8", [3], float("nan")):
            handler.request("object", "8")
            handler.request("object", bad)
            assert handler.object_id == 8 and "was given" in handler.message
        handler.request("radius", 3.0)
        handler.request("press", 0.625, 0.25)
        handler.request("release")
        assert session.wait(60)
        handler.collect_results()
        correction = session.status.refinements[-1]
        assert correction.object == 8 and correction.inside[0].startswith("ball:")
    finally:
        scene.close()


@pytest.mark.program
def test_the_panel_offers_the_objects():
    pytest.importorskip("PySide6")
    code = """
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
application = QApplication([])
from types import SimpleNamespace
from accelsurf.viewer.window.objects_panel import ObjectsPanel
asked = []
def row(own, **more):
    known = dict(id=own, name=f"object {own}", color="#e69f00", visible=True, opacity=1.0, volume="1.5 ml", voxels=9)
    return known | dict(word="paused") | more
panel = ObjectsPanel(SimpleNamespace(request=lambda *request: asked.append(request)))
panel.show_state({"object_rows": [row(3)], "object_active": 0})
panel.show_state({"object_rows": [row(3), row(8, name="cyst", visible=False, opacity=0.5)], "object_active": 8})
table = panel.table
print([[table.item(k, c).text() for c in (2, 3, 4)] for k in range(table.rowCount())], asked, panel.opacity.value())
table.cellClicked.emit(0, 2)
table.item(1, 2).setText("left kidney")
panel.show_state({"object_rows": [row(3), row(8, name="left kidney", visible=False, opacity=0.5)], "object_active": 8})
table.item(1, 0).setCheckState(Qt.CheckState.Checked)
panel.opacity.setValue(25)
table.selectAll()
panel.show_state({"object_rows": [row(3, color="#0072b2"), row(8)], "object_active": 8})
print([one.row() for one in table.selectionModel().selectedRows()])
panel.resize(320, 200)
panel.show()
cell = table.visualRect(table.model().index(0, 1)).center()
print(table.viewport().grab().toImage().pixelColor(cell).name())
panel.merge.click()
panel.add.click()
panel.nearest.click()
for request in asked:
    print(*request)
"""
    environment = {
        **os.environ,
        "QT_QPA_PLATFORM": "offscreen",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, env=environment
    )
    assert done.stdout.splitlines() == [
        "[['object 3', '1.5 ml', 'paused'], ['cyst', '1.5 ml', 'paused']] [] 50",
        "[0, 1]",
        "#0072b2",  # both rows are selected, and the colour of the first is seen
        "object_active 3",
        "object_name 8 left kidney",
        "object_visible 8 True",
        "object_opacity 8 0.25",
        "object_merge 3 8",
        "object_add",
        "object_active nearest",
    ], done.stderr
