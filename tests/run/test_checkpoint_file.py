"""A run that is stopped at any step, and goes on from the file of its state, ends as one that was never stopped."""

import numpy as np
import pytest

import accelsurf
from accelsurf.errors import InputError, UsageError
from accelsurf.run import checkpoint, checkpoint_file

SHAPE, SPACING = (16, 22, 30), (1.5, 1.0, 1.0)


def image(noise=8.0):
    """Two bright balls in noise."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    near = np.minimum((x - 9) ** 2, (x - 21) ** 2) + (y - 11) ** 2 + (z - 12) ** 2
    return (100.0 * (near < 6**2) + np.random.default_rng(1).normal(0, noise, SHAPE)).astype(
        np.float32
    )


def objects():
    """A seed in each."""
    labels = np.zeros(SHAPE, np.uint8)
    labels[7:10, 9:13, 7:11], labels[7:10, 9:13, 19:23] = 2, 5
    return labels


BALL = {"start": "ball:9,11,12,3"}
RUNS = {
    "levels": {**BALL, "levels": 2, "max_steps": 70, "tolerance": 0.3},
    "clicks": {
        "inside": "ball:9,11,12,2",
        "outside": "point:21,11,12",
        "cfl": 0.3,
        "max_steps": 15,
    },
    "objects": {"objects": objects(), "max_steps": 15},
    "noise": {**BALL, "noise": 0.2, "seed": 3, "max_steps": 12},
    "edits": {
        **BALL,
        "edit": ["step=4 smoothness=0.4", "step=8 half_width=5"],
        "max_steps": 14,
    },
    "flowable mass": {**BALL, "flow": "flowable-mass", "max_steps": 12},
    "a correction": {
        "inside": "ball:9,11,12,2",
        "refine": ["outside=point:9,11,16"],
        "max_steps": 10,
    },
}


class Killed(Exception):
    pass


def run(options, kept=None, stop_at=None, every="1", **more):
    """A whole run; with ``stop_at`` one that is killed before that step is over."""
    options = {
        **options,
        **more,
        **({} if kept is None else {"checkpoint": every, "checkpoint_to": kept}),
    }
    made = iter(range(10**6))

    def on_step(*record):
        if stop_at is not None and next(made) >= stop_at:
            raise Killed

    several = "objects" in options
    how = accelsurf.segment_objects if several else accelsurf.segment
    given = (image(), options.pop("objects")) if several else (image(),)
    return how(*given, spacing=SPACING, threads=1, on_step=on_step, **options)


def bytes_of(result):
    """All that must be the same: but what the work took, and how often its state was written."""
    rows = [
        [repr(record._replace(seconds=0.0, cells_visited=0)) for record in one.history]
        for one in result.objects
    ]
    config = result.config.model_dump(exclude={"checkpoint"})
    psi = [one.psi.tobytes() for one in result.objects]
    return (
        psi,
        rows,
        result.labels.tobytes(),
        result.warnings,
        result.late_leakage,
        config,
        result.levels,
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", RUNS)
def test_a_killed_run_goes_on_with_the_same_bytes(tmp_path, name):
    whole = bytes_of(run(RUNS[name]))
    steps = len(whole[1][0])
    assert steps > 8
    for stop_at in (2, 4, steps // 2, steps - 2):
        kept = tmp_path / f"{stop_at}.npz"
        with pytest.raises(Killed):
            run(RUNS[name], kept, stop_at)
        assert kept.exists()
        assert bytes_of(run(RUNS[name], kept)) == whole


def test_a_run_may_be_killed_again_and_again(tmp_path):
    whole, kept = bytes_of(run(RUNS["objects"])), tmp_path / "state.npz"
    for _ in range(4):
        with pytest.raises(Killed):
            run(RUNS["objects"], kept, 5)
    assert bytes_of(run(RUNS["objects"], kept)) == whole


def test_a_drawn_seed_is_that_of_the_first_run(tmp_path):
    options = {**BALL, "noise": 0.3, "max_steps": 10}
    kept = tmp_path / "state.npz"
    with pytest.raises(Killed):
        run(options, kept, 5)
    result = run(options, kept)
    assert bytes_of(result) == bytes_of(run(options, seed=result.config.seed))


def test_the_state_is_written_as_often_as_asked(tmp_path, monkeypatch):
    written = []
    real = checkpoint_file.save_checkpoint

    def save(path, state, header):
        written.append(state.step)
        real(path, state, header)

    monkeypatch.setattr(checkpoint_file, "save_checkpoint", save)
    run({**BALL, "max_steps": 11, "levels": 1}, tmp_path / "a.npz", every="4")
    assert written == [4, 8]
    now = [0.0]
    monkeypatch.setattr(checkpoint_file.time, "monotonic", lambda: now[0])
    written.clear()
    options = {
        **BALL,
        "max_steps": 11,
        "levels": 1,
        "checkpoint": "30s",
        "checkpoint_to": tmp_path / "b.npz",
    }

    def on_step(record):
        now[0] += 10.0

    accelsurf.segment(image(), spacing=SPACING, on_step=on_step, **options)
    assert written == [3, 6, 9]


def test_a_run_that_is_interrupted_writes_its_state_at_once(tmp_path):
    kept = tmp_path / "state.npz"
    whole = bytes_of(run(RUNS["levels"]))
    options = {**RUNS["levels"], "checkpoint": "1h", "checkpoint_to": kept, "threads": 1}
    steps = []

    def on_step(record):
        steps.append(record)
        return len(steps) == 5

    stopped = accelsurf.segment(image(), spacing=SPACING, on_step=on_step, **options)
    assert stopped.stop.reason == "interrupted"
    assert bytes_of(run(RUNS["levels"], kept)) == whole


@pytest.mark.threads
def test_another_image_start_or_setting_is_refused_by_name(tmp_path):
    kept = tmp_path / "state.npz"
    with pytest.raises(Killed):
        run(RUNS["levels"], kept, 3)
    for more, named in (
        ({"smoothness": 0.2}, "other settings: smoothness was 0.0, is 0.2"),
        ({"smoothness": 0.2, "cfl": 0.4}, "other settings: smoothness was 0.0, is 0.2 and 1 more"),
        ({"start": "ball:9,11,12,4"}, "other settings: start was"),
    ):
        with pytest.raises(InputError, match=named):
            run(RUNS["levels"], kept, **more)
    options = {**RUNS["levels"], "checkpoint_to": kept, "threads": 1}
    with pytest.raises(InputError, match="a checkpoint of another image or start"):
        accelsurf.segment(image(9.0), spacing=SPACING, **options)
    for same in ({"threads": 2}, {"save_sdf": True}, {"checkpoint": "7"}):
        accelsurf.segment(image(), spacing=SPACING, **{**options, **same})


def test_other_versions_and_processors_are_said(tmp_path, monkeypatch):
    kept = tmp_path / "state.npz"
    with monkeypatch.context() as there:
        there.setattr(checkpoint, "processor_name", lambda: "abacus")
        with pytest.raises(Killed):
            run(RUNS["levels"], kept, 3)
    said = []
    options = {**RUNS["levels"], "checkpoint_to": kept, "threads": 1}
    result = accelsurf.segment(image(), spacing=SPACING, on_warning=said.append, **options)
    assert any("processor abacus" in line and "last bits" in line for line in said)
    assert [line for line in said if "abacus" in line][0] in result.warnings


def test_damaged_states_are_refused_in_one_line(tmp_path):
    kept = tmp_path / "state.npz"
    with pytest.raises(Killed):
        run(RUNS["levels"], kept, 3)
    content = kept.read_bytes()
    random = np.random.default_rng(2)
    for number in range(12):
        place = int(random.integers(len(content)))
        flipped = bytes([content[place] ^ 255]) + content[place + 1 :]
        kept.write_bytes(content[:place] + (b"" if number % 2 else flipped))
        try:
            run(RUNS["levels"], kept)
        except InputError as error:
            assert str(kept) in error.message and error.hint
        kept.unlink(missing_ok=True)


def test_a_checkpoint_needs_a_file():
    with pytest.raises(UsageError, match="checkpoint: 5 was given without a file"):
        run({**BALL, "checkpoint": "5"})


@pytest.mark.parametrize("text", ["0", "0s", "-1", "5days", "1.5", "", "s"])
def test_intervals_that_are_none(text):
    with pytest.raises(UsageError, match="checkpoint: "):
        run(BALL, checkpoint=text)
