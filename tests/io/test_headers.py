"""Files that are empty, cut off, damaged, or that claim more than they hold: never read as zeros or as garbage."""

import gzip

import numpy as np
import pytest

from accelsurf import io
from accelsurf.image.volume import Volume
from accelsurf.io.formats.deflate import gzip_writer
from accelsurf.settings.file_formats import image_suffixes
from tests.support.text_headers import VALUES, refuse, text_header


@pytest.fixture(autouse=True)
def silence(capfd):
    """No C++ library speaks to the user past us."""
    yield
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_the_plain_headers_of_these_tests_are_good(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text_header(suffix) + VALUES.tobytes())
    volume = io.read(path)
    np.testing.assert_array_equal(volume.array, VALUES)
    assert volume.geometry.spacing == (3, 2, 1)


@pytest.mark.parametrize("suffix", image_suffixes())
def test_empty_file(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(b"")
    refuse(tmp_path / f"a{suffix}", "the file is empty")


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", image_suffixes())
@pytest.mark.parametrize(
    # Packed without the time: it would be in the test's name, another in each worker.
    "content",
    [b"hello world\n" * 100, bytes(1000), gzip.compress(b"hello" * 200, mtime=0), b"x"],
)
def test_not_an_image(tmp_path, suffix, content):
    (tmp_path / f"a{suffix}").write_bytes(content)
    said = "not an? (NIfTI|NRRD|MetaImage|PNG|TIFF|DICOM|NumPy|MGH)|gzip-compressed|has only|folder of an"
    said += "|which is missing"
    refuse(tmp_path / f"a{suffix}", said)


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".mhd"])
@pytest.mark.parametrize("keep", [0.02, 0.3, 0.9, 0.999])
def test_truncated_file(tmp_path, suffix, keep):
    path = tmp_path / f"a{suffix}"
    values = np.random.default_rng(1).integers(0, 30000, (20, 20, 20)).astype(np.int16)
    io.write(Volume.from_array(values), path)
    data = tmp_path / "a.zraw" if suffix == ".mhd" else path
    raw = data.read_bytes()
    data.write_bytes(raw[: int(len(raw) * keep)])
    refuse(path, "announces|end before|has only|not a MetaImage|damaged|not a NIfTI")


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
@pytest.mark.parametrize("missing", [1, 100, 240])
def test_truncated_uncompressed_text_header_formats(tmp_path, suffix, missing):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text_header(suffix) + VALUES.tobytes()[:-missing])
    refuse(path, f"announces 240 bytes of voxels, the file holds {240 - missing}")


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize("present", [0, 1, 239])
def test_a_nifti_header_that_claims_more_than_there_is(tmp_path, suffix, present):
    io.write(Volume.from_array(VALUES), tmp_path / "whole.nii")
    (tmp_path / "a.nii").write_bytes((tmp_path / "whole.nii").read_bytes()[: 352 + present])
    if suffix == ".nii.gz":
        with gzip_writer(tmp_path / "a.nii.gz") as out:
            out.write((tmp_path / "a.nii").read_bytes())
    refuse(
        tmp_path / f"a{suffix}", f"announces {352 + 240} bytes .*, the file holds {352 + present}"
    )


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_compressed_voxels_fewer_than_the_header_claims(tmp_path, suffix):
    """ITK returns what happened to be in memory for such a MetaImage."""
    path = tmp_path / f"a{suffix}"
    io.write(Volume.from_array(VALUES), path)
    path.write_bytes(path.read_bytes().replace(b"6 5 4", b"6 5 9"))
    refuse(path, "announces 540 bytes of voxels, the file holds 240")


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_damaged_compressed_voxels(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    io.write(Volume.from_array(VALUES), path)
    raw = bytearray(path.read_bytes())
    raw[-60] ^= 0x55
    path.write_bytes(raw)
    refuse(path, "compressed voxels are damaged|end before")


def test_compressed_parts_one_after_the_other_are_one_stream(tmp_path):
    """As written by parallel compressors, with padding at the end."""
    io.write(Volume.from_array(VALUES), tmp_path / "a.nii")
    raw = (tmp_path / "a.nii").read_bytes()
    packed = b"".join(gzip.compress(raw[i : i + 50]) for i in range(0, len(raw), 50))
    (tmp_path / "b.nii.gz").write_bytes(packed)
    np.testing.assert_array_equal(io.read(tmp_path / "b.nii.gz").array, VALUES)
    (tmp_path / "c.nii.gz").write_bytes(gzip.compress(raw) + bytes(512))
    np.testing.assert_array_equal(io.read(tmp_path / "c.nii.gz").array, VALUES)
    (tmp_path / "d.nii.gz").write_bytes(packed[:-40])
    refuse(tmp_path / "d.nii.gz", "end before")


def test_compression_against_the_suffix(tmp_path):
    io.write(Volume.from_array(VALUES), tmp_path / "a.nii")
    raw = (tmp_path / "a.nii").read_bytes()
    (tmp_path / "b.nii").write_bytes(gzip.compress(raw))
    (tmp_path / "b.nii.gz").write_bytes(raw)
    refuse(tmp_path / "b.nii", "gzip-compressed, against its suffix")
    refuse(tmp_path / "b.nii.gz", "not compressed, against its suffix")
