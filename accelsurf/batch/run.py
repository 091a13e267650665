"""A batch from its first case to its last: cases go to a pool, their outcomes into the tables."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, Self

from accelsurf.batch.admission import (
    Admission,
    Limits,
    Need,
    admit,
    by_cluster,
    need_of,
    need_of_sequence,
)
from accelsurf.batch.cases import Shard
from accelsurf.batch.outcome import COLUMNS, TRACK_COLUMNS, CaseTask, Outcome
from accelsurf.batch.pool import Ended, Job, Pool, Started
from accelsurf.batch.records import finished
from accelsurf.batch.tables import TableNames, Tables
from accelsurf.errors import OutputError, UsageError
from accelsurf.io import FileSet, available_cores, available_memory, recover
from accelsurf.output import Report, check_layout, layout_folder, report_name
from accelsurf.settings.track_config import TrackConfig

#: Exit code of a batch of which some cases failed.
SOME_FAILED = 9

#: Of an image whose header cannot be read, for the time that is left.
_UNKNOWN_VALUES = 1


class Observer(Protocol):
    """Watches a batch."""

    def found(self, count: int) -> None:
        """Note the number of cases that are finished already."""
        ...

    def started(self, id: str) -> None:
        """A case begins."""
        ...

    def ended(self, outcome: Outcome, seconds_left: float | None) -> None:
        """A case has ended; ``seconds_left`` of the whole batch, None where that cannot be said."""
        ...

    def warned(self, text: str) -> None:
        """Something about the batch itself is not as it should be."""
        ...


class TimeLeft:
    """Estimate of the time that the rest of a batch takes, by the values of the images and the time so far.

    Parameters
    ----------
    sizes : mapping of str to int
        Values of the image of each case.

    Examples
    --------
    >>> left = TimeLeft({"a": 10, "b": 30})
    >>> left.after("a", 2.0), left.after("b", 8.0)
    (6.0, 0.0)
    """

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self._waiting = dict(sizes)
        self._done = 0

    def after(self, id: str, seconds: float) -> float | None:
        """Seconds that are left when a case has ended, ``seconds`` after the beginning."""
        self._done += self._waiting.pop(id, 0)
        return seconds / self._done * sum(self._waiting.values()) if self._done else None


@dataclass(frozen=True, eq=False)
class Batch:
    """The cases of a batch, and how they are run.

    Parameters
    ----------
    tasks : sequence of CaseTask
    needs : mapping of str to Need
        Of each case by its id.
    admission : Admission
    shard : Shard or None
    layout : str
        Layout of the cases' source, in words.

    Attributes
    ----------
    running : set of str
        Ids of the cases that run now.
    """

    tasks: Sequence[CaseTask]
    needs: Mapping[str, Need]
    admission: Admission
    shard: Shard | None
    layout: str
    running: set[str] = field(default_factory=set)

    @classmethod
    def planned(
        cls, tasks: Sequence[CaseTask], limits: Limits, shard: Shard | None, layout: str
    ) -> Self:
        """Return a batch whose cases have their number of threads, and how many of them run at once."""
        needs = {task.case.id: _need(task) for task in tasks}
        given = {task.run.threads for task in tasks} - {"auto"}
        threads = max((int(number) for number in given), default=None)
        if limits.scheduler is not None:
            admission = by_cluster(list(needs.values()), threads)
        else:
            admission = admit(
                list(needs.values()),
                available_cores(),
                available_memory(),
                jobs=limits.jobs,
                threads=threads,
                memory=limits.memory,
            )
        tasks = [
            task.with_threads(admission.threads) if task.run.threads == "auto" else task
            for task in tasks
        ]
        return cls(tasks, needs, admission, shard, layout)

    @property
    def names(self) -> TableNames:
        """Names of the tables."""
        return TableNames(self.shard)

    def tables(self, files: FileSet) -> Tables:
        """The tables of this batch, with every case waiting."""
        waiting = [Outcome(task.case.id, folder=task.shown_folder) for task in self.tasks]
        images = {task.case.id: task.case.image for task in self.tasks}
        is_tracking = any(isinstance(task.config, TrackConfig) for task in self.tasks)
        about = {
            "argv": sys.argv,
            "layout": self.layout,
            "shard": None if self.shard is None else str(self.shard),
            "jobs": self.admission.jobs,
            "threads": self.admission.threads,
            "memory_bytes": self.admission.bytes,
        }
        columns = TRACK_COLUMNS if is_tracking else COLUMNS
        return Tables(files, self.names, about, waiting, images, columns)

    def run(self, pool: Pool, tables: Tables, observer: Observer) -> None:
        """Run the cases in a pool, record the outcome of each, and close the pool.

        Parameters
        ----------
        pool : Pool
            Its function makes an `Outcome` of a `CaseTask`.
        tables : Tables
        observer : Observer

        Raises
        ------
        OutputError
            When the tables cannot be written at the end.
        """
        left = self.tasks
        if any(task.resume for task in self.tasks):
            with ThreadPoolExecutor(available_cores()) as readers:  # of images, for their checksums
                done = [outcome for outcome in readers.map(finished, self.tasks) if outcome]
            tables.put(done)
            observer.found(len(done))
            ids = {outcome.id for outcome in done}
            left = [task for task in self.tasks if task.case.id not in ids]
        tables.write("running", 0)
        self._run(left, pool, tables, observer)
        pool.close()
        failed = tables.count("failed") > 0
        tables.write("failed" if failed else "ok", SOME_FAILED if failed else 0)

    def _run(
        self, tasks: Sequence[CaseTask], pool: Pool, tables: Tables, observer: Observer
    ) -> None:
        from accelsurf.batch.worker import lost_outcome  # it loads a run

        by_id = {task.case.id: task for task in tasks}
        for id, task in by_id.items():
            pool.submit(Job(id, task, self.needs[id].bytes))
        left = TimeLeft({id: self.needs[id].values or _UNKNOWN_VALUES for id in by_id})
        began = time.monotonic()
        for event in pool.events():
            match event:
                case Started(id):
                    self.running.add(id)
                    observer.started(id)
                case Ended(id, value, failure):
                    outcome: Outcome = (
                        value if failure is None else lost_outcome(by_id[id], failure)
                    )
                    self.running.discard(id)
                    try:
                        tables.add(outcome)
                    except OutputError as error:  # at the end it counts
                        observer.warned(error.message)
                    observer.ended(outcome, left.after(id, time.monotonic() - began))

    def stop(self, pool: Pool, tables: Tables) -> None:
        """Let the cases that run keep their state; those that end with a result are in the tables."""
        for ended in pool.stop():
            if ended.failure is None:
                self.running.discard(ended.key)
                tables.put([ended.value])

    def end_early(self, pool: Pool, tables: Tables, exit_code: int) -> None:
        """End the running cases, remove their staging files, and write the tables as they are.

        Parameters
        ----------
        pool : Pool
        tables : Tables
        exit_code : int
            Exit code of the command.
        """
        pool.close()
        for task in self.tasks:
            if task.case.id in self.running and task.folder.is_dir():
                recover(task.folder)
        with suppress(OutputError):  # another error is on its way
            tables.write("interrupted", exit_code)


def _need(task: CaseTask) -> Need:
    config, image = task.config, task.case.image
    if isinstance(config, TrackConfig):
        return need_of_sequence(image, config)
    return need_of(image, config.channel, bool(config.inside), config.reading, config.flow.name)


def refuse_results(folder: Path, work: Batch) -> None:
    """Refuse to begin where the tables of an earlier batch stand, or the result of a case.

    Raises
    ------
    OutputError
        With the options that help.
    """
    tables = [folder / name for name in reversed(work.names.all)]
    reports = [task.folder / report_name(task.case.id) for task in work.tasks]
    existing = [path for path in tables if path.exists()]
    existing += [path for path in reports if path.exists() and not Report(path).is_failure]
    if existing:
        raise OutputError(
            f"{existing[0]}: exists already",
            "add --resume to run what is not finished, --overwrite to run everything again, or choose another folder "
            "with -o",
        )


def task_of(task: CaseTask) -> CaseTask:
    """Return the task of a case in a folder of its own within the folder of the batch, or as the layout has it.

    Raises
    ------
    UsageError
        When the case cannot be in that layout.
    """
    case = task.case
    folder = task.folder
    config = task.run
    if config.layout == "plain" or isinstance(task.config, TrackConfig):
        return replace(task, folder=folder / case.id)
    try:
        check_layout(config, case.image, folder, case.id)
    except UsageError as error:
        raise UsageError(f"{case.place}: {error.message}", error.hint) from None
    laid_out = layout_folder(config, case.image, folder)
    return replace(task, folder=laid_out, place=laid_out.relative_to(folder).as_posix())
