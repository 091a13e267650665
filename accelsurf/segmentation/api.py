"""segment(), segment_objects(), evolve(): from an image and rough starts to labels, meshes and the run's history."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded import Sureness
from accelsurf.errors import InputError, UsageError
from accelsurf.evolution.records import Step, StepRecord, Stop
from accelsurf.grid.boxes import Box, box_at, widened
from accelsurf.grid.clicks import SIDES
from accelsurf.grid.volume import Volume, plain_array
from accelsurf.segmentation.clicked_voxels import clicked_voxels, on_image
from accelsurf.segmentation.evolving_object import EvolvingObject
from accelsurf.segmentation.given import clicks_of, psi_of, split_given
from accelsurf.segmentation.late_growth import LateGrowth
from accelsurf.segmentation.local_model import sureness_from
from accelsurf.segmentation.preprocessing import uses_model
from accelsurf.segmentation.refine import state_of, with_refinements
from accelsurf.segmentation.region_of_interest import closed_on, cropped
from accelsurf.segmentation.rest_points import rest_points
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.segmentation.run import AROUND, Run
from accelsurf.segmentation.run_setup import EnergyLike, ObjectsLike
from accelsurf.segmentation.solver_setup import half_width, stop_rule
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.run_config import RunConfig

__all__ = ["EnergyLike", "Result", "Run", "evolve", "result_of", "segment", "segment_objects"]


def segment(
    volume: Volume | NDArray[Any],
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    on_step: Callable[[StepRecord], bool | None] | None = None,
    on_warning: Callable[[str], None] | None = None,
    **options: Any,
) -> Result:
    """Segment one object.

    Parameters
    ----------
    volume : Volume or ndarray (nz, ny, nx)
        The image; never modified. From `accelsurf.read`, or an array with ``spacing``.
    spacing : float or (hz, hy, hx), optional
        mm, for an array only; 1 by default.
    channels : sequence of Volume or ndarray, optional
        Further channels of the image, on the same grid.
    config : RunConfig, optional
        Settings; the defaults otherwise.
    energy : str or Energy or callable, optional
        A name, over that of ``config``; or an energy of your own (`accelsurf.energies.Energy`); or a class or function
        that makes one of ``(image, spacing)``: the image as the named energies see it (`Result.image`) and
        (hz, hy, hx) in mm. Settings of the named energies, such as ``smoothness``, are then refused.
    on_step : callable, optional
        Called with each `StepRecord`; a true return value ends the run with the reason ``interrupted``.
    on_warning : callable, optional
        Called before the first step with each doubt about the start; `Result.warnings` has them too.
    **options
        Settings by name, over those of ``config``: ``start="ball:x,y,z,r"``, ``flow="gradient"``, ... ``start``,
        ``mask``, ``foreground`` and ``background`` may also be a mask (an array on the image's grid, or a Volume), a
        closed mesh with ``vertices`` and ``faces`` in mm (LPS), or a list of balls (x, y, z, r) in mm; so may
        ``inside`` and ``outside``, or a point (x, y, z), or a list of any of these.

    Returns
    -------
    Result

    Raises
    ------
    UsageError
        When an option is unknown or out of bounds, a start cannot be parsed, or an energy is incomplete.
    InputError
        When the image has NaN or infinite voxels or is constant, the start is outside, empty or full, or an energy of
        your own returns something else than numbers of the right shape.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = (x**2 + y**2 + z**2 < 8**2) * 100.0
    >>> result = segment(image, start="ball:9,9,9,4vox", max_steps=200)
    >>> result.stop.reason, result.components, bool((result.labels == (image > 50)).mean() > 0.99)
    ('converged', 1, True)
    """
    run = _run_of(volume, spacing, channels, config, energy, options)
    return _finished(run, _without_id(on_step), on_warning)


def evolve(
    volume: Volume | NDArray[Any],
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    **options: Any,
) -> Iterator[Step]:
    """Run as `segment` does, yielding each step; leave the loop to end the run.

    Parameters
    ----------
    volume, spacing, channels, config, energy, **options
        As for `segment`.

    Yields
    ------
    Step
        ``step.record`` is the record of the step, a line of the trace; ``step.object_id`` is the object's id;
        ``step.surface`` is the present surface (``.psi``, ``.labels``): copy what you need, the next step moves it.
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
    with _run_of(volume, spacing, channels, config, energy, options) as run:
        yield from run


def segment_objects(
    volume: Volume | NDArray[Any],
    objects: ObjectsLike | None = None,
    *,
    spacing: float | tuple[float, float, float] | None = None,
    channels: Sequence[Volume | NDArray[Any]] = (),
    config: RunConfig | None = None,
    energy: EnergyLike | None = None,
    on_step: Callable[[StepRecord, int], bool | None] | None = None,
    on_warning: Callable[[str], None] | None = None,
    **options: Any,
) -> Result:
    """Segment several objects that do not overlap.

    Parameters
    ----------
    volume : Volume or ndarray (nz, ny, nx)
        The image; never modified.
    objects : str, Volume or ndarray, optional
        Their first voxels: a label map, or a file as for ``--objects``. By default that of ``config``.
    energy : str or callable, optional
        A name, over that of ``config``; or a class or function that makes an energy of ``(image, spacing)`` for each
        object's part of the image: see `accelsurf.segment`.
    on_step : callable, optional
        Called with each `StepRecord` and the id of its object; a true return value ends the run.
    on_warning : callable, optional
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
    if isinstance(objects, str):
        options, objects = {**options, "objects": objects}, None
    if objects is None and with_options(config, None, options)[0].objects is None:
        raise UsageError("objects: nothing was given, expected a label map or a table of balls", "or use segment")
    run = _run_of(volume, spacing, channels, config, energy, options, objects)
    return _finished(run, on_step, on_warning)


def _without_id(on_step: Callable[[StepRecord], bool | None] | None) -> Callable[[StepRecord, int], bool | None] | None:
    """The same for a run of several objects."""
    return None if on_step is None else lambda record, own: on_step(record)


def _finished(
    run: Run,
    on_step: Callable[[StepRecord, int], bool | None] | None,
    on_warning: Callable[[str], None] | None,
) -> Result:
    """The result with its corrections, of a run that goes to the end, or until ``on_step`` returns true."""
    growth = LateGrowth(run.volume.geometry.shape)
    with run:
        if on_warning is not None:
            for warning in run.level_warnings:
                on_warning(warning)
        for step in run:
            own = next(one for one in run.objects if one.id == step.object_id)
            growth.watch(step, run.grid, own.corner, run.prepared.first)
            if on_step is not None and on_step(step.record, step.object_id):
                run.request_stop()
        result = replace(result_of(run), late_growth=growth.place())
    return with_refinements(result, on_step)


def _run_of(
    volume: Volume | NDArray[Any],
    spacing: float | tuple[float, float, float] | None,
    channels: Sequence[Volume | NDArray[Any]],
    config: RunConfig | None,
    energy: EnergyLike | None,
    options: dict[str, Any],
    objects: ObjectsLike | None = None,
) -> Run:
    """The run for the arguments of `segment`, `evolve` or `segment_objects`."""
    first = as_volume(volume, spacing)
    others = [as_channel(one, first) for one in channels]
    texts, given = split_given(options)
    clicks = [click for side in SIDES if side in given for click in clicks_of(side, given.pop(side), first)]
    arrays = {key: psi_of(key, value, first.geometry) for key, value in given.items()}
    if "start" in arrays:
        texts.setdefault("start", default_of("start"))
    config, energy = with_options(config, energy, texts, any(click.side == "inside" for click in clicks))
    return Run(first, config, energy, others, objects, arrays, clicks)


def as_volume(volume: Volume | NDArray[Any], spacing: float | tuple[float, float, float] | None) -> Volume:
    if isinstance(volume, Volume):
        if spacing is not None:
            raise InputError("spacing given together with a Volume, which has its own", "leave spacing out")
        return volume
    return Volume.from_array(volume, 1.0 if spacing is None else spacing)


def as_channel(volume: Volume | NDArray[Any], first: Volume) -> Volume:
    if isinstance(volume, Volume):
        return volume
    array = plain_array(volume, "channel")
    return Volume(array[np.newaxis] if array.ndim == 2 else array, first.geometry)


def with_options(
    config: RunConfig | None, energy: EnergyLike | None, options: dict[str, Any], clicked: bool = False
) -> tuple[RunConfig, EnergyLike | None]:
    """The configuration, and the energy if it is not given by name; ``clicked``: voxels inside are given as arrays."""
    if isinstance(energy, str):
        options, energy = {**options, "energy": energy}, None
    config = config or RunConfig()
    known = config.model_fields_set | options.keys()
    if energy is not None and (clicked or "inside" in options):
        # What clicks choose otherwise; the energy of one's own has no model of them.
        options = {"energy": default_of("energy"), **options}
    if clicked:
        defaults = {"energy": "seeded", "start": ("clicks",)}
        options = {**{key: value for key, value in defaults.items() if key not in known}, **options}
    return config.replace(**options) if options else config, energy


def result_of(run: Run) -> Result:
    """Return the result of a run; between two steps the present state, with the reason ``interrupted``.

    Histories are copies; ``psi`` of a single object may be a view of its surface, which the next step changes.
    """
    config, missed = run.config, run.config.edit[run.edits_done :]
    image = run.prepared.picture()
    objects = _separate_objects(run, image) if run.has_ids else (_single_object(run, image),)
    steps = max(one.stop.steps for one in objects)
    summaries = run.summaries()
    return Result(
        objects=objects,
        has_ids=run.has_ids,
        image=image,
        geometry=run.volume.geometry,
        config=config,
        energy=run.energy_name,
        levels=summaries,
        seconds={"start": run.start_seconds, "evolve": time.perf_counter() - run.began},
        volume=run.volume,
        start=run.prepared.start,
        resolved_settings=resolved_settings_of(run, len(summaries)),
        kernels=run.seconds_by_kernel(),
        edits_done=run.edits_done,
        given=run.given,
        clicks=on_image(run.clicks, run.prepared.first, run.volume.geometry.shape),
        state=state_of(run),
        warnings=run.level_warnings
        + [
            f"{key} was given, but has no effect on flow {config.flow} with energy {run.energy_name}"
            for key in config.unused()
        ]
        + [f"edit at step {edit.step} was not made: the run ended after {steps} steps" for edit in missed],
    )


def _ending(run: Run) -> list[tuple[list[StepRecord], Stop]]:
    """History and reason to stop of each object; the present state of one that has not stopped."""
    out = []
    for one, step in zip(run.objects, run.current(), strict=True):
        history, stop = list(one.evolution.history), one.stop
        if stop is None:
            record = step.record
            history.append(record)
            stop = Stop("interrupted", record.step, record.t, f"not ended after {record.step} steps")
        out.append((history, stop))
    return out


def _sureness(run: Run, one: EvolvingObject) -> Sureness | None:
    """How sure the model of an object's clicks is; None where the energy has none."""
    named = run.energy_given is None or isinstance(run.energy_given, str)
    return sureness_from(one.context.seeded_model()) if named and uses_model(run.config) else None


def _single_object(run: Run, image: NDArray[np.float32]) -> SegmentedObject:
    """The object of a run of one, on the whole grid."""
    (one,), ((history, stop),) = run.objects, _ending(run)
    psi = run.prepared.on_whole_grid(one.psi_on_finest()[1])
    box = tuple(slice(0, n) for n in psi.shape)
    learned = run.prepared.learned_by(one.context)
    whole: Box = (box[0], box[1], box[2])
    rests = rest_points(one.evolution.state.rests.found, run.prepared, whole)
    return SegmentedObject(
        1, whole, psi, image, run.volume.geometry, history, stop, one.made.terms, learned, rests,
        clicked_voxels(run.clicks, 1, run.prepared.first, whole), _sureness(run, one),
    )


def _separate_objects(run: Run, image: NDArray[np.float32]) -> tuple[SegmentedObject, ...]:
    """The objects of a run of several, each on a part of the grid a little larger than its own."""
    geometry, objects = run.volume.geometry, []
    for one, (corner, psi), (history, stop) in zip(run.objects, run.separated(), _ending(run), strict=True):
        z, y, x = (c + first for c, first in zip(corner, run.prepared.first, strict=True))
        box = widened(box_at((z, y, x), psi.shape), geometry.shape, (AROUND, AROUND, AROUND))
        around = closed_on(psi, (z, y, x), box)
        learned = run.prepared.learned_by(one.context)
        objects.append(
            SegmentedObject(
                one.id, box, around, image[box], cropped(geometry, box), history, stop, one.made.terms, learned,
                rest_points(one.evolution.state.rests.found, run.prepared, box),
                clicked_voxels(run.clicks, one.id, run.prepared.first, box), _sureness(run, one),
            )
        )
    return tuple(objects)


def resolved_settings_of(run: Run, levels: int) -> dict[str, Any]:
    """Return the values that a run on so many levels used for settings that depend on image and grid."""
    config, prepared = run.config, run.prepared
    diffusion = config.diffusion
    if diffusion == "auto":
        diffusion = "free" if config.flow in ("constant-density", "flowable-mass") else 0.0
    rule = stop_rule(config, levels)
    return {
        "presmooth_mm": prepared.presmooth,
        "scale": [{"at_0": low, "at_1": low + width} for low, width in prepared.context.scales],
        "step_voxels": config.cfl,
        "limiter_percentile": config.percentile,
        "diffusion": diffusion,
        "stop": {"voxels": rule.motion, "steps": rule.window},
        "half_width_voxels": half_width(config),
        "levels": levels,
    }
