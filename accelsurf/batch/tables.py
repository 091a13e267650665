"""The tables of a batch: one report, one CSV, one page; brought up to date while it runs, all three at once."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from accelsurf.batch import page
from accelsurf.batch.cases import Shard
from accelsurf.batch.outcome import COLUMNS, Outcome
from accelsurf.io import FileSet, table_text, write_bytes
from accelsurf.output import naming_final, report_json, versions

#: Raised when a key of the report or a column of the table changes its name or its meaning.
SCHEMA_VERSION = 1
#: Least time between two writings of the tables while cases run: seconds, and multiples of the time of a writing.
APART_SECONDS = 2.0
APART_TIMES = 20.0

BatchStatus = Literal["running", "ok", "failed", "interrupted"]


class TableNames:
    """Names of the three tables; a shard's have its number.

    Examples
    --------
    >>> TableNames(Shard(2, 4)).all
    ('batch_2of4.csv', 'batch_2of4.html', 'batch_report_2of4.json')
    """

    def __init__(self, shard: Shard | None = None) -> None:
        part = "" if shard is None else f"_{shard.number}of{shard.total}"
        self.table = f"batch{part}.csv"
        self.page = f"batch{part}.html"
        self.report = f"batch_report{part}.json"
        #: Of the set of files.
        self.set = f"batch{part}"

    @property
    def all(self) -> tuple[str, str, str]:
        """All three, the report last."""
        return self.table, self.page, self.report


class Tables:
    """The line of each case, and the files that have them.

    Parameters
    ----------
    files : FileSet
        That the tables are put in place by.
    names : TableNames
    about : mapping
        Entries about the whole batch, for the report.
    outcomes : sequence of Outcome
        A line for each case, in their order.
    images : mapping of str to Path
        Image of each case.
    columns : sequence of str, optional
        Of the table.
    """

    def __init__(
        self,
        files: FileSet,
        names: TableNames,
        about: Mapping[str, Any],
        outcomes: Sequence[Outcome],
        images: Mapping[str, Path],
        columns: Sequence[str] = COLUMNS,
    ) -> None:
        self._columns = columns
        self._files = files
        self._names = names
        self._about = about
        self._images = images
        self._outcomes = {outcome.id: outcome for outcome in outcomes}
        self._began = self._written = time.monotonic()
        self._cost = 0.0

    @property
    def outcomes(self) -> list[Outcome]:
        """The line of each case, in their order."""
        return list(self._outcomes.values())

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return time.monotonic() - self._began

    def paths(self, folder: Path) -> list[Path]:
        """Return the paths of the three in a folder."""
        return [folder / name for name in self._names.all]

    def count(self, status: str) -> int:
        """Count the cases with a status."""
        return sum(outcome.status == status for outcome in self._outcomes.values())

    def put(self, outcomes: Iterable[Outcome]) -> None:
        """Record the outcomes of some cases, without writing anything."""
        self._outcomes |= {outcome.id: outcome for outcome in outcomes}

    def add(self, outcome: Outcome) -> None:
        """Record the outcome of a case; write the tables if the last time was long ago.

        Raises
        ------
        OutputError
            When they cannot be written.
        """
        self.put([outcome])
        if time.monotonic() - self._written >= max(APART_SECONDS, APART_TIMES * self._cost):
            self.write("running", 0)

    def write(self, status: BatchStatus, exit_code: int) -> None:
        """Write all three.

        Parameters
        ----------
        status : {"running", "ok", "failed", "interrupted"}
        exit_code : int
            Exit code of the command.

        Raises
        ------
        OutputError
            When they cannot be written; the earlier ones stay.
        """
        began, outcomes = time.monotonic(), self.outcomes
        with naming_final(self._files):
            self._files.discard()
            contents = {
                self._names.table: table_csv(outcomes, self._columns),
                self._names.page: page.page_html(
                    outcomes, status, (self._names.table, self._names.report), self._columns
                ),
                self._names.report: report_json(self._report(status, exit_code)) + "\n",
            }
            for name, text in contents.items():
                write_bytes(self._files.staging / name, text.encode())
            self._files.commit(last=self._names.report)
        self._written = time.monotonic()
        self._cost = self._written - began

    def _image_of(self, id: str) -> str:
        """Path of the image of a case; bytes of it that are no text are written as escapes."""
        return os.fspath(self._images[id]).encode("utf-8", "backslashreplace").decode("utf-8")

    def _report(self, status: BatchStatus, exit_code: int) -> dict[str, Any]:
        cases = []
        for outcome in self.outcomes:
            entry = asdict(outcome)
            cases.append({"id": outcome.id, "image": self._image_of(outcome.id), **entry})
        counts = {key: self.count(key) for key in ("ok", "failed", "waiting")}
        return {
            "schema_version": SCHEMA_VERSION,
            "status": status,
            "exit_code": exit_code,
            "versions": versions(),
            **self._about,
            "counts": {"cases": len(cases), **counts},
            "seconds": self.seconds,
            "cases": cases,
        }


def table_csv(outcomes: Sequence[Outcome], columns: Sequence[str] = COLUMNS) -> str:
    """Return the table as CSV text: one row per case; unknown values are empty.

    Examples
    --------
    >>> one = Outcome("a", "ok", "converged", ml=1.5, probability=0.934567891, steps=12, seconds=0.8, folder="a")
    >>> print(table_csv([one]), end="")
    id,status,reason,ml,probability,dice,steps,seconds,folder
    a,ok,converged,1.5,0.9346,,12,0.8,a
    """
    rows = (
        [_with_known_digits(getattr(outcome, name)) for name in columns] for outcome in outcomes
    )
    return table_text(columns, rows)


def _with_known_digits(value: Any) -> Any:
    """A number with four digits: the report of a case has all."""
    return float(f"{value:.4g}") if isinstance(value, float) else value
