"""``accelsurf batch``: many images or sequences, each as ``segment`` or ``track`` does it, in worker processes.

The settings are for images, or with ``--track`` for tracking; never a mixture.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from accelsurf.batch import Case, CaseTask, Limits, plan_rows, read_cases, shard_of
from accelsurf.cases import COMPILING_ANEW, MAX_ERROR, Interrupts, printable, resuming_command, say
from accelsurf.cli.options import (
    FILES,
    Display,
    File,
    Output,
    Overwrite,
    Switch,
    given_options,
    options_class,
    required,
    run_config,
    settings_class,
)
from accelsurf.cli.progress import BatchProgress, table
from accelsurf.cli.track_options import TrackSettings, track_config
from accelsurf.errors import UsageError
from accelsurf.io import uninterrupted
from accelsurf.output import OutputFolder
from accelsurf.run import bytes_text
from accelsurf.settings import toml
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import FRAME_SETTINGS, TABLE, TrackConfig
from accelsurf.settings.track_fields import TrackFields

if TYPE_CHECKING:
    from accelsurf.batch import Batch, Tables

BATCH = Group("Batch", sort_key=0)
_SWITCH = Parameter(negative=(), show_default=False, group=BATCH)


def _batch_settings() -> type:
    """Return a dataclass with the options of images and of tracking; where both have one it is a text for either."""
    of_images = settings_class(
        "ImageSettings", leave_out=("layout",)
    )  # a folder is read in a layout of its own
    both = {field.name: field.type for kind in (TrackSettings, of_images) for field in fields(kind)}
    return options_class("BatchSettings", [(name, kind, None) for name, kind in both.items()])


BatchSettings = _batch_settings()


@Parameter(name="*")
@dataclass(frozen=True)
class BatchOptions:
    """Options of a batch."""

    track: Annotated[bool, _SWITCH] = False
    """The cases are sequences: each is followed as accelsurf track does it, with the settings of tracking."""

    layout: Annotated[Literal["auto", "folder", "nnunet", "bids"], Parameter(group=BATCH)] = "auto"
    """Way to read a folder; auto looks at its names."""

    output_layout: Annotated[Literal["plain", "bids", "nnunet"] | None, Parameter(group=FILES)] = (
        None
    )
    """Names and layout of label maps, as --layout of accelsurf segment."""

    plan: Annotated[bool, _SWITCH] = False
    """Print the memory that each case is thought to need and the cases that would run at once, and run nothing."""

    resume: Annotated[bool, _SWITCH] = False
    """Leave finished cases alone, those with a result of the same image by the same settings. The others are run."""

    jobs: Annotated[
        int | None, Parameter(group=BATCH, metavar="N", show_default="by cores and memory")
    ] = None
    """Cases at the same time. Unless --threads is given, all together have as many threads as there are cores."""

    shard: Annotated[str | None, Parameter(group=BATCH, metavar="I/N")] = None
    """Run every N-th case from the I-th on. In an array of jobs of SLURM the part of the task, unless given."""

    case_timeout: Annotated[float | None, Parameter(group=BATCH, metavar="SECONDS")] = None
    """End a case that takes longer than this."""

    max_memory: Annotated[
        str | None, Parameter(group=BATCH, metavar="SIZE", show_default="80% of what is free")
    ] = None
    """Memory of all cases together, such as 4GB. What needs more is not run; what takes more is ended."""

    scheduler: Annotated[str | None, Parameter(group=BATCH, metavar="ADDRESS")] = None
    """Run the cases on a Dask cluster: the address of its scheduler, as tcp://host:8786, or its scheduler file. Images
    and outputs must have the same paths there."""

    @property
    def limits(self) -> Limits:
        """Limits of the cases that run at once; options that do not go with others are refused.

        Raises
        ------
        UsageError
        """
        layouts = {
            "--layout": self.layout not in ("auto", "folder"),
            "--output-layout": self.output_layout is not None,
        }
        for name in (name for name, is_other in layouts.items() if self.track and is_other):
            raise UsageError(
                f"{name} is of single images, --track was given", "leave one of them out"
            )
        return Limits(self.jobs, self.case_timeout, self.max_memory, self.scheduler)


def batch(
    *cases: Annotated[str, Parameter(group=BATCH)],
    output: Output = None,
    config: File = None,
    overwrite: Overwrite = False,
    strict: Switch = False,
    options: BatchOptions | None = None,
    settings: BatchSettings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Segment many images, each as segment does, or follow objects through many sequences, as track does.

    A case that fails is named, and the others go on; then the exit code is 9.

    Parameters
    ----------
    cases
        A folder of images; a pattern in quotes; a table, FILE.csv, with columns image, id, reference and any setting
        (several clicks of one cell are separated by semicolons); nnU-Net's folder; a BIDS tree; or files. With --track,
        files with time and folders of frames.
    output
        Folder for the outputs; made when missing. Each case has a folder DIR/ID, or that of --output-layout.
        DIR/batch.csv has a row for each, DIR/batch.html the pictures, the most doubtful first, DIR/batch_report.json
        everything.
    config
        TOML file with settings, with --track those of tracking in its table [track]; options override it, columns of a
        table override both.
    overwrite
        Replace outputs that exist.
    strict
        A case that ends before it has converged, or whose result is doubtful, counts as failed; of images.
    """
    from accelsurf.batch import Batch, task_of

    options, display = options or BatchOptions(), display or Display()
    limits = options.limits
    if strict and options.track:
        raise UsageError("--strict is of single images, --track was given", "leave one of them out")
    shard, note = shard_of(options.shard, os.environ)
    if note and not display.quiet:
        say(note)
    found, words = read_cases(cases, options.layout, options.track)
    folder = Path() if options.plan else required(output, "-o DIR, the output folder,")
    configs = _configs(found, settings, config, options)
    how = overwrite or options.resume, strict, options.resume
    pairs = zip(found, configs, strict=True)
    tasks = [
        task_of(CaseTask(case, folder.absolute(), settings_of_case, *how))
        for case, settings_of_case in pairs
    ]
    if shard is not None:
        tasks = shard.part_of(tasks)
    work = Batch.planned(tasks, limits, shard, words)
    if options.plan:
        return _print_plan(work, options.scheduler)
    tables = [*(Path(text) for text in cases), *([config] if config is not None else [])]
    return _conclude(
        _run(work, folder, limits, overwrite, options.resume, display, tables), folder, display
    )


def _configs(
    cases: Sequence[Case], settings: Any, file: Path | None, options: BatchOptions
) -> list[RunConfig | TrackConfig]:
    """Return the settings of each case; cases without any of their own share one.

    Raises
    ------
    UsageError
        With the case where its setting is not valid; when settings of tracking and of images are mixed.
    """
    below, given = toml.read_toml(file) if file is not None else {}, given_options(settings)
    for key in given:
        name = "--" + key.replace("_", "-")
        if options.track and key not in (*FRAME_SETTINGS, *TrackFields.model_fields):
            raise UsageError(
                f"{name} is of single images, --track was given", "leave one of them out"
            )
        if (
            not options.track
            and key in TrackFields.model_fields
            and key not in RunConfig.model_fields
        ):
            raise UsageError(f"{name} is a setting of tracking", "add --track, or leave it out")
    if not options.track and TABLE in below:
        raise UsageError(
            f"{TABLE}: the configuration file has a table of tracking",
            "add --track, or take it out",
        )
    if options.output_layout is not None:
        given["layout"] = options.output_layout

    def config(**more: Any) -> RunConfig | TrackConfig:
        values = {**given, **more}
        return (
            track_config(None, None, below, **values)
            if options.track
            else run_config(None, below, **values)
        )

    common, configs = config(), []
    for case in cases:
        try:
            configs.append(config(**case.settings) if case.settings else common)
        except UsageError as error:
            raise UsageError(f"{case.place}: {error.message}", error.hint) from None
    return configs


def _print_plan(work: Batch, scheduler: str | None) -> int:
    """Print the needs of each case and the number that would run at once; some failed where one cannot be run."""
    from accelsurf.batch import SOME_FAILED

    rows = plan_rows(work.needs, work.admission)
    cells = [tuple(printable(cell, MAX_ERROR) for cell in line) for line in rows]
    print(table(("case", "values", "memory", ""), cells))
    print(f"\n{_at_once(work, scheduler)}, memory of all: {bytes_text(work.admission.bytes)}")
    impossible = sum(
        need.values is None or need.bytes > work.admission.bytes for need in work.needs.values()
    )
    return SOME_FAILED if impossible else 0


def _at_once(work: Batch, scheduler: str | None) -> str:
    count, admission = len(work.tasks), work.admission
    cases = "1 case" if count == 1 else f"{count} cases"
    if scheduler is not None:
        return f"{cases} of {work.layout}, on the cluster of {scheduler}; threads of each: {admission.threads}"
    return (
        f"{cases} of {work.layout}; {admission.jobs} at once, threads of each: {admission.threads}"
    )


def _run(
    work: Batch,
    folder: Path,
    limits: Limits,
    overwrite: bool,
    resume: bool,
    display: Display,
    given: list[Path],
) -> Tables:
    """Run the cases; files of an earlier batch are refused before anything is computed, ``given`` files always."""
    from accelsurf.batch import make_pool, refuse_inputs_of, refuse_results

    interrupts = Interrupts.current()
    with OutputFolder(folder, work.names.set, overwrite=True).stage() as files:
        if not (overwrite or resume):
            refuse_results(folder, work)
        refuse_inputs_of(work.tasks, [folder / name for name in work.names.all], given)
        if not display.quiet:
            say(_at_once(work, limits.scheduler))
        if limits.scheduler is None and work.tasks:
            _compile_before_workers(display)
        pool = make_pool(work.admission, limits)
        tables = work.tables(files)
        with BatchProgress(display, len(work.tasks)) as progress:
            try:
                work.run(pool, tables, progress)
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt) and work.running:
                    say(
                        "interrupted: the cases that run keep their state (press again to quit at once)"
                    )
                    with suppress(KeyboardInterrupt):
                        work.stop(pool, tables)
                with uninterrupted():
                    work.end_early(
                        pool, tables, interrupts.exit_code(getattr(error, "exit_code", 1))
                    )
                interrupts.note(
                    f"{tables.count('ok')} of {len(work.tasks)} cases are finished; to go on: {resuming_command()}"
                )
                raise
    return tables


def _compile_before_workers(display: Display) -> None:
    """Compile all kernels where they are not stored, once, and not in each worker; say where they cannot be stored."""
    from accelsurf.cli.warmup import compile_all, is_complete
    from accelsurf.kernels import storage

    if is_complete():
        return
    if storage.STORAGE is not None:
        compile_all(display)
    elif not display.quiet:
        say(COMPILING_ANEW)


def _conclude(tables: Tables, folder: Path, display: Display) -> int:
    """Print how the batch ended; return the exit code."""
    from accelsurf.batch import SOME_FAILED

    failed = tables.count("failed")
    if not display.quiet:
        print(
            f"{len(tables.outcomes)} cases: {tables.count('ok')} ok, {failed} failed, {tables.seconds:.1f} s"
        )
        for path in tables.paths(folder):
            print(f"  {path.absolute()}")
    return SOME_FAILED if failed else 0
