"""What noise asks of the default energy: a weight of the area, and nothing without noise."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.api.segment import segment, segment_objects
from accelsurf.image.noise import WEIGHT
from accelsurf.interact.refine import refine
from accelsurf.measure.metrics import dice
from accelsurf.run import start_checks

N = 48
START = "ball:27,20,25,5vox"
PLAIN = "chan-vese:area=0"


def cube(noise, seed=1):
    truth = np.zeros((N,) * 3, bool)
    truth[(slice(N // 4, 3 * N // 4),) * 3] = True
    return truth, (truth + np.random.default_rng(seed).normal(0, noise, truth.shape)).astype(
        np.float32
    )


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_surface_does_not_follow_raw_noise(seed):
    truth, image = cube(1.0, seed)
    plain = segment(image, start=START, energy=PLAIN, threads=1)
    found = segment(image, start=START, threads=1)
    assert dice(found.labels, truth) > dice(plain.labels, truth) + 0.01
    assert found.history[-1].area_mm2 < 0.85 * plain.history[-1].area_mm2


def test_without_noise_every_byte_is_that_of_the_plain_energy():
    image = cube(0.0)[1]
    plain, found = (
        segment(image, start=START, energy=energy, threads=1) for energy in (PLAIN, "chan-vese")
    )
    assert found.terms[0]["area"] == 0.0
    assert found.psi.tobytes() == plain.psi.tobytes()


def test_the_weight_goes_with_the_variance_and_is_told():
    """On the scale of the image that energies see: 0 and 1 at its percentiles."""
    for noise in (0.5, 1.0):
        image = cube(noise)[1]
        result = segment(image, start=START, max_steps=1, threads=1)
        width = np.diff(np.percentile(image, (0.5, 99.5)))[0]
        assert result.terms[0]["area"] == pytest.approx(WEIGHT * (noise / width) ** 2, rel=0.03)


def test_the_weight_is_the_same_on_all_levels_and_boxes():
    truth, image = cube(0.6)
    labels = np.zeros(truth.shape, np.uint8)
    labels[20:28, 20:28, 20:28] = 4
    want = segment(image, start=START, max_steps=1, levels=1, threads=1).terms[0]["area"]
    assert want > 0
    coarse = segment(image, start=START, max_steps=1, levels=2, threads=1, energy="chan-vese")
    boxed = segment_objects(image, labels, max_steps=1, threads=1)
    assert coarse.terms[0]["area"] == boxed.objects[0].terms[0]["area"] == want


def test_it_is_added_to_smoothness_and_given_it_is_as_given():
    image = cube(0.6)[1]
    words = {"start": START, "levels": 1, "threads": 1, "max_steps": 12}
    plain = segment(image, energy=PLAIN, smoothness=0.05, **words)
    given = segment(image, energy="chan-vese:area=0.03", smoothness=0.02, **words)
    assert given.terms[0]["area"] == 0.03
    assert given.psi.tobytes() == plain.psi.tobytes()
    by_noise = segment(image, smoothness=0.05, **words)
    assert by_noise.history[-1].area_mm2 < plain.history[-1].area_mm2


def test_a_start_that_it_would_pull_in_is_told_with_what_to_try():
    truth, image = cube(3.0)
    result = segment(image, start="ball:24,24,24,2.5vox", max_steps=1, levels=1, threads=1)
    (line,) = result.warnings
    assert (
        line.startswith("area: the start has a radius of about ")
        and "try --energy chan-vese:area=" in line
    )
    less = line.split("try --energy ")[1].split(",")[0]
    assert (
        segment(
            image, start="ball:24,24,24,2.5vox", energy=less, max_steps=1, levels=1, threads=1
        ).warnings
        == []
    )


def test_a_start_that_is_large_enough_is_not_copied_for_that(monkeypatch):
    """The check needs the surface twice: 5 bytes a voxel."""
    asked = []
    monkeypatch.setattr(start_checks, "area_line", lambda *given: asked.append(given) or [])
    image = cube(1.0)[1]
    words = {"start": START, "max_steps": 1, "levels": 1, "threads": 1}
    segment(image, **words)
    assert asked == []
    segment(image, smoothness=0.01, **words)
    segment(cube(3.0)[1], **words | {"start": "ball:24,24,24,2.5vox"})
    assert len(asked) == 2


def test_a_correction_has_the_weight_of_the_run():
    truth, image = cube(0.6)
    result = segment(image, start=START, threads=1, keep_state="yes")
    z, y, x = 14, 24, 24
    side = "outside" if result.labels[z, y, x] else "inside"
    after = refine(result, **{side: f"point:{x},{y},{z}vox"}, near=6)
    changed = after.labels != result.labels
    assert changed.any() and after.objects[0].terms == result.objects[0].terms
    # With another weight the whole boundary in the region would move, and far more voxels change.
    assert changed.sum() < 0.3 * 6**3
