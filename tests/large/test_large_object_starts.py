"""Starts of many objects, found by looking at a map in parts, are those of `object_starts.read`."""

import pickle

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid import boxes
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import LazyVolume
from accelsurf.large import object_starts
from accelsurf.large.object_starts import LabelMap
from accelsurf.text.objects import read_objects

SHAPE, MARGIN = (20, 17, 15), 2
GEOMETRY = Geometry(SHAPE, (1.5, 1.0, 0.8), (4.0, -3.0, 2.0))


@pytest.fixture(autouse=True)
def thin_slabs(monkeypatch):
    """Planes are read three at a time."""
    monkeypatch.setattr(boxes, "SLAB_VOXELS", 3 * SHAPE[1] * SHAPE[2])


@pytest.fixture
def labels():
    """Objects that go over several slabs, in two parts, and at a corner."""
    array = np.zeros(SHAPE, np.uint32)
    array[1:9, 3:6, 4:8], array[0, 0, 0], array[19, 16, 14] = 70000, 5, 6
    array[4, 10, 10], array[15, 12, 11] = 3, 3
    return Volume(array, GEOMETRY)


def assert_as_read(starts, want):
    assert starts.ids.tolist() == [one.id for one in want]
    for place, one in enumerate(want):
        assert starts.low[place].tolist() == list(one.corner)
        assert (starts.high[place] - starts.low[place]).tolist() == list(one.psi.shape)
    for one, other in zip(starts.made(range(len(want))), want, strict=True):
        assert (
            one.id == other.id
            and one.corner == other.corner
            and one.psi.tobytes() == other.psi.tobytes()
        )


def test_a_map_in_slabs(labels):
    want = read_objects(labels, GEOMETRY, MARGIN)
    found = LabelMap("map", LazyVolume.of_array(labels), GEOMETRY, MARGIN)
    assert_as_read(found, want)
    assert_as_read(found.only([1, 3]), [want[1], want[3]])


def test_some_ids_of_a_file_also_in_another_process(labels, tmp_path):
    io.write_labels(labels, tmp_path / "map.nii")
    name = f"{tmp_path / 'map.nii'}@3,6-80000"
    found = object_starts.opened(name, GEOMETRY, MARGIN)
    want = read_objects(name, GEOMETRY, MARGIN)
    assert_as_read(found, want)
    assert_as_read(pickle.loads(pickle.dumps(found.only([0, 2]))), [want[0], want[2]])


def test_a_table(tmp_path):
    file = tmp_path / "balls.csv"
    file.write_text("id,x_vox,y_vox,z_vox,r_vox\n9,4,4,4,3\n2,8,4,4,3\n9,3,12,15,2\n4,11,12,14,2\n")
    found = object_starts.opened(str(file), GEOMETRY, MARGIN)
    want = read_objects(str(file), GEOMETRY, MARGIN)
    assert_as_read(found, want)
    assert_as_read(pickle.loads(pickle.dumps(found.only([0, 2]))), [want[0], want[2]])


@pytest.mark.parametrize(
    ("values", "named"),
    [
        (0.0, "no voxel has a label above 0"),
        (0.5, "must be whole numbers"),
        (float(2**32), "expected at most"),
    ],
)
def test_maps_that_are_none(values, named):
    labels = Volume(np.full(SHAPE, values, np.float64 if values > 1 else np.float32), GEOMETRY)
    with pytest.raises(InputError, match=named):
        LabelMap("map", LazyVolume.of_array(labels), GEOMETRY, MARGIN)


def test_another_grid_and_clicks(labels, tmp_path):
    with pytest.raises(GeometryError, match="another grid"):
        LabelMap("map", LazyVolume.of_array(labels), Geometry(SHAPE, (1.0, 1.0, 1.0)), MARGIN)
    (tmp_path / "clicks.csv").write_text("# first\nid,x_vox,y_vox,z_vox, side\n1,2,2,2,inside\n")
    with pytest.raises(UsageError, match="column side"):
        object_starts.opened(str(tmp_path / "clicks.csv"), GEOMETRY, MARGIN)


@pytest.mark.parametrize("z", [0, 3, SHAPE[0] - 1])
def test_the_place_of_a_bad_label_is_that_in_the_whole_map(z, monkeypatch):
    monkeypatch.setattr(
        object_starts, "slabs", lambda shape: [slice(n, n + 1) for n in range(shape[0])]
    )
    values = np.zeros(SHAPE, np.float32)
    values[z, 1, 2] = 0.5
    with pytest.raises(InputError, match=f"first at index x=2, y=1, z={z}"):
        LabelMap("map", LazyVolume.of_array(Volume(values, GEOMETRY)), GEOMETRY, MARGIN)
