"""Headers of NRRD and MetaImage that are damaged, point to other files, or give other units than mm."""

import re
import zlib

import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import io
from accelsurf.errors import GeometryError
from accelsurf.image.volume import Volume
from accelsurf.io.itk import volume_of
from tests.support.text_headers import VALUES, refuse, text_header


@pytest.fixture(autouse=True)
def silence(capfd):
    """No C++ library speaks to the user past us."""
    yield
    assert capfd.readouterr() == ("", "")


# ------------------------------------------------------------------------------------------------------- NRRD


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"spacings": "0 1 1"}, r"spacing \(hz, hy, hx\) = .* three positive numbers"),
        ({"spacings": "-1 1 1"}, r"spacing \(hz, hy, hx\) = .* three positive numbers"),
        ({"spacings": "nan 1 1"}, "finite numbers"),
        (
            {
                "spacings": None,
                "space": "left-posterior-superior",
                "space_directions": "(0,0,0) (0,1,0) (0,0,1)",
            },
            r"spacing \(hz, hy, hx\) = .* three positive numbers",
        ),
        ({"space": "left-posterior-superior"}, "space directions None"),
        ({"space": "upwards", "space_directions": "(1,0,0) (0,1,0) (0,0,1)"}, "'upwards'"),
    ],
)
def test_nrrd_axes(tmp_path, changes, words):
    (tmp_path / "a.nrrd").write_bytes(text_header(".nrrd", **changes) + VALUES.tobytes())
    refuse(tmp_path / "a.nrrd", words, GeometryError)


@pytest.mark.parametrize(
    "changes",
    [
        {"type": "block"},
        {"type": None},
        {"sizes": "6 5"},
        {"dimension": str(10**15)},
        {"sizes": "6 0 4"},
        {"sizes": "6 x 4"},
        {"encoding": None},
        {"spacings": "1 1"},
        {"spacings": "1_0 1 1"},
        {"spacings": "\u0661 1 1"},
        {"byte_skip": "1_0"},
        {"spacings": None, "spacinfs": "1 2 3"},
        {"space_directions": "(1,0,0) (0,1,0)"},
    ],
)
def test_nrrd_damaged_header(tmp_path, changes):
    (tmp_path / "a.nrrd").write_bytes(text_header(".nrrd", **changes) + VALUES.tobytes())
    refuse(tmp_path / "a.nrrd", "the NRRD header is damaged")


def test_nrrd_with_voxels_in_another_file(tmp_path):
    for key in ("data_file", "datafile"):
        (tmp_path / "a.nrrd").write_bytes(text_header(".nrrd", **{key: "a.raw"}))
        (tmp_path / "a.raw").unlink(missing_ok=True)
        refuse(tmp_path / "a.nrrd", r"names the data file a\.raw, which is missing")
        (tmp_path / "a.raw").write_bytes(VALUES.tobytes()[:-1])
        refuse(tmp_path / "a.nrrd", "announces 240 bytes of voxels, the file holds 239")
        (tmp_path / "a.raw").write_bytes(VALUES.tobytes())
        np.testing.assert_array_equal(io.read(tmp_path / "a.nrrd").array, VALUES)


@pytest.mark.parametrize(
    ("suffix", "name", "said"),
    [
        (".nrrd", "LIST", "spread over several files"),
        (".nrrd", "LIST 2D", "spread over several files"),
        (".nrrd", "a%03d.raw 1 4 1", "spread over several files"),
        (".mha", "a%03d.raw 1 4 1", "spread over several files"),
        (".mha", "LIST", "the list has 0 files, 4 expected"),
        (".mha", "LIST 2D", "the list has 0 files, 4 expected"),
    ],
)
def test_voxels_in_many_files_that_are_not_there_are_refused(tmp_path, suffix, name, said):
    key = {".nrrd": "data_file", ".mha": "ElementDataFile"}[suffix]
    (tmp_path / f"a{suffix}").write_bytes(text_header(suffix, **{key: name}))
    refuse(tmp_path / f"a{suffix}", said)


@pytest.mark.parametrize("encoding", ["ascii", "text", "hex", "bzip2"])
def test_nrrd_as_text(tmp_path, encoding):
    head = text_header(".nrrd", encoding=encoding)
    (tmp_path / "a.nrrd").write_bytes(head + " ".join(map(str, VALUES.ravel())).encode())
    refuse(tmp_path / "a.nrrd", f"encoding {encoding} given, raw or gzip expected")


def test_nrrd_with_bytes_to_skip(tmp_path):
    (tmp_path / "a.nrrd").write_bytes(
        text_header(".nrrd", byte_skip="7") + b"skipped" + VALUES.tobytes()
    )
    np.testing.assert_array_equal(io.read(tmp_path / "a.nrrd").array, VALUES)
    (tmp_path / "a.nrrd").write_bytes(text_header(".nrrd", byte_skip="7") + VALUES.tobytes())
    refuse(tmp_path / "a.nrrd", "announces 240 bytes of voxels, the file holds 233")
    (tmp_path / "a.nrrd").write_bytes(
        text_header(".nrrd", byte_skip="-1") + b"any" + VALUES.tobytes()
    )
    np.testing.assert_array_equal(io.read(tmp_path / "a.nrrd").array, VALUES)


@pytest.mark.parametrize("key", ["space_units", "units"])
def test_nrrd_units(tmp_path, key):
    """ITK takes any unit for mm."""
    place = {
        "spacings": None,
        "space": "left-posterior-superior",
        "space directions": "(1,0,0) (0,2,0) (0,0,3)",
    }
    place = place if key == "space_units" else {}
    for unit, good in (("mm", True), ("um", False), ("microns", False)):
        head = text_header(".nrrd", **place, **{key: f'"{unit}" "{unit}" "{unit}"'})
        (tmp_path / "a.nrrd").write_bytes(head + VALUES.tobytes())
        if good:
            assert io.read(tmp_path / "a.nrrd").geometry.spacing == (3, 2, 1)
        else:
            refuse(tmp_path / "a.nrrd", f"lengths in {unit}, mm expected")


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
@pytest.mark.parametrize("seed", range(6))
def test_a_grid_is_where_itk_places_it(tmp_path, suffix, seed):
    draw = np.random.default_rng(seed)
    image = sitk.GetImageFromArray(VALUES)
    image.SetSpacing(draw.uniform(0.2, 3.0, 3).tolist())
    image.SetOrigin(draw.normal(size=3).tolist())
    image.SetDirection(np.linalg.qr(draw.normal(size=(3, 3)))[0].ravel().tolist())
    path = tmp_path / f"a{suffix}"
    sitk.WriteImage(image, str(path), useCompression=bool(seed % 2))
    if suffix == ".nrrd":
        space = draw.choice(["left-anterior-superior", "RAS", "3D-right-handed", "scanner-xyz"])
        content = path.read_bytes().replace(
            b"space: left-posterior-superior", f"space: {space}".encode()
        )
        path.write_bytes(content)
    found, other = io.read(path), sitk.ReadImage(str(path))
    np.testing.assert_array_equal(found.array, sitk.GetArrayFromImage(other))
    assert found.geometry.matches(volume_of(other).geometry, 1e-9)


def test_a_space_with_time_has_the_axes_of_its_patient(tmp_path):
    """ITK takes those of right-anterior-superior-time for LPS: left and right would be exchanged."""
    place = {
        "dimension": "4",
        "sizes": "6 5 4 1",
        "spacings": None,
        "space": "right-anterior-superior-time",
        "space_directions": "(1,0,0,0) (0,2,0,0) (0,0,3,0) (0,0,0,5)",
        "space_origin": "(7,8,9,0)",
    }
    (tmp_path / "a.nrrd").write_bytes(text_header(".nrrd", **place) + VALUES.tobytes())
    found = io.read(tmp_path / "a.nrrd").geometry
    assert found.origin == (-7.0, -8.0, 9.0) and np.diag(found.direction).tolist() == [-1, -1, 1]


@pytest.mark.parametrize("center", ["cell", "node"])
def test_nrrd_placed_by_axis_mins(tmp_path, center):
    head = text_header(".nrrd", axis_mins="5 6 7", centerings=" ".join([center] * 3))
    (tmp_path / "a.nrrd").write_bytes(head + VALUES.tobytes())
    other = volume_of(sitk.ReadImage(str(tmp_path / "a.nrrd"))).geometry
    assert io.read(tmp_path / "a.nrrd").geometry.matches(other)


def test_nrrd_keys_of_others_are_no_fields(tmp_path):
    head = text_header(".nrrd").replace(b"spacings: 1 2 3\n", b"spacings:=9 9 9\nsizes:=1 1 1\n")
    (tmp_path / "a.nrrd").write_bytes(head + VALUES.tobytes())
    found = io.read(tmp_path / "a.nrrd")
    np.testing.assert_array_equal(found.array, VALUES)
    assert found.geometry.spacing == (1.0, 1.0, 1.0)


# -------------------------------------------------------------------------------------------------- MetaImage


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ElementSpacing": "0 1 1"}, r"spacing \(hz, hy, hx\) = .* three positive numbers"),
        ({"ElementSpacing": "-1 1 1"}, r"spacing \(hz, hy, hx\) = .* three positive numbers"),
        ({"ElementSpacing": "nan 1 1"}, "ElementSpacing = nan 1 1, finite numbers"),
        ({"Offset": "x 0 0"}, "Offset = x 0 0, finite numbers"),
        ({"Offset": "1_0 0 0"}, "Offset = 1_0 0 0, finite numbers"),
        ({"ElementSpacing": "1 1"}, "ElementSpacing = 1 1, 3 finite numbers"),
        ({"Offset": "1 2"}, "Offset = 1 2, 3 finite numbers"),
        ({"TransformMatrix": "1 0 0 0 1 0"}, "TransformMatrix = .*, 9 finite numbers"),
    ],
)
def test_metaimage_axes(tmp_path, changes, words):
    (tmp_path / "a.mha").write_bytes(text_header(".mha", **changes) + VALUES.tobytes())
    refuse(tmp_path / "a.mha", words, GeometryError)


def test_metaimage_singular_matrix(tmp_path):
    head = text_header(".mha", TransformMatrix="1 0 0 0 0 0 0 0 1")
    (tmp_path / "a.mha").write_bytes(head + VALUES.tobytes())
    refuse(tmp_path / "a.mha", "not orthonormal", GeometryError)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ElementType": "MET_NONSENSE"}, "MetaImage header is damaged"),
        ({"ElementType": None}, "MetaImage header is damaged"),
        ({"DimSize": "6 5"}, "MetaImage header is damaged"),
        ({"DimSize": "6 5 0"}, "MetaImage header is damaged"),
        ({"DimSize": "6.5 5 4"}, "MetaImage header is damaged"),
        ({"DimSize": "6 5 4 1"}, "MetaImage header is damaged"),
        ({"NDims": None}, "NDims is missing"),
        ({"ElementByteOrderMSB": "True"}, "two values for BinaryDataByteOrderMSB"),
        ({"BinaryDataByteOrderMSB": ""}, "no value for BinaryDataByteOrderMSB"),
        ({"DistanceUnits": "um"}, "lengths in um, mm expected"),
        ({"CompressedData": "True", "HeaderSize": "3"}, "packed voxels with a HeaderSize"),
        ({"CompressedData": "True", "CompressedDataSize": "20"}, "damaged|end before"),
    ],
)
def test_metaimage_damaged_header(tmp_path, changes, words):
    (tmp_path / "a.mha").write_bytes(
        text_header(".mha", **changes) + zlib.compress(VALUES.tobytes())
    )
    refuse(tmp_path / "a.mha", words)


@pytest.mark.parametrize("seed", range(4))
def test_metaimage_lines_count_in_any_order(tmp_path, seed):
    lines = text_header(".mha").decode().splitlines(keepends=True)
    mixed = np.random.default_rng(seed).permutation(lines[:-1]).tolist() + lines[-1:]
    (tmp_path / "a.mha").write_bytes("".join(mixed).encode() + VALUES.tobytes())
    found = io.read(tmp_path / "a.mha")
    np.testing.assert_array_equal(found.array, VALUES)
    assert found.geometry.spacing == (3.0, 2.0, 1.0)


def test_metaimage_without_its_data_file(tmp_path):
    io.write(Volume.from_array(VALUES), tmp_path / "a.mhd")
    (tmp_path / "a.zraw").rename(tmp_path / "b.zraw")
    refuse(tmp_path / "a.mhd", r"names the data file a\.zraw, which is missing")


def test_metaimage_data_file_with_a_header_of_its_own(tmp_path):
    for size, before in (("16", b"x" * 16), ("-1", b"any length")):
        (tmp_path / "a.mhd").write_bytes(
            text_header(".mha", HeaderSize=size, ElementDataFile="a.raw")
        )
        (tmp_path / "a.raw").write_bytes(before + VALUES.tobytes())
        np.testing.assert_array_equal(io.read(tmp_path / "a.mhd").array, VALUES)
    (tmp_path / "a.raw").write_bytes(VALUES.tobytes()[:-1])
    refuse(tmp_path / "a.mhd", "announces 240 bytes of voxels, the file holds 239")


def test_metaimage_compressed_by_others_without_a_size(tmp_path):
    """In a file of their own ITK finds the length of the voxels, so this is read."""
    io.write(Volume.from_array(VALUES), tmp_path / "a.mhd")
    text = (tmp_path / "a.mhd").read_text()
    (tmp_path / "a.mhd").write_text(re.sub("CompressedDataSize.*\n", "", text))
    np.testing.assert_array_equal(io.read(tmp_path / "a.mhd").array, VALUES)


def test_metaimage_written_as_mhd_names_its_voxels_by_their_final_name(tmp_path):
    io.write(Volume.from_array(VALUES), tmp_path / "head.v2.mhd")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["head.v2.mhd", "head.v2.zraw"]
    assert "ElementDataFile = head.v2.zraw\n" in (tmp_path / "head.v2.mhd").read_text()
