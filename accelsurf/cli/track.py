"""``accelsurf track``: objects through a sequence of images."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from accelsurf.cases import Watcher
from accelsurf.cli.options import FILES, Display, File, Output, Overwrite, Switch, required
from accelsurf.cli.track_options import FrameSettings, TrackSettings, track_config
from accelsurf.output import OutputFolder
from accelsurf.settings.file_formats import input_help

if TYPE_CHECKING:
    from accelsurf.cases import TrackCase, Tracked

SequenceFile = Annotated[
    Path | None,
    Parameter(
        name=("--input", "-i"),
        group=FILES,
        help=f"The sequence: an image with time ({input_help()}), a folder of frames, or a pattern of their names in "
        "quotes.",
    ),
]


def track(
    input: SequenceFile = None,
    *,
    output: Output = None,
    config: File = None,
    dump_config: Switch = False,
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
    from accelsurf.cases import TrackCase, run_track_case

    display = display or Display()
    source = required(input, "SEQUENCE")
    folder = required(output, "-o DIR, the output folder,")
    case = TrackCase(
        replace(OutputFolder.for_image(source, folder, overwrite, config), resume=resume), wanted
    )
    if resume:
        from accelsurf.cases import exit_code_of_finished

        if (code := exit_code_of_finished(case.place, wanted, display.quiet)) is not None:
            return code
    done = run_track_case(case, Watcher(display))
    if not display.quiet:
        print("\n".join(_summary(case, done)))
    return done.code


def _summary(case: TrackCase, done: Tracked) -> list[str]:
    """Return lines about the end of the tracking."""
    ends = Counter(track.end for track in done.lineage.tracks)
    objects = len(done.lineage.tracks)
    lines = [
        f"{case.place.name}: {objects} object{'' if objects == 1 else 's'} in {done.frames} frames"
    ]
    words = {"end of sequence": "to the end of the sequence"}
    lines += [f"  {count} {words.get(why, why)}" for why, count in ends.items()]
    if done.doubtful:
        lines.append(f"  these tracks cannot be trusted in {done.doubtful} of {done.frames} frames")
    start = (case.place.path / case.place.name).absolute()
    return [*lines, f"  tracks     {start}_tracks.csv", f"  preview    {start}_preview.png"]
