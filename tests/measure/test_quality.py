"""What a result says about itself: border, contrast, edges, necks, growth."""

import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.api.segment import segment
from accelsurf.clicks.model.confidence import Confidence
from accelsurf.evolution.records import Stop
from accelsurf.grid.geometry import Geometry
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.image.volume import Volume
from accelsurf.interact.refine import refine
from accelsurf.measure import likely
from accelsurf.measure.likely import Plateau, click_features, features
from accelsurf.measure.metrics import dice
from accelsurf.measure.quality import Judged, ValueRange, assess
from accelsurf.output.document import describe_quality, report_json
from accelsurf.text.starts import psi_of_starts, read_starts
from tests.support.records import step_record

SHAPE, SPACING = (40, 44, 48), (1.5, 1.0, 0.8)
DONE = Stop("converged", 9, 1.0, "done")


def coordinates(shape=SHAPE):
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(shape, SPACING, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


def look(mask, image, history=(), stop=DONE):
    return assess(
        Judged(
            mask.astype(np.uint8), image.astype(np.float32), Geometry(SHAPE, SPACING), history, stop
        )
    )


def test_a_clean_ball_raises_no_warning():
    z, y, x = coordinates()
    mask = z**2 + y**2 + x**2 < 12**2
    history = [step_record(0, volume_mm3=5.0), step_record(1)]
    found = look(mask, mask + np.random.default_rng(1).normal(0, 0.05, SHAPE), history)
    assert (
        found.warnings == ()
        and found.notes == ()
        and found.parts_beyond_necks == 1
        and not found.leaked
    )
    assert found.border_fraction == 0 and found.contrast > 5
    assert found.no_edge_fraction < 0.02 and found.growth == 2


def test_the_border_s_share_is_that_of_its_area():
    z, y, x = coordinates()
    mask = x < 0  # a block: one face within, five on the border
    found = look(mask, mask * 1.0)
    a, b, c = (n * h for n, h in zip(SHAPE, SPACING, strict=True))
    within = a * b
    border = within + 2 * (a + b) * c / 2
    assert found.border_fraction == pytest.approx(border / (border + within), rel=1e-6)
    assert any("border" in words for words in found.notes)


def test_a_surface_with_no_edge_under_it_is_told():
    z, y, x = coordinates()
    r = np.sqrt(z**2 + y**2 + x**2)
    noise = np.random.default_rng(1).normal(0, 0.05, SHAPE)
    scan = (r < 9) + noise
    assert look(r < 9, scan).no_edge_fraction < 0.02
    wrong = look(r < 15, scan)
    assert wrong.no_edge_fraction > 0.4 and wrong.contrast < 2
    assert any("edge: " in words for words in wrong.notes) and any(
        "contrast: " in words for words in wrong.notes
    )
    half = look((r < 9) | ((r < 15) & (x > 0)), scan)
    assert wrong.no_edge_fraction > half.no_edge_fraction > 0.2


def test_two_balls_on_a_thin_bridge_are_two_parts():
    z, y, x = coordinates()
    balls = [(x - c) ** 2 + y**2 + z**2 < 8**2 for c in (-10, 10)]
    thin = balls[0] | balls[1] | ((np.abs(y) < 1.2) & (np.abs(z) < 1.2) & (np.abs(x) < 10))
    thick = balls[0] | balls[1] | ((np.abs(y) < 6) & (np.abs(z) < 6) & (np.abs(x) < 10))
    assert look(thin, thin * 1.0).parts_beyond_necks == 2
    assert any("necks: 2 large parts" in words for words in look(thin, thin * 1.0).notes)
    assert look(thick, thick * 1.0).parts_beyond_necks == 1
    # Small side branches are no parts.
    branch = balls[0] | ((np.abs(y) < 2) & (np.abs(z) < 2) & (x > -10))
    assert look(branch, branch * 1.0).parts_beyond_necks == 1


def test_growth_in_the_last_steps_counts_when_the_run_has_not_converged():
    z, y, x = coordinates()
    mask = z**2 + y**2 + x**2 < 12**2
    history = [step_record(step, volume_mm3=100.0 + 2.0 * step) for step in range(60)]
    found = look(mask, mask * 1.0, history, Stop("max-steps", 60, 6.0, "not converged"))
    assert found.late_growth == pytest.approx(40 / 218)
    (line,) = (words for words in found.warnings if words.startswith("growth: "))
    assert line.endswith("in the last 20 steps")
    assert look(mask, mask * 1.0, history).warnings == ()
    # What has broken through after a rest only goes on.
    seen = mask.astype(np.uint8), mask.astype(np.float32), Geometry(SHAPE, SPACING), history
    rest = Plateau(4, 110.0, 9, (1.0, 2.0, 3.0))
    found = assess(Judged(*seen, Stop("max-steps", 60, 6.0, "not converged"), plateaus=[rest]))
    assert any(
        words.startswith("growth: ") and words.endswith("try --stop-at-rest")
        for words in found.warnings
    )


def test_a_leak_after_a_plateau_names_the_plateau():
    z, y, x = coordinates()
    mask = z**2 + y**2 + x**2 < 12**2
    seen = mask.astype(np.uint8), mask.astype(np.float32), Geometry(SHAPE, SPACING), []
    leaked = Stop("leaked", 60, 6.0, "it is too large")
    rest = Plateau(4, 110.0, 9, (1.0, 2.25, 3.0))
    for plateaus, wanted in (
        ((), "leak: it is too large"),
        ((rest,), "leak: it is too large; try --stop-at-rest"),
    ):
        found = assess(Judged(*seen, leaked, plateaus=plateaus))
        assert [words for words in found.warnings if words.startswith("leak: ")] == [wanted]


def made_for(case):
    """Voxels, a start and where the object may be: one as it should be, and one for each doubt."""
    z, y, x = coordinates()
    r = np.sqrt(z**2 + y**2 + x**2)
    balls = [np.sqrt((x - c) ** 2 + y**2 + z**2) < 8 for c in (-9.5, 9.5)]
    cases = {
        "good": r < 12,
        "border": x < 0,
        "necks": balls[0] | balls[1] | ((np.abs(y) < 1.7) & (np.abs(z) < 1.7) & (np.abs(x) < 9)),
        "edge": r < 16,  # held back by a mask within it
    }
    noise = np.random.default_rng(1).normal(0, 0.01, SHAPE)
    start = "ball:11.6,21.5,19.5,7vox" if case == "necks" else "center"
    return (
        (cases[case] + noise).astype(np.float32),
        start,
        ((r < 8) | (x > 6) if case == "edge" else r < np.inf),
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("case", ["good", "border", "necks", "edge"])
def test_the_command_warns_and_notes_the_plateau(case, tmp_path, capsys):
    scan, start, allowed = made_for(case)
    io.write(Volume(scan, Geometry(SHAPE, SPACING)), tmp_path / "scan.nii.gz")
    io.write(Volume(allowed.astype(np.uint8), Geometry(SHAPE, SPACING)), tmp_path / "mask.nii.gz")
    words = [
        "segment",
        str(tmp_path / "scan.nii.gz"),
        "--start",
        start,
        "--mask",
        str(tmp_path / "mask.nii.gz"),
    ]
    words += ["--levels", "1"]
    assert cli.execute([*words, "-o", str(tmp_path / "one")]) == 0
    told = capsys.readouterr()
    assert ("warning: doubt: " in told.err) == (case == "edge")
    assert ("try --inside at the object in place of --start" in told.err) == (case == "edge")
    assert "likely to be good (Dice 0.8 or more); most doubtful near " in told.out
    noted = case in ("border", "necks", "edge")
    assert (f"note: {case}: " in told.out) == noted and "note: " not in told.err.replace(
        "note: compiling", ""
    )
    assert cli.execute([*words, "-o", str(tmp_path / "two"), "--strict", "--quiet"]) == (
        5 if case == "edge" else 0
    )
    assert (tmp_path / "two" / "scan_seg.nii.gz").exists()


def test_the_report_has_probability_place_and_plateaus_as_values():
    z, y, x = coordinates()
    mask = z**2 + y**2 + x**2 < 12**2
    rest = Plateau(4, 3000.0, 9, (1.0, 2.0, 3.0))
    geometry = Geometry(SHAPE, SPACING, origin=(100.0, 0.0, 0.0))
    history = [step_record(0, volume_mm3=900.0), step_record(9, volume_mm3=7200.0, area_mm2=1800.0)]
    found = assess(
        Judged(
            mask.astype(np.uint8), mask.astype(np.float32), geometry, history, DONE, plateaus=[rest]
        )
    )
    described = json.loads(report_json(describe_quality(found)))
    assert described["rests"] == [
        {"step": 4, "volume_mm3": 3000.0, "left_at": 9, "place": [1.0, 2.0, 3.0]}
    ]
    assert 0 <= described["probability"] <= 1 and described["next_click"][0] > 100
    assert any(
        "rested at step 4 with 3 ml" in note and "ended with 7.2 ml" in note
        for note in described["notes"]
    )


def test_a_plateau_is_noted_where_the_object_has_grown_since():
    z, y, x = coordinates()
    mask = (z**2 + y**2 + x**2 < 12**2).astype(np.uint8)
    history = [step_record(0, volume_mm3=1e-6), step_record(9, volume_mm3=5e-6, area_mm2=1800.0)]
    for size, noted in ((4e-6, True), (4.8e-6, False), (6e-6, False)):
        rest = Plateau(4, size, 9, (1.0, 2.0, 3.0))
        found = assess(
            Judged(
                mask,
                mask.astype(np.float32),
                Geometry(SHAPE, SPACING),
                history,
                DONE,
                plateaus=[rest],
            )
        )
        assert any(note.startswith("rest: ") for note in found.notes) == noted
        assert not noted or "with 4000 um3, then" in found.notes[0]


def test_what_is_too_small_to_be_judged_is_uncertain():
    mask = np.zeros(SHAPE, bool)
    mask[20, 22, 24] = True
    found = look(mask, mask * 1.0, [step_record(0, volume_mm3=1.2), step_record(9, volume_mm3=1.2)])
    assert found.next_click is None
    place = ",".join(
        f"{index * h:.1f}" for index, h in zip((24, 22, 20), SPACING[::-1], strict=True)
    )
    wanted = f"the object is too small to judge (1.2 mm3); try --inside ball:{place},{2 * max(SPACING):.2g}"
    assert [words for words in found.warnings if wanted in words]


def test_the_probability_is_that_of_the_file_and_falls_with_each_warning():
    z, y, x = coordinates()
    r = np.sqrt(z**2 + y**2 + x**2)
    image = (r < 12) + np.random.default_rng(1).normal(0, 0.05, SHAPE)
    history = [step_record(0, volume_mm3=900.0), step_record(9, volume_mm3=7200.0, area_mm2=1810.0)]
    good, bad = (look(mask, image, history) for mask in (r < 12, (r < 7) | ((x > 0) & (r < 16))))
    assert good.probability > likely.warning_threshold(good) > bad.probability
    model = likely.calibrated_models()["image"]
    total = model["constant"] + sum(
        weight * (features(good)[name] - mean) / deviation
        for name, (mean, deviation, weight) in model["features"].items()
    )
    assert good.probability == pytest.approx(1 / (1 + np.exp(-total)))


USUAL = Confidence(
    overlap=0.85, spread=0.9, correction=0.3, unchanged=0.9, taken=0.0, disagreement=0.3, answers=()
)


def told_of(confidence, mask=None):
    """Quality of a ball, or of a mask, with a confidence of the model of the clicks."""
    z, y, x = coordinates()
    mask = z**2 + y**2 + x**2 < 12**2 if mask is None else mask
    seen = mask.astype(np.uint8), mask.astype(np.float32), Geometry(SHAPE, SPACING), [], DONE
    return assess(Judged(*seen, confidence=confidence))


def test_what_the_model_of_the_clicks_says_counts_for_all():
    def probability(**changes):
        found = told_of(USUAL._replace(**changes))
        assert click_features(found) == features(found)
        warned = [words for words in found.warnings if words.startswith("doubt: ")]
        assert bool(warned) == (found.probability < likely.warning_threshold(found))
        return found.probability

    usual = probability()
    for better, worse in (
        ({"overlap": 0.95}, {"overlap": 0.7}),
        ({"correction": 0.1}, {"correction": 0.9}),
        ({"unchanged": 0.98}, {"unchanged": 0.6}),
        ({"disagreement": 0.0}, {"disagreement": 0.9}),
        ({"spread": 0.2}, {"spread": 1.8}),
    ):
        # A measure that was found to tell nothing has no weight; none counts the wrong way.
        assert probability(**better) >= usual >= probability(**worse)
    assert (
        probability(overlap=0.0, correction=5.0, unchanged=0.2, disagreement=1.0, spread=3.0) < 0.05
    )
    assert (
        probability(overlap=1.0, correction=0.03, unchanged=1.0, disagreement=0.0, spread=0.0)
        > 0.95
    )


def test_neither_the_compactness_nor_the_number_of_clicks_is_a_feature():
    names = set(likely.calibrated_models()["clicks"]["features"])
    assert names == set(click_features(told_of(USUAL))) and not names & {
        "compactness",
        "corrections",
        "clicks",
    }


@pytest.mark.parametrize(
    ("feature", "changes", "words"),
    [
        ("level_overlap", {"overlap": 0.1}, "a small change of its size gives another shape"),
        ("size_spread", {"spread": 3.0}, "objects of other sizes fit the clicks as well"),
    ],
)
def test_a_warning_names_what_speaks_most_against_the_result(feature, changes, words):
    confident = USUAL._replace(
        overlap=0.98, spread=0.2, correction=0.1, unchanged=0.98, disagreement=0.0
    )
    weight = likely.calibrated_models()["clicks"]["features"][feature][2]
    assert (words in likely.why(told_of(confident._replace(**changes)))) == (weight != 0)


@pytest.mark.parametrize("correction", [None, 0.05, 5.0])
@pytest.mark.parametrize("unchanged", [None, 0.1, 0.99])
@pytest.mark.parametrize("disagreement", [None, 0.0, 1.0])
def test_a_click_that_leaves_the_surface_as_it_is_leaves_its_probability(
    correction, unchanged, disagreement
):
    clicked = USUAL._replace(correction=correction, unchanged=unchanged, disagreement=disagreement)
    assert told_of(clicked).probability == told_of(USUAL).probability
    assert likely.why(told_of(clicked)) == likely.why(told_of(USUAL))


def test_thin_objects_and_those_whose_values_drift_are_told_so():
    z, y, x = coordinates()
    thin = told_of(USUAL, (np.abs(z) < 0.8) & (np.abs(y) < 12) & (np.abs(x) < 12))
    assert thin.rim_fraction == 1.0 and thin.probability < told_of(USUAL).probability
    assert "it is thin or small: 100% of its voxels lie at its surface" in likely.why(thin)


def test_nothing_is_doubted_and_a_ball_is_not():
    truth, noise = (
        sum(axis**2 for axis in coordinates()) < 12**2,
        np.random.default_rng(1).normal(0, 1, SHAPE),
    )
    words = {"spacing": SPACING, "threads": 1}
    good = segment(truth + 0.1 * noise, inside="ball:18.8,21.5,29.25,6", **words)
    bad = segment(0.3 * noise, inside="ball:18.8,21.5,29.25,3", **words)  # there is nothing
    assert (
        dice(good.labels > 0, truth) > 0.95
        and good.quality.warnings == ()
        and good.quality.probability > 0.8
    )
    assert bad.quality.probability < 0.3
    (warning,) = bad.quality.warnings
    assert warning.startswith("doubt: probably not right (")
    assert warning.endswith("likely to be good); try --inside or --outside where it is most wrong")
    # A click into what was found is a correction, and how deep it went counts; one beside it is none.
    beside, into = (refine(good, outside=f"ball:18.8,21.5,{at},1") for at in (45.0, 37.5))
    assert good.quality.correction is None and beside.quality.correction is None
    assert into.quality.correction == pytest.approx(1 / 12, abs=0.03)
    assert into.quality.unchanged < 1.0 and into.quality.disagreement > 0.3


def test_nothing_left_and_one_slice():
    nothing = look(np.zeros(SHAPE, bool), np.random.default_rng(1).normal(size=SHAPE))
    assert nothing.border_fraction == 0 and nothing.parts_beyond_necks == 0
    y, x = np.indices((60, 70)) - 30.0
    disc = x**2 + y**2 < 15**2
    result = segment(disc * 1.0, start="ball:30,30,0,8vox")
    assert (
        result.quality.warnings == ()
        and result.quality.contrast > 5
        and result.quality.border_fraction == 0
    )


@pytest.mark.parametrize("shape", [(12, 14, 9), (1, 20, 13)])
def test_gradients_of_some_voxels_are_those_of_all(shape):
    from accelsurf.image.smoothing import gradient_magnitude
    from accelsurf.measure.quality import gradients

    image = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    some = np.arange(0, image.size, 3)
    got = gradients(gaussian_mm(image, SPACING, 1.2), SPACING, some)
    np.testing.assert_allclose(
        got, gradient_magnitude(image, SPACING, 1.2).ravel()[some], rtol=1e-5, atol=1e-6
    )


def test_a_sample_of_the_inside_tells_as_much(monkeypatch):
    from accelsurf.measure import quality as edges

    z, y, x = coordinates()
    r = np.sqrt(z**2 + y**2 + x**2)
    scan = (r < 9) + np.random.default_rng(1).normal(0, 0.05, SHAPE)
    half = (r < 9) | ((r < 15) & (x > 0))
    whole = look(half, scan)
    monkeypatch.setattr(edges, "GRADIENT_SAMPLES", 1 << 12)
    assert look(half, scan).no_edge_fraction == pytest.approx(whole.no_edge_fraction, abs=0.03)


def test_slabs_make_no_difference(monkeypatch):
    from accelsurf.grid import boxes
    from accelsurf.measure import quality as edges

    z, y, x = coordinates()
    mask = z**2 + y**2 + x**2 < 12**2
    scan = mask + np.random.default_rng(1).normal(0, 0.3, SHAPE)
    whole = look(mask, scan)
    monkeypatch.setattr(boxes, "SLAB_VOXELS", 1)
    monkeypatch.setattr(edges, "MIN_SLAB_HALOS", 1)
    assert look(mask, scan).no_edge_fraction == pytest.approx(whole.no_edge_fraction, abs=0.01)


def test_a_leak_into_tissue_like_the_object_is_told_by_its_values():
    # An organ, muscle next to it and lung around: learned against all else, the broad background loses muscle too.
    z, y, x = coordinates()
    organ = (x + 6) ** 2 + y**2 + z**2 < 10**2
    muscle = ((x - 8) ** 2 + y**2 + z**2 < 11**2) & ~organ
    scan = -900.0 + 990 * organ + 960 * muscle + np.random.default_rng(1).normal(0, 8, SHAPE)
    start = "ball:15,21.5,19.5,6vox"
    leaked = segment(
        scan, spacing=SPACING, start=start, energy="likelihood:model=histogram,update=no"
    )
    assert leaked.labels[muscle].mean() > 0.8 and leaked.quality.unlike_learned > 0.2
    assert (
        leaked.stop.reason == "converged" and leaked.quality.no_edge_fraction < 0.1
    )  # nothing else tells
    assert any(words.startswith("values: ") and "leaked" in words for words in leaked.quality.notes)
    held = segment(scan, spacing=SPACING, start=start, energy="threshold:learned,learned")
    assert held.labels[muscle].mean() < 0.15 and held.quality.unlike_learned < 0.05
    assert not any(words.startswith("values: ") for words in held.quality.notes)
    # What was not learned cannot be unlike.
    assert segment(scan, spacing=SPACING, start=start, max_steps=5).quality.unlike_learned is None


def test_learned_values_are_those_of_the_image_that_is_evolved():
    z, y, x = coordinates()
    scan = 100.0 * (z**2 + y**2 + x**2 < 12**2) + np.random.default_rng(1).normal(0, 10, SHAPE)
    words = {"spacing": SPACING, "start": "ball:23.5,21.5,19.5,6vox", "max_steps": 1}
    words["energy"] = "threshold:learned,learned"
    for sigma in (0.0, 0.8):
        term = segment(scan, presmooth=sigma, **words).terms[0]
        volume = Volume(scan.astype(np.float32), Geometry(SHAPE, SPACING))
        evolved = gaussian_mm(volume.array, SPACING, sigma) if sigma else volume.array
        ball = evolved[psi_of_starts(read_starts([words["start"]]), volume, volume.array) < 0]
        deviation = 1.4826 * np.median(np.abs(ball - np.median(ball)))
        assert term["HI"] - term["LO"] == pytest.approx(5 * deviation, rel=1e-3)
        assert 0.5 * (term["HI"] + term["LO"]) == pytest.approx(100, abs=1)
        assert (deviation > 9) == (sigma == 0)
    half = segment(scan, **{**words, "energy": "threshold:half:20,"}).terms[0]["LO"]
    assert half == pytest.approx(60, abs=0.5)


def test_it_takes_less_memory_than_the_solver():
    # As much as the image of the solver, 16 bytes for a voxel, in what Python and numpy count.
    import tracemalloc

    ax = np.arange(160, dtype=np.float32) - 79.5
    inside = (ax[:, None, None] ** 2 + ax[:, None] ** 2 + ax**2 < 70**2).astype(np.uint8)
    image = inside.astype(np.float32)
    tracemalloc.start()
    assess(
        Judged(
            inside, image, Geometry(inside.shape, (1.0, 1.0, 1.0)), [], DONE, ValueRange(0.5, 1.5)
        )
    )
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * inside.size


def test_an_outside_click_that_takes_most_is_said():
    lines = [told_of(USUAL._replace(taken=share)).notes for share in (0.3, 0.7)]
    assert not any(line.startswith("outside:") for line in lines[0])
    assert any(
        line.startswith("outside: the last click outside took away 70%") for line in lines[1]
    )
