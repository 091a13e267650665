"""RT Structure Sets that are written: contours where they belong, holes, references, and the same bytes every time."""

import io

import numpy as np
import pydicom
import pytest

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.structure_set import Region, structure_set_bytes
from accelsurf.settings.labels import LabelEntry
from tests.support.dicom_sources import FRAME, SERIES, STUDY, source_of, write_frames, write_slices
from tests.support.even_odd import inside

GRID = Geometry((4, 20, 24), (3.0, 0.8, 0.7), (10.0, -20.0, 30.5))
LIVER, TUMOUR = LabelEntry(3, "Leber rechts ä", (200, 60, 60)), LabelEntry(7, "a\\b", (0, 255, 0))


def square(low, high, k, geometry=GRID):
    """A square in index positions (y, x) of slice k, in the world."""
    corners = np.array([[k, low, low], [k, low, high], [k, high, high], [k, high, low]], float)
    return geometry.index_to_world(corners)


def written(regions, source, geometry=GRID, seed="seed"):
    return structure_set_bytes(regions, geometry, source, "0.1", seed)


def read(content):
    return pydicom.dcmread(io.BytesIO(content))


def points_of(item):
    return np.array([float(v) for v in item.ContourData]).reshape(-1, 3)


def test_contours_come_back_with_names_colours_and_references(tmp_path):
    order = [2, 0, 3, 1]
    source = source_of(write_slices(tmp_path, GRID, order))
    loops = {1: [square(2, 15, 1), square(5.25, 9.75, 1)], 2: [square(3, 4, 2)]}
    found = read(written([Region(LIVER, loops), Region(TUMOUR, {0: [square(1, 2, 0)]})], source))
    assert [(roi.ROINumber, roi.ROIName) for roi in found.StructureSetROISequence] == [
        (3, "Leber rechts ä"),
        (7, "a/b"),
    ]
    first, second = found.ROIContourSequence
    assert (first.ReferencedROINumber, list(first.ROIDisplayColor)) == (3, [200, 60, 60])
    assert (second.ReferencedROINumber, len(second.ContourSequence)) == (7, 1)
    meant = [(1, loop) for loop in loops[1]] + [(2, loops[2][0])]
    for item, (k, loop) in zip(first.ContourSequence, meant, strict=True):
        assert np.abs(points_of(item) - loop).max() <= 5e-7
        assert (item.ContourGeometricType, item.NumberOfContourPoints) == ("CLOSED_PLANAR", 4)
        (image,) = item.ContourImageSequence
        assert image.ReferencedSOPInstanceUID == f"{SERIES}.{order[k] + 1}"
    (world,) = found.ReferencedFrameOfReferenceSequence
    (study,) = world.RTReferencedStudySequence
    (series,) = study.RTReferencedSeriesSequence
    assert (
        world.FrameOfReferenceUID,
        study.ReferencedSOPInstanceUID,
        series.SeriesInstanceUID,
    ) == (FRAME, STUDY, SERIES)
    assert {image.ReferencedSOPInstanceUID for image in series.ContourImageSequence} == {
        f"{SERIES}.{n + 1}" for n in range(4)
    }
    assert {roi.ReferencedFrameOfReferenceUID for roi in found.StructureSetROISequence} == {FRAME}
    assert [one.ReferencedROINumber for one in found.RTROIObservationsSequence] == [3, 7]
    assert (found.PatientID, str(found.PatientName), found.Modality) == (
        "P1",
        "Müller^Ada",
        "RTSTRUCT",
    )


def test_frames_of_one_file_are_named_by_number(tmp_path):
    source = source_of(write_frames(tmp_path / "f.dcm", GRID, [2, 0, 3, 1]))
    found = read(written([Region(LIVER, {k: [square(2, 5, k)] for k in range(4)})], source))
    images = [item.ContourImageSequence[0] for item in found.ROIContourSequence[0].ContourSequence]
    assert [image.ReferencedFrameNumber for image in images] == [3, 1, 4, 2]


def test_a_plane_between_the_slices_names_none(tmp_path):
    source = source_of(write_slices(tmp_path, GRID))
    fine = Geometry((7, 20, 24), (1.5, 0.8, 0.7), GRID.origin)
    found = read(
        written([Region(LIVER, {k: [square(2, 5, k, fine)] for k in range(7)})], source, fine)
    )
    named = ["ContourImageSequence" in item for item in found.ROIContourSequence[0].ContourSequence]
    assert named == [True, False] * 3 + [True]


def test_a_contour_of_any_number_of_points(tmp_path):
    source = source_of(write_slices(tmp_path, GRID))
    angle = np.linspace(0, 2 * np.pi, 9000, endpoint=False)
    loop = np.stack(
        [12 + 8 * np.cos(angle), 8 * np.sin(angle) - 12, np.full(len(angle), 33.5)], axis=1
    )
    found = read(written([Region(LIVER, {1: [loop]})], source))
    (item,) = found.ROIContourSequence[0].ContourSequence
    assert item["ContourData"].VR == "DS" and np.abs(points_of(item) - loop).max() <= 5e-7
    assert inside([points_of(item)[:, :2]], np.array([[12.0, -12.0], [21.0, -12.0]])).tolist() == [
        True,
        False,
    ]


def test_same_bytes_and_nothing_of_clock_or_chance(tmp_path):
    source = source_of(write_slices(tmp_path, GRID))
    regions = [Region(LIVER, {1: [square(2, 15, 1)]})]
    content = written(regions, source)
    assert written(regions, source) == content
    first, other = read(content), read(written(regions, source, seed="another"))
    for keyword in ("SOPInstanceUID", "SeriesInstanceUID"):
        assert first[keyword].value != other[keyword].value
    values = [
        element
        for element in first.iterall()
        if element.VR in ("UI", "DA", "TM", "DT") and element.value
    ]
    dates = {str(element.value) for element in values if element.VR != "UI"}
    assert dates == {"19500102", "20200304", "101112", "111213.5"}
    uids = {str(element.value) for element in values if element.VR == "UI"}
    assert all(uid.startswith(("2.25.", "1.2.3.4", "1.2.840.10008.")) for uid in uids)


def test_refusals(tmp_path):
    source = source_of(write_slices(tmp_path, GRID))
    with pytest.raises(UsageError, match="none is left"):
        written([], source)
    across = Geometry((4, 20, 24), (3.0, 0.8, 0.7), GRID.origin, np.eye(3)[:, [2, 0, 1]])
    with pytest.raises(InputError, match="not parallel"):
        written([Region(LIVER, {0: [square(1, 2, 0, across)]})], source, across)


@pytest.mark.parametrize("keyword", ["SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID"])
def test_a_source_without_identifiers_is_refused_by_name(tmp_path, keyword):
    files = write_slices(tmp_path, GRID, **{keyword: ""})
    with pytest.raises(InputError, match=f"{files[0].name}: has no {keyword}"):
        source_of(files)


def test_a_source_without_places_is_refused_by_name(tmp_path):
    files = write_slices(tmp_path, GRID, ImagePositionPatient=None)
    with pytest.raises(InputError, match=f"{files[0].name}: does not say where it lies"):
        source_of(files)


def test_an_id_that_no_region_can_have(tmp_path):
    far = Region(LabelEntry(2**31, "far", (1, 2, 3)), {0: [square(1, 2, 0)]})
    with pytest.raises(UsageError, match="2147483648"):
        written([far], source_of(write_slices(tmp_path, GRID)))
