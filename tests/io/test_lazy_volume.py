"""Images that are read box by box: the same voxels as the whole image has, and errors instead of zeros."""

import pickle
import struct
from concurrent.futures import ThreadPoolExecutor

import nibabel
import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.io import LazyVolume

BOXES = (
    (slice(0, 5), slice(0, 7), slice(0, 9)),  # all of it
    (slice(1, 2), slice(6, 7), slice(8, 9)),  # the last voxel of a plane
    (slice(2, 5), slice(1, 4), slice(0, 9)),  # whole rows
    (slice(0, 3), slice(3, 7), slice(2, 5)),
)


def values(dtype: str) -> np.ndarray:
    return np.random.default_rng(3).uniform(-90, 90, (5, 7, 9)).astype(dtype)


def assert_same_boxes(path, **opening) -> io.LazyVolume:
    """Every box of a lazy image has the voxels, type and grid that the whole image has."""
    whole, lazy = io.read(path), io.open_volume(path, **opening)
    assert lazy.dtype == whole.array.dtype and lazy.dtype.isnative
    assert lazy.geometry.difference(whole.geometry) == "" and lazy.shape == whole.geometry.shape
    assert (
        lazy.geometry.origin == whole.geometry.origin
        and lazy.geometry.spacing == whole.geometry.spacing
    )
    assert lazy.metadata == whole.metadata and lazy.source == path
    for box in BOXES:
        got = lazy.read(box)
        assert got.flags.c_contiguous and got.flags.owndata and got.dtype == whole.array.dtype
        np.testing.assert_array_equal(got, whole.array[box], strict=True)
    return lazy


@pytest.mark.sampled
@pytest.mark.parametrize("dtype", ["uint8", "<i2", ">i2", "<f4", ">f8", "<u2", ">i4"])
@pytest.mark.parametrize("scale", [None, (0.5, -3.0)])
@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
def test_boxes_of_a_nifti_are_those_of_the_whole_image(tmp_path, dtype, scale, kind):
    stored = np.abs(values(dtype)) if "u" in dtype else values(dtype)
    affine = np.array([[0, -0.5, 0, 10.0], [0.25, 0, 0, -4], [0, 0, 2.0, 7], [0, 0, 0, 1]])
    header = kind.header_class(endianness=">" if dtype[0] == ">" else "<")
    header.set_data_dtype(dtype)
    image = kind(stored.transpose(2, 1, 0), affine, header)
    path = tmp_path / "scan.nii"
    image.to_filename(path)
    if scale is not None:
        with path.open("r+b") as file:
            at, form = (112, "ff") if kind is nibabel.Nifti1Image else (176, "dd")
            file.seek(at)
            file.write(struct.pack((">" if dtype[0] == ">" else "<") + form, *scale))
    assert_same_boxes(path)


def test_an_array_is_read_like_a_file_and_not_shared():
    volume = Volume.from_array(values(">i2"), spacing=(2, 1, 0.5))
    lazy = io.LazyVolume.of_array(volume)
    assert (
        lazy.geometry is volume.geometry and lazy.dtype == np.dtype("i2") and lazy.bytes_read == 0
    )
    got = lazy.read(BOXES[3])
    np.testing.assert_array_equal(got, volume.array[BOXES[3]])
    got[:] = 0
    np.testing.assert_array_equal(volume.array, values(">i2"))
    assert lazy.bytes_read == got.nbytes


def test_bytes_that_were_read_are_those_of_the_boxes(tmp_path):
    array = np.arange(3 * 4 * 9000, dtype=np.uint16).reshape(3, 4, 9000)
    path = tmp_path / "wide.nii"
    io.write(Volume.from_array(array), path)
    lazy = io.open_volume(path)
    far = (slice(1, 3), slice(0, 4), slice(500, 600))
    np.testing.assert_array_equal(lazy.read(far), array[far])
    assert lazy.bytes_read == array[far].nbytes
    near = (slice(0, 3), slice(1, 4), slice(1000, 9000))
    before = lazy.bytes_read
    np.testing.assert_array_equal(lazy.read(near), array[near])
    assert lazy.bytes_read - before == array[near].nbytes


@pytest.mark.parametrize("suffix", [".nii", ".tif", ".ome.zarr"])
def test_threads_read_the_same(tmp_path, suffix):
    array = np.random.default_rng(4).integers(0, 255, (70, 66, 90)).astype(np.uint8)
    io.write(Volume.from_array(array), tmp_path / f"a{suffix}")
    lazy = io.open_volume(
        tmp_path / f"a{suffix}", cache_bytes=70_000
    )  # of a few pages, or less than a chunk

    def same(seed: int) -> bool:
        low, high = np.sort(
            np.random.default_rng(seed).integers(0, np.array(array.shape) + 1, (2, 3)), axis=0
        )
        box = tuple(
            slice(int(a), int(max(a + 1, b)))
            for a, b in zip(np.minimum(low, 65), high, strict=True)
        )
        return np.array_equal(lazy.read(box), array[box])

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(same, range(24)))


@pytest.mark.parametrize(
    "box",
    [
        (slice(0, 6), slice(0, 7), slice(0, 9)),
        (slice(0, 0), slice(0, 7), slice(0, 9)),
        (slice(-2, 5), slice(0, 7), slice(0, 9)),
        (slice(0, 5, 2), slice(0, 7), slice(0, 9)),
        (slice(None), slice(0, 7), slice(0, 9)),
    ],
)
def test_a_box_beyond_the_grid_is_refused(box):
    with pytest.raises(UsageError, match="within the grid"):
        io.LazyVolume.of_array(Volume.from_array(values("u1"))).read(box)


def test_a_compressed_file_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "scan.nii.gz"
    io.write(Volume.from_array(values("f4")), path)
    with pytest.raises(InputError, match=r"scan.nii.gz: .*packed") as caught:
        io.open_volume(path)
    assert "OME-Zarr" in caught.value.hint


def test_a_file_without_levels_has_no_second_one(tmp_path):
    path = tmp_path / "scan.nii"
    io.write(Volume.from_array(values("f4")), path)
    with pytest.raises(UsageError, match="level: 1 was given, and a .nii has no such choice"):
        io.open_volume(path, level=1)


def test_a_file_cut_short_gone_or_changed_is_an_error(tmp_path):
    path = tmp_path / "scan.nii"
    io.write(Volume.from_array(values("f4")), path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    with pytest.raises(InputError, match="announces 1612 bytes of voxels, the file holds 1611"):
        io.open_volume(path)
    path.write_bytes(whole)
    lazy = io.open_volume(path)
    path.write_bytes(whole[:-1])
    with pytest.raises(InputError, match=r"scan.nii: the image has changed since"):
        lazy.read(BOXES[0])
    path.unlink()
    with pytest.raises(InputError, match=r"scan.nii: cannot be read \(No such file"):
        lazy.read(BOXES[0])


def test_more_than_2_to_the_32_voxels(tmp_path):
    n, path = 1701, tmp_path / "large.nii"
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.uint8)
    header.set_data_shape((n, n, n))
    header.set_zooms((0.5, 0.5, 0.5))
    header.set_sform(np.diag([0.5, 0.5, 0.5, 1]), 1)
    header["vox_offset"], header["magic"] = 352, b"n+1"
    with path.open("wb") as file:
        file.write(header.binaryblock + b"\0" * 4)
        file.truncate(352 + n**3)
        for z, y, x in ((1700, 1700, 1700), (1700, 3, 5), (0, 0, 0)):
            file.seek(352 + (z * n + y) * n + x)
            file.write(bytes([z % 251 + 1]))
    lazy = io.open_volume(path)
    assert lazy.shape == (n, n, n) and lazy.geometry.spacing == (0.5, 0.5, 0.5)
    last = lazy.read((slice(1699, 1701), slice(1699, 1701), slice(1699, 1701)))
    assert last.sum() == last[1, 1, 1] == 1700 % 251 + 1
    row = lazy.read((slice(1700, 1701), slice(3, 4), slice(0, n)))
    assert np.flatnonzero(row).tolist() == [5]
    assert lazy.read((slice(0, 1), slice(0, 1), slice(0, 1))).tolist() == [[[1]]]


def test_an_opened_volume_goes_to_another_process(tmp_path, monkeypatch):
    image = Volume.from_array(np.arange(24, dtype=np.int16).reshape(2, 3, 4), (2.0, 1.0, 1.0))
    io.write(image, tmp_path / "a.nii")
    box = (slice(0, 2), slice(1, 3), slice(0, 1))
    monkeypatch.chdir(tmp_path)
    packed = pickle.dumps(io.open_volume("a.nii"))
    monkeypatch.chdir(tmp_path.parent)
    for again in (pickle.loads(packed), pickle.loads(pickle.dumps(LazyVolume.of_array(image)))):
        assert (
            again.geometry.matches(image.geometry)
            and again.read(box).tolist() == image.array[box].tolist()
        )
    assert len(packed) < 2000, "the voxels stay in their file"
