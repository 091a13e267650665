"""Objects of the click benchmark: the rule that chooses them, the folds, references by thresholds, phantoms."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from accelsurf.image.volume import Volume
from benchmarks.clicks import choice, folds, objects, phantoms
from benchmarks.clicks.references import Threshold, edge, largest, part_of

SCANS = [scan for fold in folds.FOLDS for scan in fold.scans]


def test_each_scan_is_in_one_fold_and_a_fold_sees_the_others_only() -> None:
    assert len(SCANS) == len(set(SCANS)) == 19
    assert folds.fold_of_scan("fluo_nuclei1135") == folds.fold_of_scan("fluo_nuclei1136")
    assert folds.fold_of_scan("mri_cord_iso") == folds.fold_of_scan("mri_cord_thick")
    assert folds.fold_of_scan("fluo_vessels_bbb") == folds.fold_of_scan("fluo_vessels_noleak")
    for fold in folds.NAMES:
        assert fold not in folds.tuned_on(fold) and folds.PHANTOMS not in folds.tuned_on(fold)
        assert len(folds.tuned_on(fold)) >= 5
    with pytest.raises(ValueError, match="in no fold"):
        folds.fold_of_scan("another")


def test_the_table_keeps_to_the_rule() -> None:
    every, selected = objects.objects(), objects.selected()
    assert len({which.name for which in every}) == len(every)
    assert {which.family for which in every} <= set(folds.FAMILIES)
    counts = Counter(which.volume for which in selected)
    assert set(counts) == {*SCANS, objects.PHANTOM}
    assert max(counts[scan] for scan in SCANS) <= choice.MOST and counts[objects.PHANTOM] == 12
    assert all(counts[scan] <= choice.MOST_PARTS for scan in choice.PARTS)
    # No fold is without objects, and each family but lesions and cells can be tuned on for every fold.
    for fold in folds.FOLDS:
        families = {which.family for which in objects.selected(folds.tuned_on(fold.name))}
        assert families >= {"organs", "bones", "brain", "vessels", "nuclei", "other"}
    # Objects that the first version had can be named.
    assert len(objects.selected(names=choice.FORMER)) == len(choice.FORMER) == 33
    factors = [objects.size_factor(which) for which in selected]
    assert 0.4 < factors.count(1.25) / len(factors) < 0.6


def test_objects_and_folds_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ValueError, match="no such object"):
        objects.selected(["2"], ["liver"])
    with pytest.raises(ValueError, match="no such fold"):
        objects.selected(["seven"])
    assert [which.name for which in objects.selected(["1"], ["spleen", "liver"])] == [
        "liver",
        "spleen",
    ]


@pytest.mark.skipif("ACCELSURF_VOLUMES" not in os.environ, reason="needs the scans")
@pytest.mark.parametrize(
    "scan", ["synthetic_nuclei", "mri_cord_iso", "ct_vertebra_l3", "mra_aorta"]
)
def test_the_table_is_what_the_rule_gives(scan: str) -> None:
    found = choice.of_scan(scan, Path(os.environ["ACCELSURF_VOLUMES"]))
    assert found == [which for which in objects.objects() if which.volume == scan]


def test_places_go_to_the_families_in_turn() -> None:
    found = [
        choice.Candidate(
            objects.ClickObject(f"{family}{size}", "scan", (size,), family), size, np.inf
        )
        for family, sizes in (("organs", (5, 50)), ("bones", (6, 7, 8, 9, 10)), ("other", (90,)))
        for size in sizes
    ]
    taken = [each.object.name for each in choice.spread(found, 6)]
    # Two organs, three bones from the largest to the smallest, one other.
    assert taken == ["organs50", "organs5", "bones10", "bones8", "bones6", "other90"]
    assert [each.object.name for each in choice.spread(found, 2)] == ["organs50", "bones10"]


def test_maps_of_many_parcels_are_asked_for_an_edge() -> None:
    reference = np.arange(1, 9 * 9 * 9 + 1).reshape(9, 9, 9).astype(np.int32) + 300
    reference[2:7, 2:7, 2:7] = 4
    values = np.where(reference == 4, 1.0, 0.0)
    many = {
        each.object.name: each.edge for each in choice.candidates("mri_brain256", values, reference)
    }
    assert many["ventricle-left"] > 100 and "ventricle-right" not in many
    few = next(iter(choice.candidates("mri_cord_iso", values, (reference == 4).astype(np.int32))))
    assert few.edge == np.inf and few.size == 125


def test_an_edge_is_a_difference_in_deviations() -> None:
    random = np.random.default_rng(0)
    mask = np.zeros((24, 24, 24), bool)
    mask[6:18, 6:18, 6:18] = True
    assert edge(random.normal(0.0, 2.0, mask.shape) + 3.0 * mask, mask) == pytest.approx(
        1.5, abs=0.1
    )


def test_references_by_thresholds() -> None:
    # A dark cavity in a body of middle brightness with a bright cap, and a loose bright voxel.
    values = np.zeros((24, 24, 24), np.float32)
    values[4:20, 4:20, 4:20] = 50.0
    values[4:7, 4:20, 4:20] = 100.0
    values[10:14, 10:14, 10:14] = 0.0
    values[22, 22, 22] = 100.0
    cap = Threshold("any", "bones", 2, 2).mask(values)
    assert cap.sum() == 3 * 16 * 16 and cap[4:7, 4:20, 4:20].all()
    cavity = Threshold("any", "other", 0, 0, closed=True).mask(values)
    assert cavity.sum() == 64 and cavity[10:14, 10:14, 10:14].all()
    body = Threshold("any", "bones", 1, 2, without=Threshold("any", "bones", 2, 2)).mask(values)
    # A voxel of the body goes with the cap.
    assert not body[:8].any() and body[8, 5, 5]


def test_parts_are_ranked_by_size() -> None:
    mask = np.zeros((1, 3, 12), bool)
    mask[0, 0, :2] = mask[0, 2, 3:8] = mask[0, 0, 9:12] = True
    assert [int(part_of(mask, rank).sum()) for rank in (1, 2, 3)] == [5, 3, 2]
    assert largest(mask).sum() == 5


@pytest.mark.parametrize("name", list(phantoms.KINDS))
def test_phantoms_are_the_same_each_time_and_of_one_part(name: str) -> None:
    image, truth = phantoms.made(name)
    again, same = phantoms.made(name)
    assert (image.array == again.array).all() and (truth == same).all()
    other, changed = phantoms.made(name, seed=1)
    assert (other.array != image.array).any() and (changed != truth).any()
    assert image.array.shape == truth.shape and truth.any() and not truth.all()
    assert part_of(truth, 1).sum() > 0.99 * truth.sum()


def test_phantoms_are_what_they_are_called() -> None:
    shares = {name: phantoms.made(name)[1].mean() for name in phantoms.KINDS}
    assert 0.8 < shares["phantom-large"] < 0.9 and 0.4 < shares["phantom-half"] < 0.6
    assert shares["phantom-tube"] < 0.05 and shares["phantom-tree"] < 0.05
    thick, _ = phantoms.made("phantom-thick")
    assert thick.geometry.spacing == (5.0, 1.0, 1.0) and thick.array.shape == (12, 64, 64)
    assert edge_of("phantom-noisy") < 1.0 < edge_of("phantom-blob")
    # Cells are as bright as each other, and their walls are not.
    image, truth = phantoms.made("phantom-cells")
    core, beyond = truth & (image.array < 60), ~truth & (image.array < 60)
    assert abs(image.array[core].mean() - image.array[beyond].mean()) < 5.0


def edge_of(name: str) -> float:
    image, truth = phantoms.made(name)
    return edge(image.array, truth)


def test_a_slab_of_a_scan_is_what_is_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.zeros((30, 200, 120), np.float32)
    monkeypatch.setattr(objects, "_image", lambda path: Volume.from_array(values, 1.0))
    monkeypatch.setattr(objects, "_labels", lambda path: (values == 0).astype(int))
    monkeypatch.setattr(objects, "scan", lambda folder, name: Path("folder") / name)
    objects.load.cache_clear()
    scene = objects.load(objects.selected(names=["aorta-mra"])[0], Path("folder"))
    objects.load.cache_clear()
    assert scene.region == (slice(9, 24), slice(84, 178), slice(56, 95))
    assert scene.truth[scene.region].all() and scene.truth.sum() == 15 * 94 * 39
