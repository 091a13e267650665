"""accelsurf as the click benchmark drives it, on a ball that is found at once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.text.clicks import read_clicks
from benchmarks.clicks import methods, own
from benchmarks.clicks.games import Hints
from benchmarks.clicks.person import PersonClick, ball_voxels, drawn_box, next_click


def two_balls() -> tuple[Volume, np.ndarray]:
    """A bright ball that is the object, and one like it that touches it."""
    z, y, x = np.indices((20, 24, 36)) - np.array([9, 11, 11])[:, None, None, None]
    truth = z**2 + y**2 + x**2 < 6.5**2
    values = 100.0 * (truth | (z**2 + y**2 + (x - 12) ** 2 < 6.5**2))
    values += np.random.default_rng(0).normal(0.0, 5.0, truth.shape)
    return Volume.from_array(values.astype(np.float32), 1.0), truth


def test_clicks_are_typed_in_the_worlds_coordinates() -> None:
    geometry = Geometry((9, 9, 9), (1.0, 2.0, 3.0), (10.0, -20.0, 30.0))
    truth = np.zeros((9, 9, 9), bool)
    truth[2:7, 3:6, 4:6] = True
    image = Volume(np.zeros((9, 9, 9), np.float32), geometry)
    click = next_click(truth, None, geometry)
    assert click is not None and click.index == (4, 4, 4)
    assert own.text_of(click, image) == "ball:22.0,-12.0,34.0,1.5"
    assert own.text_of(click._replace(radius=0.5), image) == "point:22.0,-12.0,34.0"


@pytest.mark.parametrize(
    "spacing", [(1.0, 1.0, 1.0), (0.7, 0.7, 0.7), (2.5, 0.9, 0.9), (3.0, 0.35, 0.61)]
)
def test_the_program_reads_the_voxels_that_the_person_has_painted(
    spacing: tuple[float, float, float],
) -> None:
    geometry = Geometry((15, 17, 19), spacing, (-11.3, 204.7, 0.1))
    image, voxel = Volume(np.zeros(geometry.shape, np.float32), geometry), (7, 8, 9)
    x, y, z = (float(value) for value in geometry.index_to_world(np.array(voxel, float)))
    # Depths are distances between voxels' centres: half of them often end at a centre.
    far = {
        math.hypot(a * spacing[0], b * spacing[1], c * spacing[2])
        for a, b, c in np.ndindex(2, 2, 2)
    }
    for radius in sorted((far | {2.0 * each for each in far}) - {0.0}):
        click = PersonClick("inside", voxel, (x, y, z), radius)
        (read,) = read_clicks([own.text_of(click, image)], "inside", image)
        box, ball = ball_voxels(click, geometry)
        assert read.box == box and (read.mask == ball).all(), radius


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["accelsurf", "accelsurf-rerun", "accelsurf-start"])
def test_every_one_of_ours_obeys_its_clicks(name: str) -> None:
    image, truth = two_balls()
    session = methods.METHODS[name].segmenter({})(image, Hints())
    first = session.click(PersonClick("inside", (9, 11, 11), (11.0, 11.0, 9.0), 3.0))
    assert first.dtype == bool and first.shape == truth.shape and first[9, 11, 11]
    second = session.click(PersonClick("outside", (9, 11, 23), (23.0, 11.0, 9.0), 3.0))
    assert second[9, 11, 11] and not second[9, 11, 20:27].any()
    assert 2 * (second & truth).sum() / (second.sum() + truth.sum()) > 0.85


def test_strokes_are_typed_as_paths_and_boxes_in_voxels() -> None:
    image, truth = two_balls()
    line = tuple((9, 11, x) for x in range(7, 16))
    stroke = PersonClick("inside", (9, 11, 11), (11.0, 11.0, 9.0), 1.5, line)
    assert own.text_of(stroke, image).startswith("path:7,11,9,1.5;8,11,9,1.5;")
    (read,) = read_clicks([own.text_of(stroke, image)], "inside", image)
    box, pen = ball_voxels(stroke, image.geometry)
    assert read.box == box and (read.mask == pen).all()
    # With the box the ball that touches is no part of the object.
    session = own.Corrected(image, Hints(box=drawn_box(truth)))
    labels = session.click(PersonClick("inside", (9, 11, 11), (11.0, 11.0, 9.0), 3.0))
    assert not (labels & (np.arange(36) > 17)).any() and (labels & truth).sum() > 0.9 * truth.sum()
    assert session.confidence is not None and 0.0 <= session.confidence <= 1.0


def test_a_stated_size_reaches_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str | None] = []

    def watched(volume: Volume, config: own.RunConfig) -> None:
        seen.append(config.size)
        raise StopIteration

    monkeypatch.setattr(own, "segment", watched)
    for name in ("accelsurf", "accelsurf-rerun"):
        session = methods.METHODS[name].segmenter({})(two_balls()[0], Hints(1234.5))
        with pytest.raises(StopIteration):
            session.click(PersonClick("inside", (9, 11, 11), (11.0, 11.0, 9.0), 3.0))
    assert seen == ["1234.500000mm3"] * 2
