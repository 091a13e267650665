"""``segment --objects`` on an image that is read in parts: groups of objects, in processes or on a cluster."""

from __future__ import annotations

import hashlib
import importlib
import json
import pickle
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from accelsurf.batch import Ended, Job, Pool
from accelsurf.cases import Interrupts, resuming_command
from accelsurf.cli import large_image
from accelsurf.cli.large_image import ObjectOptions
from accelsurf.cli.object_outputs import ObjectsDone, write_outputs
from accelsurf.cli.options import Display
from accelsurf.cli.progress import BatchProgress
from accelsurf.errors import AccelsurfError, OutputError
from accelsurf.io import available_cores, is_unfinished, refuse_links
from accelsurf.output import (
    EACH,
    OutputFolder,
    had_settings,
    load_report,
    not_of_groups,
    read_group,
    write_group,
    write_near,
)
from accelsurf.settings.run_config import RunConfig
from accelsurf.version import __version__

if TYPE_CHECKING:
    from accelsurf.large import Boxes, Groups, LargeImage, ManyStarts, Numbers
    from accelsurf.large import Group as Places
    from accelsurf.output import GroupRecord

#: Settings without effect on the files of a group.
_WITHOUT_EFFECT = ("threads", "checkpoint", "format")
#: Modules that a group loads, so that a worker has it before its first one.
_LOADED = ("accelsurf.large.many_objects", "accelsurf.output.document")


@dataclass(frozen=True, eq=False)
class GroupTask:
    """A group that is to be run.

    Attributes
    ----------
    image : LargeImage
        With the memory of this group.
    numbers : tuple of mapping
        Of each whole channel, as `accelsurf.large.many_objects.numbers_needed` returns them.
    config : RunConfig
    starts : ManyStarts
        The starts of the group alone.
    others : Boxes
        Where objects begin that are not in the group.
    other_ids : tuple of int
        Of these.
    folder : Path
        Where its files go.
    names : mapping of str to str
        Of the meshes of a single object, by kind.
    """

    image: LargeImage
    numbers: tuple[Numbers, ...]
    config: RunConfig
    starts: ManyStarts
    others: Boxes
    other_ids: tuple[int, ...]
    folder: Path
    names: Mapping[str, str]


class GroupEnd(NamedTuple):
    """End of a group: why it ``failed``, if it did, and whether it was ``too_large`` for its memory."""

    failed: str = ""
    too_large: bool = False


def load() -> None:
    """Load the modules that every group needs."""
    for name in _LOADED:
        importlib.import_module(name)


def run_task(task: GroupTask) -> GroupEnd:
    """Run a group and write its files; return why it failed, if it did.

    Parameters
    ----------
    task : GroupTask
    """
    from accelsurf.large import LargeRun, MeetsOthers, TooLarge, failure_text, run_group

    large = LargeRun(task.image, task.image.whole(task.config, task.numbers), task.config)
    try:
        starts = task.starts.made(range(len(task.starts.ids)))
        result = run_group(large, starts, task.others)
        write_group(task.folder, result, task.names, task.config.mesh_space)
    except MeetsOthers as near:
        write_near(task.folder, [task.other_ids[place] for place in near.places])
    except (AccelsurfError, MemoryError) as error:
        return GroupEnd(failure_text(error), isinstance(error, TooLarge))
    return GroupEnd()


def run_objects(
    place: OutputFolder,
    config: RunConfig,
    image: LargeImage,
    options: ObjectOptions,
    resume: bool,
    display: Display,
) -> int:
    """Run the objects of a large image, and write their files; returns the exit code.

    Parameters
    ----------
    place : OutputFolder
    config : RunConfig
    image : LargeImage
    options : ObjectOptions
    resume : bool
        Whether groups that an earlier run has left count.
    display : Display

    Raises
    ------
    AccelsurfError
        When nothing can be run, or not be written.
    """
    from accelsurf.large import check_settings

    config = large_image.settings_in_windows(place, config)
    check_settings(config)
    image.check()
    report = load_report(place.report) if resume else None
    if report is not None and report["status"] == "ok" and had_settings(report, config):
        if not display.quiet:
            print(f"{place.name}: has ended already, see {place.report.absolute()}")
        return int(report["exit_code"])
    stopped = report is not None and report["status"] != "ok" and report.get("objects")
    if stopped or (resume and is_unfinished(place.path, place.name)):
        place = place.resumed(place.plan(config).values())
    with place.stage(place.plan(config), place.inputs(config)) as files:
        work = _work_folder(place, resume)
        done = _Work(place, config, image, options, work).run(display)
        return write_outputs(place, config, image, done, files, display)


def _work_folder(place: OutputFolder, resume: bool) -> Path:
    """Return the folder for the files of the groups.

    Raises
    ------
    OutputError
        When an earlier run has left files there that may not be lost.
    """
    work = (place.path / f".{place.name}_objects").absolute()
    refuse_links(work, "remove the link, or choose another folder with -o")
    replace(place, resume=resume).refuse_left(work)
    if others := not_of_groups(work):
        raise OutputError(f"{others[0]}: no run has left it there", "move it away")
    if work.is_dir() and not resume:
        shutil.rmtree(work)
    work.mkdir(exist_ok=True)
    for staged in work.glob(".draft-*"):
        shutil.rmtree(staged, ignore_errors=True)
    return work


class _Work:
    """Runs the groups of objects of one image, from the first to the last."""

    def __init__(
        self,
        place: OutputFolder,
        config: RunConfig,
        image: LargeImage,
        options: ObjectOptions,
        folder: Path,
    ) -> None:
        from accelsurf.large import Groups, many_starts, notes_of, numbers_needed

        jobs = options.jobs or 1
        self._options, self._whole_image = options, image
        self._image = replace(image, max_bytes=image.max_bytes // jobs)
        self._place, self._folder, self._config = place, folder, _with_threads(config, options)
        self._starts: ManyStarts = many_starts(str(config.objects), image)
        self._groups: Groups = Groups(self._starts)
        whole = image.whole(config)
        self._numbers, self._notes = numbers_needed(whole, config), notes_of(whole)
        self._key = _key_of(config, image, self._numbers)
        self._records: dict[Places, GroupRecord] = {}
        self._failures: dict[Places, str] = {}

    def run(self, display: Display) -> ObjectsDone:
        """Run group after group, until no two of them could have met."""
        pool = self._pool()
        interrupts = Interrupts.current()
        number = 0
        with BatchProgress(display, len(self._starts.ids), "objects") as progress:
            try:
                while self._groups.waiting:
                    self._round(pool, number, progress)
                    for group in self._groups.unite():
                        progress.take_back(len(group) if group in self._records else 0)
                        self._records.pop(group, None)
                    number += 1
            except BaseException:
                count = sum(len(group) for group in self._records)
                interrupts.note(
                    f"{count} of {len(self._starts.ids)} objects are done; to go on: {resuming_command()}"
                )
                raise
            finally:
                pool.close()
        ids = self._starts.ids
        failures = {
            int(ids[place]): why for group, why in self._failures.items() for place in group
        }
        records = [self._records[group] for group in sorted(self._records)]
        return ObjectsDone(records, failures, ids.tolist(), self._folder, self._notes)

    def _round(self, pool: Pool, number: int, progress: BatchProgress) -> None:
        """Run the groups that wait, and record how they ended."""
        groups = {f"{number}-{place}": group for place, group in enumerate(self._groups.waiting)}
        for key, group in groups.items():
            record = read_group(self._folder_of(group))
            if record is None:
                pool.submit(Job(key, self._task(group)))
            else:
                self._put(group, record, progress)
        too_large = [
            groups[event.key]
            for event in pool.events()
            if not self._took(event, groups, progress, False)
        ]
        for group in too_large:  # one after the other, with the memory of all jobs
            pool.submit(Job("alone", self._task(group, alone=True)))
            for event in pool.events():
                self._took(event, {"alone": group}, progress, True)

    def _took(
        self, event: Any, groups: dict[str, Places], progress: BatchProgress, alone: bool
    ) -> bool:
        """Record how a group ended; False where it was too large for its part of the memory."""
        if not isinstance(event, Ended):
            return True
        group, failure = (
            groups[event.key],
            event.value.failed if event.failure is None else event.failure.message,
        )
        may_have_more = not alone and self._whole_image.max_bytes > self._image.max_bytes
        if event.failure is None and event.value.too_large and may_have_more:
            return False
        record = None if failure else read_group(self._folder_of(group))
        if record is not None:
            self._put(group, record, progress)
            return True
        why = failure or "what it left cannot be read"
        self._failures[group] = why
        self._groups.put_failed(group)
        progress.ended_objects(self._name(group), len(group), why)
        return True

    def _put(self, group: Places, record: GroupRecord, progress: BatchProgress) -> None:
        if record.near:
            ids = self._starts.ids.tolist()
            self._groups.put_near(group, [ids.index(label) for label in record.near])
            return
        self._records[group] = record
        self._groups.put(group, record.low, record.high)
        progress.ended_objects(self._name(group), len(group), "")

    def _name(self, group: Places) -> str:
        first = f"object {self._starts.ids[group[0]]}"
        return first if len(group) == 1 else f"{first} and {len(group) - 1} more"

    def _folder_of(self, group: Places) -> Path:
        """Return the folder of a group's files, found again by the same objects, starts, image and settings alone."""
        rows = (
            self._starts.ids[list(group)].tolist(),
            *(starts.tolist() for starts in self._groups.starts_of(group)),
        )
        name = hashlib.sha256(f"{self._key} {rows}".encode()).hexdigest()[:16]
        return self._folder / f"group-{self._starts.ids[group[0]]}-{name}"

    def _task(self, group: Places, alone: bool = False) -> GroupTask:
        others = self._groups.others(group)
        names = self._place.names(self._config, self._image.geometry.slice_axis is not None)
        return GroupTask(
            self._whole_image if alone else self._image,
            self._numbers,
            self._config,
            self._starts.only(group),
            self._groups.starts_of(others),
            tuple(self._starts.ids[others].tolist()),
            self._folder_of(group),
            {kind: name for kind, name in names.items() if kind.startswith(EACH)},
        )

    def _pool(self) -> Pool:
        from accelsurf.batch import InlinePool, LocalPool

        if self._options.scheduler is not None:
            from accelsurf.batch import DaskPool

            return DaskPool(run_task, self._options.scheduler)
        jobs = self._options.jobs or 1
        return InlinePool(run_task) if jobs == 1 else LocalPool(run_task, jobs, prepare=load)


def _with_threads(config: RunConfig, options: ObjectOptions) -> RunConfig:
    """The settings with the threads of each group."""
    if config.threads != "auto":
        return config
    threads = (
        1 if options.scheduler is not None else max(1, available_cores() // (options.jobs or 1))
    )
    return config.model_copy(update={"threads": threads})


def _key_of(config: RunConfig, image: LargeImage, numbers: Any) -> str:
    """Return a text of all that the files of a group depend on beside its objects."""
    settings = {
        key: value
        for key, value in config.model_dump(mode="json").items()
        if key not in _WITHOUT_EFFECT
    }
    start = Path(str(config.objects).partition("@")[0])
    files = [_version_of(path) for path in (start, *(channel.source for channel in image.channels))]
    known = [
        sorted((_name_of(key), pickle.dumps(value).hex()) for key, value in found.items())
        for found in numbers
    ]
    grid = repr(image.geometry), [str(channel.dtype) for channel in image.channels]
    return json.dumps([__version__, settings, files, known, grid], sort_keys=True)


def _name_of(key: tuple[Any, ...]) -> str:
    """A number of the whole image in words: the function that finds it, and its arguments."""
    return f"{getattr(key[0], '__name__', key[0])} {key[1:]}"


def _version_of(path: Path | None) -> list[Any]:
    """Return name, size and time of a file, which change when it is written again."""
    if path is None or not path.exists():
        return [str(path)]
    found = path.stat()
    return [path.name, 0 if path.is_dir() else found.st_size, found.st_mtime_ns]
