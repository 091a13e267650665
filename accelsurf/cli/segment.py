"""``accelsurf segment``: one object in one volume."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, Display, Output, Overwrite, Settings, required, run_config
from accelsurf.errors import UsageError


def segment(
    input: Annotated[Path | None, Parameter(name=("--input", "-i"), group=FILES)] = None,
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
    NAME_report.json, NAME_trace.csv and NAME_preview.png; with --objects a mesh
    NAME_surface_ID of each and a table of them, NAME_objects.csv.

    Parameters
    ----------
    input
        The image: .nii, .nii.gz, .nrrd, .mha, .mhd, .png or .tif.
    output
        Folder for the outputs; made when missing.
    config
        TOML file with settings; options given here beat it.
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
    from accelsurf.cli.case import Case, report_failure, run_case
    from accelsurf.cli.progress import Watcher

    display = display or Display()
    case = Case(
        required(input, "INPUT"), required(output, "-o DIR, the output folder,"), overwrite=overwrite, strict=strict
    )
    try:
        case.config = run_config(settings, config)
    except UsageError as error:
        report_failure(case, error)
        raise
    code = run_case(case, Watcher(display))
    if not display.quiet:
        _tell(case)
    if profile and case.result is not None:
        from accelsurf.cli.profile import lines

        print("\n".join(lines({**case.result.seconds, **case.seconds}, case.result.kernels)))
    return code


def _tell(case: Case) -> None:  # type: ignore[name-defined]  # noqa: F821
    """Print what came out."""
    result = case.result
    if case.config.objects is not None:
        from accelsurf.cli.objects import summary

        print("\n".join(summary(case, result)))
        return
    seconds = case.seconds["total"]
    steps = f"{result.stop.steps} steps" + (f" on {len(result.levels)} levels" if len(result.levels) > 1 else "")
    print(f"{case.name}: {result.stop.reason} after {steps}, {seconds:.1f} s ({result.stop.message})")
    if any(output["kind"] in ("surface", "contour") for output in case.outputs):
        parts = f"{result.components} component{'' if result.components == 1 else 's'}"
        sizes = f"volume {result.volume_mm3:.6g} mm3, area {result.area_mm2:.6g} mm2"
        if case.is_2d:
            sizes = f"area {result.enclosed_mm2:.6g} mm2, length {result.length_mm:.6g} mm"
        border = f", touches the {'image' if case.is_2d else 'volume'}'s border" if result.touches_border else ""
        print(f"{sizes}, {parts}{border}")
    for output in case.outputs:
        print(f"  {output['kind']:8} {output['path']}")
    print(f"  {'report':8} {case.report_path.absolute()}")
