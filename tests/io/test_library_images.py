"""Images of other libraries: each as that library makes it, and as the file that it has written is read."""

import subprocess
import sys
from pathlib import Path

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk

import accelsurf
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.io.library_images import as_volume

ROOT = Path(__file__).parents[2]
#: A turn about an oblique axis: no place is where it would be with axes left out, or mixed up.
TURN = np.array([[2.0, -2, 1], [1, 2, 2], [-2, -1, 2]]) / 3


def values():
    """A ball (5, 6, 7) voxels from the origin, on an image of which no two axes are alike."""
    z, y, x = np.indices((12, 14, 16)) - np.array([5, 6, 7])[:, None, None, None]
    return (100 * (4 * z**2 + y**2 + x**2 < 25)).astype(np.int16)


def itk_image():
    image = sitk.GetImageFromArray(values())
    image.SetSpacing((1.0, 1.0, 2.0))
    image.SetOrigin((30.0, -20.0, 10.0))
    image.SetDirection(TURN.ravel().tolist())
    return image


def same(found, wanted):
    """Test if two volumes have the same voxels at the same places."""
    return found.geometry.matches(wanted.geometry) and np.array_equal(found.array, wanted.array)


def test_an_image_of_simpleitk_is_what_its_file_is(tmp_path):
    path = tmp_path / "a.nrrd"
    sitk.WriteImage(itk_image(), str(path))
    assert same(as_volume(itk_image()), accelsurf.read(path))
    assert same(as_volume(path), accelsurf.read(path)) and same(as_volume(str(path)), accelsurf.read(path))
    upright = sitk.GetImageFromArray(values())
    flat = as_volume(upright[:, :, 5])
    assert flat.array.shape == (1, 14, 16) and flat.geometry.spacing[1:] == (1.0, 1.0)


@pytest.mark.parametrize("unit", ["mm", "micron", "unknown"])
def test_an_image_of_nibabel_is_what_its_file_is(tmp_path, unit):
    path, scale = tmp_path / "a.nii.gz", 1000.0 if unit == "micron" else 1.0
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = scale * TURN * (1.0, 1.0, 2.0), [scale * 30, scale * -20, scale * 10]
    image = nibabel.Nifti1Image(values().T[..., np.newaxis], affine)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    assert same(as_volume(image), accelsurf.read(path)) and same(as_volume(nibabel.load(path)), accelsurf.read(path))
    assert as_volume(image).geometry.origin == pytest.approx((-30.0, 20.0, 10.0))
    mgh = nibabel.MGHImage(values().T.astype(np.float32), affine)
    nibabel.save(mgh, tmp_path / "a.mgz")
    assert as_volume(mgh).geometry.matches(accelsurf.read(tmp_path / "a.mgz").geometry, 1e-3 * scale)


def xarray_image(**coords):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    return xarray.DataArray(values(), dims=("z", "y", "x"), coords=coords)


def test_an_image_of_xarray_has_its_coordinates():
    image = xarray_image(z=10 + 2.0 * np.arange(12), y=-20 - np.arange(14.0), x=30 + np.arange(16.0))
    volume = as_volume(image)
    assert volume.geometry.spacing == (2.0, 1.0, 1.0) and volume.geometry.origin == (30.0, -20.0, 10.0)
    assert np.array_equal(volume.geometry.index_to_world((1, 2, 3)), [33.0, -22.0, 12.0])
    turned = image.expand_dims(c=1).transpose("x", "c", "z", "y")
    assert same(as_volume(turned), volume)
    in_um = image.assign_coords(x=("x", 1000 * image.x.values, {"units": "um"}))
    assert same(as_volume(in_um), volume)
    straight = xarray_image(z=10 + 2.0 * np.arange(12), y=-20 + np.arange(14.0), x=30 + np.arange(16.0))
    straight.attrs["direction"] = np.flip(TURN)  # as ITK gives it: z, y, x
    assert same(as_volume(straight), as_volume(itk_image()))
    assert as_volume(xarray_image(), 3.0).geometry.spacing == (3.0, 3.0, 3.0)


def test_what_of_xarray_cannot_be_used_is_refused():
    image = xarray_image(z=np.arange(12) ** 1.5, y=np.arange(14.0))
    with pytest.raises(GeometryError, match="coordinate z: its places are not evenly spaced"):
        as_volume(image)
    with pytest.raises(GeometryError, match="coordinate y: degrees given, lengths expected"):
        as_volume(image.drop_vars("z").assign_coords(y=("y", np.arange(14.0), {"units": "degrees"})))
    with pytest.raises(InputError, match=r"dimensions time, y, x were given") as refused:
        as_volume(image.drop_vars("z").rename(z="time"))
    assert "isel(time=0)" in refused.value.hint
    with pytest.raises(InputError, match="a Dataset was given") as refused:
        as_volume(image.to_dataset(name="ct"))
    assert "dataset['NAME']" in refused.value.hint
    with pytest.raises(InputError, match="spacing given together with an image"):
        as_volume(image.drop_vars("z"), 2.0)


def test_arrays_of_torch_and_dask_are_arrays():
    dask = pytest.importorskip("dask.array", reason="dask is not installed")
    assert same(as_volume(dask.from_array(values(), chunks=5), (2.0, 1.0, 1.0)), as_volume(values(), (2.0, 1.0, 1.0)))
    torch = pytest.importorskip("torch", reason="torch is not installed")
    halves = torch.tensor(values(), dtype=torch.bfloat16)
    for tensor in (torch.tensor(values()), halves, torch.rand(3, 4, 5).requires_grad_()):
        assert np.array_equal(as_volume(tensor).array, tensor.detach().float().numpy())


@pytest.mark.parametrize("given", [{}, 7, None, object(), b"scan.nii"], ids=lambda given: type(given).__name__)
def test_what_is_no_image_names_the_reader(given):
    with pytest.raises(InputError, match=f"a {type(given).__name__} was given, expected a path, an array") as refused:
        accelsurf.segment(given)
    assert "accelsurf.read" in refused.value.hint


def test_images_of_several_values_are_refused():
    with pytest.raises(InputError, match="3 axes and 3 values per voxel"):
        as_volume(sitk.Image([4, 5, 6], sitk.sitkVectorUInt8, 3))
    with pytest.raises(InputError, match="of shape"):
        as_volume(nibabel.Nifti1Image(np.zeros((4, 5, 6, 7), np.int16), np.eye(4)))
    with pytest.raises(GeometryError, match="not orthonormal"):
        as_volume(nibabel.Nifti1Image(np.zeros((4, 5, 6)), np.eye(4) + np.eye(4, k=1)))


def test_every_function_takes_them():
    image, volume = itk_image(), as_volume(itk_image())
    click = "point:7,6,5vox"
    wanted = accelsurf.segment(volume, inside=click)
    found = accelsurf.segment(image, inside=click, channels=())
    assert np.array_equal(found.labels, wanted.labels) and found.geometry.matches(volume.geometry)
    mask = sitk.GetImageFromArray(wanted.labels)
    mask.CopyInformation(image)
    assert np.array_equal(accelsurf.segment(image, start=mask, max_steps=0).labels, wanted.labels)
    assert np.array_equal(accelsurf.segment_objects(image, mask, max_steps=0).labels, wanted.labels)
    assert np.array_equal(accelsurf.refine(image, labels=mask, islands="1ml").labels, wanted.labels)
    assert next(iter(accelsurf.evolve(image, mask=mask, start=mask))).surface.labels.any()
    session = accelsurf.ClickSession(image, channels=[image])
    session.start_from(mask)
    assert np.array_equal(session.labels, wanted.labels)


@pytest.mark.parametrize("flat", [False, True])
def test_clicks_in_the_order_of_the_axes(flat):
    image, inside, outside = values(), [(5, 6, 7)], [(0, 1, 2), (11, 12, 13)]
    if flat:
        image, inside, outside = image[5], (6, 7), [(1, 2), (12, 13)]
    labels, result = accelsurf.segment_clicks(image, inside, outside, return_result=True, spacing=1.0)
    assert labels.shape == image.shape and labels.dtype == np.uint8
    assert 2 * (labels & (image > 50)).sum() / (labels.sum() + (image > 50).sum()) > 0.98
    assert result.config.inside == (("point:7,6,0vox",) if flat else ("point:7,6,5vox",))
    core = np.zeros(image.shape, bool)
    core[np.unravel_index(image.argmax(), image.shape)] = True
    assert accelsurf.segment_clicks(image, core).any()


def test_clicks_that_are_none_are_refused():
    with pytest.raises(UsageError, match=r"inside: an array of shape \(1, 2\) was given, expected indices \(n, 3\)"):
        accelsurf.segment_clicks(values(), [(1, 2)])
    with pytest.raises(UsageError, match="inside: nothing was given"):
        accelsurf.segment_clicks(values(), [])
    with pytest.raises(InputError, match="lies outside"):
        accelsurf.segment_clicks(values(), [(5, 6, 17)])
    with pytest.raises(InputError, match="a Image was given, an array expected") as refused:
        accelsurf.segment_clicks(itk_image(), [(5, 6, 7)])
    assert "accelsurf.read" in refused.value.hint


def test_a_type_checker_sees_the_options(tmp_path):
    lines = {
        "accelsurf.segment(image, inside=[(1.0, 2.0, 3.0)], flow='gradient', cfl=0.3, levels='auto')": "",
        "accelsurf.segment('a.nii', start='otsu', energy='geodesic', mesh=['ply'])": "",
        "labels, result = accelsurf.segment_clicks(image, [(1, 2, 3)], return_result=True)": "",
        "accelsurf.segment_many('scans', 'out', start='otsu', jobs=2)": "",
        "accelsurf.segment(image, smoothnes=1.0)": "smoothnes",
        "accelsurf.segment(image, flow='gradent')": "flow",
        "accelsurf.evolve(image, cfl='large')": "cfl",
        "accelsurf.segment_objects(image, image, max_stepps=3)": "max_stepps",
        "accelsurf.segment_many('scans', 'out', smoothness='no')": "smoothness",
        "accelsurf.segment_clicks(image, [(1, 2, 3)]).volume_mm3": "volume_mm3",
    }
    script = tmp_path / "options.py"
    script.write_text("import numpy as np\nimport accelsurf\nimage = np.zeros((4, 5, 6))\n" + "\n".join(lines) + "\n")
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", str(script)], cwd=ROOT, capture_output=True,
        text=True,
    )  # fmt: skip
    for number, wrong in enumerate(lines.values(), start=4):
        said = [line for line in run.stdout.splitlines() if line.startswith(f"{script}:{number}: error")]
        assert bool(said) == bool(wrong) and all(wrong in line for line in said), run.stdout + run.stderr
