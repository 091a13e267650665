"""DICOM outputs of runs on DICOM series: what they say of the result's objects, in the world."""

import io as bytes_io

import highdicom
import numpy as np
import pydicom
import pytest

import accelsurf
from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.measure.metrics import dice
from accelsurf.output import dicom
from accelsurf.settings.labels import LabelEntry, LabelTable
from tests.support.dicom_sources import SERIES, write_slices
from tests.support.even_odd import area, inside

TABLE = LabelTable(
    {1: LabelEntry(1, "liver", (200, 60, 60)), 4: LabelEntry(4, "tumour", (0, 255, 0))}
)


def grid(turned):
    """Oblique or not; the first slice's file is not the lowest."""
    direction = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    if np.linalg.det(direction) < 0:
        direction = -direction
    return Geometry(
        (16, 30, 32), (2.0, 1.0, 0.9), (12.0, -40.0, 7.0), direction if turned else np.eye(3)
    )


def distances(geometry, middle):
    """Of each voxel from an index position, mm."""
    places = geometry.index_to_world(np.moveaxis(np.indices(geometry.shape), 0, -1))
    return np.linalg.norm(places - geometry.index_to_world(middle), axis=-1)


def shell_run(folder, turned=True, **changes):
    """A run that ends at a ball with a hollow: psi is that of the shell, after no step."""
    geometry = grid(turned)
    far = distances(geometry, (7.6, 14.3, 15.8))
    shell = np.maximum(far - 11, 5.5 - far).astype(np.float32)
    values = np.where(shell < 0, 300, 0)
    write_slices(
        folder, geometry, order=np.random.default_rng(0).permutation(16), values=values, **changes
    )
    volume = io.read(folder)
    assert volume.geometry.matches(geometry)
    return accelsurf.segment(volume, start=shell < 0, flow="gradient", max_steps=6, smoothness=0.02)


def many_run(folder):
    geometry = grid(True)
    labels = np.zeros(geometry.shape, np.uint8)
    labels[distances(geometry, (4, 8, 8)) < 6] = 1
    labels[distances(geometry, (10, 20, 20)) < 7] = 4
    write_slices(folder, geometry, values=np.where(labels > 0, 300, 0))
    return accelsurf.segment_objects(io.read(folder), labels, flow="gradient", max_steps=3)


def contents(tmp_path, result, write, table=TABLE):
    path = tmp_path / "out.dcm"
    write(result, table, path)
    return path.read_bytes()


def rasterised(dataset, geometry):
    """The regions of a structure set on a grid, in the order of the file, by even and odd."""
    zyx = np.indices(geometry.shape[1:]).reshape(2, -1).T
    found = []
    for roi in dataset.ROIContourSequence:
        mask, planes = np.zeros(geometry.shape, bool), {}
        for item in roi.ContourSequence:
            index = geometry.world_to_index(
                np.array([float(v) for v in item.ContourData]).reshape(-1, 3)
            )
            k = round(float(index[0, 0]))
            assert np.abs(index[:, 0] - k).max() < 1e-5
            planes.setdefault(k, []).append(index[:, 1:])
        for k, loops in planes.items():
            mask[k] = inside(loops, zyx).reshape(geometry.shape[1:])
        found.append((mask, planes))
    return found


@pytest.fixture(scope="module")
def shell(tmp_path_factory):
    return shell_run(tmp_path_factory.mktemp("shell") / "scan")


@pytest.mark.parametrize("write", [dicom.write_segmentation, dicom.write_labelmap])
def test_segmentation_has_the_same_voxels_in_the_world(tmp_path, shell, write):
    found = highdicom.seg.segread(bytes_io.BytesIO(contents(tmp_path, shell, write)))
    volume = found.get_volume(combine_segments=True)
    at = np.argwhere(volume.array)
    index = shell.geometry.world_to_index((volume.affine[:3] @ np.c_[at, np.ones(len(at))].T).T)
    assert np.abs(index - np.rint(index)).max() < 1e-4
    labels = np.zeros(shell.geometry.shape, bool)
    labels[tuple(np.rint(index).astype(int).T)] = True
    assert np.array_equal(labels, shell.labels > 0)
    description = found.get_segment_description(1)
    assert description.segment_label == "liver"
    assert description.algorithm_identification.parameters["energy"] == "chan-vese"


def test_structure_set_has_holes_and_the_areas_of_the_surface(tmp_path, shell):
    dataset = pydicom.dcmread(
        bytes_io.BytesIO(contents(tmp_path, shell, dicom.write_structure_set))
    )
    ((mask, planes),) = rasterised(dataset, shell.geometry)
    assert max(map(len, planes.values())) == 2  # the hollow
    assert dice(mask, shell.labels > 0) >= 0.99
    steps = np.array(shell.geometry.spacing[1:])
    volume = 2.0 * sum(area([loop * steps for loop in loops]) for loops in planes.values())
    assert volume == pytest.approx(shell.volume_mm3, rel=0.01)
    named = {
        item.ContourImageSequence[0].ReferencedSOPInstanceUID
        for item in dataset.ROIContourSequence[0].ContourSequence
    }
    assert len(named) == len(planes) and all(uid.startswith(SERIES) for uid in named)


def test_several_objects(tmp_path):
    result = many_run(tmp_path / "scan")
    table = contents(tmp_path, result, dicom.write_structure_set)
    dataset = pydicom.dcmread(bytes_io.BytesIO(table))
    assert [roi.ROIName for roi in dataset.StructureSetROISequence] == ["liver", "tumour"]
    assert [roi.ReferencedROINumber for roi in dataset.ROIContourSequence] == [1, 4]
    for (mask, _), label in zip(rasterised(dataset, result.geometry), (1, 4), strict=True):
        assert dice(mask, result.labels == label) >= 0.99
    found = highdicom.seg.segread(
        bytes_io.BytesIO(contents(tmp_path, result, dicom.write_segmentation))
    )
    assert [found.get_segment_description(n).segment_label for n in (1, 2)] == ["liver", "tumour"]
    counts = [int((found.get_volume(segment_numbers=[n]).array > 0).sum()) for n in (1, 2)]
    assert counts == [int((result.labels == label).sum()) for label in (1, 4)]


@pytest.mark.slow
def test_same_run_same_bytes_and_another_run_other_identifiers(tmp_path, shell):
    again = shell_run(tmp_path / "scan")
    other = shell_run(tmp_path / "scan", SeriesDescription="the same slices")
    moved = accelsurf.segment(
        io.read(tmp_path / "scan"),
        start=shell.labels > 0,
        flow="gradient",
        max_steps=7,
        smoothness=0.02,
    )
    for write in (dicom.write_segmentation, dicom.write_labelmap, dicom.write_structure_set):
        content = contents(tmp_path, shell, write)
        assert contents(tmp_path, again, write) == content == contents(tmp_path, other, write)
        uids = [
            pydicom.dcmread(bytes_io.BytesIO(one)).SOPInstanceUID
            for one in (
                content,
                contents(tmp_path, moved, write),
                contents(tmp_path, shell, write, LabelTable()),
            )
        ]
        assert len(set(uids)) == 3
    kinds = (dicom.write_segmentation, dicom.write_labelmap, dicom.write_structure_set)
    series = {
        pydicom.dcmread(bytes_io.BytesIO(contents(tmp_path, shell, write))).SeriesInstanceUID
        for write in kinds
    }
    assert len(series) == 3


def test_settings_of_files_and_threads_change_nothing(tmp_path, shell):
    config = shell.config.replace(threads=2, mesh="stl", save_sdf=True)
    changed = accelsurf.Result(**{**vars_of(shell), "config": config})
    write = dicom.write_segmentation
    assert contents(tmp_path, changed, write) == contents(tmp_path, shell, write)


def vars_of(result):
    return {name: getattr(result, name) for name in type(result).__dataclass_fields__}


def test_refusals(tmp_path, shell):
    plain = accelsurf.segment(
        shell.volume.array, start=shell.labels > 0, flow="gradient", max_steps=1
    )
    with pytest.raises(UsageError, match="not read from DICOM"):
        dicom.write_segmentation(plain, TABLE, tmp_path / "a.dcm")
    result = shell_run(tmp_path / "empty", StudyInstanceUID="")
    with pytest.raises(InputError, match="has no StudyInstanceUID"):
        dicom.write_structure_set(result, TABLE, tmp_path / "a.dcm")
    assert not (tmp_path / "a.dcm").exists()
