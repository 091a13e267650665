"""Trackers beside accelsurf: a trivial segmentation of each frame, linked by laptrack, btrack or overlap; and scores.

Peers are optional: ``pip install laptrack btrack traccuracy``. What is not installed is left out and said to be.
A tracking is here a label map of each frame, with the same value for the same object, and the parents of a value.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import io as stdlib_io
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.filters import threshold_otsu

from accelsurf import io
from accelsurf.image.volume import Volume
from accelsurf.track.output.outputs import track_lines
from accelsurf.track.scores import stretches
from accelsurf.track.track import Tracking

Labels = NDArray[np.integer[Any]]
#: Of the segmentation of a frame: blur in voxels, and the smallest part in voxels.
BLUR, SMALLEST = 1.0, 20
#: Frames that an object may be hidden, as accelsurf's own default.
GAP = 5


class Followed(NamedTuple):
    """A tracking: ``labels`` of each frame, and of each value the ``parents``."""

    labels: list[Labels]
    parents: dict[int, tuple[int, ...]]


def by_accelsurf(tracking: Tracking) -> Followed:
    """Our own, all frames in rising order: what is seen, as label files have it."""
    labels = [result.labels() for result in tracking]
    lineage = tracking.lineage
    return Followed(labels, {one.id: lineage.parents(one.id) for one in lineage.tracks})


def parts_of_frames(
    frames: Sequence[NDArray[Any]], first: Labels, both_ways: bool = False
) -> list[Labels]:
    """The trivial way: blur, Otsu's threshold of the first frame, parts. In the first frame all have the same start.

    With ``both_ways`` it is the distance from the frame's median that is thresholded: objects darker and brighter.
    """
    found: list[Labels] = [first.astype(np.int32)]
    threshold = float(threshold_otsu(_blurred(frames[0], both_ways)))
    for frame in frames[1:]:
        parts, _ = ndimage.label(_blurred(frame, both_ways) > threshold)
        sizes = np.bincount(parts.ravel())
        parts[sizes[parts] < SMALLEST] = 0
        found.append(
            np.asarray(np.unique(parts, return_inverse=True)[1].reshape(parts.shape), np.int32)
        )
    return found


def _blurred(frame: NDArray[Any], both_ways: bool) -> NDArray[np.float64]:
    values = frame.astype(np.float64)
    values = np.abs(values - np.median(values)) if both_ways else values
    return np.asarray(
        ndimage.gaussian_filter(values, [BLUR if n > 1 else 0.0 for n in values.shape])
    )


class Spot(NamedTuple):
    """A part of a frame: its frame, its value there, its centroid z, y, x."""

    frame: int
    value: int
    place: tuple[float, float, float]


def spots_of(parts: Sequence[Labels]) -> list[Spot]:
    """All parts of all frames."""
    spots = []
    for frame, labels in enumerate(parts):
        values = np.unique(labels[labels > 0]).tolist()
        for value, place in zip(
            values, ndimage.center_of_mass(labels > 0, labels, values), strict=True
        ):
            spots.append(Spot(frame, value, (float(place[0]), float(place[1]), float(place[2]))))
    return spots


def linked(
    parts: Sequence[Labels], spots: Sequence[Spot], ids: Sequence[int], parents: dict[int, int]
) -> Followed:
    """The parts with the ids that a tracker gave to the spots."""
    labels = [np.zeros(one.shape, np.int32) for one in parts]
    for spot, id in zip(spots, ids, strict=True):
        labels[spot.frame][parts[spot.frame] == spot.value] = id
    return Followed(labels, {id: (parents[id],) if id in parents else () for id in set(ids)})


def by_overlap(parts: Sequence[Labels], spots: Sequence[Spot], reach: float) -> Followed:
    """Each part follows the one before that it overlaps most; where several follow one they are its children."""
    del reach  # it needs no distance
    ids = {}
    parents = {}
    next_id = 1
    for spot in spots:
        before = (
            parts[spot.frame - 1][parts[spot.frame] == spot.value]
            if spot.frame
            else np.zeros(0, np.int64)
        )
        counts = np.bincount(before[before > 0])
        ids[spot] = next_id
        if counts.size:
            parents[next_id] = ids[
                next(s for s in spots if (s.frame, s.value) == (spot.frame - 1, counts.argmax()))
            ]
        next_id += 1
    # The only child is the same object.
    final: dict[int, int] = {}
    kept: dict[int, int] = {}
    for id in ids.values():
        parent = parents.get(id)
        alone = parent is not None and list(parents.values()).count(parent) == 1
        final[id] = final[parent] if parent is not None and alone else id
        if parent is not None and not alone:
            kept[id] = final[parent]
    return linked(parts, spots, [final[ids[spot]] for spot in spots], kept)


def by_laptrack(parts: Sequence[Labels], spots: Sequence[Spot], reach: float) -> Followed:
    """Linear assignment (laptrack), with gaps and divisions."""
    import pandas
    from laptrack import LapTrack

    table = pandas.DataFrame(
        [(one.frame, *one.place) for one in spots], columns=["frame", "z", "y", "x"]
    )
    tracker = LapTrack(
        cutoff=reach**2,
        gap_closing_cutoff=(2.0 * reach) ** 2,
        gap_closing_max_frame_count=GAP,
        splitting_cutoff=reach**2,
    )
    tracks, splits, _ = tracker.predict_dataframe(
        table, ["z", "y", "x"], only_coordinate_cols=False
    )
    ids = [int(n) + 1 for n in tracks.reset_index(drop=True)["track_id"]]
    order = tracks.reset_index(drop=True)[["frame", "z", "y", "x"]].itertuples(index=False)
    by_place = {tuple(row): id for row, id in zip(order, ids, strict=True)}
    parents = {}
    if len(splits):
        for parent, child in splits[["parent_track_id", "child_track_id"]].itertuples(index=False):
            parents[int(child) + 1] = int(parent) + 1
    return linked(parts, spots, [by_place[(one.frame, *one.place)] for one in spots], parents)


def by_btrack(parts: Sequence[Labels], spots: Sequence[Spot], reach: float) -> Followed:
    """A Kalman filter of constant velocity and a global choice of hypotheses (btrack, the settings of its examples)."""
    import btrack
    from btrack.models import HypothesisModel, MotionModel

    half = np.eye(3)
    motion = MotionModel(
        measurements=3,
        states=6,
        dt=1.0,
        accuracy=7.5,
        max_lost=GAP,
        prob_not_assign=0.1,
        name="even",
        A=np.block([[half, half], [np.zeros((3, 3)), half]]),
        H=np.eye(3, 6),
        P=150.0 * np.diag([0.1] * 3 + [1.0] * 3),
        G=15.0 * np.array([[0.5] * 3 + [1.0] * 3]),
        R=5.0 * half,
    )
    hypotheses = HypothesisModel(
        hypotheses=["P_FP", "P_init", "P_term", "P_link", "P_branch"],
        lambda_time=5.0,
        lambda_dist=3.0,
        lambda_link=10.0,
        lambda_branch=50.0,
        eta=1e-10,
        theta_dist=20.0,
        theta_time=5.0,
        dist_thresh=2.0 * reach,
        time_thresh=GAP + 1.0,
        apop_thresh=5,
        segmentation_miss_rate=0.1,
        apoptosis_rate=0.001,
        relax=True,
        name="usual",
    )
    table = {"ID": np.arange(len(spots)), "t": np.array([one.frame for one in spots])}
    for axis, name in enumerate("zyx"):
        table[name] = np.array([one.place[axis] for one in spots])
    objects = btrack.io.objects_from_dict(table)
    with btrack.BayesianTracker(verbose=False) as tracker:
        tracker.configure(
            btrack.config.TrackerConfig(motion_model=motion, hypothesis_model=hypotheses)
        )
        tracker.max_search_radius = reach
        tracker.append(objects)
        low, high = np.zeros(3), np.array(parts[0].shape, np.float64)
        tracker.volume = tuple((float(low[a]), float(max(high[a], 1.0))) for a in (2, 1, 0))
        tracker.track()
        tracker.optimize(options={"msg_lev": "GLP_MSG_OFF"})
        tracks = list(tracker.tracks)
    ids = [0] * len(spots)
    for one in tracks:
        for ref, dummy in zip(one.refs, one.dummy, strict=True):
            if not dummy and 0 <= ref < len(spots):
                ids[ref] = int(one.ID)
    free = max(ids, default=0) + 1
    for place, id in enumerate(ids):
        if not id:
            ids[place], free = free, free + 1
    parents = {
        int(one.ID): int(one.parent) for one in tracks if one.parent and one.parent != one.ID
    }
    return linked(parts, spots, ids, parents)


Linker = Callable[[Sequence[Labels], Sequence[Spot], float], Followed]
LINKERS: dict[str, tuple[str, Linker]] = {
    "overlap": ("", by_overlap),
    "laptrack": ("laptrack", by_laptrack),
    "btrack": ("btrack", by_btrack),
}


def installed(name: str) -> bool:
    """Whether a peer is there."""
    return not name or importlib.util.find_spec(name) is not None


def seg_of_frame(found: Labels, truth: Labels) -> list[float]:
    """Jaccard index of each object of the truth with what covers more than half of it, else 0: SEG's own rule."""
    scores = []
    for value in np.unique(truth[truth > 0]):
        own = truth == value
        counts = np.bincount(found[own])
        counts[0] = 0
        best = int(counts.argmax())
        union = own.sum() + (found == best).sum() - counts[best]
        scores.append(float(counts[best] / union) if 2 * counts[best] > own.sum() else 0.0)
    return scores


def dice_of_frame(found: Labels, truth: Labels) -> float:
    """Dice of all objects together."""
    return float(
        2.0 * ((found > 0) & (truth > 0)).sum() / max(1, (found > 0).sum() + (truth > 0).sum())
    )


def challenge_scores(found: Followed, truth: Followed) -> dict[str, float]:
    """Scores of the Cell Tracking Challenge: DET and TRA by traccuracy, and SEG."""
    from traccuracy import run_metrics
    from traccuracy.loaders import load_ctc_data
    from traccuracy.matchers import CTCMatcher
    from traccuracy.metrics import CTCMetrics

    # It draws bars of progress.
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(stdlib_io.StringIO()):
        graphs = []
        for name, one in (("truth", truth), ("found", found)):
            _write(one, Path(folder) / name)
            lines = str(Path(folder) / name / "res_track.txt")
            graphs.append(load_ctc_data(str(Path(folder) / name), lines, run_checks=False))
        results, _ = run_metrics(graphs[0], graphs[1], CTCMatcher(), [CTCMetrics()])
    values = results[0]["results"]
    seg = [
        score
        for one, true in zip(found.labels, truth.labels, strict=True)
        for score in seg_of_frame(one, true)
    ]
    return {"SEG": round(float(np.mean(seg)), 4)} | {
        name: round(float(values[name]), 4) for name in ("DET", "TRA")
    }


def _write(one: Followed, folder: Path) -> None:
    """The folder of a tracking in the layout of the challenge."""
    folder.mkdir()
    frames: dict[int, list[int]] = {}
    for number, labels in enumerate(one.labels):
        for value in np.unique(labels[labels > 0]).tolist():
            frames.setdefault(value, []).append(number)
    parents = {id: tuple(p for p in one.parents.get(id, ()) if p in frames) for id in frames}
    found = stretches({id: tuple(seen) for id, seen in frames.items()}, parents)
    for number, labels in enumerate(one.labels):
        new = np.zeros(labels.shape, np.uint16)
        for part in found:
            if part.first <= number <= part.last:
                new[labels == part.id] = part.label
        io.write(Volume.from_array(new), folder / f"mask{number:03d}.tif")
    (folder / "res_track.txt").write_text(track_lines(found))


def versions_of(names: Iterable[str]) -> dict[str, str]:
    """Versions of the peers, or that one is not installed."""
    return {
        name: importlib.metadata.version(name) if installed(name) else "not installed"
        for name in names
    }
