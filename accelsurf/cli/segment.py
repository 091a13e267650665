"""``accelsurf segment``: one object in one volume."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from accelsurf.cases import Watcher
from accelsurf.cli.large_image import ImageParts, ObjectOptions
from accelsurf.cli.options import (
    FILES,
    Display,
    File,
    InputFile,
    Output,
    Overwrite,
    Switch,
    required,
    run_config,
    settings_class,
)
from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.output import OutputFolder
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.cases import Compute, Finished

Settings = settings_class("Settings")


def segment(
    input: InputFile = None,
    *,
    output: Output = None,
    config: File = None,
    dump_config: Switch = False,
    overwrite: Overwrite = False,
    resume: Annotated[bool, Parameter(negative=(), show_default=False, group=FILES)] = False,
    strict: Switch = False,
    profile: Switch = False,
    parts: ImageParts | None = None,
    work: ObjectOptions | None = None,
    settings: Settings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Segment one object in a volume, or with --objects several.

    Writes NAME_seg (label map on the input's grid), NAME_surface (mesh in mm; for one slice NAME_contour), a report,
    a trace, figures and a preview; with --objects NAME_surface_ID of each, and NAME_objects.csv.

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
    resume
        Go on from what a killed run has left (--checkpoint), to the same bytes; begin where it has left nothing.
    strict
        Exit with 4 when the run ends before it has converged, with 5 when its result is doubtful.
    profile
        Print where the seconds went, by stage.
    """
    if dump_config:
        print(run_config(settings, config).to_toml(), end="")
        return 0
    from accelsurf.cases import report_failure
    from accelsurf.cli.large_image import choose_computation, fits, large_image, with_level

    display, work = display or Display(), work or ObjectOptions()
    place = OutputFolder.for_image(
        required(input, "INPUT"), required(output, "-o DIR, the output folder,"), overwrite, config
    )
    try:
        run, parts = run_config(settings, config), parts or ImageParts()
        run, place = with_level(place.image, run, parts, display.quiet), place.laid_out(run)
        work.check(run)
        image = large_image(place.image, run, parts, in_parts=work.given)
        if image is not None and run.objects is not None and (work.given or not fits(image, run)):
            from accelsurf.cli.object_work import run_objects

            _refuse_switches(strict, profile, run)
            return run_objects(place, run, image, work, resume, display)
        run, compute = choose_computation(place, run, image)
    except AccelsurfError as error:
        report_failure(place, error)
        raise
    return _run(place, run, compute, resume, display, strict, profile)


def _run(
    place: OutputFolder,
    run: RunConfig,
    compute: Compute | None,
    resume: bool,
    display: Display,
    strict: bool,
    profile: bool,
) -> int:
    """Run a case, or go on with it."""
    from accelsurf.cases import run_case

    if resume:
        from accelsurf.cases import exit_code_of_finished

        if (code := exit_code_of_finished(place, run, display.quiet)) is not None:
            return code
        place = place.resumed(place.plan(run).values())
    done = run_case(place, run, Watcher(display), strict, compute)
    return _summed_up(place.name, done, display.quiet, profile)


def _refuse_switches(strict: bool, profile: bool, run: RunConfig) -> None:
    """Refuse options that have no effect on many objects that are run in groups.

    Raises
    ------
    UsageError
    """
    given = {
        "--strict": strict,
        "--profile": profile,
        "--also": bool(run.also),
        "--layout": run.layout != "plain",
        "--label-group": run.label_group is not None,
    }
    for name in (name for name, is_given in given.items() if is_given):
        raise UsageError(
            f"{name}: was given with objects of an image that is read in parts",
            "leave it out; the table has all ends",
        )


def _summed_up(name: str, done: Finished, quiet: bool, profile: bool) -> int:
    """Print how the run ended, and where its seconds went; return the exit code."""
    lines = [] if quiet else done.summary_lines(name)
    if profile:
        lines += profile_lines({**done.result.seconds, **done.log.seconds}, done.result.kernels)
    if lines:
        print("\n".join(lines))
    return done.code


def seconds_by_stage(
    seconds: Mapping[str, float], kernels: Mapping[str, float]
) -> list[tuple[str, float]]:
    """Seconds by stage.

    Parameters
    ----------
    seconds : mapping of str to float
        Of the whole run, as in the report: load, start, evolve, mesh, write, total.
    kernels : mapping of str to float
        Seconds in each kernel while it evolved. Each kernel names its stage, see `kernels._jit`.

    Returns
    -------
    list of (str, float)
        Stages in the order of a run. ``other kernels`` have no stage; ``evolve: other`` is the time between kernels;
        ``other`` is the rest. They add up to the total.

    Examples
    --------
    >>> import accelsurf.levelset, accelsurf.flows.constant_density
    >>> seconds_by_stage({"load": 1.0, "evolve": 5.0, "total": 7.0}, {"find_closest_points": 3.0, "kick": 1.0})
    [('load', 1.0), ('closest points', 3.0), ('flow', 1.0), ('evolve: other', 1.0), ('other', 1.0)]
    """
    from accelsurf.kernels._jit import STAGE_OF_KERNEL, Stage

    stages = [(part, seconds[part]) for part in ("load", "start") if part in seconds]
    inside: list[tuple[str, float]] = []
    for stage in (*Stage, None):
        spent = sum(value for name, value in kernels.items() if STAGE_OF_KERNEL.get(name) is stage)
        if spent > 0:
            inside.append(("other kernels" if stage is None else stage.value, spent))
    stages += inside
    if "evolve" in seconds:
        stages.append(("evolve: other", seconds["evolve"] - sum(value for _, value in inside)))
    stages += [(part, seconds[part]) for part in ("mesh", "write") if part in seconds]
    rest = seconds["total"] - sum(value for _, value in stages)
    return [*stages, ("other", rest)]


def profile_lines(seconds: Mapping[str, float], kernels: Mapping[str, float]) -> list[str]:
    """`seconds_by_stage` as lines of text: stage, seconds, share."""
    total = max(seconds["total"], 1e-9)
    return [
        f"  {stage:18} {value:8.2f} s {value / total:6.1%}"
        for stage, value in seconds_by_stage(seconds, kernels)
    ]
