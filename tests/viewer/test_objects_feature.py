"""Several objects built in a session: begun beside others, merged, split, removed, named; how they are drawn."""

import time
from contextlib import contextmanager

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.errors import UsageError
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.objects import NOT_BEGUN
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from tests.interact.test_object_changes import BALLS, SPACING, dice, press, scan, truth
from tests.support import viewing


@contextmanager
def opened():
    with Session(
        scan(), RunConfig(start=press(1), energy="seeded", inside=press(1), threads=1)
    ) as made:
        made.ready.result(60)
        yield made


@pytest.fixture
def session():
    with opened() as made:
        yield made


def ended(session):
    session.play().result(60)
    assert session.wait(120) and session.status.stop.reason == "converged"


def frame_of(session):
    for _ in range(400):
        view = session.next_view()
        if view is not None:
            last = view
        elif not session.has_unseen_state:
            break
        time.sleep(0.005)
    return last.frame


def drag(session, own, object_id=None):
    """Press in a ball and let go where its outline is."""
    session.press(press(own, 2.0), object_id=object_id).result(60)
    session.release(BALLS[own][3]).result(60)


def saved(session, folder):
    """Labels that are saved, which ``NAME_run.toml`` makes again; and its settings."""
    folder = folder / f"s{len(list(folder.iterdir()))}"
    session.save(folder, ("labels", "run"), overwrite=True).result(60)
    config = RunConfig.from_toml(next(folder.glob("*_run.toml")))
    again = accelsurf.segment(session.volume, config=config)
    labels = io.read_labels(next(folder.glob("*_seg.*"))).array
    assert np.array_equal(again.labels, labels)
    return labels, config


def test_presses_build_objects_one_after_another_and_run_toml_repeats_them(session, tmp_path):
    drag(session, 1)  # alone: another run
    assert session.status.settings.size and session.status.objects == ()
    ended(session)
    one = saved(session, tmp_path)[0]
    drag(session, 2, 2)
    drag(session, 3, 7)
    assert session.status.objects == (1, 2, 7) and session.status.object_words[7] == "converged"
    labels, config = saved(session, tmp_path)
    assert np.array_equal(labels == 1, one > 0) and [r.new for r in config.refine] == [2, 7]
    for own, label in ((2, 2), (3, 7)):
        assert dice(labels == label, truth(own)) > 0.85
    surfaces = frame_of(session).surfaces
    assert [surface.id for surface in surfaces] == [1, 2, 7]
    for surface in surfaces:
        assert int((surface.psi < 0).sum()) == int((labels == surface.id).sum())


def test_an_object_is_begun_by_a_click_and_the_active_one_takes_strokes(session, tmp_path):
    ended(session)
    with pytest.raises(UsageError, match="object 2 has not begun"):
        session.add_click("outside", press(2), 2).result(60)
    session.add_click("inside", press(2), 2).result(60)
    before = saved(session, tmp_path)[0]
    z, y, x = 12, 15, 24  # between the first two
    session.add_click("inside", f"ball:{x},{y},{z * 1.5},2", 2).result(60)
    after = saved(session, tmp_path)[0]
    assert after[z, y, x] == 2 and np.array_equal(before == 1, after == 1)
    # With no object named it is the nearest one.
    session.add_click("inside", "point:12,15,29").result(60)
    assert session.status.refinements[-1].object == 1
    saved(session, tmp_path)


def test_while_the_run_goes_on_a_new_object_waits_for_its_end(session, tmp_path):
    session.play(3).result(60)
    assert session.wait(60) and session.status.stop is None
    session.add_click("inside", press(2), 2).result(60)
    assert session.status.objects == (1, 2) and "when the run has ended" in session.status.message
    assert session.wait(120) and session.status.stop.reason == "converged"
    labels = saved(session, tmp_path)[0]
    assert dice(labels == 2, truth(2) | truth(3)) > 0.9  # without a size it is both, which touch
    session.undo().result(60)
    assert session.wait(60) and session.status.objects == ()


def test_merge_split_remove_and_undo(session, tmp_path):
    ended(session)
    session.add_click("inside", press(2), 2).result(60)
    two = saved(session, tmp_path)[0]
    session.objects(lambda objects: objects.merge((1, 2))).result(60)
    assert session.status.objects == (1,)
    merged = saved(session, tmp_path)[0]
    assert np.array_equal(merged > 0, two > 0)
    session.objects(lambda objects: objects.split("point:38,15,17")).result(60)
    assert session.status.objects == (1, 2) and np.array_equal(
        saved(session, tmp_path)[0] > 0, two > 0
    )
    session.objects(lambda objects: objects.remove(1)).result(60)
    assert session.status.objects == (2,)
    for expected in ((1, 2), (1,), (1, 2), ()):
        session.undo().result(60)
        assert session.status.objects == expected
        assert [one.id for one in frame_of(session).surfaces] == list(expected or (1,))
    for expected in ((1, 2), (1,), (1, 2), (2,)):
        session.redo().result(60)
        assert session.status.objects == expected
    with pytest.raises(UsageError, match="only one"):
        session.objects(lambda objects: objects.remove(2)).result(60)


def test_names_and_colours_go_into_the_files(session, tmp_path):
    ended(session)
    session.add_click("inside", press(2), 2).result(60)
    session.objects(lambda objects: objects.describe({2: ("left kidney", "#102030")}, 2)).result(60)
    assert session.status.labels[2].name == "left kidney"
    session.save(tmp_path, ("labels", "mesh", "report", "run")).result(60)
    assert RunConfig.from_toml(next(tmp_path.glob("*_run.toml"))).name == ("2=left kidney",)
    text = next(tmp_path.glob("*itk*.txt"), None) or next(tmp_path.glob("*_labels.txt"))
    line = next(line for line in text.read_text().splitlines() if "left kidney" in line)
    assert line.split()[:4] == ["2", "16", "32", "48"]
    for name in ("statistics.csv", "statistics.json", "report.json", "surface_2.ply"):
        assert b"left kidney" in (tmp_path / f"surface_{name}").read_bytes(), name
    assert bytes((16, 32, 48)) in (tmp_path / "surface_surface_2.ply").read_bytes()


@contextmanager
def acting(session, folder):
    viewing.needs_graphics()
    scene = Scene(session.volume, size=(640, 360))
    yield Actions(session, scene, folder)
    scene.close()


@pytest.fixture
def actions(session, tmp_path):
    with acting(session, tmp_path) as made:
        yield made


@pytest.fixture(scope="module")
def after_a_step(tmp_path_factory):
    """A window for requests that change nothing, one after another; its run has made a step."""
    with opened() as session, acting(session, tmp_path_factory.mktemp("step")) as made:
        session.play(1).result(60)
        yield made


@pytest.fixture(scope="module")
def after_the_end(tmp_path_factory):
    """The same of a run that has ended."""
    with opened() as session, acting(session, tmp_path_factory.mktemp("end")) as made:
        session.play().result(60)
        yield made


def state_when_idle(actions):
    """Draw until nothing is new."""
    for _ in range(400):
        actions.session.wait(60)
        actions.collect_results()
        view = actions.session.next_view()
        if view is not None:
            actions.update(view)
        elif not actions.session.has_unseen_state:
            break
        time.sleep(0.005)
    return actions.state()


def ask(actions, *request):
    actions.request(*request)
    state = state_when_idle(actions)
    assert not actions.message, actions.message
    return state


def test_the_list_and_how_objects_are_drawn(actions):
    actions.session.play().result(60)
    state = state_when_idle(actions)
    (row,) = state["object_rows"]
    assert row["id"] == 1 and row["word"] == "converged" and 1.4 < viewing.ml(row) < 2.0
    assert row["voxels"] == pytest.approx(1000 * viewing.ml(row) / np.prod(SPACING), rel=0.05)
    state = ask(actions, "object_add")
    assert state["object_active"] == 2 and state["tool"] == "size"
    assert [one["word"] for one in state["object_rows"]] == ["converged", NOT_BEGUN]
    actions.session.add_click("inside", press(2), actions.object_id).result(60)
    state = state_when_idle(actions)
    assert [one["word"] for one in state["object_rows"]] == ["converged"] * 2 and len(
        state["object_rows"]
    ) == 2
    state = ask(actions, "object_name", 2, "cyst")
    shown = {one["id"]: one["color"] for one in state["object_rows"]}
    told = actions.session.status.labels
    # Files have the colours that are seen.
    assert {own: "#{:02x}{:02x}{:02x}".format(*told[own].color) for own in (1, 2)} == shown
    assert state["object_rows"][1]["name"] == "cyst" and "cyst" in actions.scene.legend
    color_before = state["object_rows"][1]["color"]
    first, second = actions.scene.space.surfaces[:2]
    assert tuple(round(255 * v) for v in second.prop.color.float_rgb) == tuple(
        int(color_before[i : i + 2], 16) for i in (1, 3, 5)
    )
    ask(actions, "object_color", 2, "#0000ff")
    assert second.prop.color.float_rgb == (0.0, 0.0, 1.0) and first.prop.color.float_rgb != (
        0.0,
        0.0,
        1.0,
    )
    ask(actions, "object_opacity", 2, 0.25)
    assert second.prop.opacity == 0.25 and first.prop.opacity == 1.0
    actions.scene.cursor = (38.0, 15.0, 17.0)
    tile = actions.scene.slice_tiles["axial"]
    assert (
        tile.lines["object 1"][0].GetVisibility() and tile.lines["object 1"][0].prop.opacity == 0.25
    )
    ask(actions, "object_visible", 2, False)
    assert (
        not second.GetVisibility()
        and not tile.lines["object 1"][0].GetVisibility()
        and first.GetVisibility()
    )
    assert "cyst" not in actions.scene.legend
    state = ask(actions, "object_visible", 2, True)
    assert second.GetVisibility() and state["object_rows"][1]["visible"]
    state = ask(actions, "object_merge", 1, 2)
    assert [one["id"] for one in state["object_rows"]] == [1] and state["object_active"] == 1
    state = ask(actions, "object_split", 38.0, 15.0, 17.0)
    assert [one["id"] for one in state["object_rows"]] == [1, 2]
    state = ask(actions, "object_remove", 1)
    assert [one["id"] for one in state["object_rows"]] == [2] and state["object_active"] == 0


def test_the_size_tool_presses_for_the_active_object(actions):
    actions.session.play().result(60)
    state_when_idle(actions)
    ask(actions, "object_add")
    actions.scene.cursor = (38.0, 15.0, 17.0)
    tool = actions.tools["size"]
    at = type("At", (), {"tile": "axial", "world": np.array([38.0, 15.0, 17.0])})()
    tool.press(at)
    actions.session.wait(60)
    tool.move(type("At", (), {"tile": "axial", "world": np.array([45.0, 15.0, 17.0])})())
    tool.release()
    state = state_when_idle(actions)
    assert not actions.message and [one["id"] for one in state["object_rows"]] == [1, 2]
    # The drag says the ball without the one beside it, as bright, which it touches.
    assert 1000 * viewing.ml(state["object_rows"][1]) == pytest.approx(
        truth(2).sum() * 1.5, rel=0.25
    )


BAD = (
    ("object_remove", 9),
    ("object_remove", "x"),
    ("object_remove", None),
    ("object_remove", True),
    ("object_remove", float("nan")),
    ("object_name", 1, "a" * 65),
    ("object_name", 1, "\n"),
    ("object_name", 1, ""),
    ("object_name", 1, 3),
    ("object_name", 1),
    ("object_name", 9, "a"),
    ("object_color", 1, "red"),
    ("object_color", 1, "#12345"),
    ("object_color", 1, "#12345g"),
    ("object_color", 1, ["#123456"]),
    ("object_opacity", 1, 1.5),
    ("object_opacity", 1, -0.1),
    ("object_opacity", 1, float("nan")),
    ("object_opacity", 1, "much"),
    ("object_active", 9),
    ("object_active", "all"),
    ("object_active", [1]),
    ("object_active", True),
    ("object_merge", 1),
    ("object_merge",),
    ("object_merge", 1, 1),
    ("object_merge", 1, 9),
    ("object_split", 1, 2),
    ("object_split", 1, 2, float("inf")),
    ("object_split", 1, 2, "z"),
    ("object_split", 1.0, 1.0, 1.0),
    ("object_visible", 9, True),
    ("object_add", 3),
    ("object_remove", 1),
)


@pytest.mark.parametrize("request_", BAD, ids=map(str, range(len(BAD))))
def test_bad_requests_change_nothing_and_say_one_line(request_, request):
    ends = request_[0] in ("object_split", "object_remove")
    actions = request.getfixturevalue("after_the_end" if ends else "after_a_step")
    before = state_when_idle(actions)["object_rows"]
    config = actions.session.status.refinements
    actions.request(*request_)
    state = state_when_idle(actions)
    assert actions.message and "\n" not in actions.message
    assert state["object_rows"] == before and actions.session.status.refinements == config
    assert actions.object_id is None


def test_no_key_means_two_things(actions):
    keys = [tool.key for tool in actions.tools.values()]
    keys += [key for feature in actions.features for key in feature.keys()]
    assert sorted(keys) == sorted(set(keys))
