"""``accelsurf batch``: many images or sequences, each as ``segment`` or ``track`` does it, in worker processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from accelsurf.cli.batch_settings import BatchSettings, run_configs, track_configs
from accelsurf.cli.interrupts import Interrupts, say
from accelsurf.cli.options import FILES, SHOW, Display, Output, Overwrite, required
from accelsurf.errors import UsageError

if TYPE_CHECKING:
    from accelsurf.batch.admission import Admission, Need
    from accelsurf.batch.case import Case
    from accelsurf.batch.outcome import CaseTask
    from accelsurf.batch.pool import Pool
    from accelsurf.batch.run import Batch
    from accelsurf.batch.tables import Tables
    from accelsurf.settings.run_config import RunConfig
    from accelsurf.settings.track_config import TrackConfig

BATCH = Group("Batch", sort_key=0)
_SWITCH = Parameter(negative=(), show_default=False, group=BATCH)


@Parameter(name="*")
@dataclass(frozen=True)
class BatchOptions:
    """What is particular about a batch."""

    track: Annotated[bool, _SWITCH] = False
    """The cases are sequences: each is followed as accelsurf track does it, with the settings of tracking."""

    layout: Annotated[Literal["auto", "folder", "nnunet", "bids"], Parameter(group=BATCH)] = "auto"
    """How a folder is read; auto looks at its names."""

    output_layout: Annotated[Literal["plain", "bids", "nnunet"] | None, Parameter(group=FILES)] = None
    """How label maps are named and laid out, as --layout of accelsurf segment."""

    plan: Annotated[bool, _SWITCH] = False
    """Print what each case is thought to need and what would run at once, and run nothing."""

    resume: Annotated[bool, _SWITCH] = False
    """Leave alone what is finished: cases with a result of the same image by the same settings. The others are run."""

    jobs: Annotated[int | None, Parameter(group=BATCH, metavar="N", show_default="by cores and memory")] = None
    """Cases at the same time. Unless --threads is given, all together have as many threads as there are cores."""

    shard: Annotated[str | None, Parameter(group=BATCH, metavar="I/N")] = None
    """Run every N-th case from the I-th on. In an array of jobs of SLURM the part of the task, unless given."""

    case_timeout: Annotated[float | None, Parameter(group=BATCH, metavar="SECONDS")] = None
    """End a case that takes longer than this."""

    max_memory: Annotated[str | None, Parameter(group=BATCH, metavar="SIZE", show_default="80% of what is free")] = None
    """Memory of all cases together, such as 4GB. What needs more is not run; what takes more is ended."""

    scheduler: Annotated[str | None, Parameter(group=BATCH, metavar="ADDRESS")] = None
    """Run the cases on a Dask cluster: the address of its scheduler, as tcp://host:8786, or its scheduler file. Images
    and outputs must have the same paths there."""

    @property
    def memory(self) -> int | None:
        """Bytes of all cases together, where they were given."""
        from accelsurf.segmentation.memory_need import memory_of

        return None if self.max_memory is None else memory_of(self.max_memory)

    def checked(self) -> BatchOptions:
        """These; numbers that are none are refused, and what a cluster decides itself.

        Raises
        ------
        UsageError
            With what is expected.
        """
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"--jobs: {self.jobs} was given, expected a whole number at least 1", "leave it out")
        decided = {"--jobs": self.jobs, "--case-timeout": self.case_timeout, "--max-memory": self.max_memory}
        given = [name for name, value in decided.items() if value is not None]
        if self.scheduler is not None and given:
            raise UsageError(f"{given[0]}: was given with --scheduler, which decides that itself", "leave one out")
        if self.case_timeout is not None and not 0 < self.case_timeout < float("inf"):
            raise UsageError(f"--case-timeout: {self.case_timeout:g} was given, expected seconds above 0", "as in 600")
        layouts = {"--layout": self.layout not in ("auto", "folder"), "--output-layout": self.output_layout is not None}
        for name in (name for name, other in layouts.items() if self.track and other):
            raise UsageError(f"{name} is of single images, --track was given", "leave one of them out")
        return self


def batch(
    *cases: Annotated[str, Parameter(group=BATCH)],
    output: Output = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    overwrite: Overwrite = False,
    strict: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False,
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
    from accelsurf.batch.cases import read_cases, shard_of
    from accelsurf.batch.outcome import CaseTask
    from accelsurf.batch.run import Batch
    from accelsurf.io.headers import is_outside_data_allowed

    options, display = (options or BatchOptions()).checked(), display or Display()
    if strict and options.track:
        raise UsageError("--strict is of single images, --track was given", "leave one of them out")
    shard, note = shard_of(options.shard, os.environ)
    if note and not display.quiet:
        say(note)
    found, words = read_cases(cases, options.layout, options.track)
    folder = Path() if options.plan else required(output, "-o DIR, the output folder,")
    configs = _configs(found, settings, config, options)
    how = overwrite or options.resume, strict, is_outside_data_allowed(), options.resume
    tasks = [task_of(CaseTask(case, folder.absolute(), one, *how)) for case, one in zip(found, configs, strict=True)]
    if shard is not None:
        tasks = shard.of(tasks)
    work = Batch(*admitted(tasks, options), shard, words, sys.argv)
    if options.plan:
        return _print_plan(work, options.scheduler)
    tables = [*(Path(text) for text in cases), *([config] if config is not None else [])]
    return _conclude(_run(work, folder, options, overwrite, display, tables), folder, display)


def task_of(task: CaseTask) -> CaseTask:
    """The task of a case in the batch's folder put into a folder of its own, or where the layout has it.

    Raises
    ------
    UsageError
        When the case cannot be in that layout.
    """
    from accelsurf.report import layouts
    from accelsurf.settings.track_config import TrackConfig

    case, folder, config = task.case, task.folder, task.run
    if config.layout == "plain" or isinstance(task.config, TrackConfig):
        return replace(task, folder=folder / case.id)
    try:
        layouts.check(config, case.image, folder, case.id)
    except UsageError as error:
        raise UsageError(f"{case.place}: {error.message}", error.hint) from None
    own = layouts.folder_of(config, case.image, folder)
    return replace(task, folder=own, place=own.relative_to(folder).as_posix())


def _configs(
    cases: Sequence[Case], settings: Any, file: Path | None, options: BatchOptions
) -> list[RunConfig | TrackConfig]:
    """The settings of each case."""
    from accelsurf.settings import toml

    below = toml.read(file) if file is not None else {}
    if options.track:
        return track_configs(cases, settings, below)
    return run_configs(cases, settings, below, options.output_layout)


def admitted(
    tasks: Sequence[CaseTask], options: BatchOptions
) -> tuple[list[CaseTask], dict[str, Need], Admission]:
    """The cases with their number of threads, what each needs, and what runs at once."""
    from accelsurf.batch.admission import admit, by_cluster
    from accelsurf.io.memory import available_cores, available_memory

    needs = {task.case.id: _need(task) for task in tasks}
    given = {task.run.threads for task in tasks} - {"auto"}
    threads = max((int(number) for number in given), default=None)
    free = available_cores(), available_memory()
    admission = (
        admit(list(needs.values()), *free, jobs=options.jobs, threads=threads, memory=options.memory)
        if options.scheduler is None
        else by_cluster(list(needs.values()), threads)
    )
    automatic = [task.with_threads(admission.threads) if task.run.threads == "auto" else task for task in tasks]
    return automatic, needs, admission


def _need(task: CaseTask) -> Need:
    from accelsurf.batch.admission import need_of, need_of_sequence
    from accelsurf.settings.track_config import TrackConfig

    if isinstance(task.config, TrackConfig):
        return need_of_sequence(task.case.image, task.config)
    config = task.config
    return need_of(task.case.image, config.channel, bool(config.inside), config.reading, config.flow)


def _print_plan(work: Batch, scheduler: str | None) -> int:
    """Print what each case needs and what would run at once; some failed where one cannot be run."""
    from accelsurf.batch.admission import plan_rows
    from accelsurf.batch.run import SOME_FAILED
    from accelsurf.cli.error_lines import MAX_ERROR, printable
    from accelsurf.cli.progress import table
    from accelsurf.segmentation.memory_need import bytes_text

    rows = plan_rows(work.needs, work.admission)
    cells = [tuple(printable(cell, MAX_ERROR) for cell in line) for line in rows]
    print(table(("case", "values", "memory", ""), cells))
    print(f"\n{_at_once(work, scheduler)}, memory of all: {bytes_text(work.admission.bytes)}")
    impossible = sum(need.values is None or need.bytes > work.admission.bytes for need in work.needs.values())
    return SOME_FAILED if impossible else 0


def _at_once(work: Batch, scheduler: str | None) -> str:
    count, admission = len(work.tasks), work.admission
    cases = "1 case" if count == 1 else f"{count} cases"
    if scheduler is not None:
        return f"{cases} of {work.layout}, on the cluster of {scheduler}; threads of each: {admission.threads}"
    return f"{cases} of {work.layout}; {admission.jobs} at once, threads of each: {admission.threads}"


def _run(
    work: Batch, folder: Path, options: BatchOptions, overwrite: bool, display: Display, given: list[Path]
) -> Tables:
    """Run the cases; files of an earlier batch are refused before anything is computed, ``given`` files always."""
    from accelsurf.batch.run import refuse_results
    from accelsurf.cli import batch_case
    from accelsurf.cli.batch_progress import BatchProgress
    from accelsurf.io.file_set import uninterrupted
    from accelsurf.report.output_folder import opened_set

    interrupts = Interrupts.current()
    with opened_set(folder, work.names.set) as files:
        if not (overwrite or options.resume):
            refuse_results(folder, work)
        batch_case.refuse_inputs_of(work.tasks, [folder / name for name in work.names.all], given)
        if not display.quiet:
            say(_at_once(work, options.scheduler))
        pool = made_pool(work, options)
        tables = work.tables(files)
        with BatchProgress(display, len(work.tasks)) as progress:
            try:
                work.run(pool, tables, progress, batch_case.lost, options.resume)
            except BaseException as error:
                with uninterrupted():
                    work.end_early(pool, tables, interrupts.exit_code(getattr(error, "exit_code", 1)))
                interrupts.outcome = (
                    f"{tables.count('ok')} of {len(work.tasks)} cases are finished; "
                    "the same command with --resume goes on"
                )
                raise
    return tables


def made_pool(work: Batch, options: BatchOptions) -> Pool:
    """Workers of this machine, or those of a cluster."""
    from accelsurf.cli import batch_case

    if options.scheduler is not None:
        from accelsurf.batch.dask_pool import DaskPool

        return DaskPool(batch_case.run_on_cluster, options.scheduler)
    from accelsurf.batch.pool import LocalPool

    return LocalPool(
        batch_case.run_one,
        work.admission.jobs,
        bytes=work.admission.bytes,
        timeout=options.case_timeout,
        limit=options.memory,
        prepare=batch_case.load,
    )


def _conclude(tables: Tables, folder: Path, display: Display) -> int:
    """Print how the batch ended; return the exit code."""
    from accelsurf.batch.run import SOME_FAILED

    failed = tables.count("failed")
    if not display.quiet:
        print(f"{len(tables.outcomes)} cases: {tables.count('ok')} ok, {failed} failed, {tables.seconds:.1f} s")
        for path in tables.paths(folder):
            print(f"  {path.absolute()}")
    return SOME_FAILED if failed else 0
