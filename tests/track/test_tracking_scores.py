"""Scores of tracks against cases that are counted by hand."""

import numpy as np
import pytest

from accelsurf.track.scores import ExactLabels, Operations, Stretch, TrackedLabels, score, stretches


def line(*runs):
    """A label map of one row: (label, count) one after the other."""
    return np.concatenate([np.full(count, own) for own, count in runs]).reshape(1, 1, -1)


def tracked(frames, parents=None, tracks=None):
    if tracks is None:
        where = {}
        for number, labels in enumerate(frames):
            for own in np.unique(labels[labels > 0]).tolist():
                where.setdefault(own, []).append(number)
        tracks = stretches(where, parents or {})
    return TrackedLabels(len(frames), lambda number: frames[number], tracks)


TWO = line((0, 2), (1, 4), (0, 2), (2, 6), (0, 2))


def test_the_same_tracks_are_perfect():
    reference = tracked([TWO] * 3)
    found = score(reference, reference)
    assert (found.seg, found.det, found.tra, found.dice, found.switches) == (1.0, 1.0, 1.0, 1.0, 0)
    assert found.operations == Operations(0, 0, 0, 0, 0, 0)
    assert found.identities == {1: 1, 2: 2}


def test_other_names_of_the_same_objects_cost_nothing():
    renamed = [np.where(TWO == 1, 9, np.where(TWO == 2, 1, 0))] * 3
    found = score(tracked(renamed), tracked([TWO] * 3))
    assert (found.seg, found.tra, found.dice, found.switches, found.identities) == (
        1.0,
        1.0,
        1.0,
        0,
        {1: 9, 2: 1},
    )


def test_overlap_is_that_of_what_covers_more_than_half():
    # 1: 3 of its 4 voxels and 1 more: 3/5. 2: 3 of its 6 is not more than half: nothing.
    result = line((0, 1), (1, 4), (0, 3), (2, 3), (0, 5))
    found = score(tracked([result]), tracked([TWO]))
    assert found.seg == pytest.approx((3 / 5 + 0) / 2)
    assert found.operations == Operations(
        splits=0, missing=1, false=1, false_edges=0, missing_edges=0, changed_edges=0
    )
    assert found.det == pytest.approx(1 - (10 + 1) / 20)
    assert found.dice == pytest.approx((6 / 8 + 6 / 9) / 2)
    assert found.frames == ((0, 2, 2, 1, found.dice),)


def test_a_missing_object_costs_itself_and_its_edges():
    # object 2 is missing in frame 1 of 0, 1, 2: one object and two edges to add; its own edge 0 -> 2 over the gap goes
    gap = np.where(TWO == 2, 0, TWO)
    found = score(tracked([TWO, gap, TWO]), tracked([TWO] * 3))
    assert found.operations == Operations(
        splits=0, missing=1, false=0, false_edges=1, missing_edges=2, changed_edges=0
    )
    anew = 10 * 6 + 1.5 * 4
    assert found.tra == pytest.approx(1 - (10 + 1 + 3) / anew)
    assert found.det == pytest.approx(1 - 10 / 60)
    assert (found.dice, found.switches) == (pytest.approx(5 / 6), 0)


def test_one_object_for_two_is_split():
    both = np.where(TWO > 0, 1, 0)
    found = score(tracked([both] * 2), tracked([TWO] * 2))
    # matched by both in each frame: two splits; no edge between objects that are matched by one alone
    assert found.operations == Operations(
        splits=2, missing=0, false=0, false_edges=0, missing_edges=2, changed_edges=0
    )
    assert found.tra == pytest.approx(1 - (2 * 5 + 2 * 1.5) / (40 + 3))
    assert found.identities == {2: 1}
    assert found.dice == pytest.approx((0 + 12 / 16) / 2)


def test_exchanged_identities_cost_edges_not_objects():
    swapped = np.where(TWO == 1, 2, np.where(TWO == 2, 1, 0))
    found = score(tracked([TWO, TWO, swapped, swapped]), tracked([TWO] * 4))
    assert (found.seg, found.det, found.switches) == (1.0, 1.0, 2)
    assert found.operations == Operations(
        splits=0, missing=0, false=0, false_edges=2, missing_edges=2, changed_edges=0
    )
    assert found.tra == pytest.approx(1 - (2 * 1 + 2 * 1.5) / (80 + 9))
    assert found.dice == pytest.approx(0.5)


def test_a_division_that_is_taken_for_a_new_object_lacks_its_edges():
    whole, halves = line((0, 1), (1, 6)), line((0, 1), (2, 3), (3, 3))
    reference = tracked([whole, whole, halves], {2: [1], 3: [1]})
    found = score(tracked([whole, whole, halves]), reference)
    assert found.operations == Operations(
        splits=0, missing=0, false=0, false_edges=0, missing_edges=2, changed_edges=0
    )
    assert found.tra == pytest.approx(1 - 3 / (40 + 4.5))


def test_an_edge_of_another_meaning_is_changed():
    # the reference goes on as 1, the result says that 1 ends and 2 is its child
    own = line((0, 1), (1, 5))
    found = score(tracked([own, own, 2 * own], {2: [1]}), tracked([own] * 3))
    assert found.operations == Operations(
        splits=0, missing=0, false=0, false_edges=0, missing_edges=0, changed_edges=1
    )
    assert found.tra == pytest.approx(1 - 1 / (30 + 3))
    assert found.switches == 1


def test_objects_that_are_not_there_are_deleted():
    more = line((5, 2), (1, 4), (0, 2), (2, 6), (0, 2))
    found = score(tracked([more] * 2), tracked([TWO] * 2))
    assert found.operations == Operations(
        splits=0, missing=0, false=2, false_edges=0, missing_edges=0, changed_edges=0
    )
    assert found.tra == pytest.approx(1 - 2 / (40 + 3))


def test_no_object_in_the_reference_has_no_score():
    empty = np.zeros((1, 1, 6), int)
    found = score(tracked([line((0, 3), (1, 3))]), tracked([empty]))
    assert (found.seg, found.det, found.tra, found.dice) == (None, None, None, None)
    assert found.operations.false == 1
    nothing = score(tracked([empty]), tracked([line((0, 3), (1, 3))]))
    assert (nothing.seg, nothing.det, nothing.tra, nothing.dice) == (0.0, 0.0, 0.0, 0.0)


def test_overlap_is_measured_on_outlines_of_their_own():
    wide = np.where(TWO == 1, 1, 0)
    found = score(tracked([TWO] * 2), tracked([TWO] * 2), [ExactLabels(1, wide)])
    assert found.seg == 1.0
    half = line((0, 2), (1, 3), (0, 11))
    assert score(
        tracked([TWO] * 2), tracked([TWO] * 2), [ExactLabels(1, half)]
    ).seg == pytest.approx(3 / 4)


def test_a_child_of_several_has_several_parents():
    assert stretches({1: [0, 1], 2: [0, 1], 3: [2]}, {3: [1, 2]})[2] == Stretch(3, 3, 2, 2, (1, 2))


def test_a_parent_that_was_never_seen_before_counts_for_nothing():
    assert stretches({1: [3], 2: [2]}, {2: [1, 7]}) == [
        Stretch(1, 1, 3, 3, ()),
        Stretch(2, 2, 2, 2, ()),
    ]
