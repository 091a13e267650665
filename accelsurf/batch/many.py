"""segment_many(): ``accelsurf batch`` from Python; each case is a future."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Unpack

from accelsurf.batch.admission import Limits
from accelsurf.batch.case import Case, check_id
from accelsurf.batch.cases import checked_cases, read_cases
from accelsurf.batch.outcome import CaseTask, Outcome
from accelsurf.batch.pool import Pool
from accelsurf.batch.run import Batch, refuse_results, task_of
from accelsurf.batch.tables import Tables
from accelsurf.batch.worker import make_pool
from accelsurf.errors import AccelsurfError, AccelsurfWarning, UsageError
from accelsurf.io import FileSet
from accelsurf.output import OutputFolder
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.api.options import ManyOptions

#: Forms of a case: a path, or a mapping with ``image`` and, if wanted, ``id``, ``reference`` and settings.
CaseLike = str | Path | Mapping[str, Any]


class SegmentedMany(Mapping[str, "Future[Outcome]"]):
    """The cases of `segment_many`: a future of each by its id, in their order. A context manager.

    A future's ``result()`` is a line of ``batch.csv`` (`accelsurf.batch.outcome.Outcome`): status ``ok`` or ``failed``,
    with its reason. It raises only where the batch as a whole cannot go on.
    """

    def __init__(self, work: Batch, pool: Pool, folder: Path) -> None:
        self._work = work
        self._pool = pool
        self._folder = folder
        self._futures: dict[str, Future[Outcome]] = {task.case.id: Future() for task in work.tasks}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="accelsurf-many", daemon=True)
        self._thread.start()

    def __getitem__(self, id: str) -> Future[Outcome]:
        return self._futures[id]

    def __iter__(self) -> Iterator[str]:
        return iter(self._futures)

    def __len__(self) -> int:
        return len(self._futures)

    def __enter__(self) -> SegmentedMany:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(wait=kind is None)

    def outcomes(self) -> dict[str, Outcome]:
        """Wait for all cases.

        Raises
        ------
        AccelsurfError
            When the batch as a whole cannot go on.
        """
        return {id: future.result() for id, future in self._futures.items()}

    def close(self, wait: bool = True) -> None:
        """Wait for the end, or end the cases that run: finished ones stay, the others are cancelled.

        Parameters
        ----------
        wait : bool
        """
        if not wait:
            self._closing.set()
            self._pool.interrupt()
        self._thread.join()

    def _run(self) -> None:
        try:
            with OutputFolder(self._folder, self._work.names.set, overwrite=True).stage() as files:
                self._run_in(files)
        except BaseException as error:
            self._leave(error)
        else:
            self._leave(None)

    def _run_in(self, files: FileSet) -> None:
        tables = self._work.tables(files)
        try:
            self._work.run(self._pool, tables, _Watch(self._futures, tables))
        except BaseException:
            self._work.end_early(self._pool, tables, 1)
            raise

    def _leave(self, error: BaseException | None) -> None:
        """Give a result to the futures that have none yet."""
        self._pool.close()
        for future in self._futures.values():
            if future.done():
                continue
            if error is None or self._closing.is_set():
                future.cancel()
            else:
                future.set_exception(error)


class _Watch:
    """Hands each line on to the future of its case."""

    def __init__(self, futures: Mapping[str, Future[Outcome]], tables: Tables) -> None:
        self._futures, self._tables = futures, tables

    def found(self, count: int) -> None:
        for line in self._tables.outcomes:
            if line.status != "waiting":
                self._futures[line.id].set_result(line)

    def started(self, id: str) -> None:
        """Leave the future as it is: it may still be cancelled with the batch."""

    def ended(self, outcome: Outcome, seconds_left: float | None) -> None:
        self._futures[outcome.id].set_result(outcome)

    def warned(self, text: str) -> None:
        warnings.warn(text, AccelsurfWarning, stacklevel=2)


def segment_many(  # noqa: PLR0913
    cases: str | Path | Sequence[CaseLike],
    output: str | Path,
    *,
    config: RunConfig | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    case_timeout: float | None = None,
    max_memory: str | None = None,
    overwrite: bool = False,
    resume: bool = False,
    strict: bool = False,
    **options: Unpack[ManyOptions],
) -> SegmentedMany:
    """Segment many images in worker processes, as ``accelsurf batch`` does.

    Parameters
    ----------
    cases : str, path, or sequence of str, path or mapping
        A folder, a pattern, a table; or a list of images, or of mappings with ``image``, ``id``, ``reference`` and
        settings.
    output : str or path
        Folder of all files; each case has its own in it.
    config : RunConfig, optional
        Settings of all cases; the defaults otherwise.
    jobs, scheduler, case_timeout, max_memory, overwrite, resume, strict
        As the options of ``accelsurf batch``.
    **options
        Settings of all cases by name; they override ``config``.

    Returns
    -------
    SegmentedMany
        At once: a mapping from ids to `concurrent.futures.Future`; ``outcomes()`` waits for all.

    Raises
    ------
    UsageError, InputError, OutputError
        When a case or a setting is not valid, or results stand in the folder that may not be replaced.

    Notes
    -----
    Workers are new processes that import the program's main module: it needs ``if __name__ == "__main__":``.

    Examples
    --------
    >>> if __name__ == "__main__":  # doctest: +SKIP
    ...     with accelsurf.segment_many("scans", "out", start="largest:otsu") as many:
    ...         for id, future in many.items():
    ...             print(id, future.result().ml)
    """
    limits = Limits(jobs, case_timeout, max_memory, scheduler)
    found, words = _cases(cases)
    common, folder = (config or RunConfig()).replace(**options), Path(output)
    base = CaseTask(found[0], folder.absolute(), common, overwrite or resume, strict, resume=resume)
    tasks = [task_of(replace(base, case=case, config=_config(case, common))) for case in found]
    work = Batch.planned(tasks, limits, None, words)
    if not (overwrite or resume):
        refuse_results(folder, work)
    return SegmentedMany(work, make_pool(work.admission, limits), folder)


def _cases(given: str | Path | Sequence[CaseLike]) -> tuple[list[Case], str]:
    """The cases, and their source in words."""
    if isinstance(given, (str, Path)):
        return read_cases([str(given)])
    several = list(given)
    if all(isinstance(case, (str, Path)) for case in several):
        return read_cases([str(case) for case in several])
    cases = [_case(case, place) for place, case in enumerate(several)]
    return checked_cases(cases), "a list"


def _case(given: CaseLike, number: int) -> Case:
    """A case of a list."""
    from accelsurf.io import split_name

    if isinstance(given, (str, Path)):
        given = {"image": given}
    settings = dict(given)
    if "image" not in settings:
        raise UsageError(f"cases: case {number} has no image", "give each at least image=PATH")
    image, reference = Path(settings.pop("image")), settings.pop("reference", None)
    given_id = settings.pop("id", None)
    id = split_name(image)[0] if given_id is None else str(given_id)
    case = Case(
        id, image, settings, None if reference is None else Path(reference), f"case {number}"
    )
    return case if given_id is None else check_id(case)


def _config(case: Case, common: RunConfig) -> RunConfig:
    try:
        return common.replace(**case.settings) if case.settings else common
    except AccelsurfError as error:
        raise type(error)(f"{case.place}: {error.message}", error.hint) from None
