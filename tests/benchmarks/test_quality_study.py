"""The study of how sure results are: whose probabilities are whose, what a weight may be, what is counted."""

from typing import Any

import numpy as np
import pytest

from benchmarks import quality

NAMES = ("level_overlap", "size_spread", "rim", "drift", "correction", "unchanged", "surprise")


def row(dice: float, overlap: float, fold: str = "1", **more: Any) -> dict[str, Any]:
    click = {**dict.fromkeys(NAMES, 0.0), "level_overlap": overlap, "size_spread": overlap}
    return {"dice": dice, "clicks": click, "fold": fold, "hinted": None, "person": None, **more}


ROWS = {
    f"object-{i}": [row(0.5 + 0.02 * i + 0.1 * k, i + 5.0 * k, str(1 + i % 3)) for k in range(3)]
    for i in range(12)
}


def test_a_measure_that_counts_the_wrong_way_is_left_out() -> None:
    model = quality.trained(ROWS, "clicks")
    # The spread has the same values as the overlap, and may only lower the probability.
    assert model["features"]["size_spread"][2] == 0.0 < model["features"]["level_overlap"][2]


def test_a_fold_is_judged_by_a_model_made_without_it() -> None:
    changed = {**ROWS, "object-4": [{**each, "dice": 0.99} for each in ROWS["object-4"]]}
    before, after = quality.judged(ROWS, "clicks"), quality.judged(changed, "clicks")
    for name, rows in ROWS.items():
        assert (before[name] == after[name]) == (rows[0]["fold"] == ROWS["object-4"][0]["fold"])


def test_an_object_of_a_drawn_scene_counts_less() -> None:
    plain = {"a": [row(0.9, 1.0)], "b": [row(0.5, 1.0)]}
    drawn = {"a": [row(0.9, 1.0)], "b": [row(0.5, 1.0, quality.DRAWN)]}
    assert (
        quality.trained(drawn, "clicks")["constant"] > quality.trained(plain, "clicks")["constant"]
    )
    assert quality.table_of(drawn, {"a": judged(0.5), "b": judged(0.5)})[2].tolist() == [
        1.0,
        quality.SCENE_WEIGHT,
    ]


def judged(*values: float) -> quality.Judged:
    return quality.Judged(list(values), [quality.WARNED] * len(values))


@pytest.mark.parametrize("seed", range(3))
def test_no_click_of_a_game_raises_what_is_stated(seed: int) -> None:
    random = np.random.default_rng(seed)
    games = [
        row(0.5, v, game=game) for game in ("exact", "jittered") for v in random.normal(size=4)
    ]
    model = quality.trained(ROWS, "clicks")
    alone, stated = (f(model, games, "clicks") for f in (quality.probabilities, quality.stated))
    for first in (0, 4):  # each game begins anew
        least = np.minimum.accumulate(alone[first : first + 4])
        assert stated[first : first + 4] == least.tolist()


def test_figures_count_what_is_said_to_be_good() -> None:
    rows = {
        "one": [row(0.5, 0.0, hinted=0.6, person=0.8), row(0.9, 0.0), row(0.75, 0.0)],
        "two": [row(0.9, 0.0), row(0.4, 0.0, hinted=0.4, person=0.7)],
    }
    found = quality.figures(rows, {"one": judged(0.2, 0.9, 0.8), "two": judged(0.75, 0.1)})
    assert (found["results"], found["said"], found["failed"]) == (5, 3, 2)
    assert (found["good_of_said"], found["said_of_failed"]) == pytest.approx((2 / 3, 0.0))
    assert (
        found["doubted_of_failed"] == 1.0
        and found["doubted_of_good"] == 0.0
        and found["hints"] == 2
    )
    assert (found["hinted_raises"], found["person_raises"]) == pytest.approx((0.5, 1.0))
    assert (found["hinted_gain"], found["person_gain"]) == pytest.approx((0.05, 0.3))
    text = quality.text_of({"clicks": {"all scans": found}, "image": {}})
    assert "| all scans | 5 | 40% | 3 | 67% | 2 | 0% | 100% | 0% |" in text
    assert "| all scans | 2 | 50% | +0.050 | 100% | +0.300 |" in text


def test_nothing_said_to_be_good_has_no_share() -> None:
    found = quality.figures({"one": [row(0.9, 0.0)]}, {"one": judged(0.2)})
    assert found["good_of_said"] is None and found["said_of_failed"] is None and found["hints"] == 0
    assert np.isclose(found["good"], 1.0)
