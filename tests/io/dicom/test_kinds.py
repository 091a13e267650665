"""What is stored in ways of its own: tables of values, padding, slices of nuclear medicine, tiles of microscopy."""

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.uid import JPEG2000Lossless, JPEGBaseline8Bit, JPEGLSLossless, RLELossless

from accelsurf import cli, io
from accelsurf.errors import InputError
from accelsurf.settings.reading import ReadOptions
from tests.support.dicom_series import Series, check, save, values_at, world_of

NUCLEAR, WHOLE_SLIDE = "1.2.840.10008.5.1.4.1.1.20", "1.2.840.10008.5.1.4.1.1.77.1.6"


def stored_slices(folder, values, change):
    """Slices with these stored values, (n, rows, columns)."""
    series = Series(rows=values.shape[1], columns=values.shape[2]).stacked(len(values))
    for number, plane in enumerate(values):
        dataset = series.dataset(number)
        dataset.PixelData = np.ascontiguousarray(plane).tobytes()
        change(dataset)
        save(dataset, folder / f"{number}.dcm")
    return folder


@pytest.mark.parametrize("seed", range(4))
def test_a_table_gives_the_values(tmp_path, seed):
    rng = np.random.default_rng(seed)
    is_signed = bool(seed % 2)
    first = int(rng.integers(-40, 0)) if is_signed else int(rng.integers(5, 60))
    table = rng.integers(0, 60000 if seed < 2 else 250, 90).astype(np.uint16)
    stored = rng.integers(-90 if is_signed else 0, 200, (3, 5, 7)).astype(np.int16)

    def change(dataset):
        dataset.PixelRepresentation = int(is_signed)
        lut = Dataset()
        lut.add_new(0x0028_3002, "SS" if is_signed else "US", [len(table), first, 16])
        lut.add_new(0x0028_3006, *(("US", table.tolist()) if seed < 2 else ("OW", table.tobytes())))
        lut.ModalityLUTType = "HU"
        dataset.ModalityLUTSequence = [lut]

    found = io.read(stored_slices(tmp_path, stored, change))
    expected = table[np.clip(stored.astype(int) - first, 0, len(table) - 1)]
    np.testing.assert_array_equal(found.array, expected)
    assert found.metadata["value_unit"] == "HU"


@pytest.mark.parametrize("fault", ["short", "deep", "empty", "late"])
def test_a_table_that_cannot_be_read_is_refused(tmp_path, fault):
    def change(dataset):
        lut = Dataset()
        first = 40000 if fault == "late" else 0
        lut.add_new(0x0028_3002, "US", [50, first, 12 if fault == "deep" else 16])
        if fault != "empty":
            lut.add_new(0x0028_3006, "US", list(range(10 if fault == "short" else 50)))
        dataset.ModalityLUTSequence = [lut]

    stored_slices(tmp_path, np.full((2, 5, 7), 30, np.int16), change)
    with pytest.raises(InputError, match="its table of values"):
        io.read(tmp_path)


@pytest.mark.parametrize(
    ("is_signed", "value", "limit", "padding"),
    [
        (True, -2000, None, [-2000]),
        (True, 63536, None, [-2000]),
        (False, 65535, None, [65535]),
        (True, -2000, -1990, [-2000, -1995, -1990]),
        (True, -1990, -2000, [-2000, -1993]),
        (False, 0, None, [0]),
    ],
)
def test_padding_gets_the_smallest_value_of_the_image_and_is_named(
    tmp_path, is_signed, value, limit, padding
):
    rng = np.random.default_rng(len(padding))
    image = rng.integers(100, 900, (3, 6, 7)).astype(np.int32)
    where = rng.random(image.shape) < 0.3
    stored = np.where(where, rng.choice(padding, image.shape), image)

    def change(dataset):
        dataset.PixelRepresentation, dataset.RescaleSlope, dataset.RescaleIntercept = (
            int(is_signed),
            2,
            -1024,
        )
        sort = "SS" if value < 0 else "US"
        dataset.add_new(0x0028_0120, sort, value)
        if limit is not None:
            dataset.add_new(0x0028_0121, sort, limit)

    found = io.read(
        stored_slices(tmp_path, stored.astype(np.int16 if is_signed else np.uint16), change)
    )
    expected = 2 * np.where(where, image[~where].min(), image) - 1024
    np.testing.assert_array_equal(found.array, expected)
    assert f"{where.sum()} voxels of padding" in found.metadata["warning"]


def test_padding_of_inverse_pictures_and_padding_alone(tmp_path):
    stored = np.arange(2 * 5 * 7, dtype=np.int16).reshape(2, 5, 7)
    stored[:, 0, 0] = -5

    def change(dataset):
        dataset.PhotometricInterpretation = "MONOCHROME1"
        dataset.add_new(0x0028_0120, "SS", -5)

    assert io.read(stored_slices(tmp_path / "a", stored, change)).array[0, 0, 0] == stored.max()
    stored_slices(tmp_path / "b", np.full((2, 5, 7), -5, np.int16), change)
    with pytest.raises(InputError, match="every voxel is padding"):
        io.read(tmp_path / "b")
    unused = io.read(stored_slices(tmp_path / "c", np.abs(stored), change))
    np.testing.assert_array_equal(unused.array, np.abs(stored))
    assert "padding" not in unused.metadata["warning"]


def nuclear(
    count, step, order=None, placed=True, orientation=(1, 0, 0, 0, 1, 0), kind="RECON TOMO"
):
    """A reconstruction of nuclear medicine in a file; frame n has slice ``order[n]``, slices follow by ``step``."""
    series = Series(orientation=orientation)
    origin = np.array((10.0, -20.0, 30.0))
    order = list(range(count)) if order is None else list(order)
    series.positions = [origin + k * step * series.normal for k in order]
    planes = np.stack([values_at(series.points(position)) for position in series.positions])
    dataset = series.dataset(0)
    dataset.SOPClassUID, dataset.Modality, dataset.NumberOfFrames = NUCLEAR, "NM", count
    dataset.ImageType = ["ORIGINAL", "PRIMARY", kind, "EMISSION"]
    dataset.SpacingBetweenSlices, dataset.PixelData = step, planes.tobytes()
    dataset.SliceVector = [int(k) + 1 for k in order]
    detector = Dataset()
    if placed:
        detector.ImagePositionPatient, detector.ImageOrientationPatient = (
            origin.tolist(),
            list(orientation),
        )
    dataset.DetectorInformationSequence = [detector]
    del dataset.ImagePositionPatient, dataset.ImageOrientationPatient
    return dataset, planes[np.argsort(order)]


@pytest.mark.parametrize("step", [-3.5, 3.5, -0.8])
@pytest.mark.parametrize("seed", range(3))
def test_slices_of_nuclear_medicine_lie_where_the_sign_of_their_distance_says(tmp_path, step, seed):
    rng = np.random.default_rng(seed)
    order = rng.permutation(6) if seed else range(6)
    orientation = ((1, 0, 0, 0, 1, 0), (0, 1, 0, 0, 0, -1), (-1, 0, 0, 0, 0.6, 0.8))[seed]
    save(nuclear(6, step, order, orientation=orientation)[0], tmp_path / "nm.dcm")
    volume = io.read(tmp_path / "nm.dcm")
    assert volume.array.shape == (6, 5, 7) and volume.geometry.spacing[0] == pytest.approx(
        abs(step)
    )
    truth = world_of(volume) @ np.array([3.0, -5.0, 7.0])
    assert np.abs(volume.array - truth).max() <= 0.5 + 1e-6


@pytest.mark.parametrize("step", [-3.5, 3.5])
def test_without_a_place_the_sign_still_says_the_way(tmp_path, step):
    dataset, planes = nuclear(4, step, placed=False)
    save(dataset, tmp_path / "nm.dcm")
    with pytest.raises(InputError, match="do not say where they lie"):
        io.read(tmp_path / "nm.dcm")
    volume = io.read(tmp_path / "nm.dcm", options=ReadOptions(spacing=(1, 1, 3.5)))
    np.testing.assert_array_equal(volume.array, planes[:: 1 if step > 0 else -1])
    # Slice k, as the file counts, lies at k * step.
    for k in range(4):
        z = volume.geometry.world_to_index((0, 0, k * step))[0]
        np.testing.assert_array_equal(volume.array[round(z)], planes[k])


def packed(kind, values, path):
    """A slice of these values as JPEG 2000 or JPEG-LS."""
    dataset = Series(rows=values.shape[0], columns=values.shape[1]).stacked(1).dataset(0)
    if kind == "JPEG 2000":
        writer = sitk.ImageFileWriter()
        writer.SetFileName(str(path))
        writer.SetImageIO("GDCMImageIO")
        writer.UseCompressionOn()
        writer.SetCompressor("JPEG2000")
        writer.Execute(sitk.GetImageFromArray(values))
        made = pydicom.dcmread(path)
        content, dataset.file_meta.TransferSyntaxUID = (
            made.PixelData,
            made.file_meta.TransferSyntaxUID,
        )
    else:
        content = encapsulate([bytes(pytest.importorskip("jpeg_ls").encode_array(values))])
        dataset.file_meta.TransferSyntaxUID = JPEGLSLossless
    dataset.PixelData = content
    dataset["PixelData"].is_undefined_length = True
    bits = 8 * values.dtype.itemsize
    dataset.BitsAllocated = dataset.BitsStored = bits
    dataset.HighBit, dataset.PixelRepresentation = bits - 1, int(values.dtype.kind == "i")
    return dataset


@pytest.mark.parametrize("kind", ["JPEG 2000", "JPEG-LS"])
@pytest.mark.parametrize("sort", ["uint8", "uint16", "int16"])
def test_packed_values_are_whole_or_refused(tmp_path, kind, sort):
    """Bits and sign in the header, and the transfer syntax, against those of what is packed."""
    if (kind, sort) == ("JPEG-LS", "int16"):
        pytest.skip("it has no sign")
    low, high = {"uint8": (0, 250), "uint16": (0, 3000), "int16": (-500, 3000)}[sort]
    values = np.random.default_rng(7).integers(low, high, (20, 24)).astype(sort)
    bits, read = 8 * values.dtype.itemsize, []
    changes = [
        {},
        {"BitsStored": 8, "HighBit": 7},
        {"BitsStored": min(12, bits), "HighBit": min(12, bits) - 1},
        {"BitsAllocated": 24 - bits, "BitsStored": 24 - bits, "HighBit": 23 - bits},
        {"Rows": 19},
        {"Columns": 25},
        {"Rows": 24, "Columns": 20},
        # What was packed without a sign has the one of the header, by common practice.
        *([{"PixelRepresentation": 1 - int(sort == "int16")}] if sort != "uint8" else []),
        *(
            {"syntax": syntax}
            for syntax in (JPEG2000Lossless, JPEGLSLossless, JPEGBaseline8Bit, RLELossless)
        ),
    ]
    for number, change in enumerate(changes):
        dataset = packed(kind, values, tmp_path / "packed.dcm")
        for name, value in change.items():
            setattr(
                *(
                    (dataset.file_meta, "TransferSyntaxUID")
                    if name == "syntax"
                    else (dataset, name)
                ),
                value,
            )
        save(dataset, tmp_path / f"{number}" / "a.dcm")
        try:
            found = io.read(tmp_path / f"{number}")
        except InputError:
            continue
        np.testing.assert_array_equal(found.array[0], values)
        read.append(number)
    assert read[0] == 0 and 2 in read and not {4, 5, 6} & set(read)


@pytest.mark.parametrize("how", ["class", "modality", "tiled", "matrix"])
def test_tiles_and_projections_are_no_slices(tmp_path, how):
    dataset = Series().stacked(1).dataset(0)
    del dataset.ImagePositionPatient, dataset.ImageOrientationPatient
    dataset.NumberOfFrames, dataset.PixelData = 4, dataset.PixelData * 4
    if how == "class":
        dataset.SOPClassUID = WHOLE_SLIDE
    elif how == "modality":
        dataset.Modality = "SM"
    elif how == "tiled":
        dataset.DimensionOrganizationType = "TILED_FULL"
    else:
        dataset.TotalPixelMatrixRows, dataset.TotalPixelMatrixColumns = 10, 14
    path = save(dataset, tmp_path / "a.dcm") or tmp_path / "a.dcm"
    for given, options in ((path, ReadOptions(spacing=(1, 1, 1))), (tmp_path, ReadOptions())):
        with pytest.raises(InputError, match="1 whole-slide image"):
            io.read(given, options=options)
    save(nuclear(4, 3.0, placed=False, kind="TOMO")[0], path)
    with pytest.raises(InputError, match="1 projection of a tomograph"):
        io.read(path, options=ReadOptions(spacing=(1, 1, 1)))


def test_info_of_a_file_is_of_its_own_series(tmp_path, capsys):
    Series(changes={"SeriesNumber": 9, "SeriesDescription": "mine"}).stacked(4).write(
        tmp_path, list("abcd")
    )
    Series(uid="1.9", changes={"SeriesNumber": 1, "SeriesDescription": "other"}).stacked(3).write(
        tmp_path, list("xyz")
    )
    scout = (
        Series(uid="1.8", changes={"ImageType": ["ORIGINAL", "PRIMARY", "LOCALIZER"]})
        .stacked(1)
        .dataset(0)
    )
    save(scout, tmp_path / "scout")
    for name, mine, others in (("b", "mine", "other"), ("y", "other", "mine")):
        assert cli.execute(["info", str(tmp_path / name)]) == 0
        out = capsys.readouterr().out
        assert mine in out and others not in out
    assert cli.execute(["info", str(tmp_path / "scout")]) == 3
    assert "1 localizer (scout)" in capsys.readouterr().err
    assert cli.execute(["info", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "mine" in out and "other" in out
    check(io.read(tmp_path / "b"), (4, 5, 7))
