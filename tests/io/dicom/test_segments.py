"""DICOM Segmentations that are read: ours, those of highdicom, and of the form that dcmqi writes."""

import itertools

import highdicom
import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.coding import Code

from accelsurf import cli, io
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import label_tables
from accelsurf.io.dicom.segmentation import Algorithm, segmentation_bytes
from accelsurf.settings.labels import LabelEntry, LabelTable
from accelsurf.settings.reading import ReadOptions
from tests.support.dicom_sources import source_of, write_slices

SEGMENTS = [LabelEntry(3, "Leber rechts ä", (200, 60, 60)), LabelEntry(7, "tumour", (0, 255, 0))]
SEGMENTATION = "1.2.840.10008.5.1.4.1.1.66.4"


def grid(seed):
    """A grid that lies anywhere."""
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned *= np.sign(np.linalg.det(turned))
    return Geometry(
        (7, 13, 11),
        tuple(rng.uniform(0.4, 3, 3).round(3)),
        tuple(rng.uniform(-90, 90, 3).round(2)),
        turned if seed % 2 else np.eye(3),
    )


def objects(seed, overlap=False):
    """Two masks, (7, 13, 11): on some slices, with an empty slice between."""
    rng = np.random.default_rng(100 + seed)
    masks = np.zeros((2, 7, 13, 11), bool)
    masks[0, 1:4] = rng.random((3, 13, 11)) < 0.5
    masks[0, 5] = rng.random((13, 11)) < 0.3
    masks[1, 2:6] = rng.random((4, 13, 11)) < 0.4
    masks[:, 4] = False
    if not overlap:
        masks[1] &= ~masks[0]
    return masks


def label_map(masks, numbers):
    return sum(np.where(mask, number, 0) for mask, number in zip(masks, numbers, strict=True))


def by_hand(
    geometry, masks, numbers, order, spacing_is_said=True, kind="BINARY", full=100, names=("a", "b")
):
    """A file of the form that dcmqi writes: a frame of each segment and slice that has a voxel, in any order."""
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = "1.2.840.10008.1.2.1"
    dataset.SOPClassUID, dataset.SOPInstanceUID, dataset.Modality = SEGMENTATION, "1.2.3.77", "SEG"
    dataset.StudyInstanceUID, dataset.SeriesInstanceUID = "1.2.3.4", "1.2.3.4.9"
    dataset.FrameOfReferenceUID = "1.2.3.4.6"
    dataset.SegmentationType, dataset.Rows, dataset.Columns = kind, *geometry.shape[1:]
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation, dataset.PixelRepresentation = (
        1,
        "MONOCHROME2",
        0,
    )
    bits = 1 if kind == "BINARY" else 8
    dataset.BitsAllocated = dataset.BitsStored = bits
    dataset.HighBit = bits - 1
    if kind == "FRACTIONAL":
        dataset.SegmentationFractionalType, dataset.MaximumFractionalValue = "PROBABILITY", full
    dataset.SegmentSequence = []
    for number, name in zip(numbers, names, strict=True):
        segment = Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, name
        dataset.SegmentSequence.append(segment)
    shared, turn, size = Dataset(), Dataset(), Dataset()
    turn.ImageOrientationPatient = [
        f"{value:.10g}" for value in geometry.direction[:, :2].T.ravel()
    ]
    size.PixelSpacing, size.SliceThickness = [f"{h:.10g}" for h in geometry.spacing[1:]], "0.1"
    if spacing_is_said:
        size.SpacingBetweenSlices = f"{geometry.spacing[0]:.10g}"
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = [turn], [size]
    dataset.SharedFunctionalGroupsSequence = [shared]
    frames = [
        (n, k) for n in range(len(masks)) for k in range(geometry.shape[0]) if masks[n, k].any()
    ]
    frames = [frames[n] for n in order.permutation(len(frames))]
    dataset.PerFrameFunctionalGroupsSequence, pixels = [], []
    for n, k in frames:
        group, place, segment = Dataset(), Dataset(), Dataset()
        place.ImagePositionPatient = [
            f"{value:.10g}" for value in geometry.index_to_world((k, 0, 0))
        ]
        segment.ReferencedSegmentNumber = numbers[n]
        group.PlanePositionSequence, group.SegmentIdentificationSequence = [place], [segment]
        dataset.PerFrameFunctionalGroupsSequence.append(group)
        pixels.append(masks[n, k])
    dataset.NumberOfFrames = len(frames)
    values = np.stack(pixels)
    content = (
        np.packbits(values.ravel(), bitorder="little") if bits == 1 else values.astype(np.uint8)
    )
    dataset.PixelData = content.tobytes() + b"\0" * (content.size % 2)
    return dataset


def save(dataset, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    dataset.save_as(path, enforce_file_format=True)
    return path


def with_highdicom(folder, geometry, values, kind, **more):
    """A segmentation that highdicom makes of slices; ``values`` (n, rows, columns, segments)."""
    slices = [pydicom.dcmread(path) for path in write_slices(folder / "scan", geometry)]
    described = [
        highdicom.seg.SegmentDescription(
            number,
            f"part {number}",
            Code("85756007", "SCT", "Tissue"),
            Code("85756007", "SCT", "Tissue"),
            "MANUAL",
        )
        for number in range(1, (values.shape[3] if values.ndim == 4 else 2) + 1)
    ]
    found = highdicom.seg.Segmentation(
        slices,
        values,
        kind,
        described,
        "1.2.3.4.11",
        3,
        "1.2.3.4.12",
        1,
        "maker",
        "model",
        "1",
        "none",
        **more,
    )
    return save(found, folder / "seg.dcm")


def check(path, geometry, expected, **more):
    """The labels lie where they were made: on their own grid, and on that of the image."""
    alone = io.read_labels(path, **more)
    index = np.argwhere(alone.array)
    places = np.rint(geometry.world_to_index(alone.geometry.index_to_world(index))).astype(int)
    assert np.array_equal(alone.array[tuple(index.T)], expected[tuple(places.T)])
    assert len(index) == np.count_nonzero(expected)
    np.testing.assert_array_equal(io.read_labels(path, grid=geometry, **more).array, expected)
    return alone


@pytest.mark.parametrize("as_labelmap", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_ours_come_back(tmp_path, seed, as_labelmap):
    geometry, masks = grid(seed), objects(seed)
    labels = label_map(masks, (3, 7)).astype(np.uint16)
    source = source_of(write_slices(tmp_path / "scan", geometry))
    content = segmentation_bytes(
        labels, geometry, source, SEGMENTS, Algorithm("1", {}), "seed", as_labelmap
    )
    path = tmp_path / "seg.dcm"
    path.write_bytes(content)
    numbers = (3, 7) if as_labelmap else (1, 2)
    found = check(path, geometry, label_map(masks, numbers))
    table = LabelTable.from_json(found.metadata["labels"])
    assert [(entry.id, entry.name) for entry in table] == [
        (numbers[0], "Leber rechts ä"),
        (numbers[1], "tumour"),
    ]
    assert [entry.color for entry in label_tables.read_label_table(path)] == [
        (200, 60, 60),
        (0, 255, 0),
    ]


@pytest.mark.parametrize("seed", range(6))
def test_frames_of_segments_in_any_order(tmp_path, seed):
    geometry, masks = grid(seed), objects(seed)
    numbers = ((1, 2), (2, 1), (5, 300))[seed % 3]
    dataset = by_hand(
        geometry, masks, numbers, np.random.default_rng(seed), spacing_is_said=seed < 4
    )
    check(save(dataset, tmp_path / "seg"), geometry, label_map(masks, numbers))


@pytest.mark.parametrize("kind", ["BINARY", "FRACTIONAL", "LABELMAP"])
@pytest.mark.parametrize("seed", [0, 1])
def test_highdicoms(tmp_path, seed, kind):
    geometry, masks = grid(seed), objects(seed)
    values = np.moveaxis(masks, 0, -1)
    if kind == "FRACTIONAL":
        values = values * 0.7 + ~values * 0.2
    if kind == "LABELMAP":
        values = label_map(masks, (1, 2)).astype(np.uint8)
    check(with_highdicom(tmp_path, geometry, values, kind), geometry, label_map(masks, (1, 2)))


def test_fractions_count_from_a_half_on_and_that_is_said(tmp_path):
    geometry = grid(0)
    values = np.zeros((1, 7, 13, 11))
    values[0, 3, 2, :6] = (49, 50, 51, 99, 100, 1)
    dataset = by_hand(
        geometry, values, (4,), np.random.default_rng(0), kind="FRACTIONAL", names=("a",)
    )
    path = save(dataset, tmp_path / "s")
    found = io.read_labels(path, grid=geometry)
    assert found.array[3, 2, :6].tolist() == [0, 4, 4, 4, 4, 0]
    assert "at least half" in found.metadata["warning"]


def test_a_single_slice_and_one_between(tmp_path):
    geometry = grid(2)
    for slices in ([5], [0, 2, 4]):
        masks = np.zeros((1, 7, 13, 11), bool)
        masks[0, slices, 3:5, 6] = True
        path = save(
            by_hand(geometry, masks, (1,), np.random.default_rng(1), names=("a",)),
            tmp_path / f"{len(slices)}",
        )
        check(path, geometry, masks[0].astype(int))


@pytest.mark.parametrize("seed", range(3))
def test_segments_that_overlap_are_refused_unless_one_is_named(tmp_path, seed):
    geometry, masks = grid(seed), objects(seed, overlap=True)
    dataset = by_hand(geometry, masks, (2, 9), np.random.default_rng(seed), names=("liver", "cyst"))
    path = save(dataset, tmp_path / "seg.dcm")
    with pytest.raises(
        InputError,
        match=r"segments (2 \(liver\) and 9 \(cyst\)|9 \(cyst\) and 2 \(liver\)) overlap",
    ):
        io.read_labels(path)
    for mask, number in zip(masks, (2, 9), strict=True):
        check(path, geometry, number * mask.astype(int), ids=((number, number),))


def test_any_order_of_axes_and_a_grid_without_these_voxels(tmp_path):
    geometry, masks = grid(0), objects(0)
    labels = label_map(masks, (1, 2))
    path = save(by_hand(geometry, masks, (1, 2), np.random.default_rng(0)), tmp_path / "seg.dcm")
    for order, *signs in itertools.product(
        itertools.permutations(range(3)), (1, -1), (1, -1), (1, -1)
    ):
        turn = tuple(slice(None, None, sign) for sign in signs)
        array = labels.transpose(order)[turn]
        first = np.zeros(3, int)
        first[list(order)] = [
            0 if sign > 0 else n - 1 for sign, n in zip(signs, array.shape, strict=True)
        ]
        axes = geometry.direction[:, ::-1][:, order] * signs
        there = Geometry(
            array.shape,
            tuple(np.array(geometry.spacing)[list(order)]),
            tuple(geometry.index_to_world(first)),
            axes[:, ::-1],
        )
        np.testing.assert_array_equal(io.read_labels(path, grid=there).array, array)
    moved = Geometry(geometry.shape, geometry.spacing, tuple(np.add(geometry.origin, (0.1, 0, 0))))
    assert io.read_labels(path, grid=moved).geometry.shape != moved.shape
    small = Geometry((7, 5, 5), geometry.spacing, geometry.origin)  # labels lie beyond it
    assert io.read_labels(path, grid=small).geometry.shape != small.shape


def test_two_of_several_slices_on_one_grid(tmp_path):
    geometry, masks = grid(3), objects(3)
    rng = np.random.default_rng(3)
    first = io.read_labels(
        save(by_hand(geometry, masks[:1], (1,), rng, names=("a",)), tmp_path / "a")
    )
    second = io.read_labels(
        save(by_hand(geometry, masks[1:], (1,), rng, names=("a",)), tmp_path / "b")
    )
    a, b = io.on_one_grid(first, second)
    assert a.geometry.matches(b.geometry) and a.geometry.shape[0] == 5
    np.testing.assert_array_equal(a.array, masks[0, 1:6])
    np.testing.assert_array_equal(b.array, masks[1, 1:6])


def test_a_start_an_evaluation_a_mask_and_info(tmp_path, capsys):
    geometry = Geometry((12, 16, 16), (1.0, 1.0, 1.0), (3.0, -2.0, 7.0))
    z, y, x = np.indices(geometry.shape)
    ball = (z - 5) ** 2 + (y - 8) ** 2 + (x - 8) ** 2 < 16
    core = (z - 5) ** 2 + (y - 8) ** 2 + (x - 8) ** 2 < 7
    write_slices(tmp_path / "scan", geometry, values=1000 * ball)
    path = save(
        by_hand(geometry, np.stack([ball, core]), (1, 2), np.random.default_rng(0)),
        tmp_path / "seg.dcm",
    )
    io.write(Volume(ball.astype(np.uint8), geometry), tmp_path / "truth.nii.gz")
    common = ["segment", str(tmp_path / "scan"), "--threads", "1", "-o"]
    assert cli.execute([*common, str(tmp_path / "out"), "--start", f"label:{path}@2"]) == 0
    assert (
        cli.execute([*common, str(tmp_path / "masked"), "--start", "otsu", "--mask", f"{path}"])
        == 3
    )
    assert "overlap" in capsys.readouterr().err
    assert (
        cli.execute(["evaluate", str(tmp_path / "out/scan_seg.nii.gz"), f"{path}@1", "--json"]) == 0
    )
    assert '"dice": 1' in capsys.readouterr().out.replace("1.0", "1")
    assert cli.execute(["evaluate", f"{path}@1", str(tmp_path / "truth.nii.gz")]) == 0
    assert cli.execute(["info", str(path)]) == 0
    assert "segments 1 a, 2 b" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (
            lambda dataset: (
                dataset.PerFrameFunctionalGroupsSequence[1]
                .SegmentIdentificationSequence[0]
                .__setattr__("ReferencedSegmentNumber", 8)
            ),
            "is of segment 8, one of 1, 2 expected",
        ),
        (lambda dataset: delattr(dataset, "SegmentSequence"), "without segments"),
        (
            lambda dataset: setattr(dataset, "PixelData", dataset.PixelData[:-20]),
            "bytes of its pixels are there",
        ),
        (lambda dataset: setattr(dataset, "NumberOfFrames", 3), "3 frames announced, 126 bytes"),
        (lambda dataset: setattr(dataset, "NumberOfFrames", 10**9), "1000000000 frames"),
        (lambda dataset: setattr(dataset, "TotalPixelMatrixRows", 1000), "whole-slide"),
        (
            lambda dataset: setattr(dataset, "SegmentationType", "FRACTIONAL"),
            "without their largest value",
        ),
        (
            lambda dataset: setattr(
                dataset.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence[0],
                "ImagePositionPatient",
                [1, 2, 3],
            ),
            "shifted sideways|no multiples",
        ),
        (
            lambda dataset: dataset.PerFrameFunctionalGroupsSequence.__setitem__(
                1, dataset.PerFrameFunctionalGroupsSequence[0]
            ),
            "two frames of a segment",
        ),
    ],
)
def test_damaged_ones_are_refused_in_one_line(tmp_path, damage, said):
    dataset = by_hand(grid(1), objects(1), (1, 2), np.random.default_rng(1))
    damage(dataset)
    save(dataset, tmp_path / "seg.dcm")
    with pytest.raises((InputError, GeometryError), match=said):
        io.read_labels(tmp_path / "seg.dcm")


def test_what_a_segmentation_is_not(tmp_path):
    dataset = by_hand(grid(1), objects(1), (1, 2), np.random.default_rng(1))
    save(dataset, tmp_path / "dataset" / "seg.dcm")
    with pytest.raises(UsageError, match="spacing: .*|spacing was given"):
        io.read(tmp_path / "dataset", options=ReadOptions(spacing=(1, 1, 1)))
    dataset.SOPInstanceUID = "1.2.3.78"
    save(dataset, tmp_path / "dataset" / "more.dcm")
    with pytest.raises(
        InputError, match=r"several segmentations are in it: 2 segmentations \(more.dcm, seg.dcm\)"
    ):
        io.read_labels(tmp_path / "dataset")
    write_slices(tmp_path / "dataset", grid(1))
    assert "2 segmentations" in io.read(tmp_path / "dataset").metadata["warning"]
