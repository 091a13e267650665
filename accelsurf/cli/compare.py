"""``accelsurf compare``: several flows on one volume, from the same start with the same step control.

``accelsurf demo`` compares two on a cube in noise as strong as its contrast.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from accelsurf.cli.options import (
    RUN,
    WITHOUT_FILES,
    Display,
    File,
    InputFile,
    Output,
    OutputFolder,
    Overwrite,
    required,
    run_config,
    settings_class,
)
from accelsurf.errors import UsageError
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.cli.progress import Watcher
    from accelsurf.image.volume import Volume
    from accelsurf.io.file_set import FileSet
    from accelsurf.run.result import Result

#: It chooses the flow and the files itself.
SharedSettings = settings_class("SharedSettings", leave_out=("flow",), groups=WITHOUT_FILES)
#: Small ball inside the cube, off its centre: most of the object has to be found.
DEMO_START = "ball:9,-7,6,10"
#: Descent and momentum.
DEMO_FLOWS = ("gradient", "constant-density")
DEMO_STEPS = 250
#: The largest speed sets the time step, for both flows: with the default percentile descent comes close to
#: momentum within these steps. So it does on a coarser grid, where noise is averaged, and with the area that noise
#: asks for.
DEMO_SETTINGS: dict[str, Any] = {"percentile": 100.0, "levels": 1, "energy": "chan-vese:area=0"}


def compare(
    input: InputFile = None,
    *,
    output: Output = None,
    flows: Annotated[str, Parameter(group=RUN)] = "gradient,constant-density",
    reference: File = None,
    config: File = None,
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
        The image.
    output
        Folder for the outputs; made when missing.
    flows
        Names of flows, separated by commas.
    reference
        Label map of the true object, on the same grid: adds Dice and surface distances.
    config
        TOML file with settings; options given here override it.
    overwrite
        Replace outputs that exist.
    """
    from accelsurf import io
    from accelsurf.cli.case import check_reference
    from accelsurf.cli.progress import Watcher
    from accelsurf.io.channels import read_channels
    from accelsurf.output.document import describe_input
    from accelsurf.output.folder import inputs_of, opened_set, refuse_existing

    display = display or Display()
    source, folder = required(input, "INPUT"), required(output, "-o DIR, the output folder,")
    configs = {name: run_config(settings, config, flow=name, checkpoint=None) for name in _names(flows)}
    paths = {"comparison": folder / "compare.json", "picture": folder / "compare.png"}
    inputs = inputs_of(source, next(iter(configs.values())), reference, config)
    with opened_set(folder, "compare", inputs) as files:
        refuse_existing(paths, overwrite, inputs)
        volume, *channels = read_channels(source, next(iter(configs.values())).reading)
        truth = io.read_labels(reference, grid=volume.geometry) if reference is not None else None
        if truth is not None:
            check_reference(truth, volume)
        watcher = Watcher(display)
        results = _evolve_each(volume, channels, configs, watcher)
        given: dict[str, Any] = {"input": describe_input(source, geometry=volume.geometry, checksum=io.sha256(source))}
        given["reference"] = describe_input(reference, checksum=io.sha256(reference)) if reference is not None else None
        with watcher.writing():
            code = conclude(results, files, paths, given, truth, source.name, display.quiet)
        watcher.note(f"the comparison so far is written: {paths['comparison'].absolute()}")
    return code


def _evolve_each(
    volume: Volume, channels: list[Volume], configs: Mapping[str, RunConfig], watcher: Watcher
) -> dict[str, Result]:
    """The results by name; those after an interrupted one are left out."""
    from accelsurf.cli.case import evolve

    results = {}
    for name, config in configs.items():
        results[name] = evolve(name, volume, channels, config, watcher)
        if watcher.interrupted:
            break
    return results


def conclude(
    results: Mapping[str, Result],
    files: FileSet,
    paths: Mapping[str, Path],
    given: Mapping[str, Any],
    truth: Volume | None,
    title: str,
    quiet: bool,
) -> int:
    """Print the table of finished runs; write the comparison and the picture.

    Parameters
    ----------
    results : mapping of str to Result
    files : FileSet
        That the two files are put in place by.
    paths : mapping of str to Path
        ``comparison`` and ``picture``.
    given : mapping
        ``input`` and ``reference`` for the report.
    truth : Volume or None
    title : str
        Of the picture.
    quiet : bool

    Returns
    -------
    int
        0, or 130 when a run was interrupted.
    """
    from accelsurf.cli import INTERRUPTED
    from accelsurf.cli.progress import table
    from accelsurf.io.files import write_bytes
    from accelsurf.output import document
    from accelsurf.output.document import describe_staged
    from accelsurf.output.folder import naming_final
    from accelsurf.output.outputs import preview_content
    from accelsurf.output.pictures import preview

    runs = [_describe_run(name, result, truth) for name, result in results.items()]
    lines = [_table_line(run, result) for run, result in zip(runs, results.values(), strict=True)]
    contents = {}
    for line, result in zip(lines, results.values(), strict=True):
        dice = f", Dice {line[4]}" if truth is not None else ""
        heading = f"{result.stop.reason}, {result.stop.steps} steps{dice}"
        contents[result.config.flow] = preview_content(result, heading, truth.array if truth is not None else None)
    code = INTERRUPTED if any(result.stop.reason == "interrupted" for result in results.values()) else 0
    picture, report = paths["picture"].name, paths["comparison"].name
    with naming_final(files):
        write_bytes(files.staging / picture, preview.comparison_png(contents, title))
        comparison = {**_heading(code, next(iter(results.values())).config), **given, "runs": runs}
        comparison["agreement_dice"] = _agreement_of_runs(results)
        comparison["outputs"] = describe_staged(files, {picture: "picture"})
        write_bytes(files.staging / report, (document.to_json(comparison) + "\n").encode())
        files.commit(last=report)
    if not quiet:
        print(table(("flow", "steps", "seconds", "energy", "Dice", "stop"), lines))
        print()
        for kind, path in paths.items():
            print(f"{kind:10}  {path.absolute()}")
    return code


def _heading(code: int, config: RunConfig) -> dict[str, Any]:
    """The first keys of the comparison."""
    from accelsurf.output import document
    from accelsurf.output.document import versions

    return {
        "schema_version": document.SCHEMA_VERSION,
        "status": "interrupted" if code else "ok",
        "exit_code": code,
        "versions": versions(),
        "argv": sys.argv,
        "config": config.model_dump(mode="json", exclude={"flow"}),
    }


def _describe_run(name: str, result: Result, truth: Volume | None) -> dict[str, Any]:
    """The entry of a run; its seconds are without those of files and pictures, which do not depend on the flow."""
    from accelsurf.output import document

    measures = _agreement(result, truth) if truth is not None else None
    seconds = sum(result.seconds.values())
    described = document.describe_result(result)
    return {"name": name, "flow": result.config.flow, **described, "seconds": seconds, "metrics": measures}


def _agreement(result: Result, truth: Volume) -> dict[str, Any]:
    """Measures of agreement with the reference; of several objects also the Dice of each id."""
    from accelsurf.measure import metrics

    found: dict[str, Any] = dict(metrics.evaluate(result.labels_volume(), truth).to_dict())
    if result.has_ids:
        found["dice_by_object"] = {
            str(label): metrics.dice(result.labels == label, truth.array == label)
            for label in (segmented.id for segmented in result.objects)
        }
    return found


def _table_line(run: Mapping[str, Any], result: Result) -> tuple[str, ...]:
    measures = run["metrics"]
    dice = f"{measures['dice']:.4f}" if measures is not None else "-"
    energy = f"{run['energy']['last']:.6g}"
    return run["flow"], str(result.stop.steps), f"{run['seconds']:.1f}", energy, dice, result.stop.reason


def _agreement_of_runs(results: Mapping[str, Result]) -> dict[str, float]:
    from accelsurf.measure import metrics

    return {
        f"{a} / {b}": metrics.dice(results[a].labels > 0, results[b].labels > 0) for a, b in combinations(results, 2)
    }


def _names(flows: str) -> list[str]:
    """Return the flows that were named, each once.

    Raises
    ------
    UsageError
        When one does not exist.
    """
    names = list(dict.fromkeys(name.strip() for name in flows.split(",") if name.strip()))
    if not names:
        raise UsageError("--flows names no flow", f"valid are {', '.join(FLOWS)}")
    for name in names:
        RunConfig(flow=name)
    return names


def demo(
    *, output: OutputFolder = Path("accelsurf-demo"), overwrite: Overwrite = False, display: Display | None = None
) -> int:
    """Segment a cube in noise with and without momentum.

    Makes a volume of 96^3 voxels with a cube of side 48 mm, contrast 1 and noise of standard deviation 1, and runs
    gradient descent and the constant-density flow on it: same start, same step control, same step budget. Prints a
    table and writes every output of both runs, the volume, and a picture of the two side by side.

    Parameters
    ----------
    output
        Folder for the outputs; made when missing.
    overwrite
        Replace outputs that exist.
    """
    from accelsurf import io
    from accelsurf.cli.case import Place, run_case
    from accelsurf.cli.progress import Watcher
    from accelsurf.output.document import describe_input
    from accelsurf.output.folder import naming_final, opened_set, refuse_existing
    from accelsurf.phantoms import recipes

    display = display or Display()
    recipe, image, labels = recipes.load_recipe("cube_noisy"), output / "cube.nii.gz", output / "cube_truth.nii.gz"
    paths = {"comparison": output / "demo.json", "picture": output / "demo.png"}
    common = RunConfig(start=DEMO_START, max_steps=DEMO_STEPS, threads=min(2, os.cpu_count() or 1), **DEMO_SETTINGS)
    places = {flow: Place(image, output, f"cube_{flow}", overwrite) for flow in DEMO_FLOWS}
    planned = [place.paths(common.replace(flow=flow)) for flow, place in places.items()]
    everything = {"image": image, "labels": labels, **paths}
    everything |= {f"{number}-{kind}": path for number, some in enumerate(planned) for kind, path in some.items()}
    refuse_existing(everything, overwrite)

    began = time.perf_counter()
    if not display.quiet:
        print(f"A cube of side {recipe.side:g} mm in noise as strong as its contrast; start: {DEMO_START}", flush=True)
    phantom = recipes.make(recipe)
    with opened_set(output, "cube") as files, naming_final(files):
        io.write(phantom.image, files.staging / image.name)
        io.write_labels(phantom.truth, files.staging / labels.name)
        files.commit()
    watcher = Watcher(display)
    results, code = {}, 0
    for flow, place in places.items():
        done = run_case(place, common.replace(flow=flow), watcher)
        results[place.name], code = done.result, max(code, done.code)
        if watcher.interrupted:
            break
    given = {"input": describe_input(image, geometry=phantom.image.geometry, checksum=io.sha256(image))}
    given["reference"] = describe_input(labels, checksum=io.sha256(labels))
    title = "A cube in noise: gradient descent and accelerated flow"
    with opened_set(output, "demo") as files, watcher.writing():
        conclude(results, files, paths, given, phantom.truth, title, display.quiet)
    if not display.quiet:
        print(f"\nAll files are in {output.absolute()} ({time.perf_counter() - began:.0f} s)")
    return code
