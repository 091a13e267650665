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

from accelsurf.cases.case import (
    note_result,
    note_state,
    say_warnings,
    warning_without_report,
)
from accelsurf.errors import AccelsurfError, OutputError
from accelsurf.output import OutputFolder, refuse_folder

if TYPE_CHECKING:
    from accelsurf.cases.watcher import Watcher
    from accelsurf.settings.track_config import TrackConfig
    from accelsurf.track import Lineage, TrackFiles, Tracking, TrackOutputs, TrackRun


@dataclass(frozen=True)
class TrackCase:
    """A sequence that is tracked, its settings and the folder of its files.

    Attributes
    ----------
    place : OutputFolder
        Its source is a file with time, a folder of frames, or a pattern of their names.
    config : TrackConfig
    """

    place: OutputFolder
    config: TrackConfig

    @property
    def state(self) -> Path:
        """The state after each frame."""
        return self.place.checkpoint

    @property
    def store(self) -> Path:
        """The frames that are done."""
        return self.place.path / f"{self.place.name}_frames"

    @property
    def files(self) -> TrackFiles:
        """The files that are written."""
        from accelsurf.track import TrackFiles

        config = self.config
        return TrackFiles(
            config.format, config.per_frame, config.mesh, config.mesh_space, config.also
        )


@dataclass(frozen=True)
class Tracked:
    """A tracking that ended with a result: ``frames`` of the sequence, the ``lineage``, the exit ``code``, and the
    number of ``doubtful`` frames.
    """

    frames: int
    lineage: Lineage
    code: int
    doubtful: int


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
    KeyboardInterrupt
        After Ctrl-C; the frames so far and the state are kept for ``--resume``.
    """
    from accelsurf.track import TrackOutputs

    _prepare_state(case)
    resumed = case.state.exists()
    try:
        tracking = _begun(case, watcher)
    except AccelsurfError as error:
        report_track_failure(case, error)
        raise
    place = case.place
    if resumed:
        place = place.resumed(case.files.paths(place.path, place.name).values())
    try:
        outputs = TrackOutputs(
            place.path,
            place.name,
            tracking.sequence,
            case.files,
            run=_run_of(tracking.config, place.inputs(case.config)),
            overwrite=place.overwrite,
            store=case.store,
        )
        try:
            _follow(case, tracking, outputs, watcher)
            code = _finish(case, tracking, outputs, watcher)
            return Tracked(len(tracking.sequence), tracking.lineage, code, len(tracking.doubtful))
        except BaseException as error:
            outputs.abort(error)
            if isinstance(error, AccelsurfError) or not case.state.exists():
                with suppress(OutputError):  # the first error matters more
                    _remove_state(case)
            note_state(watcher, case.state)
            raise
    finally:
        tracking.close()


def report_track_failure(case: TrackCase, error: BaseException) -> None:
    """Write the report of a tracking that could not begin, or whose process is gone; a warning when that fails too."""
    from accelsurf.track import write_failure

    place = case.place
    with warning_without_report():
        run = _run_of(case.config, place.inputs(None))
        write_failure(place.path, place.name, case.files, error, place.image, run)


def _run_of(config: TrackConfig, inputs: list[Path]) -> TrackRun:
    """Return command and settings of a tracking, for its files."""
    from accelsurf.track import TrackRun

    return TrackRun(config.model_dump(mode="json"), config.to_toml(), sys.argv, inputs)


def _prepare_state(case: TrackCase) -> None:
    """Refuse to lose the state of a run that was stopped; remove it unless the tracking goes on from it."""
    refuse_folder(case.state)
    case.place.refuse_left(case.state, case.store)
    is_complete = case.state.exists() and case.store.exists()
    if not (case.place.resume and is_complete):
        _remove_state(case)


def _remove_state(case: TrackCase) -> None:
    from accelsurf.track import remove_store

    case.state.unlink(missing_ok=True)
    remove_store(case.store)


def _begun(case: TrackCase, watcher: Watcher) -> Tracking:
    """The tracking, from its start or from its state."""
    from accelsurf.track import Tracking, open_sequence

    return Tracking(
        open_sequence(case.place.image, case.config),
        case.config,
        meshes=bool(case.config.mesh),
        on_step=watcher.on_step,
        checkpoint_to=case.state,
    )


def _follow(case: TrackCase, tracking: Tracking, outputs: TrackOutputs, watcher: Watcher) -> None:
    """Do the frames; raise KeyboardInterrupt where Ctrl-C comes before the last one."""
    count = len(tracking.visits)
    with watcher.watch(case.place.name, tracking.config.run.max_steps):
        for result in tracking:
            outputs.add(result)
            seen = sum(segmented.seen for segmented in result.objects)
            if watcher.on_frame(tracking.done, count, result.frame, seen, result.seconds):
                tracking.save()
                break
    if tracking.done < count or tracking.interrupted:
        raise KeyboardInterrupt


def _finish(case: TrackCase, tracking: Tracking, outputs: TrackOutputs, watcher: Watcher) -> int:
    """Write the files; return the exit code."""
    with watcher.writing():
        code = watcher.exit_code(0)
        warnings = [*tracking.sequence.notes, *tracking.warnings, *_warnings_of(tracking)]
        outputs.finish(tracking.lineage, status="ok", exit_code=code, warnings=warnings)
    say_warnings(warnings, watcher)
    note_result(watcher, case.place)
    with suppress(OutputError):  # a file of somebody else among the frames: it stays
        _remove_state(case)
    return code


def _warnings_of(tracking: Tracking) -> list[str]:
    """Return warnings about the tracks, at most ten."""
    count = len(tracking.visits)
    out = (
        [
            f"these tracks cannot be trusted in {len(tracking.doubtful)} of {count} frames, the first of them frame "
            f"{min(tracking.doubtful)}: the image around the objects is not as it was in the given frame; give labels "
            "of a frame nearer to these (--frame), or correct them (--correct)"
        ]
        if tracking.doubtful
        else []
    )
    for track in tracking.lineage.tracks:
        if track.end in ("vanished", "lost") and tracking.done == count:
            out.append(
                f"object {track.id}: not seen after frame {track.last}; look there, and try --correct "
                f"'frame={track.last + 1} inside=point:X,Y,Z object={track.id}', or a larger --max-gap"
            )
    return out[:10]
