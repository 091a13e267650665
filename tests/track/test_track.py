"""The loop over frames: places, identities, gaps, orders of the frames, the same bytes after a resume."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from accelsurf.errors import InputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts.objects import ObjectStart
from accelsurf.track import track as track_state
from accelsurf.track.evidence import Profile
from accelsurf.track.follower import appearing
from accelsurf.track.frame_run import following_settings, measure
from accelsurf.track.records import FrameResult, Identities, Lineage, SurfacePiece
from accelsurf.track.track import Tracking, track

Discs = Sequence[tuple[float, float, float]]
SHAPE = (40, 64)


def plane(
    discs: Discs, seed: int = 0, noise: float = 5.0, shape: tuple[int, int] = SHAPE
) -> Volume:
    """Discs (x, y, r) of value 100 in noise, in an image of one slice."""
    y, x = np.indices(shape).astype(float)
    image = np.random.default_rng(seed).normal(0.0, noise, shape)
    for cx, cy, r in discs:
        image += 100.0 * np.clip(0.5 + r - np.hypot(x - cx, y - cy), 0.0, 1.0)
    return Volume.from_array(np.minimum(image, 100.0 + 3 * noise).astype(np.float32))


def sequence(discs_at: Callable[[int], Discs], count: int, noise: float = 5.0) -> VolumeSequence:
    return VolumeSequence([plane(discs_at(n), n, noise) for n in range(count)])


def followed(
    frames: VolumeSequence, start: str, **options: object
) -> tuple[list[FrameResult], Lineage]:
    tracking = track(frames, start=start, threads=1, **options)
    return list(tracking), tracking.lineage


def places(result: FrameResult) -> dict[int, tuple[float, float]]:
    """x and y of the centroids of the objects that are seen, by id."""
    return {one.id: one.centroid[:2] for one in result.objects if one.seen}


def near(found: tuple[float, float], x: float, y: float, within: float = 0.5) -> bool:
    return abs(found[0] - x) <= within and abs(found[1] - y) <= within


# -------------------------------------------------------------------------------------------------------- one object


def test_of_a_prediction_that_lies_in_another_object_nothing_is_run() -> None:
    frame = plane([(20, 20, 8)])
    y, x = np.indices(SHAPE)[:, None].astype(np.float32)
    small, large = (np.hypot(x - 20, y - 20).astype(np.float32) - r for r in (3, 8))
    config, taken = (
        following_settings(RunConfig(threads=1), "auto"),
        [SurfacePiece((0, 0, 0), large)],
    )
    found = measure([frame], [ObjectStart(2, (0, 0, 0), small)], config, occupied=taken)
    assert not found[2].surface.psi.size
    beside = np.hypot(x - 27, y - 20).astype(np.float32) - 3
    found = measure([frame], [ObjectStart(2, (0, 0, 0), beside)], config, occupied=taken)
    assert not (found[2].surface.psi.size and (found[2].surface.psi[:, 20:21, 20:24] < 0).any())


@pytest.mark.sampled(2)
@pytest.mark.parametrize("model", ["flowable-mass", "last-displacement", "none"])
def test_a_disc_is_followed_by_each_model(model: str) -> None:
    results, lineage = followed(
        sequence(lambda n: [(12 + 3 * n, 20, 7)], 6), "ball:12,20,0,5", model=model
    )
    assert [result.frame for result in results] == list(range(6))
    assert all(near(places(result)[1], 12 + 3 * n, 20, 0.2) for n, result in enumerate(results))
    assert [len(result.objects) for result in results] == [1] * 6
    (one,) = lineage.tracks
    assert (one.id, one.first, one.last, one.gaps, one.end) == (1, 0, 5, (), "end of sequence")
    if model == "flowable-mass":
        last = results[-1].objects[0]
        assert last.velocity[0] == pytest.approx(3.0, abs=0.3)
        assert last.predicted is not None and last.volume_mm3 == pytest.approx(np.pi * 49, rel=0.03)


def test_a_ball_in_a_volume_is_followed_by_its_clicks() -> None:
    z, y, x = np.indices((20, 20, 34)).astype(float)
    frames = [
        Volume.from_array(
            (
                100.0
                * np.clip(5.5 - np.sqrt((z - 10) ** 2 + (y - 10) ** 2 + (x - 8 - 3 * n) ** 2), 0, 1)
            ).astype(np.float32)
        )
        for n in range(4)
    ]
    tracking = track(VolumeSequence(frames), inside="point:8,10,10", threads=1, meshes=True)
    results = list(tracking)
    for n, result in enumerate(results):
        one, apart = (
            result.objects[0],
            0.6 if n == 1 else 0.2,
        )  # where it first moves, nothing foretells it
        assert one.centroid == pytest.approx((8 + 3 * n, 10, 10), abs=apart)
        assert one.mesh is not None and one.mesh.generation == 1
        assert one.mesh.vertices.mean(axis=0) == pytest.approx((8 + 3 * n, 10, 10), abs=0.2 + apart)
    assert (
        len({len(result.objects[0].mesh.vertices) for result in results}) == 1
    )  # the same material points


def test_an_object_goes_on_by_its_momentum_where_frames_do_not_show_it() -> None:
    frames = sequence(lambda n: [] if n in (4, 5) else [(12 + 4 * n, 20, 7)], 9)
    results, lineage = followed(frames, "ball:12,20,0,5")
    assert [result.objects[0].seen for result in results] == [True] * 4 + [False] * 2 + [True] * 3
    assert near(results[5].objects[0].centroid[:2], 32, 20, 1.5)
    assert near(places(results[8])[1], 44, 20, 0.3)
    assert lineage.tracks[0].gaps == (4, 5)
    assert (results[4].labels() == 0).all() and (
        results[4].labels(seen_only=False) == 1
    ).sum() > 100
    assert results[4].objects[0].quality == 0.0


def test_an_object_that_is_gone_ends_where_it_was_seen_last() -> None:
    results, lineage = followed(
        sequence(lambda n: [(20 + n, 20, 7)] if n < 3 else [], 8), "ball:20,20,0,5", max_gap=2
    )
    assert lineage.tracks[0].last == 2 and lineage.tracks[0].end == "vanished"
    assert [len(result.objects) for result in results] == [1, 1, 1, 1, 1, 0, 0, 0]


def test_a_disc_that_shrinks_beyond_what_is_expected_is_not_seen() -> None:
    results, _ = followed(
        sequence(lambda n: [(30, 20, 9 if n < 2 else 3)], 4), "ball:30,20,0,5", max_gap=9
    )
    assert [result.objects[0].seen for result in results] == [True, True, False, False]


@pytest.mark.slow
def test_brightness_may_drift_and_what_is_learned_follows_it() -> None:
    frames = [plane([(14 + 3 * n, 20, 7)], n) for n in range(6)]
    fading = VolumeSequence(
        [one.with_array(one.array * np.float32(0.85**n)) for n, one in enumerate(frames)]
    )
    for energy in ("chan-vese", "threshold:learned,"):
        results, _ = followed(fading, "ball:14,20,0,5", energy=energy, presmooth="1vox")
        assert near(places(results[-1])[1], 29, 20, 0.5)


# -------------------------------------------------------------------------------------------------------- identities


@pytest.mark.slow
def test_two_that_meet_and_turn_back_stay_who_they_are() -> None:
    def discs(n: int) -> Discs:
        apart = 9.0 + 3.0 * abs(n - 4)
        return [(32 - apart, 20, 8), (32 + apart, 20, 8)]

    results, lineage = followed(sequence(discs, 9), "otsu")
    first, last = places(results[0]), places(results[-1])
    assert set(first) == set(last) == {1, 2}
    assert all(near(last[id], *first[id], 0.5) for id in first)
    assert len(lineage.tracks) == 2 and not lineage.links


def dividing(n: int) -> Discs:
    return [(32 - 3 * max(n - 1, 0), 20, 8), (32 + 3 * max(n - 1, 0), 20, 8)]


def test_a_division_ends_the_parent_and_begins_two_children() -> None:
    results, lineage = followed(sequence(dividing, 9), "ball:32,20,0,5")
    (parent, *children) = lineage.tracks
    assert parent.id == 1 and parent.end == "divided" and parent.first == 0
    assert [one.id for one in children] == [2, 3] and lineage.children(1) == (2, 3)
    assert (
        {one.first for one in children}
        == {parent.last + 1}
        == {link.frame for link in lineage.links}
    )
    last = places(results[-1])
    assert sorted(round(x) for x, _ in last.values()) == [11, 53]
    assert set(np.unique(results[-1].labels())) == {0, 2, 3}


def test_a_division_may_be_left_together() -> None:
    results, lineage = followed(sequence(dividing, 9), "ball:32,20,0,5", divide="no")
    assert len(lineage.tracks) == 1 and not lineage.links
    assert near(places(results[-1])[1], 32, 20, 0.5)


@pytest.mark.slow
def test_a_division_in_falling_order_is_told_in_rising_order() -> None:
    frames = sequence(lambda n: dividing(8 - n), 9)
    _, lineage = followed(frames, "ball:32,20,0,5", frame=8, direction="backward")
    assert {link.kind for link in lineage.links} == {"merging"}
    one = next(track for track in lineage.tracks if track.id == 1)
    assert lineage.parents(1) == (2, 3) and one.last == 8 and one.end == "end of sequence"
    assert {track.end for track in lineage.tracks if track.id != 1} == {"merged"}
    assert all(link.frame == one.first for link in lineage.links)


@pytest.mark.slow
def test_two_become_one_only_where_that_is_asked_for() -> None:
    frames = sequence(lambda n: dividing(8 - n), 9)
    results, lineage = followed(frames, "otsu")
    assert not lineage.links and set(places(results[6])) == {1, 2}
    results, lineage = followed(frames, "otsu", merge="yes")
    assert lineage.parents(3) == (1, 2) and {one.end for one in lineage.tracks} == {
        "merged",
        "end of sequence",
    }
    assert near(places(results[-1])[3], 32, 20, 0.5)


@pytest.mark.slow
def test_one_that_leaves_and_comes_back_is_the_same() -> None:
    x = [14, 9, 4, -1, -6, -11, -8, -3, 2, 7, 12]
    results, lineage = followed(
        sequence(lambda n: [(x[n], 20, 7), (48, 20, 7)], len(x)), "otsu", max_gap=6
    )
    first = places(results[0])
    left = next(id for id, place in first.items() if place[0] < 32)
    assert near(places(results[-1])[left], 12, 20, 0.5) and len(lineage.tracks) == 2
    gaps = next(one.gaps for one in lineage.tracks if one.id == left)
    assert {5, 6} <= set(gaps)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("model", ["flowable-mass", "none"])
def test_one_that_comes_back_is_seen_from_its_first_sliver_on(model: str) -> None:
    """It was found again when half of it was there: the bound on its size did not know that the border cuts it."""
    x = [12, 7, 2, -3, -9, -9, -5, 0, 5, 10]
    frames = sequence(lambda n: [(x[n], 20, 7)], len(x))
    results, lineage = followed(frames, "ball:12,20,0,5", max_gap=6, model=model)
    assert len(lineage.tracks) == 1 and lineage.tracks[0].gaps == (4, 5)
    for n, result in enumerate(results):
        if x[n] > -7:
            truth = np.hypot(*np.meshgrid(np.arange(64) - x[n], np.arange(40) - 20)) < 7
            found = result.labels()[0] > 0
            assert abs(int(found.sum()) - int(truth.sum())) <= 0.15 * truth.sum() + 6


def test_noise_at_the_border_is_no_object_that_enters() -> None:
    image = Volume.from_array(
        np.random.default_rng(5).normal(0.0, 0.5, (1, 60, 80)).astype(np.float32), 1.0
    )
    like = Profile((1.0, 1.0, 0.5, 0.0, 0.0, 0.0))
    assert appearing(image, [], like, (150.0, 150.0)) == []


def test_one_that_leaves_for_good_has_left() -> None:
    _, lineage = followed(sequence(lambda n: [(14 - 5 * n, 20, 7)], 8), "ball:14,20,0,5", max_gap=1)
    assert (
        lineage.tracks[0].end == "left" and lineage.tracks[0].last == 4
    )  # a sliver is there still


def test_what_enters_is_followed_only_where_that_is_asked_for() -> None:
    def discs(n: int) -> Discs:
        return [(20, 20, 7)] + ([(70 - 5 * n, 20, 7)] if n > 0 else [])

    _, lineage = followed(sequence(discs, 7), "ball:20,20,0,5")
    assert [one.id for one in lineage.tracks] == [1]
    results, lineage = followed(sequence(discs, 7), "ball:20,20,0,5", enter="yes")
    assert [one.id for one in lineage.tracks] == [1, 2] and lineage.tracks[1].first in (1, 2)
    assert near(places(results[-1])[2], 40, 20, 0.5)


# ------------------------------------------------------------------------------------------- orders, clicks, resume


def test_both_ways_from_the_middle() -> None:
    frames = sequence(lambda n: [(10 + 5 * n, 20, 7)], 8)
    tracking = track(frames, start="ball:30,20,0,5", frame=4, direction="both", threads=1)
    results = {result.frame: result for result in tracking}
    assert list(results) == [4, 5, 6, 7, 3, 2, 1, 0]
    assert all(near(places(results[n])[1], 10 + 5 * n, 20, 0.3) for n in range(8))
    assert results[3].objects[0].velocity[0] == pytest.approx(
        5.0, abs=0.5
    )  # of rising time, in either order
    predicted = results[3].objects[0].predicted
    assert predicted is not None and not np.isnan(predicted.psi).any()
    inside = np.argwhere(predicted.psi < 0).mean(axis=0) + predicted.corner
    assert inside[2] == pytest.approx(
        25.0, abs=1.0
    )  # it began with the velocity that the later frames have shown
    one = tracking.lineage.tracks[0]
    assert (one.first, one.last, one.gaps) == (0, 7, ())


def test_a_click_in_a_frame_holds_from_there_on() -> None:
    def discs(n: int) -> Discs:
        return [(20, 20, 7), (46, 20, 7)]

    frames = sequence(discs, 5)
    words = "frame=2 new=5 inside=ball:46,20,0,3"
    results, lineage = followed(
        frames, "ball:20,20,0,5", correct=words, energy="threshold:50,", presmooth="1vox"
    )
    assert [sorted(places(result)) for result in results] == [[1], [1], [1, 5], [1, 5], [1, 5]]
    assert near(places(results[-1])[5], 46, 20, 0.5)
    assert [(one.id, one.first) for one in lineage.tracks] == [(1, 0), (5, 2)]


def test_a_click_brings_back_what_was_not_seen() -> None:
    frames = sequence(lambda n: [(14, 20, 7)] if n < 2 else [(50, 20, 7)], 5)
    lost, _ = followed(
        frames, "ball:14,20,0,5", energy="threshold:50,", presmooth="1vox", max_gap=9
    )
    assert not lost[3].objects[0].seen
    words = ["frame=3 remove=1", "frame=3 new=1 inside=ball:50,20,0,4"]
    results, lineage = followed(
        frames,
        "ball:14,20,0,5",
        energy="threshold:50,",
        presmooth="1vox",
        max_gap=9,
        correct=words[1],
    )
    assert near(places(results[4])[1], 50, 20, 0.5) and lineage.tracks[0].gaps == (2,)


def bytes_of(results: Sequence[FrameResult]) -> list[tuple[int, bytes, tuple[float, ...]]]:
    return [
        (
            one.id,
            one.surface.psi.tobytes(),
            (*one.centroid, *one.velocity, one.volume_mm3, one.quality),
        )
        for result in results
        for one in result.objects
    ]


@pytest.mark.slow
@pytest.mark.threads
def test_the_same_bytes_after_a_resume_and_with_more_threads(tmp_path) -> None:
    frames = sequence(lambda n: [] if n == 3 else dividing(n), 7)
    options = {"start": "ball:32,20,0,5", "frame": 2, "direction": "both"}
    whole = track(frames, threads=1, **options)
    expected = bytes_of(list(whole))
    for stop in (1, 3, 5):
        state = tmp_path / f"{stop}.npz"
        first = track(frames, threads=1, checkpoint_to=state, **options)
        begun = []
        for result in first:
            begun.append(result)
            if first.done == stop:
                first.save()
                break
        rest = track(frames, threads=2, checkpoint_to=state, **options)
        assert rest.done == stop
        assert bytes_of([*begun, *rest]) == expected
        assert rest.lineage == whole.lineage


def test_a_state_of_another_tracking_is_refused(tmp_path) -> None:
    state, frames = tmp_path / "state.npz", sequence(lambda n: [(30, 20, 7)], 2)
    next(iter(tracking := track(frames, start="ball:30,20,0,5", threads=1, checkpoint_to=state)))
    tracking.save()
    with pytest.raises(InputError, match="other settings: model was"):
        track(frames, start="ball:30,20,0,5", model="none", checkpoint_to=state)
    other = sequence(lambda n: [(31, 20, 7)], 2)
    with pytest.raises(InputError, match="another sequence"):
        track(other, start="ball:30,20,0,5", checkpoint_to=state)
    state.write_bytes(state.read_bytes()[:-40])
    with pytest.raises(InputError, match="damaged"):
        track(frames, start="ball:30,20,0,5", checkpoint_to=state)


def test_frames_that_there_are_not_are_refused() -> None:
    frames = sequence(lambda n: [(30, 20, 7)], 2)
    with pytest.raises(UsageError, match="frame: frame 2 was given, expected 0 to 1"):
        Tracking(frames, track(frames).config.replace(frame=2))
    with pytest.raises(UsageError, match="correct: frame 7"):
        track(frames, correct="frame=7 inside=point:1,2,3")


def test_identities_tell_divisions_and_mergings_in_either_order() -> None:
    for rising in (True, False):
        ids = Identities()
        ids.see(1, 4)
        ids.see(2, 5 if rising else 3)
        ids.see(3, 5 if rising else 3)
        ids.divide(1, [2, 3], 5 if rising else 3, 4)
        again = Identities()
        again.restore(ids.state())
        lineage = again.lineage()
        expected = (
            [(1, 2, 5, "division"), (1, 3, 5, "division")]
            if rising
            else [(2, 1, 4, "merging"), (3, 1, 4, "merging")]
        )
        assert [tuple(link) for link in lineage.links] == expected
        assert lineage == ids.lineage() and ids.new_id() == 4


def test_the_state_reads_the_first_frame_once_for_its_header(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    header_of = track_state.header_of
    monkeypatch.setattr(
        track_state, "header_of", lambda *given: made.append(1) or header_of(*given)
    )
    frames = [
        Volume.from_array(100.0 * (np.hypot(*(np.indices((24, 24)) - 11.5)) < 6)[None])
        for _ in range(3)
    ]
    list(
        track(
            VolumeSequence(frames), start="ball:11,11,0,4vox", checkpoint_to=tmp_path / "state.npz"
        )
    )
    assert len(made) == 1
