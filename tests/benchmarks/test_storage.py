"""The study of storage: what it counts is what is there."""

import numpy as np
import pytest

from benchmarks import storage
from benchmarks.large.scene import Scene
from benchmarks.large.voxels import tree_distance


def test_window_and_bricks_of_a_plate():
    """A plate of 40 x 40 x 2 voxels: within 6 of it are voxels of three bricks of 8 across it."""
    inside = np.zeros((64, 64, 64), bool)
    inside[32:34, 12:52, 12:52] = True
    row = storage.of_mask("plate", inside)
    assert row["window_bytes"] == 12 * 26 * 64 * 64
    # Planes 26 to 39 are near: bricks 3 and 4 across; along it 6 to 57, bricks 0 to 7, but for the rounded corners.
    corners = 4
    assert row["bricks"]["8"]["count"] == 2 * (8 * 8 - corners)
    assert row["bricks"]["32"]["count"] == 8
    assert row["bricks"]["32"]["bytes"] == 64**3 * 12 + 8 * 4
    assert row["bricks"]["32"]["bytes_with_halo"] == 8 * 36**3 * 12 + 8 * 4


@pytest.mark.parametrize(("side", "tolerance"), [(8, 0.05), (16, 0.08)])
def test_bricks_of_a_tree_are_counted_without_its_voxels(side, tolerance):
    near = np.abs(tree_distance(Scene.of(256, cells=0), 1, 12.0)) <= storage.NEAR
    n = 256 // side
    exact = np.count_nonzero(near.reshape(n, side, n, side, n, side).any(axis=(1, 3, 5)))
    row = storage.tree(256)
    assert row["bricks"][str(side)]["count"] == pytest.approx(exact, rel=tolerance)
    assert row["band_voxels"] == np.count_nonzero(near)


@pytest.mark.slow
def test_reads_by_bricks_find_what_dense_reads_find(monkeypatch):
    times = storage.access_times(1, size=64, radius=20.0)
    assert len(times["programs"]) == 11 and all(one["ns"] > 0 for one in times["programs"].values())
    wrong = storage.bricks_of

    def shifted(*words):
        values, table = wrong(*words)
        return np.roll(values, 1), table

    monkeypatch.setattr(storage, "bricks_of", shifted)
    with pytest.raises(AssertionError, match="Not equal"):
        storage.access_times(1, size=64, radius=20.0)
