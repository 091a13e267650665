"""Clicks after the end of a run: one engine for command line, Python and session; undo, redo, repeats."""

import json
import time

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.cli import execute as command
from accelsurf.errors import InputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.interact.refine import refine
from accelsurf.interact.refiner import Refiner
from accelsurf.output.document import describe_quality, report_json
from accelsurf.settings.corrections import corrections_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.legend import caption
from tests.support.steering import at, views

SHAPE, SPACING = (12, 16, 34), (1.5, 1.0, 1.0)
#: A click in the left ball, one in the right ball, a stroke that is cut off on the left.
FIRST, OTHER, STROKE = "ball:9,8,9,1.9", "ball:25,8,9,1.4", ("ball:13,6,9,0.9", "ball:13,8,9,0.9")


def scan():
    """Two bright balls of one brightness, in noise."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    balls = (z - 9) ** 2 + (y - 8) ** 2 + np.minimum(abs(x - 9), abs(x - 25)) ** 2 < 5**2
    image = 100.0 * balls + np.random.default_rng(0).normal(0, 8, SHAPE)
    return Volume.from_array(image.astype(np.float32), SPACING)


CONFIGS = {
    "seeded": RunConfig(inside=FIRST, levels=1, threads=1),
    "chan-vese": RunConfig(start="ball:9,8,9,3", levels=1, threads=1, keep_state="yes"),
}


@pytest.fixture(scope="module")
def image():
    return scan()


def untimed(result):
    """The records of a run and its corrections without their seconds."""
    return [record._replace(seconds=0.0) for record in result.history]


def ended(session):
    """The session at the end of its run."""
    session.play().result(60)
    assert session.wait(120) and session.status.stop is not None
    return session


@pytest.mark.slow
@pytest.mark.parametrize("energy", CONFIGS)
def test_command_python_session_and_configuration_make_the_same_bytes(energy, image, tmp_path):
    io.write(image, tmp_path / "scan.nii.gz")
    volume = io.read(tmp_path / "scan.nii.gz")

    def here(text):  # a ball of the indices above, in the file's world
        x, y, z, r = (float(v) for v in text.removeprefix("ball:").split(","))
        return "ball:" + ",".join(
            f"{v:.6g}" for v in (*volume.geometry.index_to_world((z / 1.5, y, x)), r)
        )

    # Each in the words of its own: options, arguments, commands of a session.
    start = here("ball:9,8,9,3")
    given = (
        [f"--inside={here(FIRST)}"]
        if energy == "seeded"
        else [f"--start={start}", "--keep-state=yes"]
    )
    one, two = tmp_path / "one", tmp_path / "two"
    assert (
        command(
            ["segment", str(volume.source), "-o", str(one), "--levels=1", "--threads=1", *given]
        )
        == 0
    )
    assert command(["refine", str(one), "-o", str(two), f"--inside={here(OTHER)}"]) == 0
    assert command(["refine", str(two), *(f"--outside={here(ball)}" for ball in STROKE)]) == 0

    keys = {"inside": here(FIRST)} if energy == "seeded" else {"start": start}
    run = accelsurf.segment(volume, config=RunConfig(**keys, levels=1, threads=1, keep_state="yes"))
    refiner = Refiner(run)
    refiner.apply(*corrections_of({"inside": here(OTHER)}))
    refiner.apply(*corrections_of({"outside": [here(ball) for ball in STROKE]}))
    result = refiner.result()
    assert (result.labels != run.labels).sum() > 50

    with Session(volume, RunConfig(**keys, levels=1, threads=1), name="scan") as session:
        ended(session)
        session.add_click("inside", here(OTHER)).result(60)
        session.add_click("outside", [here(ball) for ball in STROKE]).result(60)
        assert (
            len(session.status.refinements) == session.status.undoable == 2
            and session.status.edits == ()
        )
        session.save(tmp_path / "saved").result(60)
    again = accelsurf.segment(volume, config=RunConfig.from_toml(tmp_path / "saved/scan_run.toml"))
    three = [
        "segment",
        str(volume.source),
        "-o",
        str(tmp_path / "three"),
        f"--config={tmp_path}/saved/scan_run.toml",
    ]
    assert command(three) == 0

    wanted = (two / "scan_seg.nii.gz").read_bytes()
    for folder in ("saved", "three"):
        assert (tmp_path / folder / "scan_seg.nii.gz").read_bytes() == wanted
        assert (tmp_path / folder / "scan_surface.ply").read_bytes() == (
            two / "scan_surface.ply"
        ).read_bytes()
    assert np.array_equal(io.read(two / "scan_seg.nii.gz").array, result.labels)
    assert again.psi.tobytes() == result.psi.tobytes() and untimed(again) == untimed(result)
    # How sure it is, too: the command has read its state from a file before the last correction.
    described = json.loads(report_json(describe_quality(result.quality)))
    assert described == json.loads(report_json(describe_quality(again.quality)))
    assert (described["correction"] is None) == (energy != "seeded")
    for folder in (two, tmp_path / "saved", tmp_path / "three"):
        assert json.loads((folder / "scan_report.json").read_text())["quality"] == described


def test_undo_and_redo_of_corrections_bring_back_every_byte(image):
    with Session(image, CONFIGS["seeded"]) as session:
        ended(session)
        shown = [psi_shown(session)]
        for side, where in (("inside", OTHER), ("outside", STROKE)):
            session.add_click(side, where).result(60)
            shown.append(psi_shown(session))
        assert len({psi.tobytes() for psi in shown}) == 3
        for wanted, redoable in ((1, 1), (0, 2)):
            session.undo().result(60)
            assert psi_shown(session).tobytes() == shown[wanted].tobytes()
            assert (session.status.redoable, len(session.status.refinements)) == (redoable, wanted)
        for wanted in (1, 2):
            session.redo().result(60)
            assert psi_shown(session).tobytes() == shown[wanted].tobytes()
        session.undo().result(60)
        session.add_click("outside", "point:9,8,16.5").result(
            60
        )  # a new change: nothing is left to be redone
        assert session.status.redoable == 0
        with pytest.raises(UsageError, match="no undone change"):
            session.redo().result(60)
        with pytest.raises(InputError, match="nothing would be left"):
            session.add_click("outside", "ball:17,8,9,40").result(60)
        assert len(session.status.refinements) == 2 and session.status.failed


@pytest.mark.sampled(1)
@pytest.mark.parametrize("steps", [4, None], ids=["while it runs", "after its end"])
def test_a_later_stroke_wins_over_an_earlier_one_and_the_settings_repeat_it(steps, image, tmp_path):
    with Session(image, CONFIGS["seeded"], name="scan") as session:
        at(session, steps) if steps else ended(session)
        session.add_click("inside", "path:9,8,9,2;19,8,9,2").result(60)
        session.add_click("outside", "path:17,4,9,1.5;17,12,9,1.5").result(60)
        if steps:
            ended(session)
        paths = session.save(tmp_path, ("labels", "run")).result(60)
        lines, clicks = session.status.changes, views(session)[-1].frame.clicks
    assert [line.line for line in lines[:2]] == [
        "inside: stroke of 2 places",
        "outside: stroke of 2 places",
    ]
    labels = io.read_labels(next(path for path in paths if "_seg" in path.name)).array
    sides = {side: np.zeros(SHAPE, bool) for side in ("inside", "outside")}
    for one in clicks:
        sides[one.side][one.box] |= one.mask
    assert (
        sides["outside"][6, 8, 17] and not sides["inside"][6, 8, 17] and sides["inside"][6, 8, 20]
    )
    assert labels[sides["inside"]].all() and not labels[sides["outside"]].any()
    again = accelsurf.segment(image, config=RunConfig.from_toml(next(tmp_path.glob("*_run.toml"))))
    assert np.array_equal(again.labels, labels)


def test_the_list_of_changes_leads_back_and_forward_in_one_go(image):
    with Session(image, CONFIGS["seeded"]) as session:
        ended(session)
        shown = [psi_shown(session)]
        for side, where in (("inside", OTHER), ("outside", STROKE), ("outside", "point:9,8,16.5")):
            session.add_click(side, where).result(60)
            shown.append(psi_shown(session))
        words = [f"inside: {OTHER}", f"outside: {STROKE[0]} and 1 more", "outside: point:9,8,16.5"]
        for count in (0, 3, 1, 2, 0, 2):
            session.go_to_change(count).result(60)
            assert session.wait(60) and psi_shown(session).tobytes() == shown[count].tobytes()
            status = session.status
            assert (status.undoable, status.redoable) == (count, 3 - count)
            assert [(one.number, one.line, one.done) for one in status.changes] == [
                (number, line, number <= count) for number, line in enumerate(words, 1)
            ]
        for wrong in (-1, 4):
            with pytest.raises(UsageError, match="expected a number from 0 to 3"):
                session.go_to_change(wrong).result(60)
        session.change(smoothness=0.4).result(60)
        assert [one.line for one in session.status.changes] == [*words[:2], "smoothness 0.4"]


def test_nothing_of_an_undone_change_stays_in_the_picture(image, scene_of):
    """Surfaces, contours and marks after undo are those that were drawn before: the same pixels."""
    scene = scene_of(image, size=(480, 272))
    with Session(image, CONFIGS["seeded"]) as session:
        ended(session)

        def drawn():
            view = views(session)[-1]
            scene.update(view.frame, view.histories)
            return scene.screenshot()

        pictures = [drawn()]
        for side, where in (("inside", OTHER), ("outside", STROKE)):
            session.add_click(side, where).result(60)
            pictures.append(drawn())
            assert (pictures[-1] != pictures[-2]).any()
        for wanted in (1, 0):
            session.undo().result(60)
            np.testing.assert_array_equal(drawn(), pictures[wanted])
        session.go_to_change(2).result(60)
        np.testing.assert_array_equal(drawn(), pictures[2])


def test_where_to_click_next_is_offered_after_the_end_and_is_that_of_the_quality():
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    bridge = (
        (x > 12) & (x < 22) & (abs(y - 8) < 3)
    )  # of nearly the balls' brightness: no edge is there
    image = Volume.from_array(
        (scan().array + 90.0 * bridge).clip(None, 100).astype(np.float32), SPACING
    )
    beside = "ball:9,2,9,0.9"  # away from the bridge, whose end stays in doubt
    with Session(image, CONFIGS["seeded"]) as session:
        at(session, 3)
        time.sleep(0.6)
        assert session.status.uncertain == ()  # it has not ended
        ended(session)
        until(lambda: session.status.uncertain)
        first, result = session.status.uncertain, accelsurf.segment(image, config=CONFIGS["seeded"])
        assert (
            first[0].world == result.quality.next_click
            and first[0].share == result.quality.next_uncertainty
        )
        session.add_click("inside", beside).result(60)
        assert session.status.uncertain == ()
        until(lambda: session.status.uncertain)
        assert session.status.uncertain[0].world == refine(result, inside=beside).quality.next_click
        assert session.status.uncertain != first
        session.undo().result(60)
        until(lambda: session.status.uncertain)
        assert session.status.uncertain == first


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def psi_shown(session):
    """Psi of what the session shows, on the whole grid; voxels that are not shown are 9."""
    frame = views(session)[-1].frame
    out = np.full(SHAPE, 9.0, np.float32)
    for surface in frame.surfaces:
        part = tuple(
            slice(a, a + n) for a, n in zip(surface.offset, surface.psi.shape, strict=True)
        )
        out[part] = surface.psi
    return np.where(out < 0, out, np.float32(9.0))


def test_a_run_that_goes_on_is_corrected_again_at_its_end(image, tmp_path):
    with Session(image, CONFIGS["seeded"], name="x") as session:
        at(session, 6)
        session.add_click("outside", "point:9,8,16.5").result(60)
        assert session.status.edits == () and len(session.status.refinements) == 1
        assert session.status.stop is not None and session.status.step == 6  # it has ended there
        session.add_click("inside", OTHER).result(60)
        assert "moved" in session.status.message
        session.change(smoothness=0.2).result(60)
        assert session.status.stop is None and len(session.status.refinements) == 2
        ended(session)
        assert "correction 2 of 2" in session.status.message
        session.save(tmp_path).result(60)
        toml = next(tmp_path.glob("*_run.toml"))
        saved = io.read(next(tmp_path.glob("x_seg.*"))).array
    again = accelsurf.segment(image, config=RunConfig.from_toml(toml))
    assert np.array_equal(again.labels, saved)
    assert len(again.config.refine) == 2 and len(again.config.edit) == 1
    assert again.labels[6, 8, 25] == 1
    with Session(
        image, RunConfig.from_toml(toml)
    ) as session:  # a session from it corrects at the end too
        ended(session)
        assert len(session.status.refinements) == 2
        session.restart().result(60)
        assert session.status.refinements == () and session.status.undoable
        session.undo().result(60)
        assert len(session.status.refinements) == 2


def test_a_saved_run_before_its_end_has_no_corrections(image, tmp_path):
    with Session(image, CONFIGS["chan-vese"], name="x") as session:
        ended(session)
        session.add_click("inside", OTHER).result(60)
        session.go_to(3).result(60)
        session.wait(60)
        session.save(tmp_path, ["run", "labels"]).result(60)
        saved = io.read(next(tmp_path.glob("x_seg.*"))).array
    again = accelsurf.segment(image, config=RunConfig.from_toml(next(tmp_path.glob("*_run.toml"))))
    assert np.array_equal(again.labels, saved) and again.config.refine == ()


def test_clicks_and_progress_are_shown(image):
    with Session(image, CONFIGS["seeded"]) as session:
        ended(session)
        seen = set()
        done = session.add_click("inside", OTHER)
        while not done.done():
            seen.add(session.status.message)
        done.result()
        assert any("correcting" in message for message in seen)
        view = views(session)[-1]
        marks = [(mark.side, mark.place) for mark in view.frame.clicks]
        assert marks == [("inside", (6, 8, 9)), ("inside", (6, 8, 25))]
        assert view.histories[0][-1].volume_mm3 == view.frame.volume_mm3
        session.undo().result(60)
        assert len(views(session)[-1].frame.clicks) == 1


@pytest.mark.parametrize("max_steps", [7, 500])
def test_the_picture_and_the_slider_say_the_same_step_after_corrections(image, max_steps):
    """Steps of a correction are none of the run, over which the slider goes."""
    with Session(image, CONFIGS["seeded"].replace(max_steps=max_steps), name="x") as session:
        ended(session)
        (plain,) = views(session)[-1:]
        assert plain.frame.step == plain.status.step and plain.frame.corrected_at is None
        session.add_click("inside", OTHER).result(60)
        (view,) = views(session)[-1:]
        assert view.histories[0][-1].step > view.status.step == max(view.status.checkpoints)
        assert view.frame.step == view.frame.corrected_at == view.status.step == plain.status.step
        assert caption(view.frame, image.geometry)[0] == f"step {view.status.step}, corrected"
        session.undo().result(60)
        (view,) = views(session)[-1:]
        assert caption(view.frame, image.geometry)[0] == f"step {view.status.step}"


def test_of_several_objects_the_named_one_or_the_nearest_is_corrected(image, tmp_path):
    balls = tmp_path / "balls.csv"
    balls.write_text("id,x,y,z,r\n3,9,8,9,3\n7,25,8,9,3\n")
    config = RunConfig(objects=str(balls), levels=1, threads=1, keep_state="yes")
    before = accelsurf.segment_objects(image, config=config)
    after = refine(before, outside="ball:28,8,9,1", object=7)
    with Session(image, config, name="x") as session:
        ended(session)
        for named in (7, None):
            session.add_click("outside", "ball:28,8,9,1", named).result(60)
            assert session.status.refinements[-1].object == 7
            session.save(tmp_path, ["labels", "run"], overwrite=True).result(60)
            saved = io.read(next(tmp_path.glob("x_seg.*"))).array
            assert np.array_equal(saved, after.labels) and not np.array_equal(saved, before.labels)
            shown = {
                one.id: one.overlap(after.labels == one.id)
                for one in views(session)[-1].frame.surfaces
            }
            assert all(
                common == own == (after.labels == id).sum() for id, (common, own) in shown.items()
            )
            session.undo().result(60)
    again = accelsurf.segment_objects(
        image, config=RunConfig.from_toml(next(tmp_path.glob("*_run.toml")))
    )
    assert np.array_equal(again.labels, after.labels)
