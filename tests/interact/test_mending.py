"""A label map that is nearly right: what moves, what stays byte for byte, what is refused."""

import json

import numpy as np
import pytest
from scipy import ndimage

import accelsurf
from accelsurf import cli, io
from accelsurf.clicks.model.given import RAMP, GivenMask, corrected_model, model_of_mask
from accelsurf.clicks.model.windows import Scene
from accelsurf.energies.constraints.mask import mask_distance
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.image.volume import Volume
from accelsurf.interact.mending import edge_field, holes_of, islands_of
from accelsurf.interact.refine import refine
from accelsurf.interact.refiner import Refiner
from accelsurf.settings.corrections import corrections_in_order, corrections_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session

SHAPE, SPACING = (20, 28, 44), (1.5, 1.0, 1.0)
LEFT, RIGHT, OTHER = 3, 700, 9


def run(*words):
    return cli.execute([str(word) for word in words])


def dice(one, other):
    return 2 * (one & other).sum() / (one.sum() + other.sum())


def balls():
    """Two bright balls that touch, in noise; and the label map of both, with a third label beside the first."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    left = (z - 14) ** 2 + (y - 14) ** 2 + (x - 13) ** 2 < 8**2
    right = (z - 14) ** 2 + (y - 14) ** 2 + (x - 29) ** 2 < 8**2
    image = 100.0 * (left | right) + np.random.default_rng(0).normal(0, 8, SHAPE)
    labels = np.zeros(SHAPE, np.uint16)
    labels[left & ~right], labels[right] = LEFT, RIGHT
    labels[2:4, 2:5, 2:5] = OTHER
    return Volume.from_array(image.astype(np.float32), SPACING), labels


@pytest.fixture(scope="module")
def scene():
    return balls()


@pytest.fixture(scope="module")
def bitten(scene):
    """The label map without a piece of the first ball; and that piece."""
    labels = scene[1].copy()
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    piece = (labels == LEFT) & ((z - 14) ** 2 + (y - 8) ** 2 + (x - 13) ** 2 < 4**2)
    labels[piece] = 0
    return labels, piece


@pytest.fixture(scope="module")
def files(scene, bitten, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan")
    io.write(scene[0], folder / "balls.nii.gz")
    io.write(scene[0].with_array(bitten[0]), folder / "mask.nii.gz")
    return folder / "balls.nii.gz", folder / "mask.nii.gz"


CLICK = "ball:13,8,14,2"


def test_a_map_without_a_correction_is_the_result_byte_for_byte(scene, tmp_path):
    image, labels = scene
    io.write(image.with_array(labels), tmp_path / "labels.nii.gz")
    found = accelsurf.segment(image, labels=str(tmp_path / "labels.nii.gz"), threads=1)
    assert np.array_equal(found.labels, labels) and found.labels.dtype == labels.dtype
    assert [(each.id, each.stop.reason) for each in found.objects] == [
        (LEFT, "given"),
        (OTHER, "given"),
        (RIGHT, "given"),
    ]
    assert (
        found.stop.reason == "given" and [each.confidence for each in found.objects] == [None] * 3
    )


def test_a_click_moves_the_surface_near_it_and_every_other_voxel_and_label_stays(
    scene, bitten, files
):
    (image, truth), (labels, piece) = scene, bitten
    refiner = Refiner(accelsurf.segment(image, labels=f"{files[1]}@{LEFT}", threads=1))
    (change,) = refiner.apply(corrections_of(f"inside={CLICK} object={LEFT}")[0])
    after = refiner.result().labels
    assert (after[piece] == LEFT).mean() > 0.9
    assert dice(after == LEFT, truth == LEFT) > dice(labels == LEFT, truth == LEFT)
    beyond = np.ones(SHAPE, bool)
    beyond[change.box] = False
    assert np.array_equal(after[beyond], labels[beyond])
    for other in (RIGHT, OTHER):  # not entered, though it looks alike and touches
        assert np.array_equal(after == other, labels == other)
    refiner.undo()
    assert np.array_equal(refiner.result().labels, labels)


def test_a_click_in_a_label_that_was_not_asked_for_is_refused(scene, bitten, files):
    with pytest.raises(InputError, match="have labels which are not to change"):
        refine(scene[0], labels=f"{files[1]}@{LEFT}", object=LEFT, inside="ball:29,14,14,2")


def test_an_outside_click_alone_takes_away_near_it(scene):
    image, truth = scene
    leak = truth.copy()
    leak[8:11, 22:26, 10:14] = LEFT
    result = refine(image, labels=leak, object=LEFT, outside="ball:12,24,14,1.5")
    assert dice(result.labels == LEFT, truth == LEFT) > dice(leak == LEFT, truth == LEFT)
    assert np.array_equal(result.labels == RIGHT, truth == RIGHT)


def test_a_mended_border_is_taken_back(scene, files):
    refiner = Refiner(accelsurf.segment(scene[0], labels=f"{files[1]}@{LEFT}", threads=1))
    before = refiner.result().labels
    refiner.apply(corrections_of("to_edges=2 islands=2mm3")[0])
    assert not np.array_equal(refiner.result().labels, before)
    refiner.undo()
    assert np.array_equal(refiner.result().labels, before) and refiner.config.refine == ()


def shifted(labels, id):
    """A label map in which an object lies 2 voxels away, with an island and a hole."""
    out = np.where(labels == id, 0, labels)
    moved = np.roll(labels == id, (0, 2, 0), (0, 1, 2))
    moved[10, 14, 13] = False
    moved[16, 24, 5] = True
    out[moved & (out == 0)] = id
    return out


def test_the_border_comes_to_the_edges_within_the_band_and_holes_and_islands_go(scene):
    image, truth = scene
    given = shifted(truth, LEFT)
    result = refine(image, labels=given, object=LEFT, to_edges=3, islands="10mm3", holes="10mm3")
    after = result.labels
    assert dice(after == LEFT, truth == LEFT) > 0.95 > 0.9 > dice(given == LEFT, truth == LEFT)
    assert ndimage.label(after == LEFT)[1] == 1 and after[10, 14, 13] == LEFT
    far = np.abs(mask_distance(given == LEFT, SPACING)) > 3 + 1.5
    far[16, 24, 5] = far[9:12, 13:16, 12:15] = False
    assert np.array_equal(after[far], given[far])
    assert np.array_equal(after == RIGHT, given == RIGHT) and np.array_equal(
        after == OTHER, given == OTHER
    )
    (segmented,) = (each for each in result.objects if each.id == LEFT)
    assert segmented.stop.reason == "converged"
    assert segmented.volume_mm3 == pytest.approx((after == LEFT).sum() * 1.5, rel=0.05)


def test_islands_and_holes_alone_change_their_voxels_alone(scene):
    image, truth = scene
    given = truth.copy()
    given[10, 14, 13], given[16, 24, 5] = 0, LEFT
    result = refine(image, labels=given, object=LEFT, islands="2mm3", holes="2mm3")
    assert np.array_equal(result.labels, truth)
    kept = refine(image, labels=given, object=LEFT, islands="1mm3")
    assert np.array_equal(kept.labels, given)


def test_islands_with_clicks_and_holes_with_clicks_stay():
    row = np.array([[[1, 0, 1, 1, 0, 1, 1]]], bool)
    held = np.zeros_like(row)
    held[0, 0, 0] = True
    assert islands_of(row, 2).sum() == 1 and not islands_of(row, 2, held).any()
    ring = np.ones((3, 3, 3), bool)
    ring[1, 1, 1] = False
    assert holes_of(ring, 2).sum() == 1 and not holes_of(ring, 2, ~ring).any()
    ring[1, 1, 0] = False  # open to a face
    assert not holes_of(ring, 3).any()


def test_the_border_stays_where_both_sides_look_alike():
    inside = np.zeros((1, 24, 24), bool)
    inside[0, 6:18, 6:18] = True
    noise = np.random.default_rng(0).normal(0, 0.1, inside.shape).astype(np.float32)
    distance = mask_distance(inside, (1.0, 1.0, 1.0))
    found = edge_field([noise], distance, (1.0, 1.0, 1.0), 3.0) < 0
    assert dice(found, inside) > 0.9


def test_the_order_of_corrections_is_the_whole_and_then_clicks():
    both = corrections_in_order(
        {"to_edges": 2.0, "inside": ("point:1,2,3",), "object": 4, "near": "auto"}
    )
    assert [(each.kind, each.object) for each in both] == [("mend", 4), ("clicks", 4)]
    assert str(both[0]) == "object=4 to_edges=2.0"
    assert corrections_of(str(both[0])) == both[:1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("to_edges=0", "to_edges 0 was given, expected a length above 0"),
        ("to_edges=2 inside=point:1,2,3", "inside was given with to_edges"),
        ("islands=5", "islands 5 was given, expected a volume with its unit"),
        ("holes=5mm3 merge=1,2", "holes was given with merge"),
    ],
)
def test_what_is_refused_of_a_correction(words, said):
    with pytest.raises(UsageError, match=said):
        corrections_of(words)


def test_a_state_of_a_map_that_was_mended_is_read_again(files, tmp_path):
    scan, mask = files
    words = (scan, "--labels", f"{mask}@{LEFT}", "-o", tmp_path / "out", "--to-edges", 2, "--quiet")
    assert run("refine", *words, "--inside", CLICK) == 0  # a single object need not be named
    first = (tmp_path / "out" / "balls_seg.nii.gz").read_bytes()
    again = ("segment", scan, "--config", tmp_path / "out" / "balls_run.toml", "--quiet", "-o")
    assert run(*again, tmp_path / "again") == 0
    assert (tmp_path / "again" / "balls_seg.nii.gz").read_bytes() == first
    labels, given = (
        io.read_labels(path).array for path in (tmp_path / "out" / "balls_seg.nii.gz", mask)
    )
    assert all(np.array_equal(labels == other, given == other) for other in (RIGHT, OTHER))
    further = ("--outside", "ball:13,21,14,1.5", "--object", LEFT, "--quiet")
    assert run("refine", tmp_path / "out", *further) == 0
    report = json.loads((tmp_path / "out" / "balls_report.json").read_text())
    assert len(report["config"]["refine"]) == 3 and report["config"]["labels"] == f"{mask}@{LEFT}"
    after = io.read_labels(tmp_path / "out" / "balls_seg.nii.gz").array
    assert not after[labels == 0].any() and (after != labels).any()
    assert run(*again, tmp_path / "more") == 0
    assert np.array_equal(io.read_labels(tmp_path / "more" / "balls_seg.nii.gz").array, after)


def test_a_map_that_cannot_be_used_is_refused_in_a_line(scene, files, tmp_path, capsys):
    scan, mask = files
    io.write(Volume.from_array(scene[1], (1.0, 1.0, 1.0)), tmp_path / "other.nii.gz")
    click = ("-o", tmp_path / "out", "--inside", CLICK)
    assert run("refine", scan, "--labels", tmp_path / "other.nii.gz", *click) == 3
    assert "on another grid than the image" in capsys.readouterr().err
    assert run("refine", scan, "--labels", f"{mask}@5", *click) == 3
    assert f"there are {LEFT}, {OTHER}, {RIGHT}" in capsys.readouterr().err
    assert run("refine", scan, "--labels", mask, *click) == 2
    assert "inside was given without object" in capsys.readouterr().err
    assert run("refine", scan, "--labels", mask, "--inside", CLICK) == 2
    assert "-o DIR" in capsys.readouterr().err
    before = mask.read_bytes()
    clash = mask.with_name("balls_seg.nii.gz")
    clash.write_bytes(before)
    assert (
        run(
            "refine",
            scan,
            "--labels",
            f"{clash}@3",
            "-o",
            mask.parent,
            "--overwrite",
            "--inside",
            CLICK,
        )
        != 0
    )
    assert clash.read_bytes() == before
    clash.unlink()
    with pytest.raises(GeometryError, match="an array of shape"):
        refine(scene[0], labels=scene[1][1:], to_edges=1)
    for options in ({"new": OTHER, "inside": CLICK}, {"split": "point:13,14,14", "new": OTHER}):
        with pytest.raises(UsageError, match=f"new {OTHER} was given, which is a label"):
            refine(scene[0], labels=f"{mask}@{LEFT}", **options)
    with pytest.raises(UsageError, match="a label map was given with a start"):
        accelsurf.segment(scene[0], labels=str(mask), start=[(13, 14, 14, 4)])
    with pytest.raises(UsageError, match="roi: it was given with labels"):
        RunConfig(labels="a.nii", roi="0,0,0,1,1,1")
    with pytest.raises(UsageError, match="given with a result"):
        refine(accelsurf.segment(scene[0], labels=str(mask)), labels=scene[1], inside=CLICK)


def test_the_model_of_a_mask_is_the_mask_and_a_click_on_its_side_changes_its_voxels_alone():
    mask = np.zeros((9, 12, 14), bool)
    mask[3:6, 4:9, 4:10] = True
    image = mask.astype(np.float32) + np.random.default_rng(0).normal(0, 0.1, mask.shape).astype(
        np.float32
    )
    given, whole = GivenMask(whole_box(mask.shape), mask), whole_box(mask.shape)
    model = model_of_mask(given, mask.shape, (1.0, 1.0, 1.0))
    assert np.array_equal(model.inside_on(whole), mask) and model.field.min() >= -1.0
    assert float(model.field_on(whole)[4, 6, 3]) == pytest.approx(0.5 / RAMP)
    inside = Click("inside", (slice(4, 5), slice(6, 7), slice(6, 7)), np.ones((1, 1, 1), bool))
    scene = Scene((image,), (1.0, 1.0, 1.0))
    after = corrected_model(scene, given, Clicks((inside,), mask.shape))
    changed = after.field_on(whole) != model.field_on(whole)
    assert np.argwhere(changed).tolist() == [[4, 6, 6]] and np.array_equal(
        after.inside_on(whole), mask
    )
    empty = model_of_mask(GivenMask(whole, np.zeros_like(mask)), mask.shape, (1.0, 1.0, 1.0))
    assert empty.count == 0


def test_a_session_opens_a_map_and_a_click_mends_the_nearest_object(files):
    scan, mask = files
    image, given = io.read(scan), io.read_labels(mask).array
    with Session(
        image, RunConfig(labels=str(mask), threads=1), source=scan, name="balls"
    ) as session:
        session.ready.result(60)
        assert session.status.stop.reason == "given"
        with pytest.raises(UsageError, match="label map"):
            session.play().result(60)
        session.add_click("inside", CLICK).result(120)
        assert session.status.refinements[0].object == LEFT
        folder = scan.parent / "session"
        session.save(folder).result(120)
        after = io.read_labels(folder / "balls_seg.nii.gz").array
        assert (after != given).any() and not (after != given)[given > 0].any()
        session.undo().result(60)
        assert session.status.refinements == ()
