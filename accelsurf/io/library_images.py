"""Images of other libraries as volumes: SimpleITK, ITK, nibabel, xarray; arrays of torch and dask.

They are known by the module of their type: none of these libraries is imported for it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.sequence import ImageSequence, check_times
from accelsurf.image.volume import UNIT_KEY, Volume, array_on_grid
from accelsurf.io.files import library_named
from accelsurf.io.images import read
from accelsurf.settings.reading import spacing_of
from accelsurf.settings.wording import mm_of

_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0])
_EXPECTED = "a path, an array, or an image of accelsurf, SimpleITK, ITK, nibabel or xarray"
_LIBRARIES = ("SimpleITK", "itk", "nibabel", "xarray", "torch", "dask")
#: Distance of a coordinate from the even ones, in steps, that counts as rounding.
_ROUNDING = 1e-3


class ItkImage(Protocol):
    """An image of SimpleITK, as far as types can say it."""

    def GetSpacing(self) -> tuple[float, ...]:  # noqa: N802
        """Return the size of a voxel (x, y, z)."""


#: An image as the functions of ``accelsurf`` take it: a path, an array, or an image with its geometry.
ImageLike = Volume | os.PathLike[str] | ArrayLike | ItkImage


def as_volume(
    image: ImageLike,
    spacing: float | str | Sequence[float] | None = None,
    name: str = "the image",
    grid: Geometry | None = None,
) -> Volume:
    """Return an image as a volume.

    Parameters
    ----------
    image : Volume, path-like, array_like, or image of SimpleITK, ITK, nibabel or xarray
        See `from_library`. An array is (z, y, x).
    spacing : float or (hz, hy, hx), optional
        mm, of an array; 1 by default. A text is read as --spacing is: x, y, z, with a unit if wanted ("0.2,0.2,1um").
    name : str, optional
        Name of the image in messages.
    grid : Geometry, optional
        Of an array without a spacing.

    Raises
    ------
    InputError
        When it is none of these, or a spacing is given with an image that has its own; else as `accelsurf.read` and
        `from_library`.
    """
    given = from_library(image, name)
    if isinstance(given, (str, os.PathLike)):
        given = read(given)
    if isinstance(given, Volume):
        if spacing is not None:
            raise InputError(
                "spacing given together with an image, which has its own", "leave spacing out"
            )
        return given
    is_array = (
        isinstance(given, (list, tuple))
        or hasattr(given, "__array__")
        or hasattr(given, "__array_interface__")
    )
    several = hasattr(given, "data_vars")
    if not is_array or several or hasattr(given, "GetSpacing"):
        hint = (
            "take a variable: dataset['NAME']" if several else "accelsurf.read(PATH) reads a file"
        )
        raise InputError(f"{name}: a {type(given).__name__} was given, expected {_EXPECTED}", hint)
    if grid is not None and spacing is None:
        return Volume(array_on_grid(given, grid, name), grid)
    if not isinstance(spacing, str):
        return Volume.from_array(given, 1.0 if spacing is None else spacing)
    x, y, z = said = spacing_of(spacing)
    volume = Volume.from_array(given, (z, y, x))
    return Volume(volume.array, volume.geometry, {UNIT_KEY: said.unit} if said.unit else {})


def array_of(image: ImageLike, geometry: Geometry, name: str) -> NDArray[Any]:
    """Return the values of an image that lies on a grid, as `accelsurf.image.volume.array_on_grid`; a path is read.

    Parameters
    ----------
    image : image
        As of `as_volume`.
    geometry : Geometry
        The grid.
    name : str
        Name of the image in messages.

    Raises
    ------
    GeometryError
        When it lies on another grid; InputError as `as_volume`.
    """
    value = from_library(image, name)
    return array_on_grid(
        read(value) if isinstance(value, (str, os.PathLike)) else value, geometry, name
    )


class VolumeSequence(ImageSequence):
    """Frames as `accelsurf.segment` takes images, on one grid; each is read or computed when it is asked for.

    Parameters
    ----------
    frames : sequence of image, or array
        Of an array the first axis is time.
    times : float or sequence of float, optional
        Seconds from one to the next, or when each was taken; by default frames are counted.
    spacing : float or (hz, hy, hx), optional
        mm, of arrays; 1 by default.

    Raises
    ------
    InputError
        When it is no sequence, its first frame cannot be used, or the times do not rise; of a frame, when it is asked
        for, also when its grid is another.
    """

    def __init__(
        self,
        frames: Any,
        times: float | Sequence[float] | None = None,
        spacing: float | str | Sequence[float] | None = None,
    ) -> None:
        is_array = (
            hasattr(frames, "__array__")
            and getattr(frames, "ndim", 0) > 2
            and not hasattr(frames, "affine")
        )
        if not (is_array or isinstance(frames, (list, tuple))) or not len(frames):
            raise InputError(
                f"the sequence: a {type(frames).__name__} of no frames was given, expected a path, images in a list, "
                "or an array (time, ...)",
                "accelsurf.read_sequence(PATH) reads a file",
            )
        self._frames = frames
        self._spacing = spacing
        self.source = ""
        step = 1.0 if times is None else times
        self.times = (
            tuple(step * n for n in range(len(frames)))
            if isinstance(step, (int, float))
            else tuple(step)
        )
        self.time_unit = "frame" if times is None else "s"
        if len(self.times) != len(frames):
            raise InputError(
                f"{len(self.times)} times given for {len(frames)} frames, one for each expected"
            )
        check_times(self.times)
        self.geometry = as_volume(frames[0], spacing, "frame 0").geometry

    def _channels(self, number: int) -> list[Volume]:
        volume = as_volume(self._frames[number], self._spacing, f"frame {number}")
        if difference := self.geometry.difference(volume.geometry):
            raise InputError(f"frame {number} lies on another grid than frame 0: {difference}")
        return [volume]


def from_library(value: Any, name: str = "the image") -> Any:
    """Return an image of another library as a volume, an array of torch or dask as one of numpy, and others unchanged.

    Parameters
    ----------
    value : object
        SimpleITK and ITK: 2D is one slice. nibabel: by ``affine``, from RAS to LPS. xarray: the dimensions z, y, x in
        any order, others in theirs; evenly spaced coordinates in mm, or in the unit of their attribute ``units``, LPS;
        the attribute ``direction`` as ITK writes it. An xarray without coordinates is an array.
    name : str, optional
        Name of the image in messages.

    Raises
    ------
    InputError
        When it has several values per voxel, or further axes; GeometryError when its grid is none of perpendicular axes
        and even steps.

    Examples
    --------
    >>> import nibabel
    >>> affine = np.array([[-2.0, 0, 0, 7], [0, -1, 0, 8], [0, 0, 3, 9], [0, 0, 0, 1]])
    >>> from_library(nibabel.Nifti1Image(np.zeros((4, 5, 6), np.int16), affine))
    Volume(int16 array, Geometry(shape=(6, 5, 4), spacing=(3.0, 1.0, 2.0), origin=(-7.0, -8.0, 9.0)))
    """
    kinds = [kind.__module__.partition(".")[0] for kind in type(value).__mro__]
    library = next(
        (kind for kind in kinds if kind in _LIBRARIES),
        None,
    )
    if library == "SimpleITK" and hasattr(value, "GetSpacing"):
        from accelsurf.io.itk import volume_of

        return volume_of(value)
    if library == "itk" and hasattr(value, "GetBufferedRegion"):
        return _of_itk(value, name)
    if library == "nibabel" and hasattr(value, "affine"):
        return _of_nibabel(value)
    if library == "xarray" and hasattr(value, "dims") and not hasattr(value, "data_vars"):
        return _of_xarray(value, name)
    if library == "torch" and hasattr(value, "detach"):
        tensor = value.detach().cpu()
        return (tensor.float() if str(tensor.dtype) == "torch.bfloat16" else tensor).numpy()
    if library == "dask" and hasattr(value, "__array__"):
        return np.asarray(value)
    return value


def _of_itk(image: Any, name: str) -> Volume:
    """Return an image of ITK, whose arrays are (z, y, x) and whose world is LPS, as a volume; a 2D one is one slice."""
    axes, values = int(image.GetImageDimension()), int(image.GetNumberOfComponentsPerPixel())
    with library_named(f"{name}: an image of ITK without voxels given", "update its filter first"):
        array = np.asarray(image)
    if axes not in (2, 3) or values > 1 or array.ndim != axes:
        raise InputError(
            f"{name}: an image of ITK with {axes} axes and {values} values per voxel given, 3 and 1 expected",
            "take one time point, or one channel",
        )
    region, matrix = image.GetBufferedRegion(), image.GetDirection().GetVnlMatrix()
    direction = np.eye(3)
    direction[:axes, :axes] = [[matrix.get(i, j) for j in range(axes)] for i in range(axes)]
    # The first voxel in memory is not that of index 0 where a part was taken.
    origin = [float(part) for part in image.TransformIndexToPhysicalPoint(region.GetIndex())]
    spacing = [float(part) for part in image.GetSpacing()]
    more = 3 - axes
    return Volume.from_array(
        array.reshape((1,) * more + array.shape),
        [1.0] * more + spacing[::-1],
        origin + [0.0] * more,
        direction,
    )


def _of_nibabel(image: Any) -> Volume:
    """Return an image of nibabel, whose arrays are (x, y, z) and whose world is RAS, as a volume."""
    array = np.asanyarray(image.dataobj)
    while array.ndim > 3 and array.shape[-1] == 1:
        array = array[..., 0]
    units = getattr(image.header, "get_xyzt_units", lambda: ("mm",))()[0]
    affine = np.asarray(image.affine, np.float64) * (mm_of(units) or 1.0)
    matrix = _RAS_TO_LPS @ affine[:3, :3]
    steps = np.linalg.norm(matrix, axis=0)
    if not np.isfinite(affine).all() or not steps.all():
        raise GeometryError("the image: its affine is no transform", "correct it: image.affine")
    origin = (_RAS_TO_LPS @ affine[:3, 3]).tolist()
    return Volume.from_array(array.T, steps[::-1].tolist(), origin, matrix / steps)


def _of_xarray(image: Any, name: str) -> Volume | NDArray[Any]:
    """Return a DataArray as a volume, or without coordinates as an array."""
    named = [dim for dim in image.dims if str(dim).lower() in ("z", "y", "x")]
    if named:
        image = image.squeeze(
            [dim for dim in image.dims if dim not in named and image.sizes[dim] == 1], drop=True
        )
        if extra := [str(dim) for dim in image.dims if dim not in named]:
            raise InputError(
                f"{name}: dimensions {', '.join(map(str, image.dims))} were given, z, y, x expected",
                f"take one place of {extra[0]}: image.isel({extra[0]}=0)",
            )
        image = image.transpose(*sorted(named, key=lambda dim: "zyx".index(str(dim).lower())))
    array = np.asarray(image.values)
    if not any(dim in image.coords for dim in image.dims):
        return array
    axes = [
        _axis(image.coords[dim], name) if dim in image.coords else (0.0, 1.0) for dim in image.dims
    ]
    axes = [(0.0, 1.0)] * (3 - len(axes)) + axes
    steps = np.array([step for _, step in axes])
    direction, given = (
        np.eye(3),
        np.asarray(image.attrs.get("direction", np.eye(len(image.dims))), np.float64),
    )
    direction[: len(given), : len(given)] = np.flip(given)
    origin = [first for first, _ in axes][::-1]
    return Volume.from_array(
        array, np.abs(steps).tolist(), origin, direction * np.sign(steps[::-1])
    )


def _axis(coordinate: Any, name: str) -> tuple[float, float]:
    """Return the first place and the step, mm, of a coordinate of an xarray.

    Raises
    ------
    GeometryError
        When its places are no numbers in even steps, or its unit is no length.
    """
    unit = str(coordinate.attrs.get("units", "mm"))
    places = np.asarray(coordinate.values)
    where = f"{name}: coordinate {coordinate.name}"
    if not mm_of(unit) or places.dtype.kind not in "iuf":
        raise GeometryError(
            f"{where}: {unit if not mm_of(unit) else places.dtype} given, lengths expected"
        )
    places = places.astype(np.float64) * mm_of(unit)
    first, last = float(places[0]), float(places[-1])
    step = (last - first) / (len(places) - 1) if len(places) > 1 else 1.0
    even = first + step * np.arange(len(places))
    if step == 0 or not np.abs(places - even).max() <= _ROUNDING * abs(step):
        raise GeometryError(
            f"{where}: its places are not evenly spaced", "resample it: image.interp"
        )
    return first, step
