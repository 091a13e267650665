"""Phantoms in time: exact truth, the same frames alone and together, recipes that come with accelsurf."""

import csv
import json
import math

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.errors import UsageError
from accelsurf.phantoms.motions import MovingPhantom, load_motion, motion_from
from accelsurf.phantoms.recipe_files import read_recipe, sequence_names
from accelsurf.phantoms.tissues import phantom_from

SMALL = {"shape": [40, 24, 24], "radius": 6.0}


def phantom(**values: object) -> MovingPhantom:
    return MovingPhantom(motion_from({**SMALL, **values}, "test"))


def measured(frame: np.ndarray, one: MovingPhantom) -> tuple[float, np.ndarray]:
    """Volume (mm3) and centroid (x, y, z) of a frame without noise, whose values are volume fractions."""
    index = np.argwhere(frame > 0)
    weight = frame[frame > 0].astype(float)
    centre = one.geometry.index_to_world(
        (index * weight[:, None]).sum(axis=0, keepdims=True) / weight.sum()
    )[0]
    return float(weight.sum()) * one.geometry.voxel_volume, centre


@pytest.mark.sampled
@pytest.mark.parametrize(
    "motion", ["translation", "acceleration", "rotation", "deformation", "beat"]
)
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 1.0)])
def test_volume_and_centroid_of_each_frame_are_those_of_the_truth(
    motion: str, spacing: tuple
) -> None:
    one = phantom(
        motion=motion, speed=1.0, spacing=list(spacing), shape=[int(40 / spacing[0]), 26, 26]
    )
    for row in one.rows()[::3]:
        volume, centre = measured(one.frame(row.frame).array, one)
        assert volume == pytest.approx(row.volume_mm3, rel=0.01)
        np.testing.assert_allclose(centre, row.center, atol=0.03)


def test_speeds_are_those_that_were_asked_for() -> None:
    moving = phantom(motion="translation", speed=2.0, direction=[3.0, 0.0, 4.0])
    centres = np.array([row.center for row in moving.rows()])
    np.testing.assert_allclose(
        np.diff(centres, axis=0), np.tile([0.72, 0.0, 0.96], (10, 1)), atol=1e-12
    )
    faster = np.array([row.center[0] for row in phantom(motion="acceleration", speed=2.0).rows()])
    np.testing.assert_allclose(
        np.diff(faster, 2), 2.0 * 12.0 / 100.0, atol=1e-12
    )  # s = v T (t/T)^2
    assert faster[-1] - faster[0] == pytest.approx(12.0)


def test_a_beat_closes_and_a_deformation_keeps_the_volume() -> None:
    beat = phantom(motion="beat", frames=21)
    np.testing.assert_allclose(beat.frame(0).array, beat.frame(10).array, atol=1e-6)
    assert beat.rows()[2].volume_mm3 > 1.5 * beat.rows()[8].volume_mm3
    volumes = [row.volume_mm3 for row in phantom(motion="deformation").rows()]
    np.testing.assert_allclose(volumes, 4 / 3 * math.pi * 6**3, rtol=1e-12)


def test_a_division_keeps_area_or_volume_and_names_the_parent() -> None:
    for shape, rows in (([60, 40, 1], "area"), ([60, 40, 40], "volume")):
        one = phantom(motion="division", shape=shape, speed=4.0)
        table = one.rows()
        whole = table[0].volume_mm3
        pieces = [row for row in table if row.frame == 10]
        assert [row.id for row in pieces] == [2, 3] and {row.parent for row in pieces} == {1}, rows
        assert sum(row.volume_mm3 for row in pieces) == pytest.approx(whole)
        at = min(row.frame for row in table if row.id == 2)
        assert (
            at == 4
            and set(np.unique(one.truth(at))) == {0, 2, 3}
            and set(np.unique(one.truth(at - 1))) == {0, 1}
        )


def test_bodies_pass_touch_leave_and_come_back() -> None:
    two = phantom(motion="passing", shape=[48, 40, 20], speed=3.0)
    assert all(set(np.unique(two.truth(n))) == {0, 1, 2} for n in range(11))
    nearest = min(math.dist(*(body.center for body in two.recipe.bodies(n))) for n in range(11))
    assert nearest == pytest.approx(2 * 6 + 2)
    bounce = phantom(motion="bounce", shape=[60, 20, 20], speed=3.0)
    gaps = [math.dist(*(body.center for body in bounce.recipe.bodies(n))) - 12 for n in range(11)]
    assert gaps[5] == pytest.approx(0.0) and gaps == pytest.approx(gaps[::-1]) and gaps[0] > 10
    away = phantom(motion="return", speed=8.0, shape=[32, 24, 24])
    shown = [row.shown for row in away.rows()]
    assert shown[0] and shown[-1] and not shown[5] and shown == shown[::-1]


def test_frames_alone_are_those_of_all_and_seeds_differ() -> None:
    one, other = (
        phantom(motion="translation", noise=0.5, seed=3),
        phantom(motion="translation", noise=0.5, seed=4),
    )
    backwards = {n: one.frame(n).array for n in reversed(range(11))}
    for n in (0, 7):
        np.testing.assert_array_equal(
            phantom(motion="translation", noise=0.5, seed=3).frame(n).array, backwards[n]
        )
        assert (other.frame(n).array != backwards[n]).any()
    assert (one.frame(1).array != one.frame(2).array).mean() > 0.9


def test_noise_drift_and_empty_frames() -> None:
    plain = phantom(motion="translation", contrast=10.0, background=5.0, drift=0.4, empty=[2])
    assert plain.frame(0).array.max() == pytest.approx(15.0) and plain.frame(
        10
    ).array.max() == pytest.approx(11.0)
    assert set(np.unique(plain.frame(2).array)) == {5.0}
    assert [row.shown for row in plain.rows()[:4]] == [True, True, False, True]
    noisy = phantom(motion="translation", noise=0.7, empty=[2]).frame(2).array
    assert noisy.std() == pytest.approx(0.7, rel=0.02)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"motion": "flight"}, "motion"),
        ({"speed": -1.0}, "speed"),
        ({"contrast": 0.0}, "contrast"),
        ({"direction": [0.0, 0.0, 0.0]}, "points somewhere"),
        ({"empty": [11]}, "frame 11"),
        ({"side": 3.0}, "side"),
        ({"shape": [4000, 4000, 4000]}, "voxels"),
    ],
)
def test_what_cannot_be_made_is_refused(values: dict, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        motion_from({"motion": "translation", **SMALL, **values})


@pytest.mark.parametrize("name", sequence_names())
def test_recipes_that_come_with_accelsurf_show_their_bodies(name: str) -> None:
    phantom = phantom_from(read_recipe(name)[1])
    assert phantom.recipe.name == name
    assert sum(row.shown for row in phantom.rows()) > 0.5 * len(phantom)


def test_the_command_writes_the_sequence_its_truth_and_a_table(tmp_path, capsys) -> None:
    recipe = 'motion = "beat"\nshape = [16, 16, 16]\nradius = 5.0\nframes = 4\nframe_time = 0.5\n'
    (tmp_path / "tiny.toml").write_text(recipe)
    words = ["synth", str(tmp_path / "tiny.toml"), "-o", str(tmp_path)]
    assert cli.execute(words) == 0
    sequence = io.read_sequence(tmp_path / "tiny.nii.gz")
    truth = io.read_sequence(tmp_path / "tiny_truth.nii.gz")
    one = MovingPhantom(load_motion(tmp_path / "tiny.toml"))
    assert sequence.times == (0.0, 0.5, 1.0, 1.5) and sequence.time_unit == "s"
    for n in range(4):
        np.testing.assert_array_equal(sequence.frame(n).array, one.frame(n).array)
        np.testing.assert_array_equal(truth.frame(n).array, one.truth(n))
    rows = list(csv.DictReader((tmp_path / "tiny_truth.csv").read_text().splitlines()))
    assert [float(row["volume_ml"]) for row in rows] == pytest.approx(
        [1e-3 * row.volume_mm3 for row in one.rows()]
    )
    description = json.loads((tmp_path / "tiny.json").read_text())
    assert description["recipe"]["motion"] == "beat" and len(description["outputs"]) == 3
    capsys.readouterr()
    assert cli.execute(words) != 0 and "overwrite" in capsys.readouterr().err


def test_a_seed_and_a_name_that_cannot_be_are_one_clear_line(tmp_path, capsys) -> None:
    assert cli.execute(["synth", "ball_moving", "-o", str(tmp_path), "--seed", "-1"]) == 2
    assert "seed = -1 given" in capsys.readouterr().err
    assert cli.execute(["synth", "ball_flying", "-o", str(tmp_path)]) == 2
    assert "ball_moving" in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize("shape", [[20, 17, 9], [20, 17, 1]])
def test_a_voxel_has_the_share_of_its_points_that_is_inside(shape: list[int]) -> None:
    """Also far from the surface, where no point is looked at; turned, on uneven spacing."""
    values = {
        "motion": "rotation",
        "shape": shape,
        "spacing": [1.0, 1.3, 2.1],
        "radius": 6.0,
        "speed": 0.3,
    }
    phantom = MovingPhantom(motion_from(values, "turning"))
    (body,) = phantom.recipe.bodies(2)
    axes = [
        (np.arange(n) - (n - 1) / 2) * h for n, h in zip(shape, phantom.recipe.spacing, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    steps, inverse, total = (-1 / 3, 0.0, 1 / 3), np.linalg.inv(body.matrix), 0.0
    for x in steps:
        for y in steps:
            for z in steps if shape[2] > 1 else (0.0,):
                points = grid + np.array([x, y, z]) * phantom.recipe.spacing - body.center
                total += (np.linalg.norm(points @ inverse.T, axis=-1) < 1.0).astype(float)
    share = (total / (27 if shape[2] > 1 else 9)).transpose(2, 1, 0)
    assert 0 < (share == 1.0).sum() < (share > 0.0).sum()
    np.testing.assert_allclose(phantom.frame(2).array, share, atol=1e-6)
