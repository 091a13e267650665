"""The setting ``extension``: every flow, levels, several objects, mask, edits and checkpoints with a fast march."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.measure import metrics
from accelsurf.run.checkpoint import checkpoint_header, load_checkpoint, save_checkpoint
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig

SHAPE, SPACING = (20, 28, 40), (1.5, 1.0, 1.0)


def distance(centre: tuple[float, float, float], radius: float) -> np.ndarray:
    places = [
        i * h - c for i, h, c in zip(np.indices(SHAPE).astype(float), SPACING, centre, strict=True)
    ]
    return np.sqrt(sum(p**2 for p in places)) - radius


AWAY = [distance((14.0, 13.5, 12.0), 8.5), distance((14.0, 13.5, 28.0), 6.5)]
TRUTH = [one < 0 for one in AWAY]


def image(noise: float = 0.3, balls: int = 2) -> Volume:
    sharp = np.clip(0.5 - np.min(AWAY[:balls], axis=0), 0, 1) + np.random.default_rng(5).normal(
        0, noise, SHAPE
    )
    return Volume.from_array(sharp.astype(np.float32), SPACING)


FLOWS = ["constant-density", "flowable-mass", "gradient", "sobolev", "momentum", "region-mass"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", FLOWS)
def test_every_flow_finds_the_object_by_a_fast_march(flow: str) -> None:
    """As by closest points, to a hundredth in Dice, by another way."""
    given = {"start": "ball:12,13.5,14,5", "flow": flow, "levels": 1, "max_steps": 60, "threads": 1}
    march, closest = (
        segment(image(0.3, 1), extension=one, **given) for one in ("fast-marching", "closest-point")
    )
    dice = [metrics.dice(np.asarray(one.labels) > 0, TRUTH[0]) for one in (march, closest)]
    assert dice[0] > 0.93 and abs(dice[0] - dice[1]) < 0.015
    assert march.psi.tobytes() != closest.psi.tobytes()


def run_of(**changes) -> RunConfig:
    return RunConfig(extension="fast-marching", max_steps=24, threads=1, **changes)


def ended(run: Run) -> list[bytes]:
    for _ in run:
        pass
    return [
        b"".join(np.ascontiguousarray(a).tobytes() for a in one.surface.band) for one in run.objects
    ]


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "changes",
    [
        {"start": "ball:12,13.5,14,5", "levels": 2, "edit": ["step=6 half_width=5"]},
        {"flow": "flowable-mass"},
    ],
)
def test_a_run_goes_on_from_a_file_with_the_same_bytes(tmp_path, changes) -> None:
    """On levels and with several objects; every surface, also one that an edit or a grid makes anew, marches."""
    starts = (
        None
        if "start" in changes
        else 3 * (AWAY[0] < -4).astype(np.int32) + 8 * (AWAY[1] < -3).astype(np.int32)
    )
    with Run(image(), run_of(**changes), objects=starts) as straight:
        for _ in range(11):
            straight.step()
        save_checkpoint(
            tmp_path / "run.checkpoint", straight.checkpoint(), checkpoint_header(straight)
        )
        assert all(one.surface.extension == "fast-marching" for one in straight.objects)
        want = ended(straight)
        assert all(one.surface.extension == "fast-marching" for one in straight.objects)
    with Run(image(), run_of(**changes), objects=starts) as other:
        other.restore(load_checkpoint(tmp_path / "run.checkpoint", other))
        assert ended(other) == want
    closest = run_of(**changes).replace(extension="closest-point")
    with pytest.raises(InputError), Run(image(), closest, objects=starts) as it:
        it.restore(load_checkpoint(tmp_path / "run.checkpoint", it))


@pytest.mark.threads
def test_threads_do_not_change_a_run() -> None:
    starts = 3 * (AWAY[0] < -4).astype(np.int32) + 8 * (AWAY[1] < -3).astype(np.int32)
    runs = []
    for threads in (1, 2):
        with Run(image(), run_of().replace(threads=threads), objects=starts) as run:
            runs.append(ended(run))
    assert runs[0] == runs[1]


def test_within_a_mask() -> None:
    mask = AWAY[0] < -2.0
    given = {"start": "ball:12,13.5,14,4", "max_steps": 60, "threads": 1}
    result = segment(image(0.1), extension="fast-marching", mask=mask, **given)
    labels = np.asarray(result.labels) > 0
    assert not labels[~mask].any() and metrics.dice(labels, mask) > 0.9
