"""Sequences with one segmented frame: its labels stay, the image tells the motion, what is lost is said."""

import json

import numpy as np
import pytest
from scipy import ndimage

from accelsurf import cli, io
from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence
from accelsurf.phantoms.tissues import TissuePhantom, phantom_from
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track import follower, frame_run
from accelsurf.track.appearance import Appearance, appearance_of
from accelsurf.track.image_motion import image_motion
from accelsurf.track.momentum_models import make_momentum
from accelsurf.track.records import SurfacePiece
from accelsurf.track.track import Tracking, track

CELL = {
    "tissue": "cell",
    "shape": [64, 64, 1],
    "radius": 15.0,
    "thickness": 1.0,
    "amplitude": 4.0,
    "frames": 4,
    "travel": [2.0, 1.0, 0.0],
    "speckle": 0.6,
    "seed": 3,
}


def cell(**values: object) -> TissuePhantom:
    phantom = phantom_from({**CELL, **values})
    assert isinstance(phantom, TissuePhantom)
    return phantom


def dice(a: np.ndarray, b: np.ndarray) -> float:
    return float(2.0 * (a & b).sum() / max(1, a.sum() + b.sum()))


def tracking(
    sequence: VolumeSequence | TissuePhantom, labels: np.ndarray, **settings: object
) -> Tracking:
    config = TrackConfig(threads=1, energy="chan-vese", levels=1, **settings)
    return Tracking(sequence, config, objects=Volume(labels, sequence.geometry))


@pytest.mark.parametrize("seed", range(4))
def test_given_labels_are_kept_voxel_by_voxel_with_specks_threads_and_neighbours(seed: int) -> None:
    random = np.random.default_rng(seed)
    labels = cell().truth(0).astype(np.uint16) * 9
    labels[random.random(labels.shape) < 0.02] = 4
    labels[0, 5, :40] = 2  # as thin as a voxel
    labels[0, 30:, 60:] = 7  # up to the border
    first = next(iter(tracking(cell(), labels)))
    np.testing.assert_array_equal(first.labels(), labels)
    assert [one.quality for one in first.objects] == [1.0] * 4


def test_start_label_keeps_the_frame_in_the_middle_and_follows_both_ways(tmp_path) -> None:
    phantom = cell()
    for number in range(4):
        io.write(phantom.frame(number), tmp_path / f"frame_{number}.nii.gz")
    io.write_labels(
        Volume(phantom.truth(1) * np.uint8(5), phantom.geometry), tmp_path / "given.nii.gz"
    )
    words = [
        "track",
        str(tmp_path / "frame_*.nii.gz"),
        "--start",
        f"label:{tmp_path / 'given.nii.gz'}",
        "--frame",
        "1",
        "-o",
        str(tmp_path / "out"),
        "--per-frame",
        "--energy",
        "chan-vese",
        "--quiet",
    ]
    assert cli.execute(words) == 0
    found = [io.read(path).array for path in sorted((tmp_path / "out").glob("*_labels_t*.nii.gz"))]
    assert len(found) == 4
    np.testing.assert_array_equal(found[1], phantom.truth(1) * 5)
    for number in (0, 2, 3):
        assert dice(found[number] == 5, phantom.truth(number) > 0) > 0.85


def test_a_correction_of_the_given_frame_is_made() -> None:
    phantom = cell()
    kept = next(iter(tracking(phantom, phantom.truth(0)))).labels()
    correct = "frame=0 outside=point:0,0,0"
    changed = next(iter(tracking(phantom, phantom.truth(0), correct=(correct,)))).labels()
    assert kept[0, 32, 32] == 1 and changed[0, 32, 32] == 0


def test_the_image_tells_how_a_shell_in_speckle_beats() -> None:
    values = {
        "tissue": "shell",
        "shape": [40, 38, 44],
        "radius": 15.0,
        "thickness": 4.5,
        "amplitude": 4.0,
        "seed": 5,
    }
    phantom = phantom_from({**values, "frames": 3, "period": 6.0})
    assert isinstance(phantom, TissuePhantom)
    results = list(tracking(phantom, phantom.truth(0)))
    copied = dice(phantom.truth(0) > 0, phantom.truth(2) > 0)
    assert copied < 0.7
    assert dice(results[2].labels() > 0, phantom.truth(2) > 0) > copied + 0.1


def test_displacement_and_variance_are_those_of_a_shifted_texture() -> None:
    random = np.random.default_rng(2)
    texture = ndimage.gaussian_filter(random.standard_normal((30, 34, 36)), 1.5)
    moved = ndimage.shift(texture, (0.6, -1.2, 2.3), order=3, mode="nearest")
    z, y, x = np.indices(texture.shape)
    psi = np.sqrt((z - 15.0) ** 2 + (y - 17.0) ** 2 + (x - 18.0) ** 2).astype(np.float32) - 7.0
    spacing = (2.0, 1.0, 1.0)
    before, now = (
        Volume.from_array(image.astype(np.float32), spacing) for image in (texture, moved)
    )
    seen = image_motion(before, now, SurfacePiece((0, 0, 0), psi), np.zeros(3))
    assert seen is not None and seen.likeness > 0.95
    middle = np.array([[15.0, 17.0, 18.0]]) * spacing
    way, variance = seen.at(middle)
    np.testing.assert_allclose(way[0], np.array([0.6, -1.2, 2.3]) * spacing, atol=0.35)
    assert 0.0 < variance[0] < 0.1
    flat = Volume.from_array(np.zeros(texture.shape, np.float32), spacing)
    assert image_motion(flat, now, SurfacePiece((0, 0, 0), psi), np.zeros(3)) is None


def textured(center: float, seed: int) -> tuple[Volume, np.ndarray]:
    """A disc with texture in a plane of the same mean without; far from it is more texture. And the disc."""
    y, x = np.indices((90, 90))
    disc, far = np.hypot(y - 30, x - center) < 11, np.hypot(y - 75, x - 70) < 11
    values = np.random.default_rng(seed).normal(50.0, np.where(disc | far, 12.0, 2.0))
    return Volume.from_array(values[None].astype(np.float32), 1.0), disc[None]


def test_appearance_is_learned_near_the_given_surface_on_both_sides() -> None:
    image, disc = textured(30.0, 1)
    psi = np.where(disc, -0.5, 0.5).astype(np.float32)
    learned = appearance_of(image, SurfacePiece((0, 0, 0), psi))
    assert learned is not None and learned.slope > 0
    later, moved = textured(36.0, 2)
    odds = learned.evidence(later, (0, 0, 0), moved.shape)
    near = (
        np.abs(np.hypot(*(np.indices((90, 90)) - np.array([30, 36])[:, None, None])) - 11)[None] < 8
    )
    assert dice((odds > 0) & near, moved) > 0.85
    beyond = learned.evidence(later, (0, -3, -2), (1, 96, 94))  # the frame's edge goes on
    np.testing.assert_array_equal(beyond[:, 3:93, 2:92], odds)
    np.testing.assert_array_equal(beyond[0, 0, 2:92], odds[0, 0])
    assert (
        appearance_of(image, SurfacePiece((0, 0, 0), np.full((1, 90, 90), -1.0, np.float32)))
        is None
    )
    flat = Volume.from_array(np.zeros((1, 90, 90), np.float32), 1.0)
    assert appearance_of(flat, SurfacePiece((0, 0, 0), psi)) is None


@pytest.mark.parametrize(
    ("model", "least", "most"), [("flowable-mass", 0.5, 2.0), ("none", -0.05, 0.05)]
)
def test_a_run_in_a_frame_begins_with_the_momentum_that_is_carried(
    model: str, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without any evidence a ball goes on as it went: so far in four steps."""
    monkeypatch.setattr(frame_run, "STEPS", 4)
    z, y, x = np.indices((24, 24, 36)) - 11.5
    psi = (np.sqrt(z**2 + y**2 + x**2) - 7.0).astype(np.float32)
    image = Volume.from_array(np.zeros(psi.shape, np.float32), 1.0)
    nothing = Appearance(np.zeros(8), np.ones(8), np.zeros(44), 0.0, 1.0)
    momentum = make_momentum(model)
    momentum.start(psi, (0, 0, 0), image.geometry, (3.0, 0.0, 0.0))
    before = momentum.centroid()[0]
    found = frame_run.recognised(momentum.moved_surface(1.0), nothing, image, 0.0)
    inside = np.argwhere(found.surface.psi < 0) + np.array(found.surface.corner)
    assert least < inside.mean(axis=0)[2] - 11.5 < most
    assert momentum.centroid()[0] == before


def test_what_the_given_frame_looked_like_keeps_the_surface_from_drifting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    phantom, score = cell(frames=7, coherence=0.0), []
    for learn in (appearance_of, lambda *_: None):
        monkeypatch.setattr(follower, "appearance_of", learn)
        results = list(tracking(phantom, phantom.truth(0)))[3:]
        score.append(
            np.mean(
                [dice(r.labels(seen_only=False) > 0, phantom.truth(r.frame) > 0) for r in results]
            )
        )
    assert score[0] > score[1] + 0.04


def test_frames_without_evidence_are_marked_and_the_track_ends() -> None:
    phantom, random = cell(frames=8), np.random.default_rng(1)
    frames = [phantom.frame(n) for n in range(8)]
    for n in range(3, 8):
        frames[n] = frames[n].with_array(
            random.normal(100.0, 30.0, frames[n].array.shape).astype(np.float32)
        )
    run = tracking(VolumeSequence(frames), phantom.truth(0), max_gap=2)
    seen = {result.frame: [one.seen for one in result.objects] for result in run}
    assert seen[2] == [True] and seen[3] == [False] and seen[7] == []
    (only,) = run.lineage.tracks
    assert only.last == 2 and only.end in ("vanished", "lost")


def test_tracks_that_cannot_be_trusted_are_said_to_be_so(
    tmp_path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cell that fades is refused in the frames in which it has faded; one that stays is not."""
    phantom, faint = cell(), cell(inside=90.0)
    frames = [phantom.frame(n) if n < 2 else faint.frame(n) for n in range(4)]
    for sequence, doubtful in ((phantom, []), (VolumeSequence(frames), [2, 3])):
        run = tracking(sequence, phantom.truth(0))
        for _ in run:
            pass
        assert run.doubtful == doubtful
    for number, frame in enumerate(frames):
        io.write(frame, tmp_path / f"frame_{number}.nii.gz")
    io.write_labels(Volume(phantom.truth(0), phantom.geometry), tmp_path / "given.nii.gz")
    words = [
        "track",
        str(tmp_path / "frame_*.nii.gz"),
        "--start",
        f"label:{tmp_path / 'given.nii.gz'}",
        "-o",
        str(tmp_path / "out"),
        "--energy",
        "chan-vese",
    ]
    assert cli.execute(words) == 0
    assert "these tracks cannot be trusted in 2 of 4 frames" in capsys.readouterr().out
    (report,) = (json.loads(path.read_text()) for path in (tmp_path / "out").glob("*_report.json"))
    assert any(
        "cannot be trusted in 2 of 4 frames, the first of them frame 2" in line
        for line in report["warnings"]
    )


def test_a_tracking_of_given_labels_goes_on_to_the_same_bytes(tmp_path) -> None:
    phantom, state = cell(), tmp_path / "state"
    settings = {"threads": 1, "energy": "chan-vese", "levels": 1, "frame": 1}
    start = Volume(phantom.truth(1), phantom.geometry)
    whole = [result.labels().tobytes() for result in track(phantom, objects=start, **settings)]
    begun = iter(track(phantom, objects=start, checkpoint_to=state, **settings))
    parts = [next(begun).labels().tobytes() for _ in range(3)]
    next(begun, None)
    parts += [
        r.labels().tobytes() for r in track(phantom, objects=start, checkpoint_to=state, **settings)
    ]
    assert parts[:3] == whole[:3] and parts[-1] == whole[-1]
