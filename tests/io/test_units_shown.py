"""The unit in which an image is shown, whether it is a patient's, and spacings as texts."""

import nibabel
import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.headers import shows_patient, size_question
from accelsurf.io.library_images import as_volume
from accelsurf.run.region_of_interest import cropped
from accelsurf.settings.reading import ReadOptions, spacing_of

ARRAY = np.arange(2 * 3 * 4, dtype=np.float32).reshape(2, 3, 4)


@pytest.mark.parametrize(
    ("text", "spacing", "unit"),
    [
        ("0.2um", (2e-4, 2e-4, 2e-4), "um"),
        ("0.2,0.3,1um", (1e-3, 3e-4, 2e-4), "um"),
        ("250nm", (2.5e-4, 2.5e-4, 2.5e-4), "nm"),
        ("2", (2.0, 2.0, 2.0), "mm"),
        ("1,2,3mm", (3.0, 2.0, 1.0), "mm"),
        ("0.1cm", (1.0, 1.0, 1.0), "mm"),
    ],
)
def test_a_spacing_as_text_is_x_y_z_and_gives_its_unit(text, spacing, unit, tmp_path):
    volume = as_volume(ARRAY, text)
    assert volume.geometry.spacing == pytest.approx(spacing) and volume.geometry.unit == unit
    np.save(tmp_path / "a.npy", ARRAY)
    read = io.read(tmp_path / "a.npy", options=ReadOptions(spacing=spacing_of(text)))
    assert read.geometry.spacing == pytest.approx(spacing) and read.geometry.unit == unit
    lazy = io.open_volume(tmp_path / "a.npy", spacing=spacing_of(text))
    assert lazy.geometry.unit == lazy.layout.levels[0].unit == unit
    part = cropped(read.geometry, (slice(0, 1), slice(1, 3), slice(0, 2)))
    assert part.unit == unit
    assert read.with_array(ARRAY + 1).geometry.unit == unit


def test_texts_that_are_no_spacing_are_refused_in_words():
    with pytest.raises(UsageError, match="spacing: 0.2parsec was given"):
        accelsurf.segment(ARRAY, spacing="0.2parsec", inside="1,1,1")
    with pytest.raises(InputError, match="spacing: the text '0.2um' was given, expected mm"):
        Volume.from_array(ARRAY, "0.2um")


@pytest.mark.parametrize(
    ("origin", "diagonal", "code", "unit", "is_patient"),
    [
        ((-30.0, 20.0, 5.0), (1, 1, 1), 1, "mm", True),
        ((-30.0, 20.0, 5.0), (-1, 1, 1), 2, "mm", True),
        ((-30.0, 20.0, 5.0), (1, 1, 1), 0, "mm", False),  # it does not say so
        ((0.0, 0.0, 0.0), (-1, -1, 1), 1, "mm", False),  # as ITK places an array
        ((0.0, 0.0, 0.0), (1, 1, 1), 1, "mm", False),
        ((-4.5, -4.5, -4.5), (1, 1, 1), 1, "mm", False),  # its middle at the world's origin
        ((-5.0, -5.0, -5.0), (1, 1, 1), 2, "mm", False),
        ((-30.0, 20.0, 5.0), (1, 1, 1), 1, "micron", False),
    ],
)
def test_a_patient_is_who_a_scanner_has_placed(tmp_path, origin, diagonal, code, unit, is_patient):
    affine = np.diag([*diagonal, 1.0]).astype(float)
    affine[:3, 3] = origin
    image = nibabel.Nifti1Image(np.zeros((10, 10, 10), np.uint8), affine)
    image.set_sform(affine, code)
    image.set_qform(affine, code)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, tmp_path / "a.nii")
    volume = io.read(tmp_path / "a.nii")
    assert shows_patient(volume) == is_patient
    assert volume.geometry.unit == ("um" if unit == "micron" else "mm")


def test_a_size_is_asked_about_where_mm_are_not_meant(tmp_path):
    wide = Geometry((1, 1200, 4), (1.0, 1.0, 1.0))
    array = np.broadcast_to(np.uint8(0), wide.shape)
    question = size_question(Volume(array, wide), tmp_path / "a.npy")
    assert "the image is 1.2 m wide" in question and "--spacing 1,1,1um" in question
    assert "correct the unit in the file" in size_question(Volume(array, wide), tmp_path / "a.nii")
    for known in (
        Volume(array, wide, {"spatial_unit": "um"}),
        Volume(array[:, :900], Geometry((1, 900, 4), wide.spacing)),
    ):
        assert not size_question(known, tmp_path / "a.npy")
