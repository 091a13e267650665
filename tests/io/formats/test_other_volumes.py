"""GIPL and MGH are read where another program has put them."""

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import io
from accelsurf.errors import InputError

VALUES = np.random.default_rng(1).integers(-300, 300, (4, 5, 6)).astype(np.int16)


def test_gipl(tmp_path):
    image = sitk.GetImageFromArray(VALUES)
    image.SetSpacing((0.5, 0.75, 2.0))
    image.SetOrigin((10.0, -20.0, 30.0))
    sitk.WriteImage(image, str(tmp_path / "a.gipl"))
    volume = io.read(tmp_path / "a.gipl")
    assert np.array_equal(volume.array, VALUES) and volume.geometry.spacing == (2.0, 0.75, 0.5)
    content = (tmp_path / "a.gipl").read_bytes()
    for name, bad in (("short", content[:-7]), ("none", b"x" * 300), ("head", content[:100])):
        (tmp_path / f"{name}.gipl").write_bytes(bad)
        with pytest.raises(InputError):
            io.read(tmp_path / f"{name}.gipl")


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
    nibabel.save(nibabel.freesurfer.MGHImage(np.stack([data, data], -1), affine), tmp_path / f"t.{suffix}")
    with pytest.raises(InputError, match="2 frames"):
        io.read(tmp_path / f"t.{suffix}")
