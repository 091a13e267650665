"""Objects of a finished run that begin, are merged, split, removed: what moves, what stays, byte for byte."""

import json

import numpy as np
import pytest
from scipy import ndimage

import accelsurf
from accelsurf import cli, io
from accelsurf.errors import InputError, UsageError
from accelsurf.interact.refine import refine
from accelsurf.interact.refiner import Refiner
from accelsurf.settings.corrections import corrections_of
from accelsurf.settings.run_config import RunConfig

SHAPE, SPACING = (24, 30, 66), (1.5, 1.0, 1.0)
#: Centres (z, y, x) of three bright balls, mm, and their radii; the second and the third touch.
BALLS = {1: (17, 15, 12, 7.5), 2: (17, 15, 38, 7.0), 3: (17, 15, 51, 7.0)}


def scan():
    """Three bright balls in noise."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    image = np.random.default_rng(5).normal(0, 6.0, SHAPE)
    for a, b, c, r in BALLS.values():
        image[(z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2 < r**2] += 100.0
    return accelsurf.Volume.from_array(image.astype(np.float32), SPACING)


def press(own, radius=3.0):
    """A ball in the middle of one of the balls, as text."""
    z, y, x, _ = BALLS[own]
    return f"ball:{x},{y},{z},{radius}"


def truth(own):
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    a, b, c, r = BALLS[own]
    return (z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2 < r**2


def dice(one, other):
    return 2 * (one & other).sum() / (one.sum() + other.sum())


def size_of(own):
    return f"{4 / 3 * np.pi * BALLS[own][3] ** 3 / 1000:.4f}ml"


@pytest.fixture(scope="module")
def volume():
    return scan()


@pytest.fixture(scope="module")
def first(volume):
    """The first ball alone, from a click."""
    return accelsurf.segment(volume, inside=press(1), threads=1)


@pytest.fixture(scope="module")
def three(first):
    """All three, one after another."""
    two = refine(first, new=2, inside=press(2), size=size_of(2))
    return refine(two, new=3, inside=press(3), size=size_of(3))


def test_a_new_object_leaves_every_byte_of_the_others(first, three):
    assert three.has_ids and [one.id for one in three.objects] == [1, 2, 3] and not first.has_ids
    assert np.array_equal(three.labels == 1, first.labels == 1)
    assert three.by_id[1].psi.tobytes() == first.psi.tobytes()
    for own in BALLS:
        assert dice(three.labels == own, truth(own)) > 0.9, own
        assert three.by_id[own].volume_mm3 == pytest.approx(
            (three.labels == own).sum() * 1.5, rel=0.08
        )


def test_where_a_new_object_meets_another_they_share_no_voxel(three):
    inside = [one.box for one in three.objects]
    assert len(inside) == 3
    counts = np.zeros(SHAPE, int)
    for one in three.objects:
        counts[one.box] += one.labels
    assert counts.max() == 1
    # The second and the third touch: some voxels of one are beside some of the other.
    grown = ndimage.binary_dilation(three.labels == 2)
    assert (grown & (three.labels == 3)).any()


def test_a_new_object_that_is_clicked_in_another_takes_from_that_one_alone(volume):
    given = {
        "start": press(2),
        "energy": "threshold:50,",
        "smoothness": 0.5,
        "threads": 1,
        "keep_state": "yes",
    }
    both = accelsurf.segment(volume, **given)
    assert dice(both.labels > 0, truth(2) | truth(3)) > 0.9
    both = refine(both, new=5, inside=press(1))
    far = both.by_id[5].psi.tobytes()
    after = refine(both, new=4, inside=press(3), size=size_of(3))
    assert dice(after.labels == 4, truth(3)) > 0.85 and after.by_id[5].psi.tobytes() == far
    lost = (both.labels == 1) & (after.labels != 1)
    assert lost.any() and np.array_equal(lost, (both.labels == 1) & (after.labels == 4))


def test_merged_objects_are_the_union_of_their_voxels(three):
    after = refine(three, merge=(3, 2))
    assert [one.id for one in after.objects] == [1, 3]
    assert np.array_equal(after.labels == 3, (three.labels == 2) | (three.labels == 3))
    assert after.by_id[1].psi.tobytes() == three.by_id[1].psi.tobytes()
    assert after.by_id[3].volume_mm3 == pytest.approx(
        three.by_id[2].volume_mm3 + three.by_id[3].volume_mm3, rel=0.02
    )


def test_what_is_split_off_is_the_component_under_the_click_and_merging_brings_it_back(three):
    merged = refine(three, merge=(1, 2))  # far apart: two parts
    parts, _ = ndimage.label(merged.labels == 1)
    z, y, x, _ = BALLS[2]
    after = refine(merged, split=f"point:{x},{y},{z}")
    assert [one.id for one in after.objects] == [1, 3, 4]
    where = tuple(np.rint(np.array((z, y, x)) / SPACING).astype(int))
    assert parts.max() > 1 and np.array_equal(after.labels == 4, parts == parts[where])
    assert np.array_equal(after.labels == 1, (parts > 0) & (parts != parts[where]))
    again = refine(after, merge=(1, 4))
    assert np.array_equal(again.labels, merged.labels)
    assert again.by_id[1].psi.tobytes() == merged.by_id[1].psi.tobytes()


def test_a_removed_object_is_gone_and_the_others_stay(three):
    after = refine(three, remove=1)
    assert [one.id for one in after.objects] == [2, 3]
    assert np.array_equal(after.labels, np.where(three.labels == 1, 0, three.labels))
    alone = refine(after, remove=2)
    with pytest.raises(UsageError, match="object 3 is the only one"):
        refine(alone, remove=3)


def test_an_object_with_a_known_id_begins_anew(three):
    after = refine(three, new=2, inside=press(2, 2.0), size="0.5ml")
    assert [one.id for one in after.objects] == [1, 2, 3]
    assert after.by_id[2].psi.tobytes() != three.by_id[2].psi.tobytes()
    for own in (1, 3):
        assert after.by_id[own].psi.tobytes() == three.by_id[own].psi.tobytes()


STEPS = (
    f"new=2 inside={press(2)} size={size_of(2)}",
    f"new=3 inside={press(3)} outside={press(2, 1.0)}",
    "merge=1,2",
    "split=point:38,15,17 new=9",
    "outside=point:38,9,17 near=4 object=9",
    "new=2 inside=ball:30,6,6,2.5",
    "inside=point:51,22,17 near=4 object=3",
    "remove=2",
)


def test_undo_brings_back_every_byte(first):
    refiner = Refiner(first)
    states = [refiner.result()]
    for text in STEPS:
        refiner.apply(corrections_of(text)[0])
        states.append(refiner.result())
    for before in states[-2::-1]:
        refiner.undo()
        now = refiner.result()
        assert now.has_ids == before.has_ids and now.config == before.config
        assert [one.id for one in now.objects] == [one.id for one in before.objects]
        assert now.labels.tobytes() == before.labels.tobytes()
        for one, other in zip(now.objects, before.objects, strict=True):
            assert one.psi.tobytes() == other.psi.tobytes() and one.history == other.history
        assert [len(click.mask) for click in (now.clicks.clicks)] == [
            len(c.mask) for c in before.clicks.clicks
        ]
    for text, after in zip(STEPS, states[1:], strict=True):
        refiner.apply(corrections_of(text)[0])
        assert refiner.result().labels.tobytes() == after.labels.tobytes()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("energy", ["chan-vese", "seeded"])
def test_command_line_and_one_configuration_make_the_same_bytes(volume, tmp_path, energy):
    image, out, whole = tmp_path / "scan.nii.gz", tmp_path / "out", tmp_path / "whole"
    io.write(volume, image)
    begin = (
        ["--inside", press(1)]
        if energy == "seeded"
        else ["--start", press(1), "--energy", "local-region:R=6"]
    )
    quiet = ["--quiet", "--threads", "1"]
    assert (
        cli.execute(["segment", str(image), "-o", str(out), "--keep-state", "yes", *begin, *quiet])
        == 0
    )
    assert (out / "scan_surface.stl").exists() or list(out.glob("scan_surface.*"))
    for text in STEPS:
        words = [
            word
            for part in text.split()
            for word in ("--" + part.partition("=")[0], part.partition("=")[2])
        ]
        assert cli.execute(["refine", str(out), *words, "--quiet"]) == 0, text
    config = RunConfig.from_toml(out / "scan_run.toml")
    assert [one.kind for one in config.refine] == [
        "new",
        "new",
        "merge",
        "split",
        "clicks",
        "new",
        "clicks",
        "remove",
    ]
    again = ["--config", str(out / "scan_run.toml"), "--quiet"]
    assert cli.execute(["segment", str(image), "-o", str(whole), *again]) == 0
    names = sorted(
        path.name for path in out.iterdir() if path.suffix in (".gz", ".stl", ".vtp", ".ply")
    )
    assert names == sorted(
        path.name for path in whole.iterdir() if path.suffix in (".gz", ".stl", ".vtp", ".ply")
    )
    assert any("_3." in name for name in names) and not any(
        name.startswith("scan_surface.") for name in names
    )
    for name in names:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    report = json.loads((out / "scan_report.json").read_text())
    assert [one["id"] for one in report["objects"]] == [1, 3, 9]
    assert (out / "scan_objects.csv").read_text() == (whole / "scan_objects.csv").read_text()


@pytest.mark.parametrize(
    "text, said",
    [
        ("merge=1,7", "merge 7"),
        ("remove=7", "remove 7"),
        ("split=point:1,1,1", "lies in no object"),
        ("split=point:12,15,17", "object 1 is in one piece"),
        ("split=point:12,15,17 object=2", "lies in object 1"),
        ("split=point:12,15,17 new=2", "new 2"),
        ("split=point:1,2", "point:X,Y,Z"),
        ("split=point:900,1,1", "outside of the volume"),
        ("inside=point:1,1,1", "without object"),
        (f"new=4 inside={press(3)} outside={press(3)}", "both inside and outside"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(three, text, said):
    refiner = Refiner(three)
    before = refiner.result()
    with pytest.raises((UsageError, InputError), match=said):
        refiner.apply(corrections_of(text)[0])
    after = refiner.result()
    assert after.config == before.config and after.labels.tobytes() == before.labels.tobytes()
    assert [one.psi.tobytes() for one in after.objects] == [
        one.psi.tobytes() for one in before.objects
    ]


def test_an_image_of_one_slice():
    y, x = np.indices((40, 64))
    image = np.where((y - 20) ** 2 + (x - 16) ** 2 < 81, 100.0, 0.0)
    image = np.maximum(image, np.where((y - 20) ** 2 + (x - 46) ** 2 < 81, 90.0, 0.0)).astype(
        np.float32
    )
    one = accelsurf.segment(accelsurf.Volume.from_array(image), inside="ball:16,20,0,3", threads=1)
    two = refine(one, new=2, inside="ball:46,20,0,3")
    assert [part.id for part in two.objects] == [1, 2] and np.array_equal(
        two.labels == 1, one.labels == 1
    )
    assert dice((two.labels == 2)[0], image == 90.0) > 0.9
    back = refine(refine(two, merge=(1, 2)), split="point:46,20,0")
    assert np.array_equal(back.labels == 1, two.labels == 1) and np.array_equal(
        back.labels == 2, two.labels == 2
    )
