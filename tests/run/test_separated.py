"""Objects cut where they meet, against the same without boxes."""

from types import SimpleNamespace

import numpy as np
import pytest

from accelsurf.grid.boxes import box_at
from accelsurf.levelset import Workers
from accelsurf.run.ensemble import Ensemble

SHAPE, GAMMA = (14, 18, 22), np.float32(3.0)


def parts(seed):
    """First voxel and psi of balls that overlap, on boxes of their own; the last is nowhere."""
    random, out = np.random.default_rng(seed), []
    at = np.indices(SHAPE)
    for _ in range(6):
        middle = random.uniform(2, np.array(SHAPE) - 2)
        away = np.sqrt(((at - middle[:, None, None, None]) ** 2).sum(axis=0)) - random.uniform(
            1.5, 5.5
        )
        psi = np.clip(away, -GAMMA, GAMMA).astype(np.float32)
        low = np.maximum(np.argwhere(psi < 0).min(axis=0) - random.integers(1, 6, 3), 0)
        high = np.argwhere(psi < 0).max(axis=0) + random.integers(2, 7, 3)
        out.append((tuple(low.tolist()), psi[tuple(map(slice, low, high))].copy()))
    out.append(((0, 0, 0), np.full((4, 4, 4), GAMMA)))
    out.append(out[0])  # equally deep everywhere: the lower id has all of it
    return out


def separated_plainly(parts):
    whole = np.full((len(parts), *SHAPE), GAMMA)
    for mine, (corner, psi) in zip(whole, parts, strict=True):
        mine[box_at(corner, psi.shape)] = psi
    for i, (corner, uncut) in enumerate(parts):
        psi = whole[i].copy()
        for j in range(len(parts)):
            if j != i:
                tie = (whole[i] == whole[j]) & (whole[i] < 0)
                cut = np.where(
                    tie,
                    np.float32(-1e-6 if i < j else 1e-6),
                    np.float32(0.5) * (whole[i] - whole[j]),
                )
                psi = np.maximum(psi, cut)
        yield corner, psi[box_at(corner, uncut.shape)]


@pytest.mark.parametrize("seed", range(8))
def test_cuts_are_those_of_all_with_all(seed):
    given = parts(seed)
    before = [psi.copy() for _, psi in given]
    objects = [SimpleNamespace(psi_on_finest=lambda part=part: part) for part in given]
    found = Ensemble(objects, Workers(1), (1.0, 1.0, 1.0), meet=True).separated(None)
    for (corner, psi), (there, plain) in zip(found, separated_plainly(given), strict=True):
        assert corner == there
        np.testing.assert_array_equal(psi, plain)
    assert all(np.array_equal(psi, old) for (_, psi), old in zip(given, before, strict=True))
    labels = np.zeros(SHAPE, int)
    for corner, psi in found:
        labels[box_at(corner, psi.shape)] += psi < 0
    assert labels.max() == 1
