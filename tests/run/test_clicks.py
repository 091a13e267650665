"""Clicks through whole runs: they hold, they are repeated, and what contradicts itself is refused."""

import itertools

import numpy as np
import pytest

from accelsurf import io
from accelsurf.api.segment import evolve, result_of, segment, segment_objects
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.click_bounds import click_bounds
from accelsurf.grid.clicks import Clicks
from accelsurf.image.volume import Volume
from accelsurf.run.arguments import given_clicks, psi_of
from accelsurf.run.run import Run
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig

#: Grids: even, thick slices, a plane, one of three levels.
GRIDS = {
    "even": ((20, 22, 24), (1.0, 1.0, 1.0)),
    "thick": ((7, 28, 26), (5.0, 1.0, 0.9)),
    "plane": ((1, 36, 40), (1.0, 1.0, 1.0)),
    "deep": ((29, 30, 31), (1.0, 1.0, 1.0)),
}
ENERGIES = ("seeded", "chan-vese", "threshold:50,", "geodesic", "local-region", "likelihood")


def phantom(grid, seed=0, radius=8.0):
    """A bright ball in noise, and the distance from its middle, mm."""
    shape, spacing = GRIDS[grid]
    index = np.indices(shape, float)
    middle = [(n - 1) / 2 for n in shape]
    distance = np.sqrt(
        sum(((i - m) * h) ** 2 for i, m, h in zip(index, middle, spacing, strict=True))
    )
    noise = np.random.default_rng(seed).normal(0, 8, shape)
    return Volume.from_array(
        (100.0 * (distance < radius) + noise).astype(np.float32), spacing
    ), distance


def drawn(rng, volume):
    """A point, a ball or a thin stroke anywhere."""
    shape, spacing = volume.array.shape, volume.geometry.spacing
    mask = np.zeros(shape, bool)
    place = np.array([rng.integers(n) for n in shape])
    kind = rng.integers(3)
    if kind == 1:
        index = np.indices(shape, float)
        far = sum(((i - p) * h) ** 2 for i, p, h in zip(index, place, spacing, strict=True))
        mask |= far < rng.uniform(0.8, 3.0) ** 2
    walk = place.astype(float)
    for _ in range(12 if kind == 2 else 1):
        mask[tuple(np.clip(np.rint(walk), 0, np.array(shape) - 1).astype(int))] = True
        walk += rng.normal(0, 0.8, 3)
    return mask


def union(masks, volume):
    return np.any([np.zeros(volume.array.shape, bool), *masks], axis=0)


def clicks_for(rng, volume, distance, allowed):
    """Random clicks that do not contradict each other; the first is in the object."""
    inside, outside = [(distance < 2.5) & allowed], []
    for _ in range(rng.integers(1, 6)):
        side, other = (inside, outside) if rng.random() < 0.5 else (outside, inside)
        mask = drawn(rng, volume) & ~union(other, volume)
        mask = mask & allowed if side is inside else mask
        if mask.any():
            side.append(mask)
    return inside, outside


#: How many levels the grids are tried with, in turn.
LEVELS = {"even": (2, 1), "thick": (2, 1), "plane": (2, 1), "deep": (3, 2)}


GRIDS_AND_LEVELS = [(grid, tried[turn]) for turn in (0, 1) for grid, tried in LEVELS.items()]
#: Every energy on every grid and, but for three levels, with each number of levels; every energy with every flow. With
#: as many steps as there is time for.
CASES = [
    (list(FLOWS)[(place + number) % len(FLOWS)], energy, grid, levels)
    for place, energy in enumerate(ENERGIES)
    for number, (grid, levels) in enumerate(GRIDS_AND_LEVELS)
]


@pytest.mark.sampled(12)
@pytest.mark.parametrize(("flow", "energy", "grid", "levels"), CASES)
def test_every_clicked_voxel_is_on_its_side(flow, energy, grid, levels):
    number = CASES.index((flow, energy, grid, levels))
    rng = np.random.default_rng([16, number])
    volume, distance = phantom(grid, number)
    allowed = np.ones(volume.array.shape, bool)
    options = {}
    if rng.random() < 0.4:
        allowed[..., :3] = False
    if rng.random() < 0.4 and energy != "seeded":
        options["start"] = "center"
    inside, outside = clicks_for(rng, volume, distance, allowed)
    one, other = union(inside, volume), union(outside, volume)
    config = RunConfig(
        **{
            "start": "clicks",
            "energy": energy,
            "flow": flow,
            "levels": levels,
            "threads": 1,
            **options,
        },
        max_steps=int(rng.choice([2, 8])),
    )
    clicks = given_clicks("inside", inside, volume)
    clicks += given_clicks("outside", outside, volume) if outside else []
    seen = set()
    with Run(
        volume,
        config,
        arrays={} if allowed.all() else {"mask": psi_of("mask", allowed, volume.geometry)},
        clicks=clicks,
    ) as run:
        for step in run:
            # In the run itself too: on the image's own grid, and on coarser ones, whose voxels hold several.
            seen.add(step.record.level)
            assert click_bounds(run.prepared.clicks.of(1), run.grid).is_met_by(step.surface.psi), (
                step.record.step
            )
            if step.record.level == 0:
                now = step.surface.labels > 0
                assert now[one].all() and not now[other].any(), step.record.step
        labels = result_of(run).labels > 0
    assert labels[one].all() and not labels[other].any()
    assert seen and (levels == 1 or max(seen) > 0), "the test shows nothing of coarse levels"


def test_every_energy_of_a_click_is_tried_on_every_grid_and_with_every_flow():
    pairs = {(case[1], case[2], case[3]) for case in CASES}
    assert pairs == {
        (energy, grid, levels)
        for energy in ENERGIES
        for grid, tried in LEVELS.items()
        for levels in tried
    }
    assert {case[:2] for case in CASES} == set(
        itertools.product(FLOWS, ENERGIES)
    ) and LEVELS.keys() == GRIDS.keys()
    assert {name.split(":")[0] for name in ENERGIES} >= {
        name for name, term in TERMS.items() if term.example
    }


def test_without_start_and_energy_clicks_choose_both():
    volume, distance = phantom("even")
    result = segment(volume, inside="ball:12,10,10,2", threads=1)
    assert result.config.energy == "seeded" and result.config.start == ("clicks",)
    truth = distance < 8
    assert 2 * (truth & (result.labels > 0)).sum() / (truth.sum() + result.labels.sum()) > 0.8
    assert result.stop.reason == "converged"
    # A click has the voxels on its rim, of which a start's surface passes through the centres.
    named = segment(volume, inside="ball:12,10,10,2.1", energy="chan-vese", threads=1, max_steps=0)
    assert (
        named.labels.sum()
        == segment(volume, start="ball:12,10,10,2.1", threads=1, max_steps=0).labels.sum()
    )
    both = segment(
        volume, inside="point:12,10,10", start="ball:12,10,10,2.1", energy="chan-vese", max_steps=0
    )
    assert both.config.start == ("ball:12,10,10,2.1",) and both.labels.sum() == named.labels.sum()
    assert RunConfig(inside="point:1,1,1", energy="chan-vese").energy == "chan-vese"
    assert RunConfig(inside="point:1,1,1").replace(cfl=0.4).energy == "seeded"
    assert RunConfig(energy="chan-vese").replace(inside="point:1,1,1").energy == "chan-vese"
    assert RunConfig().replace(inside="point:1,1,1").energy == "seeded"
    name = "mr-white-matter"
    assert RunConfig(inside="point:1,1,1", preset=name).energy == RunConfig(preset=name).energy
    assert (
        RunConfig(inside="point:1,1,1").replace(preset=name).energy == RunConfig(preset=name).energy
    )


def test_clicks_in_python_are_texts_masks_meshes_points_and_balls():
    volume, distance = phantom("even")
    core = distance < 2.0
    one = segment(volume, inside="ball:11.5,10.5,9.5,2", outside="point:2,3,4", threads=1)
    ball = (11.5, 10.5, 9.5, 2.0)
    mask = Volume(core.astype(np.uint8), volume.geometry)
    for inside in (core, mask, [core], ball, [ball], np.array([ball]), ["ball:11.5,10.5,9.5,2"]):
        clicks = Clicks(tuple(given_clicks("inside", inside, volume)), core.shape)
        np.testing.assert_array_equal(clicks.mask("inside"), core)
    for outside in ((2, 3, 4), [(2, 3, 4)], np.array([2.0, 3.0, 4.0])):
        clicks = Clicks(tuple(given_clicks("outside", outside, volume)), core.shape)
        assert np.argwhere(clicks.mask("outside")).tolist() == [[4, 3, 2]]
    by_array = segment(volume, inside=core, outside=(2, 3, 4), threads=1)
    np.testing.assert_array_equal(by_array.psi, one.psi)
    assert by_array.given == ("inside", "outside") and by_array.config.energy == "seeded"
    mesh = segment(volume, inside="ball:11.5,10.5,9.5,4", energy="chan-vese", max_steps=0).surface
    result = segment(volume, inside=[mesh, (2, 3, 4)], energy="chan-vese", threads=1, max_steps=0)
    assert (
        abs(int(result.labels.sum()) - 1 - int((distance < 4).sum())) < 20
        and result.labels[4, 3, 2]
    )
    for wrong in (5, (1, 2), [None], object()):
        with pytest.raises(UsageError, match="inside: a .* was given, expected a text, a mask"):
            segment(volume, inside=wrong)


def two_balls(tmp_path, rows, header="id,x,y,z,r,side"):
    index = np.indices((24, 24, 44), float)
    image = sum(
        100.0 * (sum((i - m) ** 2 for i, m in zip(index, middle, strict=True)) < 64)
        for middle in ((11.5, 11.5, 11), (11.5, 11.5, 31))
    )
    image += np.random.default_rng(1).normal(0, 6, image.shape)
    file = tmp_path / "objects.csv"
    file.write_text("\n".join([header, *rows]))
    return Volume.from_array(image.astype(np.float32)), str(file)


ROWS = (
    "1,11,11,11,1.9,inside",
    "7,31,11,11,1.9,inside",
    "7,31,13,16,1.2,outside",
    "1,2,21,2,,inside",
    "0,21,2,2,2,inside",
)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("energy", [None, "chan-vese", "threshold:50,"])
def test_several_objects_by_clicks(energy, tmp_path):
    volume, file = two_balls(tmp_path, ROWS)
    options = {} if energy is None else {"energy": energy}
    result = segment_objects(volume, file, threads=1, max_steps=30, **options)
    assert result.config.energy == (energy or "seeded")
    labels = result.labels
    assert labels[11, 11, 11] == 1 and labels[11, 11, 31] == 7 and labels[2, 21, 2] == 1
    assert labels[16, 13, 31] != 7 and labels[2, 2, 21] == 0
    # What is no object competes, and is left out.
    assert [one.id for one in result.objects] == [1, 7] and set(np.unique(labels)) == {0, 1, 7}
    # The click outside of 7 lies within its ball, and cuts off what is nearer to it.
    assert 1500 < (labels == 1).sum() and 1000 < (labels == 7).sum() < 2600


@pytest.mark.threads
def test_models_of_several_objects_are_the_same_on_any_number_of_threads(tmp_path):
    """They are made side by side."""
    volume, file = two_balls(tmp_path, ROWS)
    made = []
    for threads in (1, 2, 3):
        run = Run(volume, RunConfig(objects=file, max_steps=30, threads=threads))
        models = [one.context.click_model() for one in run.objects]
        assert len(models) == 2
        made.append([array.tobytes() for one in models for array in (one.field, one.inside)])
    assert made[0] == made[1] == made[2]


def test_no_object_is_left_out_of_the_steps_and_competes(tmp_path):
    volume, file = two_balls(tmp_path, ["1,11,11,11,2,inside", "0,31,11,11,2,inside"])
    ids = {
        step.object_id
        for step in evolve(volume, objects=file, energy="threshold:50,", threads=1, max_steps=20)
    }
    assert ids == {1}
    whole = segment_objects(
        volume,
        two_balls(tmp_path, ["1,11,11,11,9,inside", "1,31,11,11,2,inside"])[1],
        energy="threshold:50,",
        threads=1,
        max_steps=20,
    )
    assert whole.labels[11, 11, 37] == 1
    volume, file = two_balls(tmp_path, ["1,11,11,11,9,inside", "0,31,11,11,2,inside"])
    less = segment_objects(volume, file, energy="threshold:50,", threads=1, max_steps=20)
    assert not (less.labels[:, :, 24:] > 0).any()


def test_outside_with_objects_is_in_none_of_them(tmp_path):
    volume, file = two_balls(tmp_path, ROWS[:3])
    result = segment_objects(volume, file, outside="point:31,11,9", threads=1, max_steps=20)
    assert result.labels[9, 11, 31] == 0 and result.labels[11, 11, 11] == 1
    starts = np.zeros(volume.array.shape, int)
    starts[10:13, 10:13, 10:13], starts[10:13, 10:13, 30:33] = 3, 5
    result = segment_objects(
        volume, starts, outside="ball:11,16,11,1.5", energy="chan-vese", threads=1, max_steps=12
    )
    assert result.labels[11, 16, 11] == 0 and [one.id for one in result.objects] == [3, 5]


def test_nothing_outside_of_the_box_is_in_the_object():
    volume, distance = phantom("even")
    box = "6,4,4,14,16,15"
    for options in (
        {"inside": "ball:11,10,10,2"},
        {"start": "ball:11,10,10,2", "energy": "chan-vese"},
    ):
        result = segment(volume, box=box, threads=1, **options)
        found = np.argwhere(result.labels)[:, ::-1]
        assert (found >= (6, 4, 4)).all() and (found <= (14, 16, 15)).all() and len(found) > 500
        assert result.labels.shape == volume.array.shape
    assert found.max(axis=0).tolist() == [14, 16, 15]
    # The surroundings of the box are seen, and with --roi they are that region.
    with Run(volume, RunConfig(start="ball:11,10,10,2", box="10,8,8,14,12,12")) as run:
        assert run.geometry.shape == (20, 22, 24)
        assert (run.prepared.mask_distance < 0).sum() == 5 * 5 * 5
    with Run(
        volume, RunConfig(start="ball:11,10,10,2", box="10,8,8,14,12,12", roi="8,6,6,16,14,14")
    ) as run:
        assert (
            run.geometry.shape == (9, 9, 9) and (run.prepared.mask_distance < 0).sum() == 5 * 5 * 5
        )


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (
            {"inside": "point:90,1,1"},
            InputError,
            "inside 'point:90,1,1': 90,1,1 lies outside of the volume",
        ),
        (
            {"inside": "ball:9,9,9,3", "outside": "point:9,9,9"},
            InputError,
            "voxel 9,9,9 .* is clicked both",
        ),
        (
            {"inside": "ball:9,9,9,3", "box": "8,8,8,15,15,15"},
            InputError,
            "voxel .* outside of the mask or the box",
        ),
        (
            {"inside": "point:1,1,1", "roi": "8,8,8,15,15,15"},
            InputError,
            "voxel 1,1,1 .* outside of the region",
        ),
        (
            {"inside": "point:9,9,9", "box": "5,5"},
            UsageError,
            "box: 5,5 was given, expected X0,Y0,Z0,X1,Y1,Z1",
        ),
        ({"energy": "seeded"}, UsageError, "seeded was given without a click inside"),
        (
            {"outside": "point:1,1,1", "energy": "seeded", "start": "center"},
            UsageError,
            "without a click inside",
        ),
        ({"start": "clicks"}, UsageError, "there is no click inside"),
        (
            {"inside": "point:9,9,9", "size": "3"},
            UsageError,
            "size: 3 was given, expected a volume such as 250ml",
        ),
        (
            {"inside": "point:9,9,9", "size": "0ml"},
            UsageError,
            "size: 0ml was given, expected a volume above 0",
        ),
    ],
)
def test_what_cannot_be_is_refused(options, error, message):
    volume, _ = phantom("even")
    with pytest.raises(error, match=message):
        segment(volume, threads=1, **options)


def test_clicks_outside_of_a_mask_are_refused_or_say_nothing_new(tmp_path):
    volume, _ = phantom("even")
    mask = np.zeros(volume.array.shape, np.uint8)
    mask[4:16, 4:16, 4:16] = 1
    with pytest.raises(
        InputError, match="voxel 2,2,2 .* is clicked inside, and lies outside of the mask"
    ):
        segment(volume, inside="point:2,2,2", mask=mask)
    result = segment(
        volume, inside="point:9,9,9", outside="point:2,2,2", mask=mask, threads=1, max_steps=3
    )
    assert not result.labels[2, 2, 2] and result.labels[9, 9, 9]
    file = tmp_path / "mask.nrrd"
    io.write(Volume(mask, volume.geometry), file)
    with pytest.raises(InputError, match="outside of the mask"):
        segment(volume, inside="point:2,2,2", mask=str(file))


def test_objects_say_which_one_a_click_is_in(tmp_path):
    volume, file = two_balls(tmp_path, ROWS)
    with pytest.raises(UsageError, match="inside: point:9,9,9 was given with objects"):
        segment_objects(volume, file, inside="point:9,9,9")
    with pytest.raises(UsageError, match="inside: clicks were given with objects"):
        segment_objects(volume, np.ones(volume.array.shape, int), inside=(9, 9, 9))


def test_the_size_helps_to_choose_the_start():
    volume, _ = phantom("even")
    small, large = (
        segment(volume, inside="ball:12,10,10,1.5", size=size, threads=1, max_steps=0).volume_mm3
        for size in ("300mm3", "2.5cm3")
    )
    assert small < 700 < 1800 < large
