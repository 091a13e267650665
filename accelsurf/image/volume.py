"""A volume: an array (z, y, x) and where it lies. Made by `accelsurf.io.read`, or from a plain array."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image import thumbnail
from accelsurf.image.check import ImageCheck, Places

#: The entry of metadata with the unit of length of a file where it is smaller than mm: um or nm.
UNIT_KEY = "spatial_unit"


def plain_array(value: Any, name: str) -> NDArray[Any]:
    """An array as it is; of a masked one, in which nothing is masked, the data.

    Parameters
    ----------
    value : array_like
    name : str
        Name in messages.

    Raises
    ------
    InputError
        When values of it are masked: their meaning is not known.

    Examples
    --------
    >>> plain_array([1, 2], "mask")
    array([1, 2])
    """
    if not isinstance(value, np.ma.MaskedArray):
        return np.asarray(value)
    count = int(np.ma.count_masked(value))
    if count:
        raise InputError(
            f"{name}: a masked array with {count} masked of {value.size} values was given, values expected",
            "give array.filled(value) with the value of the background, and mask=~numpy.ma.getmaskarray(array) to keep "
            "the surface out",
        )
    return np.asarray(value.data)


@dataclass(frozen=True, eq=False, repr=False)
class Volume:
    """Voxel values on a grid.

    Parameters
    ----------
    array : ndarray, shape (nz, ny, nx)
        Real numbers or booleans. Not copied; accelsurf never writes into it.
    geometry : Geometry
        The grid, of the same shape.
    metadata : dict of str to str, optional
        Entries of the file's header beyond the grid; `accelsurf.io.write` uses it to give the same header back.
    source : Path, optional
        The file it was read from.

    Raises
    ------
    InputError
        When the array is not 3D, is empty, is not of a real type, or its shape is not the grid's.
    """

    array: NDArray[Any]
    geometry: Geometry
    metadata: dict[str, str] = field(default_factory=dict)
    source: Path | None = None

    def __post_init__(self) -> None:
        array = self.array
        if not isinstance(array, np.ndarray):
            raise InputError(f"a {type(array).__name__} given, a numpy array expected")
        if isinstance(array, np.ma.MaskedArray):
            object.__setattr__(self, "array", array := plain_array(array, "the image"))
        if array.dtype.kind not in "buif":
            raise InputError(
                f"an array of type {array.dtype} given, real numbers expected",
                hint="for complex values segment one real part, e.g. numpy.abs(array)",
            )
        if array.ndim != 3:
            raise InputError(
                f"an array of {array.ndim} dimensions given, 3 (z, y, x) expected",
                hint="take one channel or time point; Volume.from_array accepts 2D as one slice",
            )
        if array.shape != self.geometry.shape:
            raise InputError(
                f"an array of shape {array.shape} given, the grid's {self.geometry.shape} expected"
            )
        object.__setattr__(self, "geometry", in_unit_of(self.metadata, self.geometry))

    def __repr__(self) -> str:
        source = f", source={str(self.source)!r}" if self.source is not None else ""
        return f"Volume({self.array.dtype} array, {self.geometry!r}{source})"

    def _repr_html_(self) -> str:
        """The middle slice and the repr, for notebooks."""
        return thumbnail.as_html(repr(self), self.array, self.geometry)

    @classmethod
    def from_array(
        cls,
        array: ArrayLike,
        spacing: float | Sequence[float] = 1.0,
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        direction: ArrayLike | None = None,
    ) -> Volume:
        """A volume from a plain array.

        Parameters
        ----------
        array : array_like, shape (nz, ny, nx) or (ny, nx)
            Voxel values; a 2D image becomes one slice.
        spacing : float or sequence of float, optional
            mm in array order: (hz, hy, hx), or one number for all axes. For a 2D image also (hy, hx); the slice is
            then 1 mm thick.
        origin : sequence of float, optional
            World position (x, y, z), mm LPS, of the first voxel's centre.
        direction : array_like, shape (3, 3), optional
            As in `Geometry`; the identity by default.

        Raises
        ------
        InputError
            When the array cannot be a volume; GeometryError when the grid cannot be one.

        Examples
        --------
        >>> import numpy as np
        >>> Volume.from_array(np.zeros((4, 5)), spacing=(0.5, 0.25)).geometry.spacing
        (1.0, 0.5, 0.25)
        """
        values = plain_array(array, "the image")
        flat = values.ndim == 2
        if flat:
            values = values[np.newaxis]
        if values.ndim != 3 or values.size == 0:
            raise InputError(
                f"an array of shape {values.shape} given, (z, y, x) with at least one voxel expected",
                hint="take one channel or time point of it first",
            )
        written: object = spacing
        if isinstance(written, str):
            raise InputError(
                f"spacing: the text {written[:40]!r} was given, expected mm as numbers, one or (hz, hy, hx)",
                "0.2 um are 0.0002 mm; accelsurf.segment(array, spacing='0.2um') takes texts",
            )
        steps = (
            (float(spacing),) * 3
            if isinstance(spacing, (int, float, np.number))
            else tuple(spacing)
        )
        if flat and len(steps) == 2:
            steps = (1.0, *steps)
        frame = np.eye(3) if direction is None else np.asarray(direction)
        # Geometry checks every one of them and says which is wrong; the casts are for the type checker only.
        geometry = Geometry(values.shape, steps, tuple(origin), frame)  # type: ignore[arg-type]
        return cls(values, geometry)

    def as_float32(self) -> NDArray[np.float32]:
        """The values as a new C-contiguous float32 array, (z, y, x); the solver may write into it.

        Raises
        ------
        InputError
            When a voxel is NaN or infinite, or too large for float32; the message has the count and the first place.
        """
        if self.array.dtype.kind == "f" and not np.isfinite(self.array).all():
            check = ImageCheck()
            check.add(self.array)
            check.refuse_nonfinite()
        with np.errstate(over="ignore"):  # a float64 beyond float32 becomes inf; named below
            values = np.array(self.array, dtype=np.float32, order="C", copy=True)
        if self.array.dtype.itemsize > 4 and not np.isfinite(values).all():
            raise InputError(
                f"{Places.of(~np.isfinite(values))} beyond the range of 32-bit floats (3.4e38)",
                hint="rescale the image, e.g. divide it by its largest value",
            )
        return values

    def with_array(self, array: NDArray[Any]) -> Volume:
        """Another array on the same grid, with the same header metadata (but no source: it was not read)."""
        return Volume(array, self.geometry, dict(self.metadata))


def voxels_sha256(channels: Sequence[Volume]) -> str:
    """Return the SHA-256 of the values of an image and their type, whatever file they come from; not of its grid.

    Parameters
    ----------
    channels : sequence of Volume

    Examples
    --------
    >>> one, other = (Volume.from_array(np.full((2, 3, 4), value)) for value in (1, 2))
    >>> voxels_sha256([one]) == voxels_sha256([one.with_array(one.array.copy())]) != voxels_sha256([other])
    True
    """
    sha = hashlib.sha256()
    for volume in channels:
        stored = volume.array.dtype.newbyteorder("<")
        sha.update(f"{stored.str} {volume.array.shape}\n".encode())
        for plane in volume.array:
            sha.update(np.ascontiguousarray(plane, stored).data)
    return sha.hexdigest()


def in_unit_of(metadata: Mapping[str, str], geometry: Geometry) -> Geometry:
    """Return a grid whose lengths are shown in the unit of a file's metadata, where these name one.

    Examples
    --------
    >>> in_unit_of({UNIT_KEY: "um"}, Geometry((1, 1, 1), (1.0, 1.0, 1.0))).unit
    'um'
    """
    unit = metadata.get(UNIT_KEY, geometry.unit)
    return geometry if unit == geometry.unit else replace(geometry, unit=unit)


def check_images(volumes: Sequence[Volume]) -> None:
    """Refuse an image of one or several channels as `check_image`; an error names the channel."""
    for number, volume in enumerate(volumes):
        with naming_channel(number, len(volumes)):
            check_image(volume)


@contextmanager
def naming_channel(number: int, count: int) -> Iterator[None]:
    """Name the channel in an error about one of several."""
    try:
        yield
    except InputError as error:
        if count < 2:
            raise
        said = f"channel {number} of 0 to {count - 1}: {error.message}"
        raise type(error)(said, error.hint) from None


def check_image(volume: Volume) -> None:
    """Refuse an image that nothing can be segmented from.

    Raises
    ------
    InputError
        When a voxel is NaN, infinite or beyond 1e30, when their range is below 1e-30, or when all voxels
        have the same value.

    Examples
    --------
    >>> check_image(Volume.from_array([[0, 1], [1, 0]]))
    """
    check = ImageCheck()
    check.add(volume.array)
    check.refuse()


def array_on_grid(value: Volume | NDArray[Any], geometry: Geometry, name: str) -> NDArray[Any]:
    """Return the values of a volume, or of an array, that lies on a grid; a 2D array is one slice.

    Parameters
    ----------
    value : Volume or ndarray (nz, ny, nx)
    geometry : Geometry
        The image's grid.
    name : str
        Name in messages.

    Raises
    ------
    GeometryError
        When it lies on another grid, or has another shape.
    """
    if isinstance(value, Volume):
        if not value.geometry.matches(geometry):
            raise GeometryError(
                f"{name}: on another grid than the image: {value.geometry.difference(geometry)}",
                "resample it to the image's grid first, nearest neighbour",
            )
        return value.array
    array = plain_array(value, name)
    array = array[np.newaxis] if array.ndim == 2 else array
    if array.shape != geometry.shape:
        raise GeometryError(
            f"{name}: an array of shape {array.shape} was given, expected the image's {geometry.shape}",
            "both are (z, y, x)",
        )
    return array
