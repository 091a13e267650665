"""Slabs cover an array once, in order, and are as small as they may be."""

import itertools

import numpy as np
import pytest

from accelsurf.grid import boxes


@pytest.mark.sampled
@pytest.mark.parametrize("voxels", [1, 100, 250, 10_000])
@pytest.mark.parametrize(("multiple", "at_least"), [(1, 1), (2, 1), (1, 5)])
def test_slabs_cover_every_plane_once(monkeypatch, voxels, multiple, at_least):
    monkeypatch.setattr(boxes, "SLAB_VOXELS", voxels)
    shape = (23, 10, 5)
    found = list(boxes.slabs(shape, multiple, at_least))
    assert [i for run in found for i in range(run.start, run.stop)] == list(range(23))
    for run in found[:-1]:
        planes = run.stop - run.start
        assert planes % multiple == 0 and planes >= at_least
        assert planes * 50 <= voxels or planes == max(multiple, at_least)


def test_runs_cover_every_cell_once(monkeypatch):
    monkeypatch.setattr(boxes, "SLAB_VOXELS", 7)
    found = list(boxes.runs(30))
    assert np.array_equal(np.concatenate([np.arange(30)[run] for run in found]), np.arange(30))
    assert all(run.stop - run.start == 7 for run in found[:-1])
    assert all(one.stop == other.start for one, other in itertools.pairwise(found))
    assert list(boxes.runs(0)) == []


@pytest.mark.parametrize("shape", [(0, 4, 5), (3, 0, 5), (3, 4, 0)])
def test_an_empty_array_has_slabs_of_its_planes(shape):
    assert [i for run in boxes.slabs(shape) for i in range(run.start, run.stop)] == list(
        range(shape[0])
    )
