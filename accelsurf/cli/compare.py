"""``accelsurf compare``: several flows on one volume, from the same start with the same step control."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from accelsurf.cli.options import FILES, RUN, Display, Output, Overwrite, SharedSettings, required, run_config
from accelsurf.errors import UsageError
from accelsurf.settings.run_config import FLOWS, RunConfig

if TYPE_CHECKING:
    from accelsurf.cli.case import Case
    from accelsurf.grid.volume import Volume


def compare(
    input: Annotated[Path | None, Parameter(name=("--input", "-i"), group=FILES)] = None,
    *,
    output: Output = None,
    flows: Annotated[str, Parameter(group=RUN)] = "gradient,constant-density",
    reference: Annotated[Path | None, Parameter(group=FILES)] = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    overwrite: Overwrite = False,
    settings: SharedSettings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Run several flows on one volume side by side.

    All runs have the same start, energy, step control and step budget; only the flow differs. Prints a table, and
    writes compare.json and compare.png.

    Parameters
    ----------
    input
        The image: .nii, .nii.gz, .nrrd, .mha, .mhd, .png or .tif.
    output
        Folder for the outputs; made when missing.
    flows
        Names of flows, separated by commas.
    reference
        Label map of the true object, on the same grid: adds Dice and surface distances.
    config
        TOML file with settings; options given here beat it.
    overwrite
        Replace outputs that exist.
    """
    from accelsurf import io
    from accelsurf.cli.case import Case
    from accelsurf.cli.progress import Watcher
    from accelsurf.io.channels import read as read_channels
    from accelsurf.report.document import describe_input
    from accelsurf.report.outputs import refuse_existing

    display = display or Display()
    source, folder = required(input, "INPUT"), required(output, "-o DIR, the output folder,")
    configs = {name: run_config(settings, config, flow=name) for name in _names(flows)}
    paths = {"comparison": folder / "compare.json", "picture": folder / "compare.png"}
    refuse_existing(paths, overwrite)
    volume, *channels = read_channels(source)
    truth = io.read_labels(reference) if reference is not None else None
    if truth is not None:
        check_reference(truth, volume)
    watcher = Watcher(display)
    cases = []
    for name, chosen in configs.items():
        case = Case(source, folder, chosen, name=name)
        case.volume = volume
        evolve_case(case, watcher, channels)
        cases.append(case)
        if watcher.interrupted:
            break
    facts: dict[str, Any] = {"input": describe_input(source, geometry=volume.geometry, checksum=io.sha256(source))}
    facts["reference"] = describe_input(reference, checksum=io.sha256(reference)) if reference is not None else None
    return conclude(cases, paths, facts, truth, source.name, display.quiet)


def evolve_case(case: Case, watcher: Any, channels: Sequence[Volume] = ()) -> None:
    """Run the flow of one case, without writing anything; its result is kept in it."""
    from accelsurf.segmentation.api import segment

    assert case.config is not None and case.volume is not None
    with watcher.watch(case.name, case.config.max_steps):
        case.result = segment(case.volume, channels=channels, config=case.config, on_step=watcher.on_step)


def check_reference(truth: Volume, volume: Volume) -> None:
    """Refuse a reference on another grid before anything is computed.

    Raises
    ------
    GeometryError
        When the grids differ.
    """
    from accelsurf.errors import GeometryError

    if not truth.geometry.matches(volume.geometry):
        difference = truth.geometry.difference(volume.geometry)
        raise GeometryError(f"reference and image lie on different grids: {difference}", "resample the reference first")


def conclude(
    cases: list[Case],
    paths: dict[str, Path],
    facts: dict[str, Any],
    truth: Volume | None,
    title: str,
    quiet: bool,
) -> int:
    """Print the table of finished cases; write the comparison and the picture.

    Returns
    -------
    int
        0, or 130 when a run was interrupted.
    """
    from accelsurf.analysis import metrics
    from accelsurf.cli import INTERRUPTED
    from accelsurf.cli.case import scene
    from accelsurf.cli.progress import table
    from accelsurf.io.files import write_bytes
    from accelsurf.report import document, preview

    runs: list[dict[str, Any]] = []
    rows: list[tuple[str, ...]] = []
    scenes: dict[str, preview.Scene] = {}
    for case in cases:
        result, config = case.result, case.config
        assert result is not None and config is not None
        found = metrics.evaluate(result.labels_volume(), truth).to_dict() if truth is not None else None
        ending = document.describe_result(result)
        seconds = sum(result.seconds.values())  # of the run alone: files and pictures say nothing about a flow
        runs.append({"name": case.name, "flow": config.flow, **ending, "seconds": seconds, "metrics": found})
        dice = f"{found['dice']:.4f}" if found is not None else "-"
        energy = f"{ending['energy']['last']:.6g}"
        rows.append((config.flow, str(result.stop.steps), f"{seconds:.1f}", energy, dice, result.stop.reason))
        told = f"{result.stop.reason}, {result.stop.steps} steps" + (f", Dice {dice}" if found is not None else "")
        scenes[config.flow] = scene(case, told, truth.array if truth is not None else None)
    agreement = {
        f"{a.name} / {b.name}": metrics.dice(a.result.labels > 0, b.result.labels > 0)
        for a, b in combinations(cases, 2)
        if a.result is not None and b.result is not None
    }
    interrupted = any(case.result is not None and case.result.stop.reason == "interrupted" for case in cases)
    code = INTERRUPTED if interrupted else 0
    write_bytes(paths["picture"], preview.comparison_png(scenes, title))
    contents = {
        "schema_version": document.SCHEMA_VERSION,
        "status": "interrupted" if interrupted else "ok",
        "exit_code": code,
        "versions": document.versions(),
        "argv": sys.argv,
        "config": cases[0].config.model_dump(mode="json", exclude={"flow"}) if cases[0].config is not None else None,
        **facts,
        "runs": runs,
        "agreement_dice": agreement,
        "outputs": [document.describe_output(paths["picture"], "picture")],
    }
    write_bytes(paths["comparison"], (document.to_json(contents) + "\n").encode())
    if not quiet:
        print(table(("flow", "steps", "seconds", "energy", "Dice", "stop"), rows))
        print()
        for kind, path in paths.items():
            print(f"{kind:10}  {path.absolute()}")
    return code


def _names(flows: str) -> list[str]:
    """Return the flows asked for, each once.

    Raises
    ------
    UsageError
        When one does not exist.
    """
    names = list(dict.fromkeys(name.strip() for name in flows.split(",") if name.strip()))
    if not names:
        raise UsageError("--flows names no flow", f"there are {', '.join(FLOWS)}")
    for name in names:
        RunConfig(flow=name)
    return names
