"""Scales of headers, drawn and extreme: values are slope times stored plus intercept, or the file is refused."""

import math
import struct
import warnings

import nibabel
import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError
from tests.support.dicom_series import Series, save, values_at

SLOPES = [
    0.0,
    -0.0,
    math.nan,
    math.inf,
    -math.inf,
    1.0,
    -1.0,
    2.5,
    1e300,
    1e38,
    1e-40,
    5e-324,
    1e-300,
    -1e22,
]
INTERCEPTS = [0.0, -0.0, 7.0, -1024.5, math.nan, math.inf, 1e300, 1e-310]
STORED = np.random.default_rng(0).integers(-300, 300, (3, 4, 5)).astype(np.int16)


def nifti(path, slope, intercept, kind, second):
    image = (nibabel.Nifti2Image if second else nibabel.Nifti1Image)(
        STORED.T.astype(kind), np.eye(4)
    )
    content = bytearray(image.to_bytes())
    with np.errstate(over="ignore"):
        scale = np.array([slope, intercept], "<f8" if second else "<f4")
    at = 176 if second else 112
    content[at : at + scale.nbytes] = scale.tobytes()
    path.write_bytes(content)
    return path, *map(float, scale)


@pytest.mark.parametrize("second", [False, True])
@pytest.mark.parametrize("kind", ["int16", "uint16", "float32", "float64"])
def test_scales_of_nifti(kind, second, tmp_path):
    """A slope of 0, or one that is no number, is none: the intercept does not count either (nifti1.h)."""
    stored = STORED.astype(kind).astype(np.float64)
    for given in SLOPES:
        for offset in INTERCEPTS:
            path, slope, intercept = nifti(tmp_path / "a.nii", given, offset, kind, second)
            scales = slope != 0 and math.isfinite(slope)
            with np.errstate(all="ignore"):
                expected = stored * slope + intercept if scales else stored
            if not np.isfinite(expected).all():
                with pytest.raises(InputError, match=r"a\.nii: .*intercept"):
                    io.read(path)
                continue
            volume = io.read(path)
            np.testing.assert_allclose(
                volume.array.astype(np.float64),
                expected,
                rtol=1e-6,
                atol=1e-6 * abs(intercept) if scales else 0.0,
            )
            if not scales:
                assert volume.array.dtype == kind
            boxes = io.open_volume(path)
            assert np.array_equal(
                boxes.read((slice(0, 3), slice(1, 3), slice(0, 5))), volume.array[:, 1:3]
            )


DICOM_SLOPES = ("0", "-0", "nan", "inf", "1e300", "1e305", "1E-40", "-2.5", "x", "1\\2", "")
DICOM_INTERCEPTS = ("0", "nan", "-1024", "1e300", "", "-inf")


@pytest.mark.parametrize("slope", DICOM_SLOPES)
def test_scales_of_dicom(slope, tmp_path):
    """Values are as the header scales them; what is no number is refused, with the file."""
    series = Series(positions=[(0.0, 0.0, 2.0 * number) for number in range(3)], rows=6, columns=5)
    stored = [values_at(series.points(place)) for place in series.positions]
    for intercept in DICOM_INTERCEPTS:
        folder = tmp_path / f"of {intercept}"
        for number in range(len(series.positions)):
            scaled_slice(series.dataset(number), slope, intercept, folder / f"{number}.dcm")
        try:
            scale, offset = float(slope or 1), float(intercept or 0)
        except ValueError:
            scale, offset = math.nan, 0.0
        with np.errstate(all="ignore"):
            expected = np.stack(stored).astype(np.float64) * scale + offset
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if scale == 0 or not np.isfinite(expected).all():
                with pytest.raises(InputError, match=r"\.dcm"):
                    io.read(folder)
                continue
            array = io.read(folder).array.astype(np.float64)
        np.testing.assert_allclose(array, expected, rtol=1e-6, atol=1e-6 * abs(offset))


def scaled_slice(one, slope, intercept, path):
    """Write a slice whose scale is a text: LO takes any, and lies in the file as DS does."""
    for tag, said in ((0x00281053, slope), (0x00281052, intercept)):
        one.pop(tag, None)
        one.add_new(tag, "LO", said.split("\\") if "\\" in said else said)
    save(one, path)
    content = path.read_bytes()
    for tag in (b"\x28\0\x53\x10", b"\x28\0\x52\x10"):
        assert content.count(tag + b"LO") == 1
        content = content.replace(tag + b"LO", tag + b"DS")
    path.write_bytes(content)


@pytest.mark.parametrize("suffix", ["mgh", "mgz"])
@pytest.mark.parametrize("flag", [0, -1, 1, 2])
def test_where_a_volume_of_freesurfer_lies_whose_header_says_nothing(flag, suffix, tmp_path):
    """Coronal slices of 1 mm around the origin, as mghRead of FreeSurfer has it; x runs to the left, y down."""
    data = STORED.transpose(2, 1, 0).astype(np.int32)
    affine = np.diag([2.0, 3.0, 4.0, 1.0])
    image = nibabel.MGHImage(data, affine)
    content = bytearray(image.to_bytes())
    content[28:30] = struct.pack(">h", flag)
    import gzip

    path = tmp_path / f"a.{suffix}"
    path.write_bytes(gzip.compress(bytes(content)) if suffix == "mgz" else content)
    volume = io.read(path)
    assert np.array_equal(volume.array, STORED)
    if flag > 0:
        assert (
            volume.geometry.spacing_xyz == pytest.approx((2, 3, 4))
            and "warning" not in volume.metadata
        )
        return
    assert (
        volume.geometry.spacing == (1.0, 1.0, 1.0) and "goodRASFlag" in volume.metadata["warning"]
    )
    directions = np.array([[-1, 0, 0], [0, 0, -1], [0, 1, 0]])  # of x, y, z, in RAS
    middle = np.array(data.shape) / 2
    for x, y, z in [(0, 0, 0), (4, 3, 2), (1, 2, 1)]:
        right, anterior, superior = (np.array([x, y, z]) - middle) @ directions
        found = volume.geometry.index_to_world((z, y, x))
        assert found == pytest.approx((-right, -anterior, superior))
