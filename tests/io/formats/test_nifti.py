"""Where a NIfTI header places an image, what of it is refused, and that all of it comes back."""

import gzip
import struct

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import Volume, io
from accelsurf.errors import GeometryError, InputError
from accelsurf.io import channels
from accelsurf.io.formats import nifti as nifti_format
from accelsurf.settings.reading import ReadOptions

SPACING = np.array([1.0, 2.0, 3.0])
OFFSET = (-10.0, -20.0, 30.0)


def turn(degrees, axis=2):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = [(1, 2), (0, 2), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def nifti(
    codes=(1, 1),
    sform=None,
    offset=OFFSET,
    half=10.0,
    pixdim=(1, *SPACING),
    units=10,
    order="<",
    dtype=(4, 16),
    size=None,
):
    """Bytes of a NIfTI-1 file, packed here field by field; the qform turns about z by 2 * half degrees."""
    raw = bytearray(352)
    struct.pack_into(order + "i", raw, 0, 348)
    size = (3, 5, 4, 3, 1, 1, 1, 1) if size is None else size
    struct.pack_into(order + "8h", raw, 40, *size)
    struct.pack_into(order + "2h", raw, 70, *dtype)
    struct.pack_into(order + "4f", raw, 76, *pixdim)
    struct.pack_into(order + "3f", raw, 108, 352, 1, 0)
    raw[123] = units
    struct.pack_into(order + "2h", raw, 252, *codes)
    struct.pack_into(order + "6f", raw, 256, 0, 0, np.sin(np.radians(half)), *OFFSET)
    matrix = turn(2 * half) * SPACING if sform is None else sform
    struct.pack_into(order + "12f", raw, 280, *np.c_[matrix, offset].ravel())
    raw[344:348] = b"n+1\0"
    return bytes(raw) + np.arange(60).astype(order + "i2").tobytes()


def grid_fields(raw):
    """pixdim[0..3], units, codes, quaternion, offset, affine: all that places the image."""
    return raw[76:92], raw[123], raw[252:328]


def save(path, raw):
    path.write_bytes(gzip.compress(raw) if path.suffix == ".gz" else raw)
    return path


def load(path):
    return gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize(
    "codes", [(0, 0), (1, 0), (0, 1), (1, 1), (2, 2), (0, 4), (1, 4), (3, 2), (2, 1)]
)
@pytest.mark.parametrize("half", [0.0, 10.0, 89.9, 90.0])
def test_codes_and_matrices_come_back_number_by_number(tmp_path, suffix, codes, half):
    raw = nifti(codes, half=half)
    path = save(tmp_path / f"a{suffix}", raw)
    volume = io.read(path)
    assert io.WARNING_KEY not in volume.metadata
    io.write_labels(volume.with_array(volume.array > 30), tmp_path / f"b{suffix}")
    assert grid_fields(load(tmp_path / f"b{suffix}")) == grid_fields(raw)
    theirs, ours = (sitk.ReadImage(str(p)) for p in (path, tmp_path / f"b{suffix}"))
    assert ours.GetSpacing() == theirs.GetSpacing() and ours.GetOrigin() == theirs.GetOrigin()
    assert ours.GetDirection() == theirs.GetDirection()
    # geometry is ITK's
    assert (
        volume.geometry.spacing_xyz == theirs.GetSpacing()
        and volume.geometry.origin == theirs.GetOrigin()
    )
    np.testing.assert_allclose(
        volume.geometry.direction.ravel(), theirs.GetDirection(), rtol=0, atol=1e-7
    )


def test_codes_survive_also_from_a_big_endian_file(tmp_path):
    volume = io.read(save(tmp_path / "a.nii", nifti((2, 3), order=">")))
    np.testing.assert_array_equal(volume.array.ravel(), np.arange(60))
    io.write(volume, tmp_path / "b.nii")
    assert grid_fields(load(tmp_path / "b.nii")) == grid_fields(nifti((2, 3)))


def test_a_file_of_ours_has_both_forms(tmp_path):
    """Nothing to give back: ITK's default, the scanner code for both."""
    io.write(Volume.from_array(np.zeros((3, 4, 5), np.uint8), (3, 2, 1)), tmp_path / "a.nii")
    assert struct.unpack_from("<2h", load(tmp_path / "a.nii"), 252) == (1, 1)


def test_qfac_mirrors_the_third_axis(tmp_path):
    volume = io.read(save(tmp_path / "a.nii", nifti((1, 0), pixdim=(-1, *SPACING))))
    assert np.linalg.det(volume.geometry.direction) < 0
    io.write(volume, tmp_path / "b.nii")
    assert grid_fields(load(tmp_path / "b.nii")) == grid_fields(
        nifti((1, 0), pixdim=(-1, *SPACING))
    )


TURNED = turn(60) * SPACING


@pytest.mark.parametrize(
    ("codes", "used"),
    [
        ((1, 1), "sform"),
        ((2, 1), "sform"),
        ((1, 2), "qform"),
        ((2, 2), "qform"),
        ((1, 4), "qform"),
        ((3, 2), "qform"),
    ],
)
def test_forms_that_disagree(tmp_path, codes, used):
    raw = nifti(codes, TURNED)
    volume = io.read(save(tmp_path / "a.nii", raw))
    angle = np.degrees(np.arctan2(volume.geometry.direction[1, 0], volume.geometry.direction[0, 0]))
    assert abs((angle % 180) - (60 if used == "sform" else 20)) < 1e-3
    warning = volume.metadata[io.WARNING_KEY]
    assert (
        "qform and sform place the image differently" in warning
        and f"the {used} is used" in warning
    )
    io.write(volume, tmp_path / "b.nii")
    assert grid_fields(load(tmp_path / "b.nii")) == grid_fields(raw)


def test_without_a_code_the_image_starts_at_the_worlds_origin(tmp_path):
    geometry = io.read(save(tmp_path / "a.nii", nifti((0, 0), TURNED))).geometry
    assert geometry.origin == (0, 0, 0) and geometry.spacing == (3, 2, 1)
    np.testing.assert_array_equal(geometry.direction, np.eye(3))


def sheared(amount):
    return SPACING * (np.eye(3) + amount * np.eye(3, k=1))


@pytest.mark.sampled
@pytest.mark.parametrize("codes", [(0, 1), (1, 1), (0, 2), (2, 2), (4, 4), (3, 1)])
@pytest.mark.parametrize("amount", [0.001, 0.01, 0.5])
def test_shear_is_refused_with_its_size(tmp_path, codes, amount, capfd):
    with pytest.raises(
        GeometryError, match="axes of the NIfTI sform are not perpendicular"
    ) as caught:
        io.read(save(tmp_path / "a.nii", nifti(codes, sheared(amount), half=0)))
    column = (amount, 1.0)
    cosine = column[0] / np.hypot(*column)
    assert f"off by {cosine:.3g} ({np.degrees(np.arcsin(cosine)):.3g} degrees)" in str(caught.value)
    assert "resample" in caught.value.hint
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("codes", [(1, 2), (1, 4), (2, 3)])
def test_shear_beside_a_qform_of_another_kind_is_carried_along(tmp_path, codes):
    """An affine registration to an atlas does not make the scan unreadable: its own qform places it."""
    raw = nifti(codes, sheared(0.2), half=0)
    volume = io.read(save(tmp_path / "a.nii", raw))
    np.testing.assert_allclose(volume.geometry.direction, np.diag([-1, -1, 1]), atol=1e-6)
    io.write(volume, tmp_path / "b.nii")
    assert grid_fields(load(tmp_path / "b.nii")) == grid_fields(raw)


def test_shear_of_float32_rounding_is_accepted(tmp_path):
    volume = io.read(save(tmp_path / "a.nii", nifti((0, 1), sheared(1e-5), half=0)))
    np.testing.assert_allclose(volume.geometry.direction, np.diag([-1, -1, 1]), atol=2e-5)


@pytest.mark.parametrize("codes", [(0, 1), (1, 1)])
def test_a_voxel_size_stated_twice_must_agree(tmp_path, codes, capfd):
    """ITK would take pixdim here, others the lengths of the affine's axes: half as much volume."""
    with pytest.raises(
        GeometryError, match="contradicts itself: spacing .*6, 4, 2.* against .*3, 2, 1.*pixdim"
    ) as caught:
        io.read(save(tmp_path / "a.nii", nifti(codes, 2 * turn(20) * SPACING)))
    assert "pixdim, qform and sform agree" in caught.value.hint
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.full((3, 3), np.nan)])
def test_an_sform_that_is_no_transform(tmp_path, matrix):
    with pytest.raises(GeometryError, match="sform of the header is no transform"):
        io.read(save(tmp_path / "a.nii", nifti((0, 1), matrix)))


@pytest.mark.sampled
@pytest.mark.parametrize("field", range(6))
@pytest.mark.parametrize("version", [1, 2])
def test_a_qform_that_is_no_transform(tmp_path, field, version, capfd):
    raw = bytearray(nifti((1, 0)))
    struct.pack_into("<f", raw, 256 + 4 * field, np.nan)
    raw = second(bytes(raw)) if version == 2 else bytes(raw)
    with pytest.raises(GeometryError, match="qform of the header is no transform: .*nan") as caught:
        io.read(save(tmp_path / "a.nii", raw))
    assert caught.value.hint and capfd.readouterr() == ("", "")


@pytest.mark.sampled
@pytest.mark.parametrize("codes", [(0, 0), (1, 0), (1, 1)])
@pytest.mark.parametrize("axis", [1, 2, 3])
@pytest.mark.parametrize("value", [0.0, -2.0, np.nan, np.inf])
def test_spacing_must_be_positive(tmp_path, codes, axis, value):
    pixdim = [1, *SPACING]
    pixdim[axis] = value
    with pytest.raises(
        GeometryError, match=r"spacing \(x,y,z\) = .*three positive numbers expected"
    ) as caught:
        io.read(save(tmp_path / "a.nii", nifti(codes, pixdim=pixdim)))
    assert "pixdim" in caught.value.hint


@pytest.mark.parametrize(
    ("units", "mm"), [(0, 1), (2, 1), (10, 1), (1, 1000), (9, 1000), (3, 1e-3), (11, 1e-3)]
)
def test_units_of_length_become_mm_and_come_back(tmp_path, units, mm):
    raw = nifti((1, 1), units=units)
    volume = io.read(save(tmp_path / "a.nii", raw))
    np.testing.assert_allclose(volume.geometry.spacing_xyz, SPACING * mm, rtol=1e-6)
    np.testing.assert_allclose(volume.geometry.origin, np.array([10, 20, 30]) * mm, rtol=1e-6)
    io.write(volume, tmp_path / "b.nii")
    assert grid_fields(load(tmp_path / "b.nii")) == grid_fields(raw)


def test_scaled_values_are_read_as_floats(tmp_path):
    raw = bytearray(nifti())
    struct.pack_into("<2f", raw, 112, 0.5, 10)
    volume = io.read(save(tmp_path / "a.nii", raw))
    np.testing.assert_allclose(volume.array.ravel(), np.arange(60) * 0.5 + 10)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size": (4, 5, 4, 3, 7, 1, 1, 1)}, "sequence of 7 time points"),
        ({"size": (5, 5, 4, 3, 1, 3, 1, 1)}, "3 channels given, one expected"),
        ({"size": (2, 5, 4, 1, 1, 1, 1, 1)}, r"2D image \(5 x 4\)"),
        ({"size": (3, 5, -4, 3, 1, 1, 1, 1)}, "header is damaged: dim"),
        ({"size": (0, 5, 4, 3, 1, 1, 1, 1)}, "header is damaged: dim"),
        ({"dtype": (32, 64)}, "complex image"),
        ({"dtype": (1792, 128)}, "complex image"),
        ({"dtype": (128, 24)}, r"colour \(RGB\) image"),
        ({"dtype": (2304, 32)}, r"colour \(RGBA\) image"),
        ({"dtype": (1536, 128)}, "type code 1536"),
        ({"dtype": (0, 0)}, "type code 0"),
    ],
)
def test_other_sorts_of_images_are_named(tmp_path, change, words, capfd):
    with pytest.raises(InputError, match=words) as caught:
        io.read(save(tmp_path / "a.nii", nifti(**change) + bytes(1000)))
    assert caught.value.hint
    assert capfd.readouterr() == ("", "")


def test_trailing_axes_of_one_are_no_axes(tmp_path):
    volume = io.read(save(tmp_path / "a.nii", nifti(size=(5, 5, 4, 3, 1, 1, 1, 1))))
    assert volume.array.shape == (3, 4, 5)


# ---------------------------------------------------------------------------------------------------- NIfTI-2


def second(raw, order=None):
    """The same image as NIfTI-2, by nibabel; in the same byte order, or another."""
    old = nibabel.Nifti1Header(raw[:348], check=False)
    size = tuple(old["dim"][1 : old["dim"][0] + 1])
    stored = np.frombuffer(raw[352:], old.get_data_dtype(), np.prod(size))
    header = nibabel.Nifti2Header(endianness=order or old.endianness)
    for key in header.keys():
        if key in old.keys() and key not in ("sizeof_hdr", "magic", "vox_offset"):
            header[key] = old[key]
    header["vox_offset"] = 544
    return header.binaryblock + bytes(4) + stored.astype(header.get_data_dtype()).tobytes()


def read_both(tmp_path, raw, suffix=".nii", order=None):
    """A NIfTI-1 file read by ITK, and the same as NIfTI-2."""
    one, two = (
        save(tmp_path / f"one{suffix}", raw),
        save(tmp_path / f"two{suffix}", second(raw, order)),
    )
    assert struct.unpack_from((order or "<") + "i", load(two)) == (540,)
    return io.read(one), io.read(two)


@pytest.mark.sampled
@pytest.mark.parametrize(
    "codes", [(0, 0), (1, 0), (0, 1), (1, 1), (2, 2), (0, 4), (1, 4), (3, 2), (2, 1)]
)
@pytest.mark.parametrize("half", [0.0, 10.0, 89.9, 90.0])
@pytest.mark.parametrize("qfac", [1, -1])
def test_nifti_2_is_placed_as_itk_places_nifti_1(tmp_path, codes, half, qfac):
    matrix = turn(2 * half) * SPACING * (1, 1, qfac)
    one, two = read_both(
        tmp_path, nifti(codes, matrix, half=half, pixdim=(qfac, *SPACING), units=3)
    )
    assert two.geometry.matches(one.geometry, 1e-6 * max(one.geometry.spacing))
    np.testing.assert_array_equal(two.array, one.array)
    assert two.metadata == one.metadata and two.array.dtype == one.array.dtype


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_nifti_2_is_written_as_nifti_1_on_the_same_grid(tmp_path, suffix, order):
    raw = nifti((2, 3))
    _, volume = read_both(tmp_path, raw, suffix, order)
    assert volume.array.flags.c_contiguous and volume.array.dtype == np.dtype("=i2")
    io.write(volume, tmp_path / f"b{suffix}")
    assert grid_fields(load(tmp_path / f"b{suffix}")) == grid_fields(raw)
    np.testing.assert_array_equal(io.read(tmp_path / f"b{suffix}").array, volume.array)


@pytest.mark.sampled
@pytest.mark.parametrize("code", ["u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
@pytest.mark.parametrize("scale", [(0.3, 7.0), (1, 0), (0, 5), (1, 3), (np.nan, 1)])
def test_values_of_nifti_2_are_those_that_itk_gives_of_nifti_1(tmp_path, code, scale):
    kind = nibabel.Nifti1Header()
    kind.set_data_dtype(code)
    raw = bytearray(nifti(dtype=(int(kind["datatype"]), int(kind["bitpix"])))[:352])
    struct.pack_into("<2f", raw, 112, *scale)
    raw += np.random.default_rng(0).integers(0, 100, 60).astype("<" + code).tobytes()
    one, two = read_both(tmp_path, bytes(raw))
    assert two.array.dtype == one.array.dtype
    np.testing.assert_array_equal(two.array, one.array)


def test_forms_of_nifti_2_that_disagree_or_contradict_pixdim(tmp_path):
    one, two = read_both(tmp_path, nifti((1, 2), TURNED))
    assert two.metadata[io.WARNING_KEY] == one.metadata[io.WARNING_KEY]
    for matrix, words in (
        (2 * turn(20) * SPACING, "contradicts itself"),
        (sheared(0.1), "not perpendicular"),
    ):
        with pytest.raises(GeometryError, match=words):
            io.read(save(tmp_path / "a.nii", second(nifti((1, 1), matrix))))


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize("keep", [3, 100, 539, 540, 544, 663])
def test_nifti_2_cut_short(tmp_path, suffix, keep):
    whole = second(nifti())
    assert len(whole) == 664
    with pytest.raises(
        InputError, match="has only|announces 664 bytes of voxels, the file holds|lacks the NIfTI"
    ):
        io.read(save(tmp_path / f"a{suffix}", whole[:keep]))


def test_damage_of_the_header_is_refused_or_read_but_never_anything_else(tmp_path, capfd):
    rng = np.random.default_rng(3)
    two = nifti((1, 2), size=(4, 5, 4, 3, 2, 1, 1, 1)) + bytes(120)
    for raw in (second(nifti((1, 2))), two, second(two)):
        refused = 0
        for _ in range(150):
            damaged = bytearray(raw)
            for place in rng.integers(0, 540 if raw[:2] == b"\x1c\x02" else 348, 4):
                damaged[place] = rng.integers(0, 256)
            path = save(tmp_path / "a.nii", bytes(damaged))
            try:
                channels.read_channels(path, ReadOptions(channels_from_time=True))
            except InputError as error:
                refused += 1
                assert str(error).startswith(f"{path}: ") and error.hint
        assert 10 < refused < 150
    capfd.readouterr()  # VNL prints about forms that no code refers to


def test_nifti_2_that_is_none_or_too_large(tmp_path):
    with pytest.raises(InputError, match="lacks the NIfTI marks"):
        io.read(save(tmp_path / "a.nii", struct.pack("<i", 540) + bytes(1000)))
    raw = bytearray(second(nifti()))
    struct.pack_into("<3q", raw, 24, 10**6, 10**6, 10**6)
    with pytest.raises(
        InputError, match="announces 20{15}\\d{3} bytes of voxels, the file holds 664"
    ):
        io.read(save(tmp_path / "a.nii", bytes(raw)))
    with pytest.raises(InputError, match="needs about"):
        io.read(save(tmp_path / "a.nii", second(nifti())), memory_bytes=60 * (2 + 12) - 1)
    raw = bytearray(second(nifti()))
    struct.pack_into("<i", raw, 344, 70000)
    with pytest.raises(InputError, match=r"damaged: form codes \(70000, 1\)"):
        io.read(save(tmp_path / "a.nii", bytes(raw)))


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("axes", [(4, 5, 4, 3, 2, 1, 1, 1), (5, 5, 4, 3, 1, 2, 1, 1)])
def test_channels_are_placed_and_scaled_as_one_alone(tmp_path, version, axes):
    raw = bytearray(nifti((1, 2), TURNED, size=axes)) + np.arange(60, 120).astype("<i2").tobytes()
    struct.pack_into("<2f", raw, 112, 0.5, 10)
    one = raw[:40] + struct.pack("<8h", 3, 5, 4, 3, 1, 1, 1, 1) + raw[56:]
    alone = io.read(save(tmp_path / "alone.nii", bytes(one)))
    path = save(tmp_path / "a.nii.gz", second(bytes(raw)) if version == 2 else bytes(raw))
    found = channels.read_channels(path, ReadOptions(channels_from_time=True))
    assert len(found) == 2
    for number, volume in enumerate(found):
        np.testing.assert_array_equal(volume.array, alone.array + 30 * number)
        assert volume.array.dtype == np.float32 and volume.geometry.matches(alone.geometry, 1e-5)
        assert volume.metadata == alone.metadata


def test_the_header_knows_its_own_grid():
    """The rule by which ITK places an image, which the tests above check on files."""
    header = nifti_format.parse_header(nifti((0, 0), TURNED))
    assert header.grid.geometry().origin == (0, 0, 0) and header.grid.geometry().spacing == (
        3,
        2,
        1,
    )
