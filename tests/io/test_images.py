import hashlib
import os
import re
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import io
from accelsurf.errors import GeometryError, InputError, OutputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.format_functions import FORMAT_FUNCTIONS
from accelsurf.io.formats import raw_header
from accelsurf.io.formats.deflate import gzip_writer
from accelsurf.settings.file_formats import image_format, written_suffixes
from tests.support.folders import contents

#: Formats that keep the whole grid; tests/io/test_raster.py is about the others.
VOLUMES = [suffix for suffix in written_suffixes() if image_format(suffix).keeps == "all"]
DTYPES = ["uint8", "int16", "uint16", "int32", "float32", "float64"]


def oblique(seed=0, left_handed=False):
    rng = np.random.default_rng(seed)
    direction, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return direction * np.sign(np.linalg.det(direction)) * (-1 if left_handed else 1)


GRIDS = {
    "aligned": Geometry((5, 6, 7), (1.0, 1.0, 1.0)),
    "anisotropic": Geometry((5, 6, 7), (3.0, 0.5, 0.75), (-12.5, 4.0, 100.25)),
    "oblique": Geometry((5, 6, 7), (2.4, 0.81, 1 / 3), (-69.02, 134.4, -13.57), oblique()),
    "left-handed": Geometry(
        (5, 6, 7), (2.4, 0.81, 1 / 3), (-69.02, 134.4, -13.57), oblique(1, left_handed=True)
    ),
    "one slice": Geometry((1, 6, 7), (2.4, 0.81, 1 / 3), (1.0, 2.0, 3.0), oblique(2)),
}


def make(grid="oblique", dtype="int16", seed=0):
    values = np.random.default_rng(seed).integers(0, 200, GRIDS[grid].shape)
    return Volume(values.astype(dtype), GRIDS[grid])


def refuse(path, words, family=InputError, **options):
    """The error is one line that starts with the path, has a hint, and says what is expected."""
    with pytest.raises(family, match=words) as caught:
        io.read(path, **options)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value) and caught.value.hint
    assert caught.value.exit_code == 3
    return caught.value


# ------------------------------------------------------------------------------------------------- round trip


@pytest.mark.sampled
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("suffix", VOLUMES)
def test_round_trip(tmp_path, suffix, grid, dtype):
    volume = make(grid, dtype)
    path = tmp_path / f"a{suffix}"
    io.write(volume, path)
    back = io.read(path)
    assert back.array.dtype == volume.array.dtype and back.source == path
    np.testing.assert_array_equal(back.array, volume.array)
    assert back.geometry.matches(volume.geometry, tolerance_mm=1e-4)
    # what was read once is given back to the last bit
    io.write(back, tmp_path / f"b{suffix}")
    again = io.read(tmp_path / f"b{suffix}")
    assert again.geometry.spacing == back.geometry.spacing
    assert again.geometry.origin == back.geometry.origin
    np.testing.assert_array_equal(again.geometry.direction, back.geometry.direction)


@pytest.mark.parametrize(
    "suffix", [suffix for suffix in VOLUMES if not image_format(suffix).folder_marks]
)
def test_others_read_the_same_from_our_files(tmp_path, suffix):
    volume = make()
    io.write(volume, tmp_path / f"a{suffix}")
    image = sitk.ReadImage(str(tmp_path / f"a{suffix}"))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), volume.array)
    ours = io.read(tmp_path / f"a{suffix}").geometry
    assert image.GetSize() == ours.size and image.GetSpacing() == ours.spacing_xyz
    point = image.TransformContinuousIndexToPhysicalPoint((1.5, 2.5, 3.5))
    np.testing.assert_allclose(ours.index_to_world((3.5, 2.5, 1.5)), point, atol=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize("source", VOLUMES)
@pytest.mark.parametrize("target", VOLUMES)
def test_from_any_format_to_any_other(tmp_path, source, target):
    io.write(make(), tmp_path / f"a{source}")
    volume = io.read(tmp_path / f"a{source}")
    io.write_labels(volume.with_array(volume.array > 100), tmp_path / f"b{target}")
    labels = io.read_labels(tmp_path / f"b{target}")
    assert labels.geometry.matches(volume.geometry)
    np.testing.assert_array_equal(labels.array, volume.array > 100)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("dtype", "stored"),
    [(bool, "uint8"), ("f2", "float32"), (">i2", "int16"), ("i8", "int64"), ("i1", "int8")],
)
@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_types_that_formats_lack_are_converted(tmp_path, suffix, dtype, stored):
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    io.write(Volume.from_array(array), tmp_path / f"a{suffix}")
    back = io.read(tmp_path / f"a{suffix}").array
    assert back.dtype == stored
    np.testing.assert_array_equal(back, array.astype(stored))


def test_suffixes_in_capitals_are_understood(tmp_path):
    volume = make()
    for name in ("A.NII", "A.NII.GZ", "A.NRRD", "A.MHA", "A.MHD"):
        io.write(volume, tmp_path / name)
        np.testing.assert_array_equal(io.read(tmp_path / name).array, volume.array)


def test_the_same_volume_gives_the_same_bytes(tmp_path):
    def written():
        for suffix in VOLUMES:
            io.write(make(), tmp_path / f"a{suffix}")
        return contents(tmp_path)

    first = written()
    time.sleep(1.1)  # a date in a header counts seconds
    assert written() == first and len({name.partition("/")[0] for name in first}) == 8


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha", ".mhd"])
def test_files_are_compressed(tmp_path, suffix):
    io.write(Volume.from_array(np.zeros((50, 50, 50), np.uint8)), tmp_path / f"a{suffix}")
    assert sum(f.stat().st_size for f in tmp_path.iterdir()) < 3000


def test_nrrd_in_another_space_is_given_back_in_it(tmp_path):
    io.write(make(), tmp_path / "a.nrrd")
    head, gap, voxels = (tmp_path / "a.nrrd").read_bytes().partition(b"\n\n")
    ras = head.replace(b"left-posterior-superior", b"right-anterior-superior")
    (tmp_path / "ras.nrrd").write_bytes(ras + gap + voxels)
    volume = io.read(tmp_path / "ras.nrrd")
    np.testing.assert_allclose(
        volume.geometry.origin, np.array([-1, -1, 1]) * GRIDS["oblique"].origin
    )
    io.write(volume, tmp_path / "b.nrrd")
    placing = [line for line in ras.splitlines() if line.startswith(b"space")]
    written = (tmp_path / "b.nrrd").read_bytes().partition(b"\n\n")[0].splitlines()
    assert len(placing) == 3 and [line for line in written if line.startswith(b"space")] == placing


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd"])
def test_header_fields_of_another_grid_are_not_used(tmp_path, suffix):
    io.write(make(), tmp_path / f"a{suffix}")
    read = io.read(tmp_path / f"a{suffix}")
    moved = Volume(read.array, GRIDS["anisotropic"], read.metadata)
    io.write(moved, tmp_path / f"b{suffix}")
    assert io.read(tmp_path / f"b{suffix}").geometry.matches(moved.geometry)
    assert sorted(f.name for f in tmp_path.iterdir()) == [f"a{suffix}", f"b{suffix}"]


# ----------------------------------------------------------------------------------------------------- labels


@pytest.mark.parametrize(
    ("top", "stored"), [(1, "uint8"), (255, "uint8"), (256, "uint16"), (65536, "uint32")]
)
@pytest.mark.parametrize("dtype", ["int32", "float64"])
def test_labels_are_written_in_the_smallest_type(tmp_path, dtype, top, stored):
    array = np.zeros((2, 3, 4), dtype)
    array[1] = top
    io.write_labels(Volume.from_array(array), tmp_path / "a.nii.gz")
    assert io.read(tmp_path / "a.nii.gz").array.dtype == stored
    np.testing.assert_array_equal(io.read_labels(tmp_path / "a.nii.gz").array, array)


@pytest.mark.parametrize("value", [-1, 2**32, 0.5])
def test_labels_that_do_not_fit_are_refused(tmp_path, value):
    with pytest.raises(InputError, match="labels"):
        io.write_labels(Volume.from_array(np.full((2, 3, 4), value)), tmp_path / "a.nii.gz")
    assert not list(tmp_path.iterdir())


def test_labels_stored_as_floats_are_read_as_integers(tmp_path):
    io.write(Volume.from_array(np.full((2, 3, 4), 7.0)), tmp_path / "a.mha")
    labels = io.read_labels(tmp_path / "a.mha")
    assert labels.array.dtype == np.int32 and labels.source == tmp_path / "a.mha"
    assert (labels.array == 7).all()


@pytest.mark.parametrize("value", [0.5, 3.99, 2.0**53 + 2])
def test_labels_that_are_not_whole_are_refused(tmp_path, value):
    array = np.zeros((2, 3, 4))
    array[1, 1, 1] = value
    io.write(Volume.from_array(array), tmp_path / "a.mha")
    with pytest.raises(
        InputError, match=r"a\.mha: labels must be whole numbers, 1 voxel is .* not: the"
    ) as caught:
        io.read_labels(tmp_path / "a.mha")
    assert "nearest" in caught.value.hint


# -------------------------------------------------------------------------------------------------- bad input


def test_missing_file(tmp_path):
    refuse(tmp_path / "none.nii.gz", "no such file")


def test_folder_instead_of_a_file(tmp_path):
    (tmp_path / "a.nii").mkdir()
    refuse(tmp_path / "a.nii", "folder")


@pytest.mark.parametrize("name", ["a.jpg", "a.gz", "a", ".nii", "a.nii.bz2"])
def test_unknown_suffix(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    known = ".nii.gz, .nii, .hdr, .hdr.gz, "
    known += ".nrrd, .nhdr, .mha, .mhd, .ome.zarr, .zarr, .png, .tif, .tiff, .dcm, .ima, .mgz"
    known += ", .mgh, .npy"
    refuse(tmp_path / name, re.escape(f"unknown file type, one of {known} expected"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_file_without_permission(tmp_path):
    io.write(make(), tmp_path / "a.mha")
    (tmp_path / "a.mha").chmod(0)
    refuse(tmp_path / "a.mha", "Permission denied")


def write_sitk(image, path):
    sitk.WriteImage(image, str(path))
    return path


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_other_sorts_of_images_are_named_with_the_way_out(tmp_path, suffix, capfd):
    image = sitk.GetImageFromArray(np.arange(60, dtype=np.float32).reshape(3, 4, 5))
    byte = sitk.Cast(image, sitk.sitkUInt8)
    cases = [
        (sitk.JoinSeries([image, image]), "sequence of 2 time points", "--time-index 0 to 1"),
        (sitk.Compose(image, image), "vector|2 channels", "channel"),
        (sitk.Compose(byte, byte, byte), "vector|3 channels", "channel"),
        (image[:, :, 0], "2D image", "slice"),
    ]
    if suffix != ".mha":  # a complex MetaImage is a vector of two to every reader
        cases.append((sitk.RealAndImaginaryToComplex(image, image), "complex", "magnitude"))
    for number, (other, words, way_out) in enumerate(cases):
        error = refuse(write_sitk(other, tmp_path / f"{number}{suffix}"), words)
        assert way_out in error.hint
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_colour_is_named(tmp_path, suffix):
    byte = sitk.GetImageFromArray(np.arange(60, dtype=np.uint8).reshape(3, 4, 5))
    refuse(write_sitk(sitk.Compose(byte, byte, byte), tmp_path / f"a{suffix}"), r"3 channels")


@pytest.mark.parametrize("suffix", [".nii", ".nrrd", ".mha"])
def test_a_fourth_axis_of_one_is_dropped(tmp_path, suffix):
    image = sitk.GetImageFromArray(np.arange(60, dtype=np.int16).reshape(3, 4, 5))
    image.SetSpacing((1, 2, 3))
    volume = io.read(write_sitk(sitk.JoinSeries([image]), tmp_path / f"a{suffix}"))
    assert volume.array.shape == (3, 4, 5) and volume.geometry.spacing == (3, 2, 1)


@pytest.mark.parametrize("suffix", VOLUMES)
def test_an_image_larger_than_memory_is_refused_with_the_estimate(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    io.write(make(dtype="int16"), path)
    needed = 5 * 6 * 7 * (2 + 12)
    io.read(path, memory_bytes=needed)
    refuse(
        path,
        r"7 x 6 x 5 voxels needs about 0\.00 GiB of memory, 0\.00 GiB are available",
        memory_bytes=needed - 1,
    )


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_a_huge_image_is_refused_before_anything_is_allocated(tmp_path, suffix):
    """The header claims 27 terabytes; nothing but the header is there."""
    path = huge(tmp_path, suffix)
    refuse(path, r"the header announces .*54000000000\d{3}")


def huge(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    text = {
        ".nrrd": "NRRD0004\ntype: short\ndimension: 3\nsizes: 30000 30000 30000\nencoding: raw\nendian: little\n\n",
        ".mha": "ObjectType = Image\nNDims = 3\nBinaryData = True\nDimSize = 30000 30000 30000\n"
        "ElementType = MET_SHORT\nElementDataFile = LOCAL\n",
    }
    if suffix in text:
        path.write_text(text[suffix])
        return path
    io.write(make(), tmp_path / "small.nii")
    raw = bytearray((tmp_path / "small.nii").read_bytes()[:352])
    struct.pack_into("<8h", raw, 40, 3, 30000, 30000, 30000, 1, 1, 1, 1)
    (tmp_path / "a.nii").write_bytes(raw)
    if suffix == ".nii.gz":
        with gzip_writer(path) as out:
            out.write((tmp_path / "a.nii").read_bytes())
    return path


def test_available_memory_is_that_of_this_machine():
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert 2**20 < io.available_memory() <= physical


def test_memory_that_runs_out_all_the_same(tmp_path, monkeypatch):
    io.write(make(), tmp_path / "a.mha")

    def fail(*size):
        raise MemoryError

    monkeypatch.setattr(raw_header.np, "empty", fail)
    with pytest.raises(InputError, match="does not fit into memory"):
        io.read(tmp_path / "a.mha", memory_bytes=10**9)


def test_itk_warnings_are_off_only_while_reading(tmp_path):
    io.write(make(), tmp_path / "a.nii")
    assert sitk.ProcessObject.GetGlobalWarningDisplay()
    io.read(tmp_path / "a.nii")
    assert sitk.ProcessObject.GetGlobalWarningDisplay()


# ------------------------------------------------------------------------------------------------ bad output


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.nii.bz2"])
def test_writing_an_unknown_type_is_a_usage_error(tmp_path, name):
    with pytest.raises(UsageError, match=r"unknown file type, one of \.nii\.gz"):
        io.write(make(), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_writing_where_one_cannot(tmp_path):
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder.nii").mkdir()
    for path in (tmp_path / "none" / "a.nii", tmp_path / "file" / "a.nii", tmp_path / "folder.nii"):
        with pytest.raises(OutputError) as caught:
            io.write(make(), path)
        assert (
            caught.value.exit_code == 7
            and str(caught.value).startswith(f"{path}: ")
            and caught.value.hint
        )
    assert sorted(f.name for f in tmp_path.iterdir()) == ["file", "folder.nii"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into every folder")
def test_writing_into_a_locked_folder(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="Permission denied"):
            io.write(make(), tmp_path / "a.nii")
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", VOLUMES)
@pytest.mark.parametrize(
    ("where", "failure", "raised"),
    [
        ("os.replace", OSError(28, "No space left on device"), OutputError),
        ("write", RuntimeError("many lines\nITK ERROR: NiftiImageIO(0x5): disk full"), OutputError),
        ("write", KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
def test_nothing_half_written_stays(tmp_path, monkeypatch, suffix, where, failure, raised):
    path = tmp_path / f"a{suffix}"
    io.write(make(seed=1), path)
    before = contents(tmp_path)

    def fail(*args):
        raise failure

    if where == "os.replace":
        monkeypatch.setattr(os, "replace", fail)
    else:
        name = image_format(suffix).name
        failing = replace(FORMAT_FUNCTIONS[name](), write=fail)
        monkeypatch.setitem(FORMAT_FUNCTIONS, name, lambda: failing)
    with pytest.raises(raised) as caught:
        io.write(make(seed=2), path)
    if raised is OutputError:
        assert "No space left" in str(caught.value) or str(caught.value).endswith("(disk full)")
    assert contents(tmp_path) == before


def test_written_files_have_the_usual_permissions(tmp_path):
    (tmp_path / "plain").write_text("")
    usual = (tmp_path / "plain").stat().st_mode
    for suffix in VOLUMES:
        io.write(make(), tmp_path / f"a{suffix}")
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or path.stat().st_mode == usual
    assert len(list(tmp_path.rglob("*"))) > len(VOLUMES)


# ------------------------------------------------------------------------------------------------------ names


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("a.nii.gz", ("a", ".nii.gz")),
        ("a.b.NII", ("a.b", ".nii")),
        ("/x/y.z/a.nrrd", ("a", ".nrrd")),
        ("a.mhd", ("a", ".mhd")),
        ("a.PNG", ("a", ".png")),
        ("a.jpg", ("a", "")),
        (".nii", (".nii", "")),
    ],
)
def test_split_name(name, parts):
    assert io.split_name(name) == parts


def test_sha256(tmp_path):
    (tmp_path / "a").write_bytes(bytes(range(256)) * 9999)
    assert io.sha256(tmp_path / "a") == hashlib.sha256(bytes(range(256)) * 9999).hexdigest()
    with pytest.raises(InputError, match="cannot be read"):
        io.sha256(tmp_path / "none")


# ------------------------------------------------------------------------------------------------- real scans


def test_real_scans_keep_their_grid(real_volumes, tmp_path):
    for path in sorted(real_volumes.glob("*oblique*.nii.gz")):
        volume = io.read(path)
        image = sitk.ReadImage(str(path))
        assert (
            volume.geometry.spacing_xyz == image.GetSpacing()
            and volume.geometry.origin == image.GetOrigin()
        )
        io.write_labels(volume.with_array(volume.array > volume.array.mean()), tmp_path / path.name)
        back = sitk.ReadImage(str(tmp_path / path.name))
        assert back.GetSpacing() == image.GetSpacing() and back.GetOrigin() == image.GetOrigin()
        assert back.GetDirection() == image.GetDirection()
        for key in (
            "qform_code",
            "sform_code",
            "srow_x",
            "srow_y",
            "srow_z",
            "quatern_b",
            "xyzt_units",
        ):
            assert back.GetMetaData(key) == image.GetMetaData(key)


def test_shear_in_text_headers_is_refused(tmp_path):
    shear = {
        "a.mha": (b"TransformMatrix = ", b"1 0 0 0.01 1 0 0 0 1"),
        "a.nrrd": (b"space directions: ", b"(1,0,0) (0.01,1,0) (0,0,1)"),
    }
    for name, (key, value) in shear.items():
        io.write(make(), tmp_path / name)
        head, mark, rest = (tmp_path / name).read_bytes().partition(key)
        (tmp_path / name).write_bytes(head + mark + value + rest[rest.index(b"\n") :])
        refuse(tmp_path / name, "not orthonormal: it is off by 0.01,", GeometryError)
