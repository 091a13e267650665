"""A run to its end: observers are told, and its result is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import NO_OBJECT
from accelsurf.grid.window import Window
from accelsurf.segmentation.checkpoint_file import CheckpointFile
from accelsurf.segmentation.late_growth import LateGrowth, nearest_inside
from accelsurf.segmentation.refine import with_refinements
from accelsurf.segmentation.refiner import OnObjectStep
from accelsurf.segmentation.result import Result
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_result import result_of


def finished(
    run: Run,
    on_step: OnObjectStep | None,
    on_warning: Callable[[str], None] | None,
    checkpoints: CheckpointFile | None = None,
) -> Result:
    """The result with its corrections, of a run that goes to the end, or until ``on_step`` returns true."""
    grid = run.volume.geometry
    growth = LateGrowth(run.window or Window(grid, whole_box(grid.shape)))
    with run:
        notes = [] if checkpoints is None else checkpoints.restore(run, growth)
        if on_warning is not None:
            for warning in (*run.level_warnings, *notes):
                on_warning(warning)
        while made := run.step():
            asked = False
            for step in (one for one in made if one.object_id != NO_OBJECT):
                own = next(one for one in run.objects if one.id == step.object_id)
                growth.watch(step, run.grid, own.corner, run.prepared.first)
                if on_step is not None and on_step(step.record, step.object_id):
                    asked = True
            if checkpoints is not None:
                checkpoints.watch(run, growth, at_once=asked)
            if asked:
                run.request_stop()
        result = result_of(run)
    late = nearest_inside(growth.place(), result.labels > 0, grid.spacing)
    result = replace(result, late_growth=late, warnings=[*result.warnings, *notes])
    return with_refinements(result, on_step)
