"""Corrections of a finished run: what moves, what stays, byte for byte."""

import dataclasses
import tomllib

import numpy as np
import pytest
from scipy import ndimage

import accelsurf
from accelsurf.clicks.model import ClickModel, Scene, click_model
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.interact.corrected_surface import CorrectedSurface
from accelsurf.interact.local_evolution import measures_of
from accelsurf.interact.local_model import LocalModel, ModelChange, basin_of
from accelsurf.interact.refine import refine
from accelsurf.interact.refiner import Refiner
from accelsurf.interact.region import rim_width
from accelsurf.interact.restored import restored
from accelsurf.interact.state_file import read_state, state_bytes
from accelsurf.levelset import Workers
from accelsurf.measure.surface_mesh import extract_surface
from accelsurf.run.setup import PATIENCE, correction_rule, half_width
from accelsurf.settings.corrections import Correction, corrections_of
from accelsurf.settings.run_config import RunConfig
from tests.support.clicked_balls import ball

SHAPE, SPACING = (26, 30, 64), (1.5, 1.0, 1.0)


def world(*index, spacing=SPACING):
    """Text of the world coordinates of a voxel (z, y, x)."""
    return ",".join(f"{i * h:.6g}" for i, h in zip(index[::-1], spacing[::-1], strict=True))


def two_balls(noise=8.0, seed=3):
    """Two bright balls of different brightness, far apart, in noise; and their masks."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    one = (z - 18) ** 2 + (y - 14) ** 2 + (x - 14) ** 2 < 8**2
    other = (z - 18) ** 2 + (y - 14) ** 2 + (x - 48) ** 2 < 7**2
    image = 100.0 * one + 90.0 * other + np.random.default_rng(seed).normal(0, noise, SHAPE)
    return image.astype(np.float32), one, other


ENERGIES = ("chan-vese", "threshold:50,", "likelihood:model=gauss", "local-region:R=6", "seeded")


@pytest.fixture(scope="module")
def image():
    return two_balls()[0]


def first_run(image, energy="chan-vese", **options):
    start = {} if energy == "seeded" else {"start": f"ball:{world(12, 14, 14)},5"}
    if energy == "seeded":
        start["inside"] = f"ball:{world(12, 14, 14)},3"
    return accelsurf.segment(
        image,
        spacing=SPACING,
        energy=energy,
        smoothness=0.3,
        threads=1,
        keep_state="yes",
        **start,
        **options,
    )


@pytest.fixture(scope="module")
def result(image):
    return first_run(image)


def far_from(points, near, shape=SHAPE, spacing=SPACING):
    """Voxels farther than ``near`` mm from some voxels."""
    index = np.indices(shape).reshape(3, -1).T * np.array(spacing)
    distance = np.min(
        [np.linalg.norm(index - np.array(p) * spacing, axis=1) for p in points], axis=0
    )
    return (distance > near).reshape(shape)


@pytest.mark.parametrize("energy", ENERGIES)
def test_beyond_near_every_byte_stays_and_the_click_is_on_its_side(image, energy):
    before = first_run(image, energy)
    psi = before.psi.copy()
    z, y, x = 12, 14, 21  # near the surface of the first ball
    side = "outside" if before.labels[z, y, x] else "inside"
    after = refine(before, **{side: f"point:{world(z, y, x)}"}, near=7)
    assert bool(after.labels[z, y, x]) == (side == "inside")
    far = far_from([(z, y, x)], 7.0)
    assert after.psi[far].tobytes() == psi[far].tobytes()
    assert (after.psi != psi).any()
    np.testing.assert_array_equal(before.psi, psi)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("energy", ["chan-vese", "threshold:50,", "seeded"])
@pytest.mark.parametrize("click", [f"point:{world(12, 14, 21)}", f"ball:{world(12, 14, 20)},2"])
def test_beyond_the_automatic_region_every_byte_stays(image, energy, click):
    refiner, regions = Refiner(first_run(image, energy)), []
    region_of = refiner._region
    refiner._region = lambda *given: regions.append(region_of(*given)) or regions[-1]
    before = refiner.result()
    for side in ("outside", "inside"):
        psi = refiner.result().psi.copy()
        refiner.apply(*corrections_of({side: click}))
        after = refiner.result()
        assert after.config.refine[-1].near == "auto" and len(regions) == 1
        (region,), beyond = regions, np.ones(SHAPE, bool)
        beyond[region.box] = ~region.mask
        assert after.psi[beyond].tobytes() == psi[beyond].tobytes()
        # It is a part of the image and of the surface, and there the surface has moved.
        surface = np.abs(psi) < 1.0
        assert (
            beyond.mean() > 0.3
            and (surface & beyond).any()
            and ((after.psi < 0) != (psi < 0))[~beyond].any()
        )
        regions.clear()
    refiner.undo()
    refiner.undo()
    assert refiner.result().psi.tobytes() == before.psi.tobytes()


def test_vertices_away_from_the_region_are_the_same(result):
    both = refine(result, inside=f"ball:{world(12, 14, 48)},3")
    after = refine(both, outside=f"ball:{world(12, 14, 21)},2", near=6)
    before, now = both.surface.vertices, after.surface.vertices
    # A vertex depends on psi two voxels around it, and on its neighbours' displacements in four rounds.
    far = [
        np.linalg.norm(v - np.array([21.0, 14.0, 18.0]), axis=1) > 6 + 6 * 1.5
        for v in (before, now)
    ]
    assert {v.tobytes() for v in before[far[0]]} == {v.tobytes() for v in now[far[1]]}
    assert len(before[far[0]]) > 100


@pytest.mark.parametrize("energy", ["chan-vese", "seeded"])
def test_what_is_missing_is_added_whole(image, energy):
    result, other = first_run(image, energy), two_balls()[2]
    after = refine(result, inside=f"ball:{world(12, 14, 48)},3")
    added = (after.labels > 0) & ~(result.labels > 0)
    assert 2 * (added & other).sum() / (added.sum() + other.sum()) > 0.9
    with Workers(1) as workers:  # volume and area are those of the whole surface, not of the box
        volume, area = measures_of(after.psi, SPACING, half_width(after.config), workers)
    last = after.history[-1]
    assert (last.volume_mm3, last.area_mm2) == pytest.approx((volume, area), rel=0.005)
    assert after.history[: len(result.history) - 1] == result.history[:-1]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("edits", [[], ["step=3 smoothness=0.2"]])
def test_the_energy_in_the_report_is_that_of_the_run_alone(image, edits):
    """That of a correction is of its box, which compares with no other."""
    before = first_run(image, edit=edits)
    assert (
        before.run_history == before.history
        and before.report["energy"]["steps_of_corrections"] == 0
    )
    once = refine(before, inside=f"ball:{world(12, 14, 48)},3")
    for after in (once, refine(once, outside=f"point:{world(12, 14, 21)}", near=6)):
        assert after.run_history == before.history[:-1]
        assert abs(after.history[-1].potential / before.history[-1].potential - 1) > 0.05
        energy = after.report["energy"]
        assert energy["first"] == before.report["energy"]["first"]
        assert energy["last"] == before.history[-2].potential
        assert energy["steps_of_corrections"] == len(after.history) - len(before.history) + 1


def test_a_click_that_changes_nothing_changes_nothing(image):
    for energy in ("chan-vese", "seeded"):
        before = first_run(image, energy)
        z, y, x = 12, 14, 14
        after = refine(before, inside=f"point:{world(z, y, x)}")
        assert after.psi.tobytes() == before.psi.tobytes()
        assert after.history == before.history


def test_the_means_count_the_whole_object(image):
    """A correction on a small box has the means of one on the whole image, which the box alone does not have."""
    shade = image + np.linspace(
        0, 60, SHAPE[2], dtype=np.float32
    )  # brighter to the right, everywhere
    before = first_run(shade)
    click = {"outside": f"ball:{world(12, 14, 22)},1.5"}
    found = {}
    for near in (9, 200):
        refiner = Refiner(before)
        original = refiner._problem
        refiner._problem = lambda *args, make=original, near=near: found.setdefault(
            near, make(*args)
        )
        refiner.apply(*corrections_of({**click, "near": near}))
    # 200 mm is the whole image.
    assert found[200].region.box == box_at((0, 0, 0), SHAPE) != found[9].region.box
    assert found[9].energy.means == pytest.approx(found[200].energy.means, abs=0.004)
    alone = before.image[found[9].region.box]
    outside = alone[before.labels[found[9].region.box] == 0].mean()
    assert abs(outside - found[9].energy.means[1]) > 0.02  # what the box alone would say


def test_the_field_of_the_clicks_on_a_box_is_that_on_the_whole_image(image):
    """Seeded has no means: its field is that of the whole model, and so is the weight of the area with its offset."""
    before = first_run(image, "seeded")
    found = {}
    for near in (9, 200):
        refiner = Refiner(before)
        original = refiner._problem
        refiner._problem = lambda *args, make=original, near=near: found.setdefault(
            near, make(*args)
        )
        refiner.apply(*corrections_of({"outside": f"ball:{world(12, 14, 22)},1.5", "near": near}))
    part = found[9].region.box
    assert found[200].region.box == box_at((0, 0, 0), SHAPE) != part
    own, whole = (found[near].energy.sums.image.reshape(found[near].psi.shape) for near in (9, 200))
    assert own.tobytes() == np.ascontiguousarray(whole[part]).tobytes()
    assert found[9].energy.alpha == found[200].energy.alpha > 0


def test_undo_brings_back_every_byte(image):
    for energy in ("chan-vese", "seeded"):
        before = first_run(image, energy)
        refiner = Refiner(before)
        first = refiner.apply(*corrections_of({"inside": f"ball:{world(12, 14, 48)},3"}))
        middle = refiner.result()
        refiner.apply(*corrections_of({"outside": f"ball:{world(12, 14, 21)},2", "near": 6}))
        refiner.undo()
        again = refiner.result()
        assert again.psi.tobytes() == middle.psi.tobytes() and again.config == middle.config
        refiner.undo()
        assert refiner.result().psi.tobytes() == before.psi.tobytes()
        assert first[0].voxels > 0
        # What follows is the same as if the undone had never been.
        refiner.apply(*corrections_of({"outside": f"ball:{world(12, 14, 21)},2", "near": 6}))
        direct = refine(before, outside=f"ball:{world(12, 14, 21)},2", near=6)
        assert refiner.result().psi.tobytes() == direct.psi.tobytes()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("energy", ["chan-vese", "likelihood:model=histogram", "seeded"])
@pytest.mark.threads
def test_one_configuration_repeats_run_and_corrections(image, energy):
    result = first_run(image, energy)
    result = refine(result, inside=f"ball:{world(12, 14, 48)},3")
    result = refine(result, outside=f"point:{world(12, 14, 21)}", near=6)
    config = RunConfig(**tomllib.loads(result.config.to_toml()))
    assert config.refine == result.config.refine and len(config.refine) == 2
    for threads in (1, 2):
        again = accelsurf.segment(image, spacing=SPACING, config=config.replace(threads=threads))
        assert again.psi.tobytes() == result.psi.tobytes()
        assert again.surface.vertices.tobytes() == result.surface.vertices.tobytes()


@pytest.mark.parametrize("energy", ["threshold:50,", "seeded"])
def test_no_crease_at_the_seam(image, energy):
    """The surface leaves its old place at a tangent: its curvature along the seam stays as it is around it."""
    before = first_run(image, energy)
    at, near = np.array([12, 14, 21]), 12.0
    after = refine(before, outside=f"ball:{world(*at)},2.5", near=near)
    rim = rim_width(SHAPE, SPACING)
    index = np.indices(SHAPE).reshape(3, -1).T.reshape(*SHAPE, 3) * np.array(SPACING)
    depth = near - np.linalg.norm(index - at * SPACING, axis=-1)
    seam = (np.abs(depth) < 2.0) & (np.abs(before.psi) < 1.5)
    assert seam.sum() > 50

    def curvature(psi):
        gradient = np.stack(np.gradient(psi.astype(float), *SPACING))
        unit = gradient / np.maximum(np.linalg.norm(gradient, axis=0), 1e-6)
        return sum(np.gradient(unit[i], SPACING[i], axis=i) for i in range(3))

    old, new = (np.abs(curvature(one.psi))[seam] for one in (before, after))
    assert np.percentile(new, 99) <= np.percentile(old, 99) + 1.0 / rim
    # A hard edge of the region would be a crease: there psi would jump.
    jump = np.abs(after.psi - before.psi)[(depth > 0) & (depth < 1.5) & (np.abs(before.psi) < 1.0)]
    assert jump.max() < 0.35


@pytest.mark.parametrize(
    "shape, spacing", [((1, 40, 48), (5.0, 1.0, 1.0)), ((9, 40, 48), (5.0, 0.8, 0.8))]
)
def test_two_dimensions_and_thick_slices(shape, spacing):
    z, y, x = np.indices(shape)
    inside = ((y - 20) ** 2 + (x - 16) ** 2 < 9**2) & (abs(z - shape[0] // 2) < 3)
    image = 100.0 * inside + np.random.default_rng(0).normal(0, 10, shape)
    middle = shape[0] // 2
    start = f"ball:{16 * spacing[2]},{20 * spacing[1]},{middle * spacing[0]},{5 * spacing[1]}"
    before = accelsurf.segment(image.astype(np.float32), spacing=spacing, start=start, threads=1)
    click = np.array([middle, 20, 26])
    text = "point:" + ",".join(str(i * h) for i, h in zip(click[::-1], spacing[::-1], strict=True))
    side = "outside" if before.labels[tuple(click)] else "inside"
    after = refine(before, **{side: text}, near=6)
    assert bool(after.labels[tuple(click)]) == (side == "inside")
    index = np.stack(np.indices(shape), -1) * np.array(spacing)
    far = np.linalg.norm(index - click * np.array(spacing), axis=-1) > 6
    assert after.psi[far].tobytes() == before.psi[far].tobytes()


def test_several_objects_never_overlap_and_the_named_one_is_corrected():
    image, one, other = two_balls()
    starts = np.zeros(SHAPE, int)
    starts[10:14, 12:16, 12:16], starts[10:14, 12:16, 46:50] = 3, 7
    before = accelsurf.segment_objects(image, starts, spacing=SPACING, threads=1)
    after = refine(before, outside=f"ball:{world(12, 14, 53)},2", object=7, near=8)
    assert (
        not (after.labels[12, 13:16, 53] == 7).any() and (before.labels[12, 13:16, 53] == 7).all()
    )
    assert after.by_id[3].psi.tobytes() == before.by_id[3].psi.tobytes()
    far = far_from([(12, 14, 53)], 10.5)
    np.testing.assert_array_equal(after.labels[far], before.labels[far])
    grown = refine(before, inside=f"ball:{world(12, 14, 21)},2", object=7, near=6)
    assert grown.labels[12, 14, 21] == 7  # taken from 3, or from nothing
    own = [grown.by_id[i] for i in (3, 7)]
    whole = np.zeros(SHAPE, int)
    for part in own:
        whole[part.box] += part.labels
    assert whole.max() == 1
    with pytest.raises(UsageError, match="object 5 was given"):
        refine(before, inside=f"point:{world(12, 14, 21)}", object=5)
    with pytest.raises(UsageError, match="without object"):
        refine(before, inside=f"point:{world(12, 14, 21)}")


def test_a_later_stroke_takes_the_voxels_of_an_earlier_one(result):
    """For every energy; undo gives the earlier stroke back, and made at once the two make the same bytes."""
    refiner = Refiner(result)
    first, later = (
        {"inside": f"ball:{world(12, 14, 24)},3"},
        {"outside": f"ball:{world(12, 14, 25)},2.5"},
    )
    refiner.apply(*corrections_of(first))
    before = refiner.result()
    refiner.apply(*corrections_of(later))
    after = refiner.result()
    taken, left = refiner.clicks.mask("outside"), refiner.clicks.mask("inside")
    assert taken.any() and left.any() and not (taken & left).any()
    assert not after.labels[taken].any() and after.labels[left].all()
    assert (before.labels[taken] > 0).any()
    again = Refiner(result)
    for one in after.config.refine:
        again.apply(one)
    assert again.result().psi.tobytes() == after.psi.tobytes()
    refiner.undo()
    assert refiner.result().psi.tobytes() == before.psi.tobytes()
    assert refiner.clicks.mask("inside").sum() > left.sum()
    assert not refiner.clicks.mask("outside").any()


def test_what_contradicts_itself_or_leaves_nothing_is_refused_and_changes_nothing(result):
    refiner = Refiner(result)
    refiner.apply(*corrections_of({"inside": f"point:{world(12, 14, 24)}", "near": 5}))
    psi, config = refiner.result().psi, refiner.config
    here = f"point:{world(12, 14, 24)}"
    with pytest.raises(InputError, match=r"voxel 24,14,12 .* both inside and outside at once"):
        refiner.apply(*corrections_of({"outside": here, "inside": here}))
    with pytest.raises(InputError, match="nothing would be left that is clicked inside"):
        refiner.apply(*corrections_of({"outside": f"ball:{world(12, 14, 18)},12"}))
    assert refiner.result().psi.tobytes() == psi.tobytes() and refiner.config == config
    # What was refused is no correction: undo takes back the one before it.
    refiner.undo()
    assert (
        refiner.result().psi.tobytes() == result.psi.tobytes() and refiner.config == result.config
    )


def test_a_correction_that_fails_leaves_nothing_behind(result):
    """All or nothing: the objects corrected before the failure go back too."""
    refiner = Refiner(result)
    refiner.apply(*corrections_of({"inside": f"point:{world(12, 14, 24)}", "near": 5}))
    before = refiner.result()

    def fail(record, own):
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        refiner.apply(
            *corrections_of({"outside": f"ball:{world(12, 14, 6)},2", "near": 6}), on_step=fail
        )
    now = refiner.result()
    assert now.psi.tobytes() == before.psi.tobytes() and now.config == before.config
    assert len(now.clicks) == len(before.clicks) == 1
    refiner.undo()
    assert refiner.result().psi.tobytes() == result.psi.tobytes()


def test_the_result_has_all_clicks_in_order(image):
    before = first_run(image, inside=f"point:{world(12, 14, 14)}", roi="2,2,0,60,26,36")
    after = refine(before, outside=f"point:{world(12, 14, 24)}", near=5)
    after = refine(after, inside=f"point:{world(11, 14, 14)}")
    at = [("inside", (12, 14, 14)), ("outside", (12, 14, 24)), ("inside", (11, 14, 14))]
    assert [(one.side, tuple(s.start for s in one.box)) for one in after.clicks.clicks] == at
    assert (
        after.clicks.shape == SHAPE and after.objects[0].clicked.shape == after.objects[0].psi.shape
    )
    assert sorted(map(tuple, np.argwhere(after.objects[0].clicked).tolist())) == sorted(
        place for _, place in at
    )


def test_objects_that_the_region_cuts_end_half_a_voxel_beyond_it():
    image, starts = two_balls()[0], np.zeros(SHAPE, int)
    starts[10:14, 12:16, 12:16], starts[10:14, 12:16, 46:50] = 3, 7
    roi = "0,14,0,63,29,37"  # through the middle of both
    before = accelsurf.segment_objects(image, starts, spacing=SPACING, threads=1, roi=roi)
    after = refine(before, outside=f"ball:{world(12, 16, 53)},2", object=7, near=6)
    old, new = before.by_id[7], after.by_id[7]
    assert not np.array_equal(after.labels, before.labels) and new.box == old.box
    assert not new.labels[:, : 14 - new.box[1].start].any()
    # Where the region ends, to a part of a voxel that vertices move by; without what lies beyond it would be 14.
    assert [one.surface.vertices[:, 1].min() for one in (old, new)] == pytest.approx(
        [13.5, 13.5], abs=0.05
    )
    far = far_from([(12, 16, 53)], 6.0 + 2.0)
    far[:, :14] = False  # no surface there: the values next to it, turned outside
    far = far[new.box]
    assert new.psi[far].tobytes() == old.psi[far].tobytes()


def test_a_result_without_state_is_refused(image):
    start = f"ball:{world(12, 14, 14)},5"
    result = accelsurf.segment(image, spacing=SPACING, start=start, max_steps=2, keep_state="no")
    assert result.state is None
    with pytest.raises(UsageError, match="keep_state"):
        refine(result, inside=f"point:{world(12, 14, 24)}")


def in_thick_slices(energy):
    """A result of a ball in slices of 5 mm."""
    shape, spacing = (9, 40, 48), (5.0, 0.8, 0.8)
    z, y, x = (np.indices(shape) - np.array([4, 20, 18])[:, None, None, None]) * np.array(spacing)[
        :, None, None, None
    ]
    image = 100.0 * (z**2 + y**2 + x**2 < 11**2) + np.random.default_rng(2).normal(0, 8, shape)
    start = f"ball:{world(4, 20, 18, spacing=spacing)},5"
    given = {
        "inside" if energy == "seeded" else "start": start,
        "energy": energy,
        "keep_state": "yes",
        "threads": 1,
    }
    return accelsurf.segment(image.astype(np.float32), spacing=spacing, **given)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("energy", ["chan-vese", "seeded"])
@pytest.mark.parametrize("thick", [False, True])
def test_random_clicks_after_random_corrections_hold(image, result, energy, thick, seed):
    """Every click so far is on its side, bytes beyond each region stay, and undoing all gives the first surface."""
    if thick:
        result = in_thick_slices(energy)
    elif energy == "seeded":
        result = first_run(image, energy)
    shape, spacing = result.geometry.shape, result.geometry.spacing
    rng = np.random.default_rng([seed, thick])
    refiner, said = Refiner(result), {}
    clicked = result.clicks.mask("inside") if result.clicks is not None else np.zeros(shape, bool)
    for _ in range(4):
        at = tuple(int(v) for v in rng.integers((2, 4, 4), np.array(shape) - (2, 4, 4)))
        side = "inside" if rng.random() < 0.5 else "outside"
        if said.get(at, side) != side or clicked[at]:
            continue
        near = float(rng.uniform(3, 12))
        before = refiner.result().psi
        refiner.apply(*corrections_of({side: f"point:{world(*at, spacing=spacing)}", "near": near}))
        said[at] = side
        after = refiner.result()
        far = far_from([at], near, shape, spacing)
        assert after.psi[far].tobytes() == before[far].tobytes()
        for place, wanted in said.items():
            assert bool(after.labels[place]) == (wanted == "inside")
        assert after.labels[clicked].all()
    assert len(said) > 2
    for _ in said:
        refiner.undo()
    assert refiner.result().psi.tobytes() == result.psi.tobytes()


def test_refinements_are_read_from_texts_and_tables():
    (one,) = corrections_of(
        "inside=point:1,2,3 inside=point:4,5,6 outside=ball:1,1,1,2 near=7 object=2"
    )
    assert one == Correction(
        inside=("point:1,2,3", "point:4,5,6"), outside=("ball:1,1,1,2",), near=7.0, object=2
    )
    assert corrections_of(str(one)) == (one,)
    for text in (
        "inside=ball:1,1,1,2 new=3 size=4ml",
        "merge=1,3,2",
        "new=5 split=point:1,2,3",
        "remove=4",
    ):
        assert [str(one) for one in corrections_of(text)] == [text] and corrections_of(text)[
            0
        ].kind in text
    for wrong, said in (
        ("merge=1", "at least two"),
        ("merge=2,2", "at least two"),
        ("merge=1,x", "merge x"),
        ("merge=1,2 inside=point:1,2,3", "inside was given with merge"),
        ("new=0 inside=point:1,2,3", "new 0"),
        ("new=4294967296 inside=point:1,2,3", "new 4294967296"),
        ("new=2 outside=point:1,2,3", "expected inside"),
        ("new=2 inside=point:1,2,3 near=4", "near was given with new"),
        ("new=2 inside=point:1,2,3 size=4", "size 4"),
        ("inside=point:1,2,3 size=4ml", "size was given with clicks"),
        ("split=ball:1,2,3,4", "split"),
        ("remove=2 merge=1,2", "remove was given with merge"),
        ("near=3", "no click was given"),
        ("inside=point:1,2,3 near=-1", "near"),
        ("inside=point:1,2,3 depth=1", "depth"),
        ("inside=point:1,2,3 object=x", "object"),
        ({"inside": 3}, "inside 3"),
        (7, "expected clicks"),
    ):
        with pytest.raises(UsageError, match=said):
            corrections_of(wrong)


def test_the_mesh_of_the_result_is_that_of_its_psi(result):
    after = refine(result, outside=f"ball:{world(12, 14, 21)},2", near=6)
    fresh = extract_surface(after.psi, after.geometry)
    assert fresh.vertices.tobytes() == after.surface.vertices.tobytes()
    assert dataclasses.replace(after).stop == after.stop
    assert box_at((0, 0, 0), SHAPE) == after.objects[0].box


def model_of(images, clicks, previous=None):
    return click_model(
        Scene(tuple(images), SPACING), Clicks(tuple(clicks), SHAPE), previous=previous
    )


def continued(images, clicks):
    """The model of some clicks, as corrections go on from it."""
    made = model_of(images, clicks)
    return LocalModel(made, SPACING, lambda clicks, before: model_of(images, clicks.clicks, before))


def never(clicks, before):
    raise AssertionError(f"a model was asked for, with {len(clicks)} clicks")


def row(side, at, length=1):
    """A click on some voxels along x."""
    return Click(side, box_at(at, (1, 1, length)), np.ones((1, 1, length), bool))


def field_and_object(model):
    whole = whole_box(SHAPE)
    return model.field_on(whole).tobytes(), model.inside_on(whole).tobytes()


def test_the_model_click_by_click_is_the_model_of_all_clicks(image):
    """F and the model's object are those of all clicks at once, to the last byte."""
    images = first_run(image, "seeded").state.prepared.images
    clicks = [ball("inside", (12, 14, 14), 3.0, SHAPE, SPACING)]
    local = continued(images, clicks)
    places = (
        ("outside", (12, 14, 20)),
        ("inside", (12, 14, 48)),
        ("outside", (12, 14, 40)),
        ("inside", (6, 14, 14)),
    )
    for side, at in places:
        clicks.append(row(side, at))
        before, change = local.state, local.add(clicks[-1])
        made, after = model_of(images, clicks), local.state
        assert field_and_object(after) == field_and_object(made)
        assert after.inside_on(after.box).sum() == after.count == made.count
        changed = np.zeros(SHAPE, bool)
        changed[change.box] = change.mask
        assert np.array_equal(
            changed, before.inside_on(whole_box(SHAPE)) != after.inside_on(whole_box(SHAPE))
        )
        local.undo(change)
        assert local.state is before
        local.add(clicks[-1])
        assert field_and_object(local.state) == field_and_object(made)


def test_what_a_click_leaves_of_others_keeps_what_they_have_said(image):
    """Where it takes voxels of an earlier click: the model changes to its side alone, from what was there before."""
    images, whole = first_run(image, "seeded").state.prepared.images, whole_box(SHAPE)
    rows = (
        row("inside", (12, 14, 14), 3),
        row("outside", (12, 14, 30)),
        row("inside", (12, 14, 46), 3),
    )
    local = continued(images, rows)
    before = local.state
    for taker in (
        row("outside", (12, 14, 48), 2),
        row("outside", (12, 14, 45), 6),
    ):  # a part, and all of a click
        change = local.add(taker)
        was, now = before.inside_on(whole), local.state.inside_on(whole)
        assert not now[taker.box].any() and not (now & ~was).any() and now[12, 14, 14:17].all()
        assert len(local.state.clicks) == len(rows) + (taker.mask.size == 2)
        far = far_from([(12, 14, 48)], 15.0)
        assert np.array_equal(was[far], now[far])
        again = continued(images, rows)
        again.add(taker)
        assert field_and_object(again.state) == field_and_object(local.state)
        local.undo(change)
        assert local.state is before
    # Of the first click too.
    first = local.state.clicks.clicks[0]
    local.add(first._replace(side="outside", mask=np.array([[[True, False, False]]])))
    now = local.state.inside_on(whole)
    assert not now[12, 14, 14] and now[12, 14, 15:17].all() and now[12, 14, 46:49].all()


def test_a_model_of_several_clicks_goes_on_from_its_first_ones(image):
    """Of which the first is outside."""
    images = first_run(image, "seeded").state.prepared.images
    rows = [
        row("outside", (12, 14, 30)),
        row("inside", (12, 14, 14), 3),
        row("inside", (12, 14, 46), 3),
    ]
    whole = model_of(images, rows)
    assert field_and_object(model_of(images, rows, model_of(images, rows[:2]))) == field_and_object(
        whole
    )
    # One of other clicks is none to go on from.
    other = model_of(images, [row("inside", (12, 14, 46), 3)])
    assert field_and_object(model_of(images, rows, other)) == field_and_object(whole)


def test_what_an_outside_click_cuts_off_is_won_by_it():
    """A leak through a neck: the click is in the neck, and the model's object loses all that lies behind it."""
    field, start = np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool)
    state = ClickModel(Clicks((), SHAPE), whole_box(SHAPE), field, start)
    leak = np.zeros(SHAPE, bool)
    leak[8:18, 8:20, 22:60] = True
    local = LocalModel(state, SPACING, never)
    click = Click("outside", box_at((12, 14, 21), (1, 1, 1)), np.ones((1, 1, 1), bool))
    one = CorrectedSurface(
        1, (0, 0, 0), np.where(leak, -1.0, 1.0).astype(np.float32), int(leak.sum()), [], None
    )
    won = basin_of(click, ModelChange(state.box, leak, state), local, one)
    found = np.zeros(SHAPE, bool)
    found[won.box] = won.mask
    assert found[leak].all() and found.sum() == leak.sum() + 1


def test_single_voxels_far_from_a_click_are_not_won():
    """Any click moves the model's boundary by parts of a voxel everywhere: they would make the region the whole object.

    A piece far away that is thicker than a voxel is won; so is a voxel beside the click.
    """
    field, start = np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool)
    state = ClickModel(Clicks((), SHAPE), whole_box(SHAPE), field, start)
    changed = np.zeros(SHAPE, bool)
    changed[4, 6, 10:60:3] = changed[20, 8:20, 50] = True
    thick = np.zeros(SHAPE, bool)
    thick[10:13, 12:15, 52:55] = True
    beside = np.zeros(SHAPE, bool)
    beside[12, 14, 22] = True
    changed |= thick | beside
    local = LocalModel(state, SPACING, never)
    click = Click("outside", box_at((12, 14, 21), (1, 1, 1)), np.ones((1, 1, 1), bool))
    psi = np.where(changed, -1.0, 1.0).astype(np.float32)
    one = CorrectedSurface(1, (0, 0, 0), psi, int(changed.sum()), [], None)
    won = basin_of(click, ModelChange(state.box, changed, state), local, one)
    found = np.zeros(SHAPE, bool)
    found[won.box] = won.mask
    found[12, 14, 21] = False
    assert np.array_equal(found, thick | beside)


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_clicks_of_one_side_move_the_surface_to_that_side_alone(image, side):
    """Even where the energy pulls everywhere: the start is far from where the energy would have it."""
    before = first_run(image, "threshold:50,", max_steps=1)
    click = f"ball:{world(12, 14, 21)},2" if side == "inside" else f"ball:{world(12, 14, 17)},1.5"
    after = refine(before, **{side: click}, near=20)
    was, now = before.labels > 0, after.labels > 0
    gained, lost = int((now & ~was).sum()), int((was & ~now).sum())
    assert (gained > 0, lost > 0) == (side == "inside", side == "outside")


def test_a_correction_ends_when_its_energy_has_been_lowest(image):
    """At most so many steps after that, whatever its motion."""
    before = first_run(image, "seeded")
    after = refine(before, inside=f"ball:{world(12, 14, 48)},2")
    steps = after.history[len(before.history) - 1 :]
    low = int(np.argmin([record.potential for record in steps[:-1]]))
    assert after.stop.reason == "converged" and len(steps) - 1 <= low + PATIENCE
    lowest = steps[low].potential
    assert steps[-1].potential <= lowest + 1e-9 * abs(lowest)


def test_flows_with_short_steps_wait_longer():
    """Their energy may rise for some steps while the surface has a way to go."""
    assert correction_rule(RunConfig()).patience == PATIENCE
    for flow in ("flowable-mass", "sobolev"):
        assert correction_rule(RunConfig(flow=flow)).patience is None


@pytest.fixture(scope="module")
def doubtful():
    """A result whose values drift towards its rim, and places at the rim of its object."""
    z, y, x = np.indices((24, 40, 40)) - np.array([12, 20, 20]).reshape(3, 1, 1, 1)
    away = np.sqrt(z**2 + y**2 + x**2)
    image = np.where(away < 11, 100.0 - 3.0 * away, 0.0)
    image += np.random.default_rng(2).normal(0.0, 6.0, image.shape)
    result = accelsurf.segment(
        image.astype(np.float32), inside="ball:20,20,12,4", keep_state="yes", threads=1
    )
    labels = result.labels > 0
    rim = np.argwhere(labels & ~ndimage.binary_erosion(labels))
    return result, np.random.default_rng(0).permutation(rim)


def rim_clicks(rim, count):
    return [f"ball:{x},{y},{z},2.5" for z, y, x in rim[:count]]


def test_no_correction_by_a_click_raises_the_probability(doubtful):
    result, rim = doubtful
    refiner, told, unbounded = Refiner(result), [result.quality.probability], []
    for click in rim_clicks(rim, 6):
        (change,) = refiner.apply(Correction(outside=(click,)))
        if change.voxels:
            (segmented,) = refiner.result().objects
            told.append(segmented.quality.probability)
            unbounded.append(dataclasses.replace(segmented, before=None).quality.probability)
            assert segmented.quality.likely.startswith("at least ")
    assert told == sorted(told, reverse=True)
    # Without the bound it would rise: the clicks are harmful, and a measure says otherwise.
    assert any(free > bound for free, bound in zip(unbounded, told[1:], strict=True))


def test_the_bound_is_that_of_all_clicks_in_any_way_they_are_made(doubtful, tmp_path):
    result, rim = doubtful
    clicks = rim_clicks(rim, 4)
    at_once = refine(result, outside=clicks)
    one_by_one, asked = result, []
    for click in clicks:
        one_by_one = refine(one_by_one, outside=click)
        asked.append(one_by_one.quality.probability)
    assert at_once.quality.probability == one_by_one.quality.probability == min(asked)
    path = tmp_path / "state.npz"
    path.write_bytes(state_bytes(at_once, "0" * 64))
    (stored,) = read_state(path).objects
    assert stored.before == at_once.objects[0].before.value
    again = restored(read_state(path), result.volume)
    assert again.quality.probability == at_once.quality.probability
    assert refine(again, outside=rim_clicks(rim, 5)[4]).quality.probability <= min(asked)


def test_undo_gives_the_probability_back(doubtful):
    result, rim = doubtful
    refiner = Refiner(result)
    for click in rim_clicks(rim, 2):
        refiner.apply(Correction(outside=(click,)))
    assert refiner.result().quality.likely.startswith("at least ")
    refiner.undo()
    refiner.undo()
    assert refiner.result().quality.likely == result.quality.likely
