"""Tracking of one sequence: read, track, write. `track` does it once, `batch --track` for each case.

Existing outputs are refused before anything is computed. The files appear all at once or not at all; a report says how
the tracking ended, also when it failed.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.cli.case import Place
from accelsurf.errors import AccelsurfError, OutputError
from accelsurf.output import folder, result_sets

if TYPE_CHECKING:
    from accelsurf.cli.progress import Watcher
    from accelsurf.settings.track_config import TrackConfig
    from accelsurf.track.output.files import TrackFiles
    from accelsurf.track.output.outputs import TrackOutputs
    from accelsurf.track.records import Lineage
    from accelsurf.track.track import Tracking


@dataclass(frozen=True)
class TrackCase:
    """A sequence that is tracked, its settings and the folder of its files.

    Attributes
    ----------
    place : Place
        Its source is a file with time, a folder of frames, or a pattern of their names.
    config : TrackConfig
    """

    place: Place
    config: TrackConfig

    @property
    def state(self) -> Path:
        """The state after each frame."""
        return self.place.checkpoint_path

    @property
    def store(self) -> Path:
        """The frames that are done."""
        return self.place.folder / f"{self.place.name}_frames"

    @property
    def files(self) -> TrackFiles:
        """The files that are written."""
        from accelsurf.track.output.files import TrackFiles

        said = self.config
        return TrackFiles(said.format, said.per_frame, said.mesh, said.mesh_space, said.also)


@dataclass(frozen=True)
class Tracked:
    """A tracking that ended with a result: ``frames`` of the sequence, the ``lineage``, and the exit ``code``."""

    frames: int
    lineage: Lineage
    code: int


def run_track_case(case: TrackCase, watcher: Watcher) -> Tracked:
    """Track, and write the files.

    Parameters
    ----------
    case : TrackCase
    watcher : Watcher
        Shows progress, and ends the tracking at Ctrl-C.

    Raises
    ------
    AccelsurfError
        When there is no result; an earlier one is as it was.
    """
    from accelsurf.track.output.outputs import TrackOutputs

    _look_at_state(case)
    resumed = case.state.exists()
    try:
        tracking = _begun(case, watcher)
    except AccelsurfError as error:
        report_failure(case, error)
        raise
    paths = case.files.paths(case.place.folder, case.place.name).values()
    is_free = result_sets.unfinished_alone(case.place.report_path, paths)
    try:
        outputs = TrackOutputs(
            case.place.folder, case.place.name, tracking.sequence, case.files,
            settings=tracking.config.model_dump(mode="json"), toml=tracking.config.to_toml(), argv=sys.argv,
            overwrite=case.place.overwrite or (resumed and is_free), store=case.store,
            inputs=case.place.inputs(case.config),
        )
        try:
            _follow(case, tracking, outputs, watcher)
            return Tracked(len(tracking.sequence), tracking.lineage, _finish(case, tracking, outputs, watcher))
        except BaseException as error:
            outputs.abort(error)
            if isinstance(error, AccelsurfError):
                with suppress(OutputError):  # what went wrong first matters more
                    _remove_state(case)
            raise
    finally:
        tracking.close()


def report_failure(case: TrackCase, error: BaseException) -> None:
    """Write the report of a tracking that could not begin, or whose process is gone; a warning when that fails too."""
    from accelsurf.cli.interrupts import say
    from accelsurf.track.output.outputs import write_failure

    try:
        write_failure(
            case.place.folder, case.place.name, case.files, error, source=case.place.source,
            settings=case.config.model_dump(mode="json"), argv=sys.argv,
        )
    except AccelsurfError as second:
        say(f"warning: the report could not be written: {second.message}")


def _look_at_state(case: TrackCase) -> None:
    """Refuse to lose the work of a killed run, or take it away where that was asked for."""
    folder.refuse_folder(case.state)
    there = [path for path in (case.state, case.store) if path.exists()]
    if there and not (case.place.resume or case.place.overwrite):
        raise OutputError(
            f"{there[0]}: is the state of a run that was stopped",
            "add --resume to go on from it, or --overwrite to begin anew",
        )
    if not case.place.resume or len(there) < 2:  # of one without the other there is nothing to go on from
        _remove_state(case)


def _remove_state(case: TrackCase) -> None:
    from accelsurf.track.output.frames import remove_store

    case.state.unlink(missing_ok=True)
    remove_store(case.store)


def _begun(case: TrackCase, watcher: Watcher) -> Tracking:
    """The tracking, from its start or from its state."""
    from accelsurf.track.track import Tracking, open_sequence

    return Tracking(
        open_sequence(case.place.source, case.config), case.config, meshes=bool(case.config.mesh),
        on_step=watcher.on_step, checkpoint_to=case.state,
    )


def _follow(case: TrackCase, tracking: Tracking, outputs: TrackOutputs, watcher: Watcher) -> None:
    """Do the frames, until the last one or Ctrl-C."""
    count = len(tracking.visits)
    with watcher.watch(case.place.name, tracking.config.run.max_steps):
        for result in tracking:
            outputs.add(result)
            seen = sum(segmented.seen for segmented in result.objects)
            if watcher.on_frame(tracking.done, count, result.frame, seen, result.seconds):
                tracking.save()
                break


def _finish(case: TrackCase, tracking: Tracking, outputs: TrackOutputs, watcher: Watcher) -> int:
    """Write the files; return the exit code."""
    from accelsurf.cli import INTERRUPTED
    from accelsurf.cli.interrupts import say

    complete = tracking.done == len(tracking.visits) and not tracking.interrupted
    with watcher.writing():
        code = watcher.exit_code(0 if complete else INTERRUPTED)
        warnings = [*tracking.sequence.notes, *tracking.warnings, *_doubts(tracking)]
        outputs.finish(
            tracking.lineage, status="ok" if complete else "interrupted", exit_code=code, warnings=warnings
        )
    for warning in warnings:
        if warning not in watcher.printed_warnings:
            say(f"warning: {warning}")
    report = case.place.report_path.absolute()
    watcher.note(f"the {'result' if complete else 'result so far'} is written: {report}")
    if complete:
        with suppress(OutputError):  # somebody has put a file among the frames: it stays
            _remove_state(case)
    return code


def _doubts(tracking: Tracking) -> list[str]:
    """Return doubts about the tracks, at most ten."""
    count = len(tracking.visits)
    out = []
    for track in tracking.lineage.tracks:
        if track.end == "vanished" and tracking.done == count:
            out.append(
                f"object {track.id}: not seen after frame {track.last}; look there, and try --correct "
                f"'frame={track.last + 1} inside=point:X,Y,Z object={track.id}', or a larger --max-gap"
            )
    return out[:10]
