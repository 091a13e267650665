"""MGH is read where another program has put them."""

import gzip

import nibabel
import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError

VALUES = np.random.default_rng(1).integers(-300, 300, (4, 5, 6)).astype(np.int16)


@pytest.mark.parametrize("suffix", ["mgz", "mgh"])
def test_mgh(tmp_path, suffix):
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * [0.5, 0.75, 2.0], (10, -20, 30)
    data = VALUES.transpose(2, 1, 0).astype(np.int32)
    nibabel.save(nibabel.freesurfer.MGHImage(data, affine), tmp_path / f"a.{suffix}")
    volume = io.read(tmp_path / f"a.{suffix}")
    assert np.array_equal(volume.array, VALUES)
    for index in ((0, 0, 0), (3, 4, 5), (1, 2, 3)):
        ras = (affine @ [*index[::-1], 1])[:3]
        assert volume.geometry.index_to_world(index) == pytest.approx(ras * [-1, -1, 1], abs=1e-4)
    content = (tmp_path / f"a.{suffix}").read_bytes()
    for number, bad in enumerate((content[: len(content) // 2], content[:100], b"x" * 400)):
        (tmp_path / f"{number}.{suffix}").write_bytes(bad)
        with pytest.raises(InputError):
            io.read(tmp_path / f"{number}.{suffix}")
    nibabel.save(
        nibabel.freesurfer.MGHImage(np.stack([data, data], -1), affine), tmp_path / f"t.{suffix}"
    )
    with pytest.raises(InputError, match="2 frames"):
        io.read(tmp_path / f"t.{suffix}")


@pytest.mark.parametrize("seed", range(6))
def test_mgh_whose_axes_have_another_length_than_1_is_refused(seed, tmp_path):
    """The size of a voxel would be said twice, and differently: by delta, and by the axes."""
    draw = np.random.default_rng(seed)
    image = nibabel.MGHImage(np.zeros((4, 5, 6), np.float32), np.diag([2.0, 3.0, 4.0, 1.0]))
    nibabel.save(image, tmp_path / "a.mgh")
    content = bytearray((tmp_path / "a.mgh").read_bytes())
    axis, place = int(draw.integers(3)), 42 if seed % 2 else 30
    value = float(draw.choice([0.5, 1.01, 1e9])) if seed % 2 else float(draw.choice([-2.0, -0.5]))
    at = place + (16 if seed % 2 else 4) * axis
    content[at : at + 4] = np.array(value, ">f4").tobytes()
    (tmp_path / "b.mgh").write_bytes(content)
    io.read(tmp_path / "a.mgh")
    with pytest.raises(InputError, match="have no length of 1, or voxels no positive size"):
        io.read(tmp_path / "b.mgh")


@pytest.mark.parametrize("seed", range(6))
def test_packed_mgh_whose_voxels_are_damaged_is_refused(seed, tmp_path):
    """Unpacked they are numbers like others: the checksum at the end of the stream tells."""
    image = nibabel.MGHImage(VALUES.astype(np.int32), np.eye(4))
    content = bytearray(gzip.compress(image.to_bytes(), 0))
    content[len(content) // 2 + seed] ^= 1 << seed
    (tmp_path / "a.mgz").write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        io.read(tmp_path / "a.mgz")


@pytest.mark.parametrize(
    "key", ["ElementSpacing = 1 2 3", "Offset = 5 5 5", "DimSize = 1 1 1", "junk"]
)
def test_a_metaimage_header_that_goes_on_after_its_data_file_is_refused(key, tmp_path):
    volume = io.read(_metaimage(tmp_path, ""))
    assert volume.array.shape == (4, 5, 6)
    with pytest.raises(InputError, match="goes on after ElementDataFile"):
        io.read(_metaimage(tmp_path, f"{key}\n"))


def _metaimage(folder, rest):
    (folder / "voxels.raw").write_bytes(bytes(240))
    head = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nDimSize = 6 5 4\n"
    path = folder / "a.mhd"
    path.write_text(f"{head}ElementType = MET_SHORT\nElementDataFile = voxels.raw\n{rest}")
    return path
