"""Region of interest, mask, channels, leak guard: what a run begins with and what it may not do."""

import json

import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import cli, io
from accelsurf.api.segment import evolve, segment
from accelsurf.energies.constraints.mask import mask_distance
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import channels
from accelsurf.measure.metrics import dice
from accelsurf.run.region_of_interest import cropped, region_of_interest
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.run_config import RunConfig

TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
SPACING, ORIGIN = (1.5, 1.0, 0.8), (-7.0, 3.0, 11.0)


def ball(shape=(28, 40, 46), direction=None):
    """A bright ball of 10 mm around the middle of an anisotropic grid: volume, truth, centre in world mm."""
    geometry = Geometry(shape, SPACING, ORIGIN, np.eye(3) if direction is None else direction)
    centre = geometry.center_world()
    world = geometry.index_to_world(np.moveaxis(np.indices(shape), 0, -1))
    truth = np.linalg.norm(world - centre, axis=-1) < 10
    scan = 100.0 * truth + np.random.default_rng(1).normal(0, 5, shape)
    return Volume(scan, geometry), truth, centre


def at(centre, radius):
    return "ball:" + ",".join(f"{c:.4f}" for c in centre) + f",{radius}"


# ----------------------------------------------------------------------------------------------------------- region


@pytest.mark.sampled(1)
@pytest.mark.parametrize("direction", [None, TURN])
def test_inside_the_region_it_is_the_run_on_the_cropped_volume(direction):
    volume, truth, centre = ball(direction=direction)
    box = (slice(3, 25), slice(5, 36), slice(4, 44))
    geometry = cropped(volume.geometry, box)
    index = np.array([[s.start, s.stop - 1] for s in box], float)
    words = "roi", ",".join(f"{v:g}" for v in (*index[::-1, 0], *index[::-1, 1])) + "vox"
    assert region_of_interest(words[1], volume.geometry) == box
    part = Volume(np.ascontiguousarray(volume.array[box]), geometry)
    whole = segment(volume, start=at(centre, 6), **dict([words]))
    alone = segment(part, start=at(centre, 6))
    np.testing.assert_array_equal(whole.psi[box], alone.psi)
    assert whole.labels.shape == volume.array.shape and dice(whole.labels, truth) > 0.98
    np.testing.assert_allclose(
        whole.surface.vertices.mean(axis=0), alone.surface.vertices.mean(axis=0), atol=1e-4
    )
    assert whole.volume_mm3 == alone.volume_mm3 and whole.surface.area == pytest.approx(
        alone.surface.area, rel=1e-5
    )


def test_a_region_in_world_mm_lies_where_it_says_and_cuts_the_object_there():
    volume, truth, (x, y, z) = ball()
    text = f"{x - 14},{y - 14},{z - 14},{x + 3},{y + 14},{z + 14}"
    result = segment(volume, start=at((x, y, z), 4), roi=text)
    world = volume.geometry.index_to_world(np.moveaxis(np.indices(truth.shape), 0, -1))
    within = world[..., 0] <= x + 3
    assert (
        not (result.labels > 0)[~within].any() and dice(result.labels[within], truth[within]) > 0.98
    )
    # The wall of the cut is half a voxel beyond the last one.
    last = world[..., 0][within].max()
    assert result.surface.vertices[:, 0].max() == pytest.approx(last + 0.4, abs=0.05)


@pytest.mark.parametrize(
    ("roi", "error", "words"),
    [
        ("1,2,3", UsageError, "roi: 1,2,3 was given, expected"),
        ("9,9,9,1,1,1", UsageError, "roi: "),
        ("900,900,900,990,990,990", InputError, "fewer than two of the image's voxels"),
        ("0,0,0,5,5,5vox", InputError, "lies outside of the region of interest"),
    ],
)
def test_bad_regions_are_told(roi, error, words):
    volume, _, centre = ball()
    with pytest.raises(error, match=words) as caught:
        segment(volume, start=at(centre, 4), roi=roi)
    assert "\n" not in str(caught.value)


# ------------------------------------------------------------------------------------------------------------- mask


def masked(tmp_path, volume, mask, name="mask.nii.gz"):
    io.write(Volume(mask.astype(np.uint8), volume.geometry), tmp_path / name)
    return str(tmp_path / name)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("levels", ["auto", 2])
@pytest.mark.parametrize(
    "flow", ["constant-density", "flowable-mass", "gradient", "sobolev", "momentum"]
)
def test_the_surface_never_leaves_the_mask(tmp_path, flow, levels):
    volume, truth, centre = ball()
    x = np.arange(46)[None, None, :]
    mask = np.broadcast_to(x < 27, truth.shape)
    words = dict(
        start=at(centre, 4),
        flow=flow,
        mask=masked(tmp_path, volume, mask),
        levels=levels,
        max_steps=300,
    )
    seen = []
    for step in evolve(volume, **words):
        if step.record.level == 0:
            seen.append(bool((step.surface.labels > 0)[~mask].any()))
    # The first step of a level may find a surface that a coarser grid has let through by part of a voxel.
    assert not any(seen[1:])
    result = segment(volume, **words)
    assert not (result.labels > 0)[~mask].any()
    assert dice(result.labels, truth & mask) > 0.97
    assert result.stop.reason == "converged"


def test_without_a_mask_it_does_leave():
    volume, truth, centre = ball()
    result = segment(volume, start=at(centre, 4))
    assert (result.labels > 0)[..., 27:].any() and dice(result.labels, truth) > 0.98


def test_bad_masks_are_told(tmp_path):
    volume, truth, centre = ball()
    start = at(centre, 4)
    with pytest.raises(InputError, match="it is empty"):
        segment(volume, start=start, mask=masked(tmp_path, volume, truth & False))
    far = truth & False
    far[:3] = True
    with pytest.raises(InputError, match="lies outside of the mask"):
        segment(volume, start=start, mask=masked(tmp_path, volume, far))
    other = Volume(truth.astype(np.uint8), Geometry(truth.shape, SPACING, (0.0, 0.0, 0.0)))
    io.write(other, tmp_path / "other.nii.gz")
    with pytest.raises(GeometryError, match="mask .*on another grid"):
        segment(volume, start=start, mask=str(tmp_path / "other.nii.gz"))
    with pytest.raises(InputError):
        segment(volume, start=start, mask=str(tmp_path / "absent.nii.gz"))


def test_a_mask_constraint_is_half_a_voxel_from_the_centres_next_to_it():
    mask = np.zeros((5, 6, 7), bool)
    mask[1:4, 2:5, 2:6] = True
    distance = mask_distance(mask, (2.0, 1.0, 1.0))
    np.testing.assert_array_equal(distance < 0, mask)
    assert distance[2, 2, 3] == -0.5 and distance[2, 1, 3] == 0.5
    assert (mask_distance(np.ones((3, 3, 3), bool), (1.0, 1.0, 1.0)) < -1000).all()


# --------------------------------------------------------------------------------------------------------- channels


def two_channels():
    """A ball that neither channel tells from what lies beside it: one sees a slab, the other a bar."""
    z, y, x = np.indices((32, 32, 36)) - 15.5
    rng = np.random.default_rng(3)
    one, two = np.abs(x) < 8, np.abs(y) < 8
    return [mask * 1.0 + rng.normal(0, 0.1, mask.shape) for mask in (one, two)], one & two


@pytest.mark.slow
@pytest.mark.parametrize("energy", ["likelihood:update=no", "likelihood:histogram,no"])
def test_two_channels_tell_what_one_cannot(energy):
    (first, second), truth = two_channels()
    words = dict(start="ball:15,15,15,5vox", max_steps=300, energy=energy)
    alone = dice(segment(first, **words).labels, truth)
    both = segment(first, channels=[second], **words)
    print(f"\n{energy}: {alone:.3f} alone, {dice(both.labels, truth):.3f} together")
    assert alone < 0.8
    assert dice(both.labels, truth) > 0.9
    assert [entry["channel"] for entry in both.terms[0]["channels"]] == [1, 2]


@pytest.mark.slow
@pytest.mark.parametrize("energy", ["chan-vese", "local-region:R=6"])
def test_two_noisy_channels_are_less_noisy_than_one(energy):
    z, y, x = np.indices((28, 28, 28)) - 13.5
    truth = z**2 + y**2 + x**2 < 9**2
    rng = np.random.default_rng(4)
    first, second = (truth + rng.normal(0, 1.0, truth.shape) for _ in range(2))
    words = dict(start="ball:13,13,13,6vox", max_steps=300, energy=energy)
    found = [dice(segment(first, channels=more, **words).labels, truth) for more in ([], [second])]
    print(f"\n{energy}: {found[0]:.3f} alone, {found[1]:.3f} together")
    assert found[1] > found[0] + 0.01 and found[1] > 0.9


def test_a_channel_is_chosen_by_its_number():
    (first, second), _ = two_channels()
    words = dict(start="ball:15,15,15,5vox", max_steps=100)
    swapped = segment(first, channels=[second], energy="chan-vese:channel=2", **words)
    np.testing.assert_array_equal(
        swapped.labels, segment(second, energy="chan-vese", **words).labels
    )
    with pytest.raises(UsageError, match="channel 3 of chan-vese was given, expected 1 to 2"):
        segment(first, channels=[second], energy="chan-vese:channel=3", **words)


@pytest.mark.slow
def test_the_same_channel_twice_is_the_same_as_once():
    (first, _), _ = two_channels()
    words = dict(start="ball:15,15,15,5vox", max_steps=60, levels=1)
    once, twice = segment(first, **words), segment(first, channels=[first], **words)
    assert twice.volume_mm3 == pytest.approx(once.volume_mm3, rel=1e-3)
    assert twice.history[0].potential == pytest.approx(once.history[0].potential, rel=1e-6)


def test_channels_on_other_grids_are_refused(tmp_path):
    volume, _, centre = ball()
    other = Volume(np.array(volume.array), Geometry(volume.array.shape, SPACING, (0.0, 0.0, 0.0)))
    with pytest.raises(GeometryError, match="channel .*another grid"):
        segment(volume, channels=[other], start=at(centre, 4))
    with pytest.raises(InputError):
        segment(volume, channel=str(tmp_path / "absent.nii"), start=at(centre, 4))


# ------------------------------------------------------------------------------------------------------- leak guard


def test_a_run_ends_when_the_object_is_larger_than_it_may_be():
    volume, _, centre = ball()
    free = segment(volume, start=at(centre, 4))
    held = segment(volume, start=at(centre, 4), max_volume=2500)
    assert free.stop.reason == "converged" and free.volume_mm3 > 4000 and not free.quality.leaked
    assert held.stop.reason == "leaked" and 2500 < held.volume_mm3 < 4000
    assert held.quality.leaked and "2500 mm3" in held.quality.warnings[0]
    assert segment(volume, start=at(centre, 4), max_volume=1e6).stop.reason == "converged"


def test_the_command_line_has_them_all(tmp_path, capsys):
    volume, truth, centre = ball()
    (tmp_path / "a").mkdir()
    io.write(
        Volume(volume.array.astype(np.float32), volume.geometry), tmp_path / "a" / "scan.nii.gz"
    )
    mask = masked(tmp_path, volume, np.broadcast_to(np.arange(46)[None, None, :] < 27, truth.shape))
    words = [
        "segment",
        str(tmp_path / "a" / "scan.nii.gz"),
        "-o",
        str(tmp_path / "out"),
        "--start",
        at(centre, 4),
        "--mask",
        mask,
        "--roi",
        "2,2,2,43,37,25vox",
        "--energy",
        "likelihood:update=no + 0.05*area - 0.1*balloon",
        "--foreground",
        at(centre, 5),
        "--channel",
        str(tmp_path / "a" / "scan.nii.gz"),
        "--max-volume",
        "1e5",
    ]
    assert cli.execute(words) == 0, capsys.readouterr().err
    document = json.loads((tmp_path / "out" / "scan_report.json").read_text())
    assert [term["term"] for term in document["energy"]["terms"]] == [
        "likelihood",
        "area",
        "balloon",
    ]
    assert document["quality"]["leaked"] is False
    config = RunConfig(**document["config"])
    assert (config.mask, config.max_volume) == (mask, 1e5)
    assert (
        dice(
            io.read_labels(tmp_path / "out" / "scan_seg.nii.gz").array > 0,
            truth & (np.arange(46) < 27),
        )
        > 0.95
    )


def test_strict_turns_a_warning_into_exit_5(tmp_path, capsys):
    volume, _, centre = ball()
    io.write(Volume(volume.array.astype(np.float32), volume.geometry), tmp_path / "scan.nii.gz")
    words = [
        "segment",
        str(tmp_path / "scan.nii.gz"),
        "--start",
        at(centre, 4),
        "--max-volume",
        "2500",
    ]
    assert cli.execute([*words, "-o", str(tmp_path / "one")]) == 0
    assert (
        "warning: leak: the object became larger than --max-volume, 2500 mm3"
        in capsys.readouterr().err
    )
    assert cli.execute([*words, "-o", str(tmp_path / "two"), "--strict"]) == 5
    assert "error: scan: leak" in capsys.readouterr().err
    document = json.loads((tmp_path / "two" / "scan_report.json").read_text())
    assert (document["status"], document["exit_code"], document["error"]["type"]) == (
        "failed",
        5,
        "DoubtfulError",
    )
    assert cli.execute([*words[:4], "-o", str(tmp_path / "three"), "--strict"]) == 0


# -------------------------------------------------------------------------------------------- files of several channels


@pytest.mark.parametrize(
    ("suffix", "sort"),
    [(suffix, "vector") for suffix in (".nii", ".nii.gz", ".nrrd", ".mha")]
    + [(suffix, "fourth axis") for suffix in (".nii", ".nii.gz")],
)
def test_a_file_of_channels_is_its_channels(tmp_path, suffix, sort):
    rng = np.random.default_rng(1)
    parts = [
        sitk.GetImageFromArray(rng.normal(size=(5, 6, 7)).astype(np.float32)) for _ in range(3)
    ]
    for part in parts:
        part.SetSpacing((0.75, 1.0, 1.5))
        part.SetOrigin((1.0, 2.0, 3.0))
    path = tmp_path / f"image{suffix}"
    sitk.WriteImage(sitk.Compose(*parts) if sort == "vector" else sitk.JoinSeries(parts), str(path))
    # ITK writes seconds into a fourth axis, so it is time unless it is said to be channels.
    found = channels.read_channels(path, ReadOptions(channels_from_time=sort == "fourth axis"))
    assert len(found) == 3
    for volume, part in zip(found, parts, strict=True):
        np.testing.assert_array_equal(volume.array, sitk.GetArrayFromImage(part))
        assert volume.geometry.spacing == (1.5, 1.0, 0.75) and volume.geometry.origin == (
            1.0,
            2.0,
            3.0,
        )
        assert volume.source == path


def test_ordinary_bad_and_endless_files(tmp_path):
    volume, _, _ = ball()
    io.write(Volume(volume.array.astype(np.float32), volume.geometry), tmp_path / "one.nii.gz")
    (one,) = channels.read_channels(tmp_path / "one.nii.gz")
    np.testing.assert_array_equal(one.array, volume.array.astype(np.float32))
    series = [sitk.GetImageFromArray(np.full((2, 3, 4), i, np.float32)) for i in range(17)]
    sitk.WriteImage(sitk.JoinSeries(series), str(tmp_path / "time.nii"))
    with pytest.raises(InputError, match="a sequence of 17 time points given"):
        channels.read_channels(tmp_path / "time.nii")
    sitk.WriteImage(sitk.JoinSeries(series[:2]), str(tmp_path / "cut.nii"))
    whole = (tmp_path / "cut.nii").read_bytes()
    (tmp_path / "cut.nii").write_bytes(whole[:-20])
    with pytest.raises(InputError, match="cut.nii"):
        channels.read_channels(tmp_path / "cut.nii")
    (tmp_path / "bad.nii.gz").write_bytes(b"nothing")
    for name in ("bad.nii.gz", "absent.nii", "absent.nrrd"):
        with pytest.raises(InputError, match=name):
            channels.read_channels(tmp_path / name)


def test_the_command_line_takes_a_vector_image(tmp_path, capsys):
    (first, second), truth = two_channels()
    images = [sitk.GetImageFromArray(part.astype(np.float32)) for part in (first, second)]
    sitk.WriteImage(sitk.Compose(*images), str(tmp_path / "two.nii.gz"))
    words = ["segment", str(tmp_path / "two.nii.gz"), "-o", str(tmp_path / "out")]
    assert (
        cli.execute([*words, "--start", "ball:15,15,15,5vox", "--energy", "likelihood:update=no"])
        == 0
    )
    labels = io.read_labels(tmp_path / "out" / "two_seg.nii.gz")
    assert dice(labels.array > 0, truth) > 0.9, capsys.readouterr().err
