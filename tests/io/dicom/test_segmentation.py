"""DICOM Segmentations that are written: voxels in the world, names, references, and the same bytes every time."""

import io

import highdicom
import numpy as np
import pydicom
import pytest

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.segmentation import Algorithm, segmentation_bytes
from accelsurf.io.dicom.source_images import SourceImages
from accelsurf.settings.labels import LabelEntry
from tests.support.dicom_sources import FRAME, SERIES, STUDY, source_of, write_frames, write_slices

SEGMENTS = [LabelEntry(3, "Leber rechts ä", (200, 60, 60)), LabelEntry(7, "tumour", (0, 255, 0))]


def oblique():
    turned, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    return turned if np.linalg.det(turned) > 0 else -turned


GRIDS = {
    "axial": Geometry((6, 20, 24), (3.0, 0.8, 0.7), (10.0, -20.0, 30.5)),
    "oblique": Geometry((6, 20, 24), (3.0, 0.8, 0.7), (10.0, -20.0, 30.5), oblique()),
    "left-handed": Geometry(
        (6, 20, 24), (0.5, 0.8, 0.7), (10.0, -20.0, 30.5), np.diag([1.0, 1.0, -1.0])
    ),
    "odd": Geometry((3, 7, 5), (3.0, 0.8, 0.7)),
    "one slice": Geometry((1, 20, 24), (3.0, 0.8, 0.7)),
}


def labels_on(geometry):
    """Two objects; slice 2 of a volume has none, the corners of the grid differ."""
    labels = np.zeros(geometry.shape, np.uint16)
    labels[:, 1:4, 2:5] = 3
    labels[-2:, 5:7, :3] = 7
    labels[0, 0, 0] = 7
    if geometry.shape[0] > 3:
        labels[2] = 0
    return labels


def written(labels, geometry, source, as_labelmap=False, seed="seed", segments=SEGMENTS):
    return segmentation_bytes(
        labels,
        geometry,
        source,
        segments,
        Algorithm("0.1", {"energy": "chan-vese"}),
        seed,
        as_labelmap,
    )


def world_points(content, geometry, is_labelmap):
    """Label number of each voxel of the grid, found by the world position that highdicom gives the pixels."""
    found = highdicom.seg.segread(io.BytesIO(content))
    volume = found.get_volume(combine_segments=True)
    values = np.zeros(geometry.shape, np.int64)
    for at in np.argwhere(volume.array):
        # highdicom's world is LPS as ours; its index is (slice, row, column) of its own order.
        place = volume.affine[:3] @ [*at, 1.0]
        index = geometry.world_to_index(place)
        assert np.abs(index - np.rint(index)).max() * min(geometry.spacing) < 1e-4
        values[tuple(np.rint(index).astype(int))] = volume.array[tuple(at)]
    return values


@pytest.mark.sampled
@pytest.mark.parametrize("as_labelmap", [False, True])
@pytest.mark.parametrize("name", GRIDS)
def test_same_voxels_at_the_same_places(tmp_path, name, as_labelmap):
    geometry = GRIDS[name]
    files = write_slices(tmp_path, geometry, order=list(reversed(range(geometry.shape[0]))))
    labels = labels_on(geometry)
    content = written(labels, geometry, source_of(files), as_labelmap)
    numbers = labels if as_labelmap else np.select([labels == 3, labels == 7], [1, 2])
    assert np.array_equal(world_points(content, geometry, as_labelmap), numbers)


@pytest.mark.parametrize("as_labelmap", [False, True])
def test_names_colours_patient_and_references(tmp_path, as_labelmap):
    geometry = GRIDS["axial"]
    order = [3, 0, 5, 1, 4, 2]
    labels = labels_on(geometry)
    content = written(
        labels, geometry, source_of(write_slices(tmp_path, geometry, order)), as_labelmap
    )
    found = highdicom.seg.segread(io.BytesIO(content))
    assert found.segment_numbers == ([3, 7] if as_labelmap else [1, 2])
    described = [found.get_segment_description(n) for n in found.segment_numbers]
    assert [one.segment_label for one in described] == ["Leber rechts ä", "tumour"]
    assert [one.tracking_id for one in described] == ["label 3", "label 7"]
    colors = [
        highdicom.color.CIELabColor.from_dicom_value(one.RecommendedDisplayCIELabValue)
        for one in described
    ]
    assert [color.to_rgb() for color in colors] == [(200, 60, 60), (0, 255, 0)]
    assert described[0].algorithm_identification.parameters == {"energy": "chan-vese"}
    assert (str(found.PatientName), found.PatientID, found.PatientSex) == ("Müller^Ada", "P1", "F")
    assert (found.StudyInstanceUID, found.FrameOfReferenceUID) == (STUDY, FRAME)
    assert found.SeriesInstanceUID not in (STUDY, SERIES)
    assert found.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SliceThickness == 3
    # Every frame names the slice that lies in its plane.
    empty = [k for k in range(6) if not labels[k].any()]
    assert empty == [2]
    for group in found.PerFrameFunctionalGroupsSequence:
        k = (group.PlanePositionSequence[0].ImagePositionPatient[2] - 30.5) / 3
        assert k not in empty
        (item,) = group.DerivationImageSequence[0].SourceImageSequence
        assert item.ReferencedSOPInstanceUID == f"{SERIES}.{order[round(k)] + 1}"
        assert item.SpatialLocationsPreserved == "YES"
    listed = {
        item.ReferencedSOPInstanceUID
        for item in found.ReferencedSeriesSequence[0].ReferencedInstanceSequence
    }
    assert listed == {f"{SERIES}.{n + 1}" for n in range(6)}
    assert found.ReferencedSeriesSequence[0].SeriesInstanceUID == SERIES


def test_empty_frames_are_left_out(tmp_path):
    geometry = GRIDS["axial"]
    source = source_of(write_slices(tmp_path, geometry))
    labels = labels_on(geometry)
    frames = sum(int((labels[k] == n).any()) for k in range(6) for n in (3, 7))
    assert pydicom.dcmread(io.BytesIO(written(labels, geometry, source))).NumberOfFrames == frames
    slices = sum(int(labels[k].any()) for k in range(6))
    assert (
        pydicom.dcmread(io.BytesIO(written(labels, geometry, source, True))).NumberOfFrames
        == slices
        == 5
    )


def test_frames_of_one_file_are_named_by_number(tmp_path):
    geometry = GRIDS["oblique"]
    order = [3, 0, 5, 1, 4, 2]
    labels = labels_on(geometry)
    content = written(
        labels, geometry, source_of(write_frames(tmp_path / "f.dcm", geometry, order))
    )
    assert np.array_equal(world_points(content, geometry, False) == 1, labels == 3)
    found = pydicom.dcmread(io.BytesIO(content))
    for group in found.PerFrameFunctionalGroupsSequence:
        place = [float(v) for v in group.PlanePositionSequence[0].ImagePositionPatient]
        k = round(float(geometry.world_to_index(place)[0]))
        (item,) = group.DerivationImageSequence[0].SourceImageSequence
        assert (item.ReferencedSOPInstanceUID, item.ReferencedFrameNumber) == (
            f"{SERIES}.1",
            order[k] + 1,
        )


def test_a_grid_with_planes_between_the_slices_has_places_of_its_own(tmp_path):
    source = source_of(write_slices(tmp_path, Geometry((6, 20, 24), (3.0, 0.8, 0.7))))
    # Same planes and others between them, other pixels.
    geometry = Geometry((11, 10, 12), (1.5, 1.6, 1.4), (0.2, 0.1, 0.0))
    labels = np.zeros(geometry.shape, np.uint16)
    labels[1:9, 2:4, 3:8] = 3
    content = written(labels, geometry, source)
    assert np.array_equal(world_points(content, geometry, False) == 1, labels == 3)
    found = pydicom.dcmread(io.BytesIO(content))
    named = {}
    for group in found.PerFrameFunctionalGroupsSequence:
        k = round(float(group.PlanePositionSequence[0].ImagePositionPatient[2]) / 1.5)
        items = (
            group.DerivationImageSequence[0].SourceImageSequence
            if group.DerivationImageSequence
            else []
        )
        named[k] = [
            (item.ReferencedSOPInstanceUID, item.SpatialLocationsPreserved) for item in items
        ]
    assert named == {
        k: [(f"{SERIES}.{k // 2 + 1}", "NO")] if k % 2 == 0 else [] for k in range(1, 9)
    }


@pytest.mark.parametrize("as_labelmap", [False, True])
def test_same_bytes_and_nothing_of_clock_or_chance(tmp_path, as_labelmap):
    geometry = GRIDS["axial"]
    source = source_of(write_slices(tmp_path, geometry))
    labels = labels_on(geometry)
    content = written(labels, geometry, source, as_labelmap)
    assert written(labels, geometry, source, as_labelmap) == content
    other = written(labels, geometry, source, as_labelmap, seed="another")
    first, second = (pydicom.dcmread(io.BytesIO(one)) for one in (content, other))
    for keyword in ("SOPInstanceUID", "SeriesInstanceUID"):
        assert first[keyword].value != second[keyword].value
    values = [
        element
        for element in first.iterall()
        if element.VR in ("UI", "DA", "TM", "DT") and element.value
    ]
    dates = {str(element.value) for element in values if element.VR != "UI"}
    assert dates == {"19500102", "20200304", "101112", "111213.5", "20200304111213.5"}
    uids = {str(element.value) for element in values if element.VR == "UI"}
    assert all(uid.startswith(("2.25.", "1.2.3.4", "1.2.840.10008.")) for uid in uids)
    assert all(len(uid) <= 64 for uid in uids)


def test_refusals(tmp_path):
    geometry = GRIDS["odd"]
    source = source_of(write_slices(tmp_path, geometry))
    labels = np.zeros(geometry.shape, np.uint32)
    with pytest.raises(UsageError, match="none is left"):
        written(labels, geometry, source, segments=[])
    labels[1, 1, 1] = 70000
    far = [LabelEntry(70000, "far", (1, 2, 3))]
    with pytest.raises(UsageError, match="70000"):
        written(labels, geometry, source, True, segments=far)
    assert (
        world_points(written(labels, geometry, source, segments=far), geometry, False)[1, 1, 1] == 1
    )


def test_a_source_without_a_frame_of_reference(tmp_path):
    geometry = GRIDS["odd"]
    files = write_slices(
        tmp_path, geometry, FrameOfReferenceUID=None, PatientSex="X", PatientBirthDate=None
    )
    source = source_of(files)
    assert isinstance(source, SourceImages) and source.frame_of_reference.startswith("2.25.")
    labels = labels_on(geometry)
    assert np.array_equal(
        world_points(written(labels, geometry, source), geometry, False) == 1, labels == 3
    )
