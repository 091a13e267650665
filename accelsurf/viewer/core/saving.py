"""What a session saves: the files of `accelsurf segment`, and the run itself as TOML."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Collection
from pathlib import Path

from accelsurf import __version__, io
from accelsurf.errors import UsageError, check_known
from accelsurf.io.files import write_bytes
from accelsurf.report import document, file_entries, outputs
from accelsurf.segmentation.api import Result, result_of
from accelsurf.segmentation.run import Run
from accelsurf.settings.run_config import RunConfig

#: What can be saved; ``run`` is the configuration that repeats the run.
KINDS = ("labels", "mesh", "picture", "trace", "report", "run")
RUN_FILE = "run.toml"


def save(
    run: Run, folder: Path, name: str, source: Path | None, what: Collection[str], own: Collection[Path] | None
) -> list[Path]:
    """Write what a run has reached into a folder.

    Parameters
    ----------
    run : Run
        Between two steps, its edits applied.
    folder : Path
    name : str
        First part of the files' names.
    source : Path or None
        The image's file, for the report and the format of the labels.
    what : collection of str
        Of `KINDS`.
    own : collection of Path or None
        Files that may be replaced; None: all.

    Returns
    -------
    list of Path
        What was written, the configuration first.

    Raises
    ------
    UsageError
        For another kind, or when there is no surface to write.
    OutputError
        When a file is there already or cannot be written.
    """
    for kind in what:
        check_known("save", kind, KINDS)
    config = repeating(run)
    result = dataclasses.replace(result_of(run), config=config)
    empty = not result.labels.any() or bool(result.labels.all())
    if empty and set(what) & {"labels", "mesh"}:
        raise UsageError("there is no surface to save", "go back, or restart")
    suffix = "" if source is None else io.split_name(source)[1]
    labels = outputs.label_format(config, suffix)
    outputs.check(config, labels, run.volume.geometry)
    names = {
        kind: f"{name}_{last}"
        for kind, last in outputs.names(config, labels, run.volume.geometry.slice_axis is not None).items()
        if _kind(kind) in what
    }
    paths = {kind: folder / last for kind, last in names.items()}
    paths |= {"run": folder / RUN_FILE} if "run" in what else {}
    paths |= {"report": folder / f"{name}_report.json"} if "report" in what else {}
    outputs.refuse_existing({k: p for k, p in paths.items() if own is not None and p not in own}, overwrite=False)
    outputs.refuse_existing(paths, overwrite=True)
    written = []
    if "run" in paths:
        write_bytes(paths["run"], _toml(config, result, source).encode())
        written.append(("run", paths["run"]))
    picture = outputs.preview_content(result, outputs.outcome_title(name, result))
    written += list(outputs.write_result(result, folder, names, picture))
    if "report" in paths:
        contents = document.build(
            status="ok",
            exit_code=0,
            argv=sys.argv,
            config=config,
            source=None if source is None else file_entries.describe_input(source, geometry=result.geometry),
            result=result,
            outputs=[file_entries.describe_output(path, kind) for kind, path in written],
        )
        write_bytes(paths["report"], (document.to_json(contents) + "\n").encode())
        written.append(("report", paths["report"]))
    return [path for _, path in written]


def _kind(output: str) -> str:
    """What an output is saved under."""
    return {"labels": "labels", "sdf": "labels", "trace": "trace", "preview": "picture"}.get(output, "mesh")


def repeating(run: Run) -> RunConfig:
    """Return the configuration that makes this run, up to where it is, from the start."""
    stop = run.stop
    steps = run.step_number if stop is None else stop.steps
    edits = tuple(edit for edit in run.config.edit if edit.step <= steps)
    # A run that has ended by itself does so again; one that was paused ends here.
    ends = stop is not None and stop.reason not in ("interrupted", "max-steps")
    return run.config.replace(edit=edits, max_steps=max(run.config.max_steps, steps + 1) if ends else steps)


def _toml(config: RunConfig, result: Result, source: Path | None) -> str:
    image = "INPUT" if source is None else source.name
    told = [
        f"# accelsurf {__version__}: {result.stop.reason} after {result.stop.steps} steps.",
        f"# The same run: accelsurf segment {image} --config {RUN_FILE} -o DIR",
    ]
    if result.stop.reason == "interrupted":
        told.append("# max_steps ends it where it was saved; raise it to let the run go on.")
    return "\n".join(told) + "\n\n" + config.to_toml()
