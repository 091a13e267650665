"""``accelsurf track``: objects through a sequence of images."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, Display, Output, Overwrite, required
from accelsurf.cli.track_options import FrameSettings, TrackSettings, track_config
from accelsurf.errors import OutputError
from accelsurf.settings.file_formats import input_help

if TYPE_CHECKING:
    from accelsurf.cli.progress import Watcher
    from accelsurf.grid.sequence import ImageSequence
    from accelsurf.report.track_outputs import TrackOutputs
    from accelsurf.settings.track_config import TrackConfig
    from accelsurf.tracking.records import Lineage
    from accelsurf.tracking.track import Tracking

SequenceFile = Annotated[
    Path | None,
    Parameter(
        name=("--input", "-i"),
        group=FILES,
        help=f"The sequence: an image with time ({input_help()}), a folder of frames, or a pattern of their names in "
        "quotes.",
    ),
]


@dataclass(frozen=True)
class _Case:
    """What is tracked, and where it goes: first part of the files' ``name``, files that hold it while it goes on."""

    sequence: ImageSequence
    config: TrackConfig
    folder: Path
    name: str
    overwrite: bool

    @property
    def state(self) -> Path:
        """The state after each frame."""
        return self.folder / f"{self.name}_checkpoint.npz"

    @property
    def store(self) -> Path:
        """The frames that are done."""
        return self.folder / f"{self.name}_frames"


def track(
    input: SequenceFile = None,
    *,
    output: Output = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    dump_config: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False,
    overwrite: Overwrite = False,
    resume: Annotated[bool, Parameter(negative=(), show_default=False, group=FILES)] = False,
    follow: TrackSettings | None = None,  # type: ignore[valid-type]
    settings: FrameSettings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Follow objects through a sequence of images.

    The first frame is segmented as accelsurf segment does; then each surface goes on by its own momentum to the next
    frame, and is corrected there. Writes NAME_labels (ids, with time), NAME_tracks.csv, NAME_curves.csv, a film strip
    and a report.

    Parameters
    ----------
    input
        The sequence.
    output
        Folder for the outputs; made when missing.
    config
        TOML file with settings, those of tracking in its table [track]; options given here override it.
    dump_config
        Print the settings as TOML and do nothing else.
    overwrite
        Replace outputs that exist.
    resume
        Go on from the last frame that a killed or interrupted run has done, to the same bytes; begin where there is
        none.
    """
    wanted = track_config(follow, settings, config)
    if dump_config:
        print(wanted.to_toml(), end="")
        return 0
    from accelsurf.cli.progress import Watcher

    display = display or Display()
    source = required(input, "SEQUENCE")
    folder = required(output, "-o DIR, the output folder,")
    sequence = _opened(source, wanted)
    case = _Case(sequence, wanted, folder, _name_of(source), overwrite)
    _look_at_state(case, resume)
    lineage, code = _run(case, Watcher(display), display)
    if not display.quiet:
        print("\n".join(_summary(case, lineage)))
    return code


def _opened(source: Path, config: TrackConfig) -> ImageSequence:
    """The sequence, with the channels that the settings add."""
    from accelsurf.io.sequences import read_sequence
    from accelsurf.tracking.joined_sequence import JoinedSequence

    def read(path: Path) -> ImageSequence:
        return read_sequence(
            path, frame_time=config.frame_time, frames_from_slices=config.frames_from_slices,
            options=config.run.reading,
        )

    first = read(source)
    return JoinedSequence(first, [read(Path(file)) for file in config.run.channel]) if config.run.channel else first


def _name_of(source: Path) -> str:
    """The first part of the files' names."""
    from accelsurf.io import split_name
    from accelsurf.io.headers import is_pattern

    return split_name(source.absolute().parent if is_pattern(source) else source.absolute())[0]


def _look_at_state(case: _Case, resume: bool) -> None:
    """Refuse to lose the work of a killed run, or take it away where that was asked for."""
    there = [path for path in (case.state, case.store) if path.exists()]
    if there and not (resume or case.overwrite):
        raise OutputError(
            f"{there[0]}: is the state of a run that was stopped",
            "add --resume to go on from it, or --overwrite to begin anew",
        )
    if not resume or len(there) < 2:  # of one without the other there is nothing to go on from
        _remove_state(case)


def _remove_state(case: _Case) -> None:
    case.state.unlink(missing_ok=True)
    shutil.rmtree(case.store, ignore_errors=True)


def _run(case: _Case, watcher: Watcher, display: Display) -> tuple[Lineage, int]:
    """Track, and write the files; return the lineage and the exit code."""
    from accelsurf.errors import AccelsurfError
    from accelsurf.report.track_files import TrackFiles
    from accelsurf.report.track_outputs import TrackOutputs
    from accelsurf.tracking.track import Tracking

    config, resumed = case.config, case.state.exists()
    files = TrackFiles(config.format, config.per_frame, config.mesh, config.mesh_space, config.also)
    tracking = Tracking(
        case.sequence, config, meshes=bool(config.mesh), on_step=watcher.on_step, checkpoint_to=case.state
    )
    outputs = TrackOutputs(
        case.folder, case.name, case.sequence, files, settings=tracking.config.model_dump(mode="json"),
        toml=tracking.config.to_toml(), argv=sys.argv, overwrite=case.overwrite or resumed, store=case.store,
    )
    try:
        _follow(case, tracking, outputs, watcher)
        return tracking.lineage, _finish(case, tracking, outputs, watcher)
    except BaseException as error:
        outputs.abort(error)
        if isinstance(error, AccelsurfError):
            _remove_state(case)
        raise
    finally:
        tracking.close()


def _follow(case: _Case, tracking: Tracking, outputs: TrackOutputs, watcher: Watcher) -> None:
    """Do the frames, until the last one or Ctrl-C."""
    count = len(tracking.visits)
    with watcher.watch(case.name, tracking.config.run.max_steps):
        for result in tracking:
            outputs.add(result)
            seen = sum(one.seen for one in result.objects)
            if watcher.on_frame(tracking.done, count, result.frame, seen, result.seconds):
                tracking.save()
                break


def _finish(case: _Case, tracking: Tracking, outputs: TrackOutputs, watcher: Watcher) -> int:
    """Write the files; return the exit code."""
    from accelsurf.cli import INTERRUPTED
    from accelsurf.cli.interrupts import say

    complete = tracking.done == len(tracking.visits) and not tracking.interrupted
    with watcher.writing():
        code = watcher.exit_code(0 if complete else INTERRUPTED)
        warnings = [*tracking.warnings, *_doubts(tracking)]
        outputs.finish(
            tracking.lineage, status="ok" if complete else "interrupted", exit_code=code, warnings=warnings
        )
    for warning in warnings:
        if warning not in watcher.said:
            say(f"warning: {warning}")
    report = (case.folder / f"{case.name}_report.json").absolute()
    watcher.outcome = f"the {'result' if complete else 'result so far'} is written: {report}"
    if complete:
        _remove_state(case)
    return code


def _doubts(tracking: Tracking) -> list[str]:
    """What a person should look at."""
    count = len(tracking.visits)
    out = []
    for one in tracking.lineage.tracks:
        if one.end == "vanished" and tracking.done == count:
            out.append(
                f"object {one.id}: not seen after frame {one.last}; look there, and try --correct "
                f"'frame={one.last + 1} inside=point:X,Y,Z object={one.id}', or a larger --max-gap"
            )
    return out[:10]


def _summary(case: _Case, lineage: Lineage) -> list[str]:
    """How the tracking ended, for a person."""
    ends: dict[str, int] = {}
    for one in lineage.tracks:
        ends[one.end] = ends.get(one.end, 0) + 1
    objects = len(lineage.tracks)
    lines = [f"{case.name}: {objects} object{'' if objects == 1 else 's'} in {len(case.sequence)} frames"]
    words = {"end of sequence": "to the end of the sequence"}
    lines += [f"  {count} {words.get(why, why)}" for why, count in ends.items()]
    return [*lines, f"  {(case.folder / case.name).absolute()}_tracks.csv"]
