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
from accelsurf.io import write_labels
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
    assert same(as_volume(path), accelsurf.read(path)) and same(
        as_volume(str(path)), accelsurf.read(path)
    )
    upright = sitk.GetImageFromArray(values())
    flat = as_volume(upright[:, :, 5])
    assert flat.array.shape == (1, 14, 16) and flat.geometry.spacing[1:] == (1.0, 1.0)


class FakeMatrix:
    """A direction as ITK gives it."""

    def __init__(self, matrix):
        self.matrix = matrix

    def GetVnlMatrix(self):
        return self

    def get(self, i, j):
        return float(self.matrix[i, j])


class FakeItk:
    """An image of the package itk, which is not installed here; tried with itk 5.4."""

    __module__ = "itk.itkImagePython"

    def __init__(self, image, first=(0, 0, 0), values=1):
        self.image, self.first, self.values = image, first, values

    def __array__(self, dtype=None, copy=None):
        x, y, z = self.first
        array = sitk.GetArrayFromImage(self.image)
        return array[z:, y:, x:] if array.ndim == 3 else array

    def GetImageDimension(self):
        return self.image.GetDimension()

    def GetNumberOfComponentsPerPixel(self):
        return self.values

    def GetBufferedRegion(self):
        return self

    def GetIndex(self):
        return self.first[: self.image.GetDimension()]

    def GetSpacing(self):
        return self.image.GetSpacing()

    def GetDirection(self):
        axes = self.image.GetDimension()
        return FakeMatrix(np.reshape(self.image.GetDirection(), (axes, axes)))

    def TransformIndexToPhysicalPoint(self, index):
        return self.image.TransformIndexToPhysicalPoint([int(i) for i in index])


@pytest.mark.parametrize("first", [(0, 0, 0), (2, 1, 3)])
def test_an_image_of_itk_is_that_of_simpleitk(first):
    x, y, z = first
    assert same(as_volume(FakeItk(itk_image(), first)), as_volume(itk_image()[x:, y:, z:]))
    flat = itk_image()[:, :, 5]
    flat = sitk.GetImageFromArray(sitk.GetArrayFromImage(flat))
    flat.SetSpacing((0.5, 0.75))
    found = as_volume(FakeItk(flat))
    assert found.geometry.spacing == (1.0, 0.75, 0.5) and found.array.shape == (1, 14, 16)
    with pytest.raises(InputError, match="2 values per voxel"):
        as_volume(FakeItk(itk_image(), values=2))


@pytest.mark.parametrize("unit", ["mm", "micron", "unknown"])
def test_an_image_of_nibabel_is_what_its_file_is(tmp_path, unit):
    path, scale = tmp_path / "a.nii.gz", 1000.0 if unit == "micron" else 1.0
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = (
        scale * TURN * (1.0, 1.0, 2.0),
        [scale * 30, scale * -20, scale * 10],
    )
    image = nibabel.Nifti1Image(values().T[..., np.newaxis], affine)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    assert same(as_volume(image), accelsurf.read(path)) and same(
        as_volume(nibabel.load(path)), accelsurf.read(path)
    )
    assert as_volume(image).geometry.origin == pytest.approx((-30.0, 20.0, 10.0))
    mgh = nibabel.MGHImage(values().T.astype(np.float32), affine)
    nibabel.save(mgh, tmp_path / "a.mgz")
    assert as_volume(mgh).geometry.matches(
        accelsurf.read(tmp_path / "a.mgz").geometry, 1e-3 * scale
    )


def xarray_image(**coords):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    return xarray.DataArray(values(), dims=("z", "y", "x"), coords=coords)


def test_an_image_of_xarray_has_its_coordinates():
    image = xarray_image(
        z=10 + 2.0 * np.arange(12), y=-20 - np.arange(14.0), x=30 + np.arange(16.0)
    )
    volume = as_volume(image)
    assert volume.geometry.spacing == (2.0, 1.0, 1.0) and volume.geometry.origin == (
        30.0,
        -20.0,
        10.0,
    )
    assert np.array_equal(volume.geometry.index_to_world((1, 2, 3)), [33.0, -22.0, 12.0])
    turned = image.expand_dims(c=1).transpose("x", "c", "z", "y")
    assert same(as_volume(turned), volume)
    in_um = image.assign_coords(x=("x", 1000 * image.x.values, {"units": "um"}))
    assert same(as_volume(in_um), volume)
    straight = xarray_image(
        z=10 + 2.0 * np.arange(12), y=-20 + np.arange(14.0), x=30 + np.arange(16.0)
    )
    straight.attrs["direction"] = np.flip(TURN)  # as ITK gives it: z, y, x
    assert same(as_volume(straight), as_volume(itk_image()))
    assert as_volume(xarray_image(), 3.0).geometry.spacing == (3.0, 3.0, 3.0)


def test_what_of_xarray_cannot_be_used_is_refused():
    image = xarray_image(z=np.arange(12) ** 1.5, y=np.arange(14.0))
    with pytest.raises(GeometryError, match="coordinate z: its places are not evenly spaced"):
        as_volume(image)
    with pytest.raises(GeometryError, match="coordinate y: degrees given, lengths expected"):
        as_volume(
            image.drop_vars("z").assign_coords(y=("y", np.arange(14.0), {"units": "degrees"}))
        )
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
    assert same(
        as_volume(dask.from_array(values(), chunks=5), (2.0, 1.0, 1.0)),
        as_volume(values(), (2.0, 1.0, 1.0)),
    )
    torch = pytest.importorskip("torch", reason="torch is not installed")
    halves = torch.tensor(values(), dtype=torch.bfloat16)
    for tensor in (torch.tensor(values()), halves, torch.rand(3, 4, 5).requires_grad_()):
        assert np.array_equal(as_volume(tensor).array, tensor.detach().float().numpy())


@pytest.mark.parametrize(
    "given", [{}, 7, None, object(), b"scan.nii"], ids=lambda given: type(given).__name__
)
def test_what_is_no_image_names_the_reader(given):
    with pytest.raises(
        InputError, match=f"a {type(given).__name__} was given, expected a path, an array"
    ) as refused:
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
    session = accelsurf.Interaction(image, channels=[image])
    session.start_from(mask)
    assert np.array_equal(session.labels, wanted.labels)


def test_agreement_of_label_maps_of_any_kind(tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    dask = pytest.importorskip("dask.array", reason="dask is not installed")
    image = as_volume(itk_image())
    first, second = (
        image.with_array((image.array > 50).astype(np.uint8)),
        image.with_array((image.array > 0) * 3),
    )
    second.array[:5] = 0
    wanted = accelsurf.evaluate(first, second)
    assert wanted.dice < 0.8 and wanted.volume_pred_mm3 == 2 * first.array.sum()
    mask = sitk.GetImageFromArray(first.array)
    mask.CopyInformation(itk_image())
    accelsurf.write(mask, tmp_path / "pred.nii.gz")
    assert same(accelsurf.read(tmp_path / "pred.nii.gz"), first)
    others = [second, str(tmp_path / "ref.nrrd"), second.array, dask.from_array(second.array)]
    accelsurf.write(second, others[1])
    for pred in (
        first,
        mask,
        first.array,
        tmp_path / "pred.nii.gz",
        nibabel.load(tmp_path / "pred.nii.gz"),
    ):
        for number, ref in enumerate(others):
            given = {"spacing": (2.0, 1.0, 1.0)} if pred is first.array and number > 1 else {}
            found = accelsurf.evaluate(pred, ref, **given).to_dict()
            assert found == pytest.approx(wanted.to_dict(), rel=1e-5), (type(pred), type(ref))
    coords = {"z": 2.0 * np.arange(12), "y": np.arange(14.0), "x": np.arange(16.0)}
    pair = [xarray.DataArray(labels.array, coords, dims=tuple("zyx")) for labels in (first, second)]
    assert accelsurf.evaluate(*pair) == wanted
    with pytest.raises(GeometryError, match="not on the same grid"):
        accelsurf.evaluate(pair[0], second)
    with pytest.raises(GeometryError, match=r"ref: an array of shape \(12, 14, 1\)"):
        accelsurf.evaluate(mask, second.array[..., :1])
    with pytest.raises(InputError, match="spacing given together with an image"):
        accelsurf.evaluate(mask, second.array, spacing=2.0)
    for wrong in (3, {}, None):
        with pytest.raises(InputError, match="pred: a"):
            accelsurf.evaluate(wrong, second)
        with pytest.raises(InputError, match="ref: a"):
            accelsurf.evaluate(second.array, wrong)


def test_images_of_any_kind_are_written(tmp_path):
    volume = as_volume(itk_image())
    for number, image in enumerate((itk_image(), xarray_image(), values(), values().tolist())):
        path = tmp_path / f"{number}.nrrd"
        accelsurf.write(image, path, **({} if number == 0 else {"spacing": (2.0, 1.0, 1.0)}))
        written = accelsurf.read(path)
        assert np.array_equal(written.array, volume.array) and written.geometry.spacing == (
            2.0,
            1.0,
            1.0,
        )
    assert same(accelsurf.read(tmp_path / "0.nrrd"), volume)
    write_labels(itk_image(), tmp_path / "labels.nii.gz")
    assert accelsurf.read(tmp_path / "labels.nii.gz").array.dtype == np.uint8
    before = (tmp_path / "0.nrrd").read_bytes()
    for wrong in ({}, 7, tmp_path / "no.nii", np.zeros((2, 3, 4, 5, 6))):
        with pytest.raises(InputError):
            accelsurf.write(wrong, tmp_path / "0.nrrd")
    assert (tmp_path / "0.nrrd").read_bytes() == before and len(list(tmp_path.iterdir())) == 5


def frames():
    """A ball that moves by a voxel along x."""
    z, y, x = np.indices((14, 16, 22)) - 7.0
    return [(100 * (z**2 + y**2 + (x - n) ** 2 < 25)).astype(np.float32) for n in range(3)]


def test_frames_of_any_kind_are_followed(tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    dask = pytest.importorskip("dask.array", reason="dask is not installed")
    stack, start = np.stack(frames()), (frames()[0] > 50).astype(np.uint8)
    np.save(tmp_path / "frames.npy", stack)
    for number, frame in enumerate(stack):
        accelsurf.write(frame, tmp_path / f"f{number}.nii")
    coords = {axis: np.arange(float(n)) for axis, n in zip("zyx", stack.shape[1:], strict=True)}
    kinds = {
        "array": stack,
        "dask": dask.from_array(stack, chunks=(1, 14, 16, 22)),
        "path": tmp_path / "frames.npy",
        "sitk": [sitk.GetImageFromArray(frame) for frame in stack],
        "files": sorted(tmp_path.glob("f?.nii")),
        "xarray": xarray.DataArray(stack, coords, dims=tuple("tzyx")),
        "pattern": str(tmp_path / "f?.nii"),
    }
    for name, given in kinds.items():
        tracking = accelsurf.track(given, objects=sitk.GetImageFromArray(start), max_steps=60)
        middles = [round(result.objects[0].centroid[0], 1) for result in tracking]
        assert middles == [7.0, 8.0, 9.0], name
    tracking = accelsurf.track(stack, spacing=(2.0, 1.0, 1.0), frame_time=0.5, objects=start)
    sequence = tracking.sequence
    assert sequence.geometry.spacing == (2.0, 1.0, 1.0)
    assert (sequence.times, sequence.time_unit) == ((0.0, 0.5, 1.0), "s")
    tracking.close()


def test_frames_that_are_none_are_refused(tmp_path):
    for wrong in (
        [],
        7,
        None,
        np.zeros((3, 4)),
        accelsurf.Volume.from_array(frames()[0]),
        itk_image(),
        nibabel.Nifti1Image(np.zeros((4, 5, 6, 3), np.int16), np.eye(4)),
    ):
        with pytest.raises(InputError, match="the sequence: a ") as refused:
            accelsurf.track(wrong)
        assert "accelsurf.read_sequence" in refused.value.hint
    with pytest.raises(InputError, match="spacing given together with a sequence"):
        accelsurf.track(tmp_path / "frames.npy", spacing=2.0)
    tracking = accelsurf.track(
        [*frames(), frames()[0][1:]], objects=(frames()[0] > 50).astype(np.uint8)
    )
    with pytest.raises(InputError, match="frame 3 lies on another grid"):
        list(tracking)


@pytest.mark.parametrize("flat", [False, True])
def test_clicks_in_the_order_of_the_axes(flat):
    image, inside, outside = values(), [(5, 6, 7)], [(0, 1, 2), (11, 12, 13)]
    if flat:
        image, inside, outside = image[5], (6, 7), [(1, 2), (12, 13)]
    labels, result = accelsurf.segment_clicks(
        image, inside, outside, return_result=True, spacing=1.0
    )
    assert labels.shape == image.shape and labels.dtype == np.uint8
    assert 2 * (labels & (image > 50)).sum() / (labels.sum() + (image > 50).sum()) > 0.98
    assert result.config.inside == (("point:7,6,0vox",) if flat else ("point:7,6,5vox",))
    core = np.zeros(image.shape, bool)
    core[np.unravel_index(image.argmax(), image.shape)] = True
    assert accelsurf.segment_clicks(image, core).any()


def test_clicks_that_are_none_are_refused():
    with pytest.raises(
        UsageError, match=r"inside: an array of shape \(1, 2\) was given, expected indices \(n, 3\)"
    ):
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
        "accelsurf.track([image, image], spacing=2.0, objects=image)": "",
        "accelsurf.track(image, config=accelsurf.TrackConfig())": "",
        "accelsurf.write(image, 'a.nii', spacing=(1.0, 1.0, 2.0))": "",
        "accelsurf.evaluate(image, 'a.nii').dice + 1.0": "",
        "accelsurf.track('a.nii', start='otsu', direction='both', friction='auto', max_steps=9)": "",
        "accelsurf.segment(image, smoothnes=1.0)": "smoothnes",
        "accelsurf.evolve(image, cfl='large')": "cfl",
        "accelsurf.segment_objects(image, image, max_stepps=3)": "max_stepps",
        "accelsurf.segment_many('scans', 'out', smoothness='no')": "smoothness",
        "accelsurf.track(image, direction='back')": "direction",
        "accelsurf.segment_clicks(image, [(1, 2, 3)]).volume_mm3": "volume_mm3",
    }
    script = tmp_path / "options.py"
    script.write_text(
        "import numpy as np\nimport accelsurf\nimage = np.zeros((4, 5, 6))\n"
        + "\n".join(lines)
        + "\n"
    )
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", str(script)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    for number, wrong in enumerate(lines.values(), start=4):
        # The folder is that of the run whose answer mypy's cache has kept.
        said = [
            line for line in run.stdout.splitlines() if f"{script.name}:{number}: error" in line
        ]
        assert bool(said) == bool(wrong) and all(wrong in line for line in said), (
            run.stdout + run.stderr
        )
