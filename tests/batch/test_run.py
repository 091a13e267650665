"""A batch from its first case to its last, with cases that cost nothing."""

import csv
import json
from pathlib import Path

import pytest

from accelsurf.batch import tables as tables_module
from accelsurf.batch.admission import Admission, Need
from accelsurf.batch.case import Case
from accelsurf.batch.outcome import CaseTask, Outcome
from accelsurf.batch.run import Batch
from accelsurf.batch.tables import Tables
from accelsurf.errors import OutputError
from accelsurf.output.folder import OutputFolder
from accelsurf.settings.run_config import RunConfig
from tests.support.batch_jobs import InlinePool


class Watching:
    """Remembers what an observer is told."""

    def __init__(self):
        self.events, self.warnings = [], []

    def found(self, count):
        self.events.append(("found", count))

    def started(self, id):
        self.events.append(("started", id))

    def ended(self, outcome, seconds_left):
        self.events.append((outcome.status, outcome.id))

    def warned(self, text):
        self.warnings.append(text)


@pytest.fixture
def batch(tmp_path, monkeypatch):
    monkeypatch.setattr("accelsurf.batch.worker.lost_outcome", lost)
    tasks = [
        CaseTask(Case(name, tmp_path / f"{name}.nii"), tmp_path / "out" / name, RunConfig())
        for name in "abc"
    ]
    needs = {"a": Need(8, 1), "b": Need(8, 1), "c": Need(8, 1000)}
    return Batch(tasks, needs, Admission(2, 1, 100), None, "a folder")


def statuses(folder):
    with (folder / "batch.csv").open() as file:
        return {row["id"]: row["status"] for row in csv.DictReader(file)}


def lost(task, failure):
    return Outcome(task.case.id, "failed", f"lost: {failure.kind}", details=failure.details)


def run(batch, folder, function):
    watching = Watching()
    with OutputFolder(folder, "batch").stage() as files:
        made = batch.tables(files)
        batch.run(InlinePool(function, 1, bytes=batch.admission.bytes), made, watching)
    return made, watching


def test_tables_are_current_while_it_runs(batch, tmp_path, monkeypatch):
    monkeypatch.setattr(tables_module, "APART_SECONDS", 0.0)
    monkeypatch.setattr(tables_module, "APART_TIMES", 0.0)
    seen = []

    def look(task):
        seen.append(
            (statuses(tmp_path), json.loads((tmp_path / "batch_report.json").read_text())["status"])
        )
        if task.case.id == "b":
            raise ValueError("no luck")
        return Outcome(task.case.id, "ok", ml=1.5)

    made, watching = run(batch, tmp_path, look)
    assert seen == [
        ({"a": "waiting", "b": "waiting", "c": "waiting"}, "running"),
        ({"a": "ok", "b": "waiting", "c": "waiting"}, "running"),
    ]
    assert statuses(tmp_path) == {"a": "ok", "b": "failed", "c": "failed"}
    reasons = {one.id: one.reason for one in made.outcomes}
    assert (reasons["b"], reasons["c"]) == ("lost: error", "lost: memory")
    assert watching.events == [
        ("started", "a"),
        ("ok", "a"),
        ("started", "b"),
        ("failed", "b"),
        ("failed", "c"),
    ]
    document = json.loads((tmp_path / "batch_report.json").read_text())
    assert (document["status"], document["exit_code"]) == ("failed", 9)
    assert "no luck" in document["cases"][1]["details"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "batch.csv",
        "batch.html",
        "batch_report.json",
    ]


def test_tables_that_cannot_be_written_stop_no_case(batch, tmp_path, monkeypatch):
    monkeypatch.setattr(tables_module, "APART_SECONDS", 0.0)
    monkeypatch.setattr(tables_module, "APART_TIMES", 0.0)
    write, calls = Tables.write, []

    def failing(self, status, exit_code):
        calls.append(status)
        if len(calls) == 2:
            raise OutputError("no space")
        write(self, status, exit_code)

    monkeypatch.setattr(Tables, "write", failing)
    _, watching = run(batch, tmp_path, lambda task: Outcome(task.case.id, "ok"))
    assert watching.warnings == ["no space"] and calls[0] == "running" and calls[-1] == "failed"
    assert statuses(tmp_path) == {"a": "ok", "b": "ok", "c": "failed"}


def test_one_batch_at_a_time_writes_the_tables_of_a_folder(batch, tmp_path):
    def again(task):
        with (
            pytest.raises(OutputError, match="another run is writing there"),
            OutputFolder(Path(tmp_path), "batch").stage(),
        ):
            pytest.fail("two at once")
        return Outcome(task.case.id, "ok")

    made, _ = run(batch, tmp_path, again)
    assert made.count("ok") == 2
