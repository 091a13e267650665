"""The study of how sure results are: which rows a model sees, whose probabilities are whose, what is counted."""

from typing import Any

import numpy as np
import pytest

from benchmarks import quality


def row(dice: float, overlap: float, game: str = "exact") -> dict[str, Any]:
    clicks = {"level_overlap": overlap, "corrections": 0.0, "correction": 0.0, "size_spread": overlap}
    return {"dice": dice, "clicks": clicks, "image": {}, "game": game, "at_wrong": None}


ROWS = {f"object-{i}": [row(0.5 + 0.02 * i + 0.1 * k, i + 5.0 * k) for k in range(3)] for i in range(10)}


def test_shares_are_of_all_results_by_weight() -> None:
    quiet, truth = np.array([True, True, False, False]), np.array([0.6, 0.9, 0.6, 0.9])
    assert quality.shares(quiet, truth, np.array([1.0, 1.0, 1.0, 2.0])) == (0.2, 0.4)


def test_only_rows_with_clicks_make_the_model_of_clicks() -> None:
    phantoms = {"ball": [{"dice": 0.9, "image": {"drift": 1.0}}]}
    assert quality.rows_of({**ROWS, **phantoms}, "clicks") == ROWS
    assert quality.rows_of({**ROWS, **phantoms}, "image") == {**ROWS, **phantoms}


def test_a_measure_that_counts_the_wrong_way_is_left_out() -> None:
    model = quality.trained(ROWS, "clicks")
    # The spread has the same values as the overlap, and may only lower the probability.
    assert model["features"]["size_spread"][2] == 0.0 < model["features"]["level_overlap"][2]


def test_an_object_is_judged_by_a_model_made_without_it() -> None:
    changed = {**ROWS, "object-4": [{**one, "dice": 0.99} for one in ROWS["object-4"]]}
    assert quality.crossed(ROWS, "object-4", "clicks") == quality.crossed(changed, "object-4", "clicks")
    assert quality.crossed(ROWS, "object-5", "clicks") != quality.crossed(changed, "object-5", "clicks")


def test_figures_count_silent_failures_and_false_alarms() -> None:
    judged = {"one": [(row(0.6, 0.0), 0.8), (row(0.9, 0.0), 0.8)], "two": [(row(0.9, 0.0), 0.3)]}
    found = quality.figures(judged, 0.5)
    # Each object counts the same: the first one's failure is a quarter, the second one's alarm a half.
    assert (found["silent"], found["false"]) == pytest.approx((0.25, 0.5))
    assert (found["silent_of_failures"], found["false_of_good"]) == pytest.approx((1.0, 2.0 / 3.0))
