"""Series made here are read at the right place with the right values, or refused with the names of the files."""

import itertools
import warnings

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import GeometryError, InputError
from accelsurf.settings.reading import ReadOptions

pydicom = pytest.importorskip("pydicom")

from tests.support.dicom_series import (  # noqa: E402
    SECONDARY,
    Series,
    check,
    enhanced,
    packed_jpeg_ls,
    save,
    values_at,
    world_of,
)

ORDERS = [
    (row, column, way)
    for row, column in itertools.product(np.vstack([np.eye(3), -np.eye(3)]).tolist(), repeat=2)
    if abs(np.dot(row, column)) < 0.5
    for way in (1, -1)
]


@pytest.mark.sampled(9)
@pytest.mark.parametrize("order", range(len(ORDERS)))
def test_all_orders_of_axes_and_files(tmp_path, order):
    row, column, way = ORDERS[order]
    series = Series(orientation=(*row, *column)).stacked()
    series.positions = series.positions[::way]
    series.write(tmp_path / "scan")
    volume = io.read(tmp_path / "scan")
    check(volume, (4, 5, 7))
    assert volume.geometry.spacing == pytest.approx((2.0, 0.5, 0.75), abs=1e-9)
    assert np.linalg.det(volume.geometry.direction) == pytest.approx(1)
    assert len(ORDERS) == 48


def oblique(seed=3):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return (*q[:, 0], *q[:, 1])


def test_oblique_slices_in_mixed_order_without_suffix_in_folders(tmp_path):
    series = Series(orientation=oblique()).stacked(6, 1.25)
    series.positions = [series.positions[n] for n in (3, 0, 5, 1, 4, 2)]
    names = ["a/IM1", "a/b/IM2", "IM3", "c/IM4", "c/IM5", "IM6"]
    series.write(tmp_path / "scan", names)
    (tmp_path / "scan" / "readme.txt").write_text("not a slice")
    volume = io.read(tmp_path / "scan")
    assert volume.geometry.shape == (6, 5, 7) and volume.geometry.spacing == pytest.approx(
        (1.25, 0.5, 0.75)
    )
    truth = world_of(volume) @ np.array([3.0, -5.0, 7.0])
    assert np.abs(volume.array - truth).max() <= 0.5 + 1e-6
    assert io.headers.is_anatomical(volume.metadata) and volume.metadata["value_unit"] == "HU"


def test_one_file_stands_for_its_series(tmp_path):
    paths = Series().stacked().write(tmp_path / "scan")
    Series(uid="1.2.3.7").stacked(3, 1.0).write(tmp_path / "scan", ["x.dcm", "y.dcm", "z.dcm"])
    check(io.read(paths[2]), (4, 5, 7))


@pytest.mark.parametrize(
    ("break_it", "said"),
    [
        (lambda p: p.pop(2), "1 slice missing: 4 mm between 001.dcm, 002.dcm, 2 mm elsewhere"),
        (lambda p: p.append(p[1].copy()), "two images lie at one place: 001.dcm, 005.dcm"),
        (
            lambda p: p.__setitem__(4, p[4] + [0, 0, 0.7]),
            "distances of slices differ: 2.7 mm between 003.dcm, 004.dcm",
        ),
        (
            lambda p: [one.__iadd__([0, 0.25 * n, 0]) for n, one in enumerate(p)],
            "tilted by 7.13 degrees",
        ),
        (lambda p: p[2].__iadd__([0.3, 0, 0]), "shifted sideways, 002.dcm by 0.3 mm"),
    ],
    ids=["gap", "twice", "uneven", "tilt", "shift"],
)
def test_slices_on_no_grid_are_refused_with_their_names(tmp_path, break_it, said):
    series = Series().stacked(5)
    break_it(series.positions)
    series.write(tmp_path)
    with pytest.raises(GeometryError, match=f".*{said}") as caught:
        io.read(tmp_path)
    assert "dcm2niix" in caught.value.hint


def test_places_within_a_hundredth_of_a_millimetre_are_a_grid(tmp_path):
    series = Series().stacked(5)
    series.positions[2] = series.positions[2] + [0.004, 0, 0.004]
    series.write(tmp_path / "good")
    io.read(tmp_path / "good")
    series.positions[2] = series.positions[2] + [0, 0, 0.02]
    series.write(tmp_path / "bad")
    with pytest.raises(GeometryError, match="distances of slices differ"):
        io.read(tmp_path / "bad")


@pytest.mark.parametrize("what", ["size", "direction", "pixel"])
def test_a_slice_of_another_kind_is_named(tmp_path, what):
    series = Series().stacked(4)
    paths = series.write(tmp_path)
    other = {
        "size": Series(rows=6),
        "direction": Series(orientation=(1, 0, 0, 0, 0.8, 0.6)),
        "pixel": Series(spacing=(1, 1)),
    }[what].stacked(4)
    save(other.dataset(3), paths[3])
    with pytest.raises(GeometryError, match="003.dcm differ"):
        io.read(tmp_path)


def test_two_phases_are_two_volumes(tmp_path):
    first = Series(changes={"AcquisitionNumber": 1}).stacked()
    second = Series(changes={"AcquisitionNumber": 2}).stacked()
    first.write(tmp_path, [f"a{n}" for n in range(4)])
    second.write(tmp_path, [f"b{n}" for n in range(4)])
    with pytest.raises(
        InputError, match=r"2 volumes are in it: 1 CT phantom \(acquisition 1\), 4 slices; 2 "
    ):
        io.read(tmp_path)
    check(io.read(tmp_path, options=ReadOptions(series="2")), (4, 5, 7))
    with pytest.raises(InputError, match="has 2 volumes, numbers 1, 2"):
        io.read(tmp_path, options=ReadOptions(series="1.2.3.4.5"))


def test_a_number_that_differs_from_slice_to_slice_is_no_phase(tmp_path):
    series = Series().stacked()
    for number in range(4):
        one = series.dataset(number)
        one.AcquisitionNumber = number
        save(one, tmp_path / f"{number}")
    check(io.read(tmp_path), (4, 5, 7))


def test_of_several_series_one_is_chosen(tmp_path):
    Series().stacked().write(tmp_path / "a")
    thin = Series(uid="1.2.3.8", changes={"SeriesNumber": 1, "SeriesDescription": "thin"})
    thin.stacked(3, 1.0).write(tmp_path / "b")
    with pytest.raises(
        InputError, match="2 volumes are in it: 1 CT thin, 3 slices; 2 CT phantom, 4 slices"
    ):
        io.read(tmp_path)
    check(io.read(tmp_path, options=ReadOptions(series="1")), (3, 5, 7))
    check(io.read(tmp_path, options=ReadOptions(series="1.2.3.4.5")), (4, 5, 7))
    with pytest.raises(InputError, match="series 9 is not in it"):
        io.read(tmp_path, options=ReadOptions(series="9"))


def test_what_is_no_volume_is_left_out_and_said(tmp_path):
    Series().stacked().write(tmp_path)
    save(
        Series(uid="1.5", changes={"ImageType": ["ORIGINAL", "PRIMARY", "LOCALIZER"]})
        .stacked(1)
        .dataset(0),
        tmp_path / "scout",
    )
    capture = Series(uid="1.6", changes={"SOPClassUID": SECONDARY}).stacked(1).dataset(0)
    del capture.ImagePositionPatient, capture.ImageOrientationPatient
    save(capture, tmp_path / "capture")
    report = Series(uid="1.7", changes={"Modality": "SR"}).stacked(1).dataset(0)
    del report.Rows, report.Columns, report.PixelData
    save(report, tmp_path / "report")
    (tmp_path / "broken.dcm").write_bytes((tmp_path / "000.dcm").read_bytes()[:200])
    volume = io.read(tmp_path)
    check(volume, (4, 5, 7))
    said = volume.metadata["warning"]
    for part in (
        "1 localizer (scout)",
        "1 picture without a place (capture)",
        "1 report (report)",
        "broken.dcm: ",
    ):
        assert part in said


def test_series_without_a_uid(tmp_path):
    Series(uid="").stacked().write(tmp_path)
    check(io.read(tmp_path), (4, 5, 7))


def test_slices_scaled_one_by_one(tmp_path):
    series = Series().stacked()
    for number, slope in enumerate((0.5, 2.0, 0.25, 1.0)):
        one = series.dataset(number)
        truth = values_at(series.points(series.positions[number]))
        one.RescaleSlope, one.RescaleIntercept = slope, 10.5
        one.PixelData = np.rint((truth - 10.5) / slope).astype(np.int16).tobytes()
        save(one, tmp_path / f"{number}.dcm")
    volume = io.read(tmp_path)
    assert volume.array.dtype == np.float32
    assert np.abs(volume.array - values_at(np.round(world_of(volume), 6))).max() <= 1.0


def test_offsets_keep_whole_numbers(tmp_path):
    series = Series().stacked()
    for number in range(4):
        one = series.dataset(number)
        truth = values_at(series.points(series.positions[number]))
        one.RescaleSlope, one.RescaleIntercept, one.PixelRepresentation = 1, -1024, 0
        one.PixelData = (truth.astype(np.int32) + 1024).astype(np.uint16).tobytes()
        save(one, tmp_path / f"{number}.dcm")
    volume = io.read(tmp_path)
    check(volume)
    assert volume.array.dtype == np.int16


def test_compressed_slices(tmp_path):
    pytest.importorskip("jpeg_ls")
    series = Series(rows=24, columns=20).stacked()
    for number in range(4):
        save(packed_jpeg_ls(series.dataset(number)), tmp_path / f"{number}.dcm")
    check(io.read(tmp_path), (4, 24, 20))
    rle = Series(rows=24, columns=20).stacked()
    for number in range(4):
        one = rle.dataset(number)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            one.compress(pydicom.uid.RLELossless)
        save(one, tmp_path / "rle" / f"{number}.dcm")
    check(io.read(tmp_path / "rle"), (4, 24, 20))


@pytest.mark.parametrize("slopes", [None, (1.0, 2.0, 0.5, 4.0)])
def test_an_enhanced_file_has_its_frames_in_any_order(tmp_path, slopes):
    series = Series(orientation=(0, 1, 0, 0, 0, -1)).stacked()
    series.positions = [series.positions[n] for n in (2, 0, 3, 1)]
    save(enhanced(series, slopes), tmp_path / "all.dcm")
    volume = io.read(tmp_path / "all.dcm")
    assert volume.array.shape == (4, 5, 7)
    off = np.abs(volume.array - values_at(np.round(world_of(volume), 6))).max()
    assert off == 0 if slopes is None else off <= 2.0


def test_links_out_of_the_folder_are_not_followed(tmp_path):
    Series().stacked(5).write(tmp_path / "elsewhere")
    Series().stacked(4).write(tmp_path / "scan")
    (tmp_path / "scan" / "link.dcm").symlink_to(tmp_path / "elsewhere" / "004.dcm")
    (tmp_path / "scan" / "more").symlink_to(tmp_path / "elsewhere")
    check(io.read(tmp_path / "scan"), (4, 5, 7))


def test_nothing_but_other_objects_is_refused_by_name(tmp_path):
    report = Series(changes={"Modality": "SR"}).stacked(1).dataset(0)
    del report.Rows, report.Columns, report.PixelData
    save(report, tmp_path / "report.dcm")
    with pytest.raises(InputError, match=r"it has no 3D image, but 1 report \(report.dcm\)"):
        io.read(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "notes.txt").write_text("x")
    with pytest.raises(InputError, match="this is a folder, an image file expected"):
        io.read(tmp_path / "empty")


def test_pictures_without_a_place_need_a_spacing(tmp_path):
    one = enhanced(Series().stacked())
    del one.PerFrameFunctionalGroupsSequence, one.SharedFunctionalGroupsSequence
    save(one, tmp_path / "cine.dcm")
    with pytest.raises(GeometryError, match="4 of 4 slices do not say where they lie"):
        io.read(tmp_path / "cine.dcm")
    volume = io.read(tmp_path / "cine.dcm", options=ReadOptions(spacing=(0.5, 0.6, 3.0)))
    assert volume.geometry.spacing == (3.0, 0.6, 0.5) and volume.array.shape == (4, 5, 7)
    Series().stacked().write(tmp_path / "placed")
    with pytest.raises(InputError, match="the files say where each slice lies"):
        io.read(tmp_path / "placed", options=ReadOptions(spacing=(1, 1, 1)))


@pytest.mark.parametrize("kind", ["rows", "frames", "pixels", "deep", "scale", "position"])
def test_hostile_headers_end_in_one_line(tmp_path, kind):
    series = Series().stacked(2)
    one = series.dataset(0)
    if kind == "rows":
        one.Rows = one.Columns = 65535
    elif kind == "frames":
        one.NumberOfFrames = 2_000_000_000
    elif kind == "pixels":
        one.PixelData = one.PixelData[:10]
    elif kind == "scale":
        one.RescaleSlope = 0
    elif kind == "position":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            one.ImagePositionPatient = ["nan", "1", "2"]
    else:
        inner = pydicom.Dataset()
        for _ in range(150):
            outer = pydicom.Dataset()
            outer.ReferencedSeriesSequence = [inner]
            inner = outer
        one.SharedFunctionalGroupsSequence = [inner]
    save(one, tmp_path / "a.dcm")
    if kind == "deep":
        io.read(tmp_path / "a.dcm")
        return
    if kind == "position":
        save(series.dataset(1), tmp_path / "b.dcm")
    with pytest.raises((InputError, GeometryError)):
        io.read(tmp_path / "a.dcm")
