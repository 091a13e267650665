"""A group of objects of a large image in a worker process: its run, and its files."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from accelsurf.errors import AccelsurfError
from accelsurf.report import group_files

if TYPE_CHECKING:
    from accelsurf.initialization.large_object_starts import ManyStarts
    from accelsurf.segmentation.group_run import Boxes
    from accelsurf.segmentation.whole_image import Numbers
    from accelsurf.segmentation.windowed import LargeImage
    from accelsurf.settings.run_config import RunConfig

#: What a group loads, so that a worker has it before its first one.
_LOADED = ("accelsurf.segmentation.many_objects", "accelsurf.report.document")


@dataclass(frozen=True, eq=False)
class GroupTask:
    """A group that is to be run.

    Attributes
    ----------
    image : LargeImage
        With the memory of this group.
    numbers : tuple of mapping
        Of each whole channel, as `accelsurf.segmentation.many_objects.numbers_needed` returns them.
    config : RunConfig
    starts : ManyStarts
        Those of the group alone.
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
    """How a group ended: why it ``failed``, if it did, and whether it was ``too_large`` for its memory."""

    failed: str = ""
    too_large: bool = False


def load() -> None:
    """Load what every group needs."""
    for name in _LOADED:
        importlib.import_module(name)


def run_task(task: GroupTask) -> GroupEnd:
    """Run a group and write its files; return why that is not possible, or nothing.

    Parameters
    ----------
    task : GroupTask
    """
    from accelsurf.segmentation.group_run import MeetsOthers, TooLarge, run_group
    from accelsurf.segmentation.many_objects import failure_text

    whole = task.image.whole(task.config, task.numbers)
    try:
        starts = task.starts.made(range(len(task.starts.ids)))
        result = run_group(task.image, whole, task.config, starts, task.others)
        group_files.write_group(task.folder, result, task.names, task.config.mesh_space)
    except MeetsOthers as near:
        group_files.write_near(task.folder, [task.other_ids[place] for place in near.places])
    except (AccelsurfError, MemoryError) as error:
        return GroupEnd(failure_text(error), isinstance(error, TooLarge))
    return GroupEnd()
