"""segment(), segment_objects(), evolve(): from an image and rough starts to labels, meshes and the run's history."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.evolution import Step, StepRecord
from accelsurf.grid.clicks import SIDES, Side
from accelsurf.image.volume import Volume
from accelsurf.interact import OnObjectStep, finished, result_of, with_corrections
from accelsurf.io import ImageLike, LazyVolume, as_volume, from_library
from accelsurf.run import (
    CheckpointFile,
    EnergyLike,
    ObjectsLike,
    Result,
    Run,
    given_clicks,
    psi_of,
    split_given,
    with_options,
)
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.api.options import GivenOptions, Options, SegmentOptions

__all__ = [
    "EnergyLike",
    "Result",
    "Run",
    "evolve",
    "result_of",
    "segment",
    "segment_clicks",
    "segment_objects",
]


def segment(
    image: ImageLike | LazyVolume,
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
    channels: Sequence[ImageLike] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    on_step: Callable[[StepRecord], bool | None] | None = None,
    on_warning: Callable[[str], None] | None = None,
    checkpoint_to: str | Path | CheckpointFile | None = None,
    **options: Unpack[SegmentOptions],
) -> Result:
    """Segment one object.

    Parameters
    ----------
    image : path-like, ndarray (nz, ny, nx), Volume, LazyVolume, or image of SimpleITK, nibabel or xarray
        Never modified. An image of a library has its geometry; nibabel's, which is RAS, is turned to LPS. Tensors of
        torch and arrays of dask are arrays. Of `accelsurf.open_volume` parts near the object are read, with the same
        result.
    spacing : float, str or (hz, hy, hx), optional
        mm, for an array only, in the order of its axes; 1 by default. A text is as of ``--spacing``: x, y, z, with a
        unit if wanted ("0.2,0.2,1um"), in which sizes are then shown. Clicks and starts are x, y, z.
    channels : sequence of images, optional
        Further ones, on the same grid.
    config : RunConfig, optional
    energy : str or Energy or callable, optional
        A name; an `accelsurf.energies.Energy`, or a callable that makes one of `Result.image` and (hz, hy, hx) mm.
    on_step : callable, optional
        Called with each `StepRecord`; a true return value ends the run with the reason ``interrupted``.
    on_warning : callable, optional
        Called before the first step with each of `Result.warnings`.
    checkpoint_to : path-like, optional
        File of the run's state, see the setting ``checkpoint``: where it exists the run continues, to the same bytes.
    **options
        Settings by name, over ``config``. A start, mask, foreground, background or click may also be an array,
        an image, a mesh with ``vertices`` and ``faces``, or balls (x, y, z, r); a click also (x, y, z). All in mm, LPS.
        Of a LazyVolume texts only, and ``max_memory`` for the run, as "4GB" (0.8 of the free memory).

    Returns
    -------
    Result

    Raises
    ------
    UsageError
        When an option is unknown or out of bounds, a start cannot be parsed, or an energy is incomplete; InputError
        when the image, the start, a value of your own energy, or ``checkpoint_to`` cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> image = 100.0 * (((np.indices((24, 24, 24)) - 11.5) ** 2).sum(axis=0) < 8**2)
    >>> result = segment(image, start="ball:9,9,9,4vox", max_steps=200)
    >>> result.stop.reason, result.components, bool((result.labels == (image > 50)).mean() > 0.99)
    ('converged', 1, True)
    """
    watch: OnObjectStep | None = None if on_step is None else lambda record, id: on_step(record)
    if isinstance(image, LazyVolume):
        from accelsurf.large import segment_lazily

        given = {"spacing": spacing, "channels": channels, "energy": energy, **options}
        return segment_lazily(image, config, watch, on_warning, checkpoint_to, given)
    checkpoints = CheckpointFile.of(checkpoint_to)
    run = _run_of(image, spacing, channels, config, energy, {**options}, None, checkpoints)
    return with_corrections(finished(run, watch, on_warning, checkpoints), watch)


@overload
def segment_clicks(
    image: ArrayLike,
    inside: ArrayLike,
    outside: ArrayLike = ...,
    *,
    spacing: float | str | Sequence[float] = ...,
    return_result: Literal[False] = ...,
    **options: Unpack[Options],
) -> NDArray[np.uint8]: ...


@overload
def segment_clicks(
    image: ArrayLike,
    inside: ArrayLike,
    outside: ArrayLike = ...,
    *,
    spacing: float | str | Sequence[float] = ...,
    return_result: Literal[True],
    **options: Unpack[Options],
) -> tuple[NDArray[np.uint8], Result]: ...


def segment_clicks(
    image: ArrayLike,
    inside: ArrayLike,
    outside: ArrayLike = (),
    *,
    spacing: float | str | Sequence[float] = 1.0,
    return_result: bool = False,
    **options: Unpack[Options],
) -> NDArray[np.uint8] | tuple[NDArray[np.uint8], Result]:
    """Segment the object of some voxels of an array, all in the order of its axes.

    Parameters
    ----------
    image : array_like (nz, ny, nx) or (ny, nx)
        An array of numpy, torch or dask; never modified.
    inside, outside : array_like
        Voxels in the object, and beside it: indices (n, ndim) or (ndim,), or a mask of booleans of the image's shape.
    spacing : float, str or sequence of float, optional
        Size of a voxel along each axis, mm; a text as for `segment`.
    return_result : bool, optional
        Return the `Result` as well.
    **options
        As for `segment`.

    Returns
    -------
    labels : ndarray of uint8, of the image's shape
        1 inside, 0 elsewhere.
    result : Result
        With ``return_result``: volume, area, mesh, history.

    Raises
    ------
    UsageError
        When clicks are neither indices nor a mask; InputError when one lies outside of the image, or the image has a
        geometry of its own; else as `segment`.

    Examples
    --------
    >>> import numpy as np
    >>> image = 100.0 * (((np.indices((24, 24, 24)) - 11.5) ** 2).sum(axis=0) < 8**2)
    >>> labels = segment_clicks(image, inside=[(12, 12, 9)], outside=[(1, 2, 3)])
    >>> bool((labels == (image > 50)).mean() > 0.99)
    True
    """
    array = from_library(image)
    if isinstance(array, (Volume, str, os.PathLike)):
        raise InputError(
            f"a {type(image).__name__} was given, an array expected, whose axes the clicks are given in",
            "use accelsurf.segment, which keeps the geometry, or give the values: accelsurf.read(PATH).array",
        )
    volume, flat = as_volume(array, spacing), np.ndim(array) == 2
    named, beside = (
        _clicks_in_order(side, given, volume, flat)
        for side, given in zip(SIDES, (inside, outside), strict=True)
    )
    if not named:
        raise UsageError("inside: nothing was given, expected at least one voxel of the object")
    result = segment(volume, inside=named, outside=beside, **options)
    labels = np.asarray(result.labels[0] if flat else result.labels, np.uint8)
    return (labels, result) if return_result else labels


def _clicks_in_order(side: Side, given: ArrayLike, volume: Volume, flat: bool) -> list[Any]:
    """Return clicks of `segment` for indices in the order of the axes, or for a mask."""
    value = np.asarray(from_library(given, side))
    shape = volume.geometry.shape[1:] if flat else volume.geometry.shape
    if value.dtype == np.bool_ and value.shape == shape:
        return [value]
    points = (
        value.reshape(-1, len(shape)) if value.size == 0 or value.shape == (len(shape),) else value
    )
    if points.ndim != 2 or points.shape[1] != len(shape) or points.dtype.kind not in "iuf":
        raise UsageError(
            f"{side}: an array of shape {value.shape} was given, expected indices (n, {len(shape)}) in the order of "
            f"the axes, or a mask of booleans of shape {shape}"
        )
    places = [[*point[::-1], 0.0] if flat else point[::-1] for point in points.tolist()]
    return [f"point:{x:.9g},{y:.9g},{z:.9g}vox" for x, y, z in places]


def evolve(
    image: ImageLike,
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
    channels: Sequence[ImageLike] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    **options: Unpack[SegmentOptions],
) -> Iterator[Step]:
    """Run as `segment` does, yielding each step; leave the loop to end the run.

    Parameters
    ----------
    image, spacing, channels, config, energy, **options
        As for `segment`.

    Yields
    ------
    Step
        ``step.record`` is the record of the step, a line of the trace; ``step.object_id`` is the object's id;
        ``step.surface`` is the present surface (``.psi``, ``.labels``): copy values to keep, the next step moves it.
        While ``step.record.level`` is above 0 it lies on a coarser grid than the image; with ``levels=1`` it never
        does.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = (x**2 + y**2 + z**2 < 8**2) * 100.0
    >>> for step in evolve(image, start="ball:9,9,9,4vox"):
    ...     if step.record.volume_mm3 > 1000:
    ...         break
    >>> step.surface.labels.shape
    (24, 24, 24)
    """
    with _run_of(image, spacing, channels, config, energy, {**options}) as run:
        yield from run


def segment_objects(  # noqa: PLR0913
    image: ImageLike,
    objects: ObjectsLike | ImageLike | None = None,
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
    channels: Sequence[ImageLike] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    on_step: OnObjectStep | None = None,
    on_warning: Callable[[str], None] | None = None,
    checkpoint_to: str | Path | CheckpointFile | None = None,
    **options: Unpack[GivenOptions],
) -> Result:
    """Segment several objects that do not overlap.

    Parameters
    ----------
    image : image
        As for `segment`; never modified.
    objects : str or label map, optional
        Their first voxels: a label map, or a file as for ``--objects``. By default that of ``config``.
    energy : str or callable, optional
        As for `segment`; one of your own is made for each object's part of the image.
    on_step : callable, optional
        Called with each `StepRecord` and the id of its object; a true return value ends the run.
    on_warning, checkpoint_to : optional
        As for `segment`.
    spacing, channels, config, **options
        As for `segment`; ``max_volume`` counts for each object, ``max_steps`` for the run.

    Returns
    -------
    Result
        With a tuple of objects; ``result.by_id[ID]`` is one of them.

    Raises
    ------
    UsageError
        When no objects are given, an option is unknown, or an energy is incomplete.
    InputError
        As `accelsurf.segment`, and when a start is empty or lies inside others.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((20, 20, 36)) - np.array([9.5, 9.5, 0])[:, None, None, None]
    >>> image = (z**2 + y**2 + np.minimum(abs(x - 10), abs(x - 25))**2 < 7**2) * 100.0
    >>> starts = np.zeros(image.shape, int)
    >>> starts[8:12, 8:12, 8:12], starts[8:12, 8:12, 24:28] = 3, 700
    >>> result = segment_objects(image, starts)
    >>> {one.id: one.stop.reason for one in result.objects}, result.labels.dtype
    ({3: 'converged', 700: 'converged'}, dtype('uint16'))
    """
    settings: dict[str, Any] = {**options}
    if isinstance(objects, (str, os.PathLike)):
        settings, objects = {**settings, "objects": os.fspath(objects)}, None
    if objects is None and with_options(config, None, settings)[0].objects is None:
        raise UsageError(
            "objects: nothing was given, expected a label map or a table of balls", "or use segment"
        )
    checkpoints = CheckpointFile.of(checkpoint_to)
    starts: ObjectsLike | None = from_library(objects, "objects")
    run = _run_of(image, spacing, channels, config, energy, settings, starts, checkpoints)
    return with_corrections(finished(run, on_step, on_warning, checkpoints), on_step)


def _run_of(
    image: ImageLike,
    spacing: float | str | tuple[float, float, float] | None,
    channels: Sequence[ImageLike],
    config: RunConfig | None,
    energy: EnergyLike | None,
    options: dict[str, Any],
    objects: ObjectsLike | None = None,
    checkpoints: CheckpointFile | None = None,
) -> Run:
    """The run for the arguments of `segment`, `evolve` or `segment_objects`."""
    first = as_volume(image, spacing)
    others = [as_volume(channel, None, "channel", first.geometry) for channel in channels]
    texts, given = split_given(options)
    clicks = [
        click
        for side in SIDES
        if side in given
        for click in given_clicks(side, given.pop(side), first)
    ]
    arrays = {key: psi_of(key, value, first.geometry) for key, value in given.items()}
    if "start" in arrays:
        texts.setdefault("start", default_of("start"))
    config, energy = with_options(
        config, energy, texts, any(click.side == "inside" for click in clicks)
    )
    if checkpoints is not None:
        config = checkpoints.begun(config)
    elif config.checkpoint is not None:
        raise UsageError(
            f"checkpoint: {config.checkpoint} was given without a file for it",
            "give segment() checkpoint_to=FILE",
        )
    return Run(first, config, energy, others, objects, arrays, clicks)
