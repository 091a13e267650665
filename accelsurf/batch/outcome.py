"""Outcomes of cases: lines of the batch's tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

from accelsurf.batch.case import Case
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

#: How it stands with a case; waiting: it has not been run, or has not ended.
Status = Literal["ok", "failed", "waiting"]
#: Columns of the table of a batch of images, and of sequences.
COLUMNS = ("id", "status", "reason", "ml", "probability", "dice", "steps", "seconds", "folder")
TRACK_COLUMNS = ("id", "status", "reason", "objects", "frames", "probability", "seconds", "folder")


@dataclass(frozen=True)
class CaseTask:
    """A case with everything that a worker needs to run it.

    Attributes
    ----------
    case : Case
    folder : Path
        Of its files.
    config : RunConfig or TrackConfig
        The latter where the case is a sequence.
    overwrite : bool
        Whether files of an earlier run may be replaced.
    strict : bool
        Whether a run that did not converge, or whose result is doubtful, counts as failed.
    resume : bool
        Whether it goes on from the state that an earlier run has left.
    place : str
        Its folder within that of the batch; empty: the id of the case.
    """

    case: Case
    folder: Path
    config: RunConfig | TrackConfig
    overwrite: bool = False
    strict: bool = False
    resume: bool = False
    place: str = ""

    @property
    def run(self) -> RunConfig:
        """The settings of its run; of a sequence, of the run on each frame."""
        return self.config.run if isinstance(self.config, TrackConfig) else self.config

    def with_threads(self, threads: int) -> Self:
        """The same on a number of threads."""
        run = self.run.model_copy(update={"threads": threads})
        return replace(
            self,
            config=self.config.replace(run=run) if isinstance(self.config, TrackConfig) else run,
        )

    @property
    def shown_folder(self) -> str:
        """Its folder within that of the batch."""
        return self.place or self.case.id


@dataclass(frozen=True)
class Outcome:
    """A line of the tables.

    Attributes
    ----------
    id : str
    status : {"ok", "failed", "waiting"}
    reason : str
        Why its run ended or failed.
    ml : float or None
        Volume of the object, or of all objects.
    probability : float or None
        Probability that the result is good; of several objects the least.
    dice : float or None
        With the reference.
    steps : int or None
    objects, frames : int or None
        Of a sequence: identities, and frames that were done.
    seconds : float or None
        From file to files; of a sequence the seconds of its frames.
    folder : str
        Of its files, in the folder of the batch.
    picture : str
        Name of its picture there; empty where it has none.
    hint : str
        Remedy for a failure.
    exit_code : int
        Exit code that `accelsurf segment` or `accelsurf track` would return.
    warnings : tuple of str
    details : str
        The traceback of an error that is a bug.
    """

    id: str
    status: Status = "waiting"
    reason: str = ""
    ml: float | None = None
    probability: float | None = None
    dice: float | None = None
    steps: int | None = None
    objects: int | None = None
    frames: int | None = None
    seconds: float | None = None
    folder: str = ""
    picture: str = ""
    hint: str = ""
    exit_code: int = 0
    warnings: tuple[str, ...] = ()
    details: str = ""


def outcome_of_report(task: CaseTask, report: Mapping[str, Any], dice: float | None) -> Outcome:
    """Return the line of a case that has a result, from the report of its run or of its tracking.

    Parameters
    ----------
    task : CaseTask
    report : mapping
        From `accelsurf.output.document.build`, or `accelsurf.track.output.document.build`.
    dice : float or None
    """
    error = report["error"]
    of_kind = (
        _of_tracking(report)
        if isinstance(task.config, TrackConfig)
        else {**_of_run(report), "dice": dice}
    )
    return Outcome(
        id=task.case.id,
        status="ok" if report["status"] == "ok" else "failed",
        **({**of_kind, "reason": error["message"]} if error else of_kind),
        folder=task.shown_folder,
        picture=next(
            (
                Path(output["path"]).name
                for output in report["outputs"]
                if output["kind"] == "preview"
            ),
            "",
        ),
        hint=error["hint"] if error else "",
        exit_code=report["exit_code"],
        warnings=tuple(report["warnings"]),
    )


def _of_run(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the cells of a run."""
    best = report.get("estimates") or report  # a report of an earlier version has none
    volume, is_2d = best["volume_mm3"], report["enclosed_mm2"] is not None
    return {
        "reason": report["stop"]["reason"],
        "ml": None if volume is None or is_2d else volume / 1000,
        "probability": _probability(report),
        "steps": report["stop"]["steps"],
        "seconds": report["seconds"]["total"],
    }


def _of_tracking(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the cells of a tracking: the ends of its objects, and the least of their qualities."""
    tracks, frames = report["tracks"], report["frames"]
    ends = Counter(track["end"] for track in tracks)
    qualities = [track["quality_lowest"] for track in tracks if track["quality_lowest"] is not None]
    return {
        "reason": ", ".join(f"{count} {end}" for end, count in ends.items()),
        "probability": min(qualities, default=None),
        "objects": len(tracks),
        "frames": len(frames),
        "seconds": sum(frame["seconds"] for frame in frames),
    }


def _probability(report: Mapping[str, Any]) -> float | None:
    several = [entry["quality"] for entry in report["objects"] or ()]
    found = [
        quality["probability"]
        for quality in (several or [report["quality"]])
        if quality is not None
    ]
    return min(found, default=None)
