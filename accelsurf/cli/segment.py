"""``accelsurf segment``: one object in one volume."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, Display, InputFile, Output, Overwrite, Settings, required, run_config
from accelsurf.errors import UsageError


def segment(
    input: InputFile = None,
    *,
    output: Output = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    dump_config: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False,
    overwrite: Overwrite = False,
    strict: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False,
    profile: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False,
    settings: Settings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Segment one object in a volume, or with --objects several.

    Writes NAME_seg (label map on the input's grid), NAME_surface (mesh in mm; for an image of one slice NAME_contour),
    NAME_report.json, NAME_trace.csv and NAME_preview.png; with --objects a mesh NAME_surface_ID of each and a table of
    them, NAME_objects.csv.

    Parameters
    ----------
    input
        The image.
    output
        Folder for the outputs; made when missing.
    config
        TOML file with settings; options given here override it.
    dump_config
        Print the settings as TOML and do nothing else.
    overwrite
        Replace outputs that exist.
    strict
        Exit with 4 when the run ends before it has converged, with 5 when its result is doubtful.
    profile
        Print where the seconds went, by stage.
    """
    if dump_config:
        print(run_config(settings, config).to_toml(), end="")
        return 0
    from accelsurf.cli.case import Place, report_failure, run_case
    from accelsurf.cli.outcome import summary_lines
    from accelsurf.cli.progress import Watcher

    display = display or Display()
    place = Place.of(required(input, "INPUT"), required(output, "-o DIR, the output folder,"), overwrite)
    try:
        run = run_config(settings, config)
    except UsageError as error:
        report_failure(place, error)
        raise
    done = run_case(place, run, Watcher(display), strict)
    result, log = done.result, done.log
    if not display.quiet:
        lines = summary_lines(place.name, result, log.outputs, done.place.report_path, log.seconds["total"])
        print("\n".join(lines))
    if profile:
        from accelsurf.cli import profile as stages

        print("\n".join(stages.lines({**result.seconds, **log.seconds}, result.kernels)))
    return done.code
