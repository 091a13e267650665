"""Session: steered from another thread; what it saves repeats the run, byte for byte."""

import json
import threading
import time

import numpy as np
import pytest

from accelsurf import io
from accelsurf.api.segment import segment
from accelsurf.cli import execute as command
from accelsurf.energies.chan_vese import ChanVese
from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.run.run import Run
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.timeline import CheckpointHistory
from tests.support.steering import at, labels_of, views


def volume(shape=(24, 30, 34), spacing=(1.5, 1.0, 1.0)):
    z, y, x = np.indices(shape)
    ball = ((z - 11) * spacing[0]) ** 2 + (y - 15) ** 2 + (x - 17) ** 2 < 10**2
    return Volume.from_array(
        (ball * 100 + np.random.default_rng(0).normal(0, 30, shape)).astype(np.float32), spacing
    )


START = "ball:17,15,16,6"


@pytest.fixture
def session():
    with Session(volume(), RunConfig(start=START)) as made:
        made.ready.result(60)
        yield made


def test_a_session_that_shall_not_begin_waits_until_it_is_told_to():
    with Session(volume(), RunConfig(start=START), begin=False) as session:
        asked = session.single_step()  # what is asked for meanwhile is done then
        time.sleep(0.3)
        assert session.is_alive and not session.ready.done() and not asked.done()
        session.start_preparing()
        session.start_preparing()  # no second time
        asked.result(60)
        assert session.wait(60) and session.status.step == 1


def test_a_session_that_is_closed_before_it_began_never_begins():
    session = Session(volume(), RunConfig(start=START), begin=False)
    asked = session.single_step()
    assert session.close(0.1) and not session.is_alive and asked.cancelled()
    assert session.next_view() is None  # a window that is about to close may still ask
    session.start_preparing()
    assert not session.is_alive and session.wait(0.1) is False
    with pytest.raises(UsageError, match="closed"):
        session.single_step().result(1)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", FLOWS)
def test_what_is_saved_repeats_the_steered_run_from_the_command_line(flow, tmp_path):
    io.write(volume(), tmp_path / "scan.nii.gz")
    scan = io.read(tmp_path / "scan.nii.gz")
    other = "gradient" if flow != "gradient" else "constant-density"
    center = scan.geometry.index_to_world((10, 15, 17))
    start = "ball:" + ",".join(f"{v:.3f}" for v in center) + ",6"
    with Session(scan, RunConfig(start=start, flow=flow), name="scan") as session:
        at(session, 7)
        session.change(smoothness=0.3, diffusion=0.2)
        at(session, 12)
        session.change(smoothness=0.05).result(60)
        at(session, 15)
        session.undo().result(60)  # the last change
        session.wait(60)
        assert session.status.step == 12
        at(session, 18)
        session.go_to(9).result(60)
        session.wait(60)
        session.change(flow=other, cfl=0.4).result(60)
        at(session, 14)
        session.go_to(11).result(60)
        at(session, 21)
        session.change(half_width=5).result(60)  # in the very last state
        paths = session.save(tmp_path / "saved").result(120)
        status = session.status
    assert [path.name for path in paths] == [
        "scan_run.toml",
        "scan_seg.nii.gz",
        "scan_surface.ply",
        "scan_trace.csv",
        "scan_preview.png",
        "scan_statistics.csv",
        "scan_statistics.json",
        "scan_report.json",
    ]
    assert [edit.step for edit in status.edits] == [7, 9, 21]
    code = command(
        [
            "segment",
            str(tmp_path / "scan.nii.gz"),
            "--config",
            str(paths[0]),
            "-o",
            str(tmp_path / "again"),
        ]
    )
    assert code == 0
    for name in ("scan_seg.nii.gz", "scan_surface.ply"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "saved" / name).read_bytes()
    report = json.loads((tmp_path / "again/scan_report.json").read_text())
    assert (
        report["stop"]["steps"] == 21 and [edit["done"] for edit in report["edits"]] == [True] * 3
    )

    def trace(folder):  # all but the seconds
        lines = (tmp_path / folder / "scan_trace.csv").read_text().splitlines()
        return [
            [
                v
                for k, v in zip(lines[0].split(","), line.split(","), strict=True)
                if k not in ("seconds",)
            ]
            for line in lines
        ]

    mine, again = trace("saved"), trace("again")
    visited = again[0].index("cells_visited")
    assert [r[:visited] + r[visited + 1 :] for r in mine] == [
        r[:visited] + r[visited + 1 :] for r in again
    ]


def test_a_run_that_converged_says_so_when_repeated(session, tmp_path):
    session.play().result(60)
    assert session.wait(120)
    stop = session.status.stop
    assert stop.reason == "converged" and session.status.step == stop.steps
    saved, toml = labels_of(session, tmp_path)
    again = segment(volume(), config=RunConfig.from_toml(toml))
    assert again.labels.tobytes() == saved and again.stop == stop
    # It goes on when asked to, and that is repeated too.
    session.play().result(60)
    assert session.wait(120) and session.status.stop.steps > stop.steps
    saved, toml = labels_of(session, tmp_path)
    again = segment(volume(), config=RunConfig.from_toml(toml))
    assert again.labels.tobytes() == saved and again.stop == session.status.stop


def test_going_back_keeps_what_comes_after_until_something_changes(session, tmp_path):
    at(session, 6).change(smoothness=0.3).result(60)
    straight = labels_of(at(session, 14), tmp_path / "a")[0]
    session.go_to(3).result(60)
    assert session.status.settings.smoothness == 0 and max(session.status.checkpoints) == 14
    session.go_to(14).result(60)
    assert (
        labels_of(session, tmp_path / "b")[0] == straight
        and session.status.settings.smoothness == 0.3
    )
    session.go_to(6).result(60)
    assert session.status.settings.smoothness == 0.3  # what the next step will be made with
    assert labels_of(at(session, 14), tmp_path / "c")[0] == straight
    session.go_to(3).result(60)
    session.change(cfl=0.4).result(60)
    assert max(session.status.checkpoints) == 3 and [
        edit.step for edit in session.status.edits
    ] == [3]
    session.undo().result(60)
    session.wait(60)
    assert [edit.step for edit in session.status.edits] == [6]
    assert labels_of(at(session, 14), tmp_path / "d")[0] == straight


def test_changes_at_one_step_are_one_edit_and_one_back_and_forth_is_none(session):
    at(session, 4)
    for value in (0.1, 0.2, 0.3):
        session.change(smoothness=value).result(60)
    session.change(cfl=0.25).result(60)
    assert [str(edit) for edit in session.status.edits] == ["step=4 cfl=0.25 smoothness=0.3"] or [
        edit.settings for edit in session.status.edits
    ] == [{"smoothness": 0.3, "cfl": 0.25}]
    session.change(smoothness=0, cfl=0.5).result(60)
    assert session.status.edits == ()
    for _ in range(5):
        session.undo().result(60)
    assert session.status.edits == () and session.status.undoable == 0
    with pytest.raises(UsageError, match="no change to undo"):
        session.undo().result(60)


def test_restart_keeps_the_settings_and_another_start_too(session, tmp_path):
    at(session, 5).change(smoothness=0.4).result(60)
    at(session, 8).restart().result(60)
    status = session.status
    assert status.step == 0 and [edit.model_dump() for edit in status.edits] == [
        {"step": 0, "smoothness": 0.4}
    ]
    saved, toml = labels_of(at(session, 9), tmp_path)
    assert segment(volume(), config=RunConfig.from_toml(toml)).labels.tobytes() == saved
    session.start_from(["ball:20,15,16,5", "ball:12,15,16,4"]).result(60)
    assert session.status.step == 0 and session.status.settings.smoothness == 0.4
    saved, toml = labels_of(at(session, 9), tmp_path)
    config = RunConfig.from_toml(toml)
    assert segment(volume(), config=config).labels.tobytes() == saved and len(config.start) == 2
    session.undo().result(60)
    assert session.wait(60) and session.status.settings.start == (START,)


@pytest.mark.slow
def test_the_steps_of_plateaus_stay_known_when_it_has_gone_back():
    """Two balls joined by a neck: the front rests in the first one before it breaks through."""
    z, y, x = np.indices((28, 28, 60)) - np.array([13.5, 13.5, 0.0])[:, None, None, None]
    balls = z**2 + y**2 + np.minimum(abs(x - 14), abs(x - 44)) ** 2 < 11**2
    neck = (z**2 + y**2 < 3.2**2) & (x > 14) & (x < 44)
    image = Volume.from_array((100.0 * (balls | neck)).astype(np.float32))
    config = RunConfig(
        start="ball:14,13.5,13.5,4vox",
        energy="threshold:50,",
        smoothness=0.3,
        max_steps=300,
        threads=1,
    )
    with Session(image, config) as session:
        at(session, 3)
        assert session.status.plateaus == ()
        session.play().result(60)
        assert session.wait(120)
        result = segment(image, config=config.replace(levels=1))
        (rest,) = result.objects[0].plateaus
        assert session.status.plateaus == (rest.step,)
        session.go_to(2).result(60)
        session.wait(60)
        assert session.status.plateaus == (rest.step,)  # it is ahead, and was made already
        session.go_to(rest.step).result(60)
        assert session.wait(60) and session.status.step == rest.step
        session.go_to(2).result(60)
        session.wait(60)
        session.change(smoothness=0.5).result(60)  # what was ahead is forgotten
        assert session.status.plateaus == ()


def test_noise_that_comes_later_has_a_seed_that_is_saved(session, tmp_path):
    at(session, 4).change(noise=0.3, flow="constant-density:noise_time=100").result(60)
    saved, toml = labels_of(at(session, 12), tmp_path)
    config = RunConfig.from_toml(toml)
    assert config.seed is not None and segment(volume(), config=config).labels.tobytes() == saved
    session.go_to(2).result(60)
    assert labels_of(at(session, 12), tmp_path)[0] == saved


def test_a_paused_run_is_saved_as_it_is_seen_above_its_lowest_energy(tmp_path):
    """A command that has used up its steps ends at the lowest energy so far; what a person saves is what he sees."""
    with Session(volume(), RunConfig(start=START, seed=855414476)) as session:
        session.ready.result(60)
        at(session, 4).change(noise=0.3, flow="constant-density:noise_time=100").result(60)
        saved, toml = labels_of(at(session, 12), tmp_path)
    config = RunConfig.from_toml(toml)
    assert config.end == "present" and segment(volume(), config=config).labels.tobytes() == saved
    lowest = segment(volume(), config=config.replace(end="lowest"))
    assert lowest.labels.tobytes() != saved and lowest.history[-1].returned


def test_levels_are_one_unless_asked_for(tmp_path):
    image = volume((48, 48, 48), (1, 1, 1))
    with Session(image, RunConfig(start="ball:17,15,16,9")) as one:
        one.ready.result(60)
        assert one.status.settings.levels == 1
    config = RunConfig(start="ball:17,15,16,9", levels=2, flow="constant-density")
    with Session(image, config) as two:
        two.play().result(60)
        assert two.wait(120)
        end = two.status.step
        straight = labels_of(two, tmp_path)[0]
        assert min(two.status.checkpoints) > 0  # those of the coarse level are gone
        two.go_to(3).result(60)  # and are made again
        assert two.wait(60) and two.status.step == 3
        two.change(smoothness=0.2).result(60)
        two.undo().result(60)
        two.play(end).result(60)
        assert two.wait(120)
        assert labels_of(two, tmp_path)[0] == straight


def test_bad_commands_are_one_line_and_change_nothing(session):
    at(session, 3)
    before = session.status
    bad = [
        (lambda: session.change(smoothness=-1), "smoothness: -1 was given"),
        (lambda: session.change(smothness=1), "there is no such setting"),
        (lambda: session.change(presmooth=1), "cannot change while a run runs"),
        (lambda: session.change(inside="point:1,2,3"), "inside cannot change while a run runs"),
        (lambda: session.add_click("inside", "ball:900,0,0,3"), "no voxel centre is inside"),
        (lambda: session.go_to(99), "expected at most 3"),
        (lambda: session.go_to(-1), "at least 0"),
        (lambda: session.start_from(["ball:900,0,0,3"]), "no voxel centre is inside"),
        (lambda: session.start_from(["sphere"]), "unknown kind"),
    ]
    for call, message in bad:
        with pytest.raises((UsageError, InputError)) as caught:
            call().result(60)
        assert message in str(caught.value)
        status = session.status
        assert status.failed and message in status.message and "\n" not in status.message
        assert (status.step, status.edits, status.settings, status.undoable) == (
            3,
            (),
            before.settings,
            0,
        )
    at(session, 5)
    assert not session.status.failed


def test_an_error_in_the_solver_is_one_line_and_a_checkpoint_is_sound(
    session, tmp_path, monkeypatch
):
    straight = labels_of(at(session, 8), tmp_path / "a")[0]
    session.go_to(4).result(60)
    monkeypatch.setattr(ChanVese, "follow", lambda *a: 1 / 0)
    session.play().result(60)
    assert session.wait(60)
    assert session.status.failed and "ZeroDivisionError" in session.status.message
    assert "\n" not in session.status.message
    assert (tmp_path / "a/surface_seg.nii.gz").exists()
    monkeypatch.undo()
    session.go_to(4).result(60)
    assert labels_of(at(session, 8), tmp_path / "b")[0] == straight


def test_an_image_that_cannot_be_run_is_an_error():
    with Session(volume(), RunConfig(start="ball:900,0,0,3")) as session:
        with pytest.raises(InputError, match="no voxel centre"):
            session.ready.result(60)
        assert session.status.failed and not session.status.ready
        with pytest.raises(UsageError, match="no voxel centre"):
            session.play().result(60)


def test_files_of_others_are_not_replaced_and_those_of_the_session_are(session, tmp_path):
    at(session, 2)
    (tmp_path / "surface_seg.nii.gz").write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists already"):
        session.save(tmp_path).result(60)
    assert [p.name for p in tmp_path.iterdir()] == ["surface_seg.nii.gz"]
    assert (tmp_path / "surface_seg.nii.gz").read_bytes() == b"precious"
    (tmp_path / "surface_seg.nii.gz").unlink()
    first = session.save(tmp_path, ("labels", "run")).result(60)
    old = first[1].read_bytes()
    at(session, 6)
    second = session.save(tmp_path, ("labels", "run")).result(60)
    assert second == first and second[1].read_bytes() != old


def test_the_end_is_prompt_and_saves_first(tmp_path):
    session = Session(
        volume((60, 60, 60), (1, 1, 1)), RunConfig(start="ball:20,20,20,9", max_steps=10**6)
    )
    session.ready.result(60)
    session.play()
    saved = session.save(tmp_path, ("labels",))
    began = time.perf_counter()
    assert session.close(20)
    assert time.perf_counter() - began < 10 and saved.result(0)[0].exists()
    with pytest.raises(UsageError, match="closed"):
        session.play().result(1)
    assert not session.is_alive and "accelsurf session" not in [
        t.name for t in threading.enumerate()
    ]


# ------------------------------------------------------------------------------------------------------- what is drawn


def test_frames_come_when_asked_for_and_the_last_is_of_the_last_state(session):
    first = views(session)
    assert first and first[-1].frame.step == 0
    session.play(12).result(60)
    seen = views(session)
    last = seen[-1]
    assert last.frame.step == 12 == last.status.step and not last.status.playing
    assert [record.step for record in last.histories[0]] == list(range(13))
    assert last.frame.surfaces[0].quantities["speed"].values.any()
    session.go_to(5).result(60)
    (back,) = views(session)[-1:]
    assert back.frame.step == 5 and [record.step for record in back.histories[0]] == list(range(6))
    session.play().result(60)
    assert views(session, 120)[-1].status.stop.reason == "converged"


def test_frames_are_made_only_when_asked_for_and_change_nothing(tmp_path, monkeypatch):
    made, of_run = [], Frame.of_run
    monkeypatch.setattr(Frame, "of_run", lambda *given: made.append(given) or of_run(*given))
    with Session(volume(), RunConfig(start=START)) as unseen:
        at(unseen, 15)
        assert not made
        labels = labels_of(unseen, tmp_path / "a")[0]
    with Session(volume(), RunConfig(start=START)) as seen:
        seen.play(15)
        assert len(views(seen)) >= 1 and made
        assert labels_of(seen, tmp_path / "b")[0] == labels


def test_frames_are_few_enough(session, monkeypatch):
    session.play(60).result(60)
    began = time.perf_counter()
    running = [view for view in views(session, 60) if view.status.playing]
    spent = time.perf_counter() - began
    assert len(running) <= spent * 15 + 2


# ------------------------------------------------------------------------------------------------------- checkpoints


def checkpoints(count, **options):
    run = Run(volume(), RunConfig(start=START, levels=1, max_steps=10**6, **options))
    for _ in range(count):
        yield run.checkpoint()
        run.step()


def test_checkpoints_stay_within_their_memory_dense_at_the_end_and_sparse_before():
    all_of_them = list(checkpoints(40))
    budget = sum(checkpoint.nbytes for checkpoint in all_of_them) / 4 / 1e6
    history = CheckpointHistory(budget)
    for checkpoint in all_of_them:
        history.add(checkpoint)
        assert history.nbytes <= budget * 1e6 and history.nbytes == sum(s.nbytes for s in history)
    steps = history.steps
    assert steps[0] == 0 and steps[-2:] == (38, 39)
    gaps = np.diff(steps)
    assert (
        gaps.max() <= 16
        and gaps[-4:].max() <= 2
        and gaps[: len(gaps) // 2].mean() > gaps[-5:].mean()
    )
    assert (
        history.nearest(38, 0).step == 38
        and history.nearest(1, 0).step == 0
        and history.nearest(38, 1) is None
    )
    history.drop_after(steps[2])
    assert history.steps == steps[:3] and history.nbytes == sum(s.nbytes for s in history)
    history.add(all_of_them[0])
    assert len(history) == 3


def test_a_session_with_little_memory_goes_back_to_any_step(tmp_path):
    with Session(volume(), RunConfig(start=START), checkpoint_mb=1) as small:
        at(small, 4).change(smoothness=0.2)
        straight = {}
        for step in range(5, 22):
            straight[step] = labels_of(at(small, step), tmp_path)[0]
        assert len(small.status.checkpoints) < 15
        for step in (20, 7, 13, 5):
            small.go_to(step).result(60)
            assert small.wait(60) and small.status.step == step
            assert labels_of(small, tmp_path)[0] == straight[step]
