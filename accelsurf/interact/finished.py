"""`Result` of a run: at its end, or between two steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import Confidence, clicked_voxels, on_image
from accelsurf.evolution import StepRecord, Stop
from accelsurf.grid.boxes import box_at, whole_box, widened
from accelsurf.grid.clicks import NO_OBJECT
from accelsurf.grid.window import Window
from accelsurf.run import (
    AROUND,
    CheckpointFile,
    EvolvingObject,
    LateLeakage,
    Result,
    Run,
    RunState,
    SegmentedObject,
    closed_on,
    cropped,
    half_width,
    nearest_inside,
    plateaus_of,
    stop_rule,
)
from accelsurf.settings.flow_specs import AUTO

#: Called with each record and the id of its object; a true value ends the run or the correction.
OnObjectStep = Callable[[StepRecord, int], bool | None]


def result_of(run: Run) -> Result:
    """Return the result of a run; between two steps the present state, with the reason ``interrupted``.

    Histories are copies; ``psi`` of a single object may be a view of its surface, which the next step changes.
    """
    config, missed = run.config, run.config.edit[run.edits_done :]
    image = run.prepared.picture()
    objects = _separate_objects(run, image) if run.has_ids else (_single_object(run, image),)
    steps = max(segmented.stop.steps for segmented in objects)
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
        resolved_settings=_resolved_settings_of(run, len(summaries)),
        kernels=_seconds_by_kernel(run),
        edits_done=run.edits_done,
        given=run.given,
        clicks=on_image(run.prepared.clicks, run.prepared.first, run.volume.geometry.shape),
        state=None if config.keep_state == "no" else state_at_end(run),
        other_labels=run.prepared.other_labels,
        warnings=run.level_warnings
        + [
            f"edit at step {edit.step} was not made: the run ended after {steps} steps"
            for edit in missed
        ],
    )


def _seconds_by_kernel(run: Run) -> dict[str, float]:
    """Seconds in each kernel so far, over all objects and threads."""
    total = dict(run.workers.seconds)
    for evolving in run.objects if run.has_ids else ():
        for name, seconds in evolving.workers.seconds.items():
            total[name] = total.get(name, 0.0) + seconds
    return total


def _ending(run: Run) -> list[tuple[list[StepRecord], Stop]]:
    """History and reason to stop of each object; the present state of one that has not stopped."""
    out = []
    for evolving, step in zip(run.objects, run.current(), strict=True):
        history, stop = list(evolving.evolution.history), evolving.stop
        if stop is None:
            record = step.record
            history.append(record)
            stop = Stop(
                "interrupted", record.step, record.t, f"not ended after {record.step} steps"
            )
        out.append((history, stop))
    return out


def _confidence(run: Run, evolving: EvolvingObject) -> Confidence | None:
    """Return the confidence of the model of an object's clicks; None where the energy has none."""
    named = run.energy_given is None or isinstance(run.energy_given, str)
    return evolving.context.confidence() if named and run.config.energy.uses_model else None


def _single_object(run: Run, image: NDArray[np.float32]) -> SegmentedObject:
    """The object of a run of one, on the whole grid."""
    (evolving,), ((history, stop),) = run.objects, _ending(run)
    psi = run.prepared.on_whole_grid(evolving.psi_on_finest()[1])
    learned, whole = run.prepared.learned_by(evolving.context), whole_box(run.volume.geometry.shape)
    plateaus = plateaus_of(evolving.evolution.state.plateaus.found, run.prepared)
    return SegmentedObject(
        1,
        whole,
        psi,
        image,
        run.volume.geometry,
        history,
        stop,
        evolving.made.terms,
        learned,
        plateaus,
        clicked_voxels(run.prepared.clicks, 1, run.prepared.first, whole),
        _confidence(run, evolving),
    )


def _separate_objects(run: Run, image: NDArray[np.float32]) -> tuple[SegmentedObject, ...]:
    """The objects of a run of several, each on a part of the grid a little larger than its own."""
    geometry, objects = run.volume.geometry, []
    for evolving, (first, psi), (history, stop) in zip(
        run.objects, run.separated(), _ending(run), strict=True
    ):
        corner = run.prepared.corner_on_image(first)
        box = widened(box_at(corner, psi.shape), geometry.shape, (AROUND, AROUND, AROUND))
        around = closed_on(psi, corner, box)
        learned = run.prepared.learned_by(evolving.context)
        objects.append(
            SegmentedObject(
                evolving.id,
                box,
                around,
                image[box],
                cropped(geometry, box),
                history,
                stop,
                evolving.made.terms,
                learned,
                plateaus_of(evolving.evolution.state.plateaus.found, run.prepared),
                clicked_voxels(run.prepared.clicks, evolving.id, run.prepared.first, box),
                _confidence(run, evolving),
            )
        )
    return tuple(objects)


def _resolved_settings_of(run: Run, levels: int) -> dict[str, Any]:
    """Return the values that a run on a number of levels used for settings that depend on image and grid."""
    config, prepared = run.flow_choice.applied(run.config), run.prepared
    diffusion = config.diffusion
    if diffusion == "auto":
        diffusion = "free" if config.flow.name in ("constant-density", "flowable-mass") else 0.0
    rule = stop_rule(config, levels)
    return {
        "flow": str(config.flow),
        "flow_why": run.flow_choice.why
        if run.config.flow == AUTO
        else f"{config.flow}, as it was given",
        "presmooth_mm": prepared.filters.sigma,
        "closing_mm": prepared.filters.closing,
        "scale": [{"at_0": low, "at_1": low + width} for low, width in prepared.context.scales],
        "step_voxels": config.cfl,
        "limiter_percentile": config.percentile,
        "diffusion": diffusion,
        "stop": {"voxels": rule.motion, "steps": rule.window},
        "half_width_voxels": half_width(config),
        "levels": levels,
    }


def state_at_end(run: Run) -> RunState:
    """Return the state from which a finished run is corrected, whatever the settings say of keeping it."""
    contexts = {evolving.id: evolving.context for evolving in run.objects}
    return RunState(run.prepared, contexts, run.energy_given, run.prepared.clicks)


def finished(
    run: Run,
    on_step: OnObjectStep | None,
    on_warning: Callable[[str], None] | None,
    checkpoints: CheckpointFile | None = None,
) -> Result:
    """Return the result of a run that goes to the end, or until ``on_step`` returns true; no correction is made."""
    grid = run.volume.geometry
    growth = LateLeakage(run.window or Window(grid, whole_box(grid.shape)))
    with run:
        notes = [] if checkpoints is None else checkpoints.restore(run, growth)
        if on_warning is not None:
            for warning in (*run.level_warnings, *notes):
                on_warning(warning)
        while made := run.step():
            asked = False
            for step in (step for step in made if step.object_id != NO_OBJECT):
                evolving = next(
                    evolving for evolving in run.objects if evolving.id == step.object_id
                )
                growth.watch(step, run.grid, evolving.corner, run.prepared.first)
                if on_step is not None and on_step(step.record, step.object_id):
                    asked = True
            if checkpoints is not None:
                checkpoints.watch(run, growth, at_once=asked)
            if asked:
                run.request_stop()
        result = result_of(run)
    late = nearest_inside(growth.place(), result.inside_on, grid.shape, grid.spacing)
    return replace(result, late_leakage=late, warnings=[*result.warnings, *notes])
