"""Reading of images and runs in the viewer: a path is an image, one of several, a sequence, a result, or tracks.

Phantoms have a name in place of a path. A page asks for files of a served folder alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from accelsurf import io
from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import (
    check_name,
    format_of,
    functions_of,
    header_counts,
    image_name,
    is_pattern,
    is_sequence,
    naming,
    read_channels,
    refuse_unfinished,
    split_name,
)
from accelsurf.large import fitting_level
from accelsurf.output import GivenImage, Report, settings_of
from accelsurf.phantoms import recipe_files, recipes
from accelsurf.run import allowed_bytes
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track import SavedTracks
from accelsurf.viewer.core.command_queue import in_background
from accelsurf.viewer.core.sequence_view import SequenceView
from accelsurf.viewer.core.session import CHECKPOINT_MB, Origin, Session
from accelsurf.viewer.core.unsaved import Unsaved, fingerprint

#: Settings that belong to one image: places in it, files on its grid, which part of its file it is.
OF_ONE_IMAGE = (
    "start",
    "objects",
    "mask",
    "roi",
    "foreground",
    "background",
    "channel",
    "edit",
    "inside",
    "outside",
    "box",
    "size",
    "refine",
    "checkpoint",
    "level",
    "channel_index",
    "time_index",
    "channels_from_time",
    "series",
    "spacing",
    "name",
    "color",
    "label_table",
)


@dataclass(frozen=True)
class Choice:
    """One of several images of a file or folder: its path and description, and the settings with which it is read."""

    path: Path
    text: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class OpenedImage:
    """An image that was read.

    Attributes
    ----------
    volume : Volume
    config : RunConfig
        Of its run; repeats how it was read.
    name : str
        First part of the names of files.
    source : Path or None
        Its file; None where no file has it alone: a phantom, a slice of a volume as a frame.
    channels : tuple of Volume
        Further ones.
    reference : Volume or None
        Labels to compare with.
    note : str
        A remark about it, in one line; may be empty.
    frames : SequenceView or None
        The sequence that the image is a frame of.
    is_result : bool
        The configuration is of a result that has its files: its run is made again, to its end.
    unsaved : Unsaved or None
        The session that was not saved, and goes on; its configuration is that of the image.
    """

    volume: Volume
    config: RunConfig
    name: str
    source: Path | None = None
    channels: tuple[Volume, ...] = field(default=())
    reference: Volume | None = None
    note: str = ""
    frames: SequenceView | None = None
    is_result: bool = False
    unsaved: Unsaved | None = None

    def session(self, checkpoint_mb: float = CHECKPOINT_MB, begin: bool = True) -> Session:
        """Return a session of it, which prepares itself in its own thread, at once or when it is told to begin.

        The run of a result, or of a session that was not saved, is made again.
        """
        origin: Origin = "saved" if self.is_result else "new" if self.unsaved is None else "unsaved"
        made = Session(
            self.volume,
            self.config,
            name=self.name,
            source=self.source,
            checkpoint_mb=checkpoint_mb,
            channels=self.channels,
            begin=begin,
            origin=origin,
        )
        if origin != "new":
            made.go_on(-1 if self.unsaved is None else self.unsaved.step)
        return made


class ImageWithSession(NamedTuple):
    """An image that was read, and the session of it that has begun."""

    image: OpenedImage
    session: Session


def for_another_image(config: RunConfig) -> RunConfig:
    """Return settings without those that belong to one image.

    Examples
    --------
    >>> made = for_another_image(RunConfig(smoothness=0.5, start="ball:1,2,3,4"))
    >>> made.smoothness, made.start
    (0.5, ('center',))
    """
    # An energy that learns from clicks has none in another image.
    left_out = {*OF_ONE_IMAGE, *(["energy"] if config.energy.uses_model else [])}
    return RunConfig(**{key: getattr(config, key) for key in config.model_fields_set - left_out})


def choices_of(path: Path, config: RunConfig) -> list[Choice]:
    """Return the images of a file or folder where it has several and the settings do not say which; else none.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    with naming(path):
        form = format_of(path)
        listing = functions_of(form).listing
        if listing is not None:
            # One file stands for its series; where it does not, reading says so.
            is_study = path.is_dir()
            found = listing(path) if is_study and config.series is None else []
            return _several(
                [
                    Choice(path, _volume_text(entry), {"series": str(entry["number"])})
                    for entry in found
                ]
            )
        asked = config.reading.restricted_to(form.options)
        if (
            "time_index" not in form.options
            or asked.time_index is not None
            or asked.channels_from_time
        ):
            return []
        moments = header_counts(path, replace(asked, level=0))[1]
    return _several(
        [
            Choice(path, f"time point {n + 1} of {moments}", {"time_index": n})
            for n in range(moments)
        ]
    )


def _several(found: list[Choice]) -> list[Choice]:
    return found if len(found) > 1 else []


def _volume_text(entry: Mapping[str, Any]) -> str:
    """A volume of a DICOM folder in one line."""
    phase = ", ".join(f"{name} {value}" for name, value in entry["phase"].items())
    words = [
        " ".join(word for word in (entry["modality"], entry["description"]) if word)
        or "without a name"
    ]
    words += [phase] if phase else []
    if entry["size"] is not None:
        size, voxel = (
            " x ".join(map(str, entry["size"])),
            " x ".join(f"{h:.4g}" for h in entry["spacing"]),
        )
        words += [f"{size} voxels of {voxel} mm", entry["orientation"]]
    return f"{entry['number']}  {', '.join([*words, *entry['warnings']])}"


def report_of(path: Path) -> Report | None:
    """Return the report of a run or tracking that has ended: a report itself, or the one in a folder; None without one.

    Raises
    ------
    InputError
        When there are several.
    """
    known = sorted(path.glob("*_report.json")) if path.is_dir() else [path]
    found = [Report(each) for each in known if each.suffix == ".json"]
    if path.is_dir() and not known:
        refuse_unfinished(path)
    found = [report for report in found if report.document and not report.is_failure]
    if len(found) > 1:
        names = ", ".join(str(report.path) for report in found)
        raise InputError(f"{path}: there are several results: {names}", "give one of them")
    return found[0] if found else None


def finished_run(path: Path) -> tuple[GivenImage, RunConfig | TrackConfig] | None:
    """Return image and settings of the result that a folder or a report has; None for an image.

    Raises
    ------
    InputError
        When there are several results, or the image is not there.
    """
    report = report_of(path)
    if report is None or report.document is None:
        return None
    run = report.path.with_name(f"{report.path.name.removesuffix('_report.json')}_run.toml")
    hint = f"give the image where it is now, and --config {run}"
    given = GivenImage.of_report(report.document, report.path).found(None, hint)
    return given, settings_of(report.document, report.path)


@dataclass(frozen=True)
class ImageToOpen:
    """An image, and how it is read.

    Attributes
    ----------
    source : Path
        A file or folder.
    config : RunConfig
        Settings of its run; among them how it is read.
    reference : Path or None
        Labels to compare with.
    tracks : Path or None
        Folder of its tracks, from ``accelsurf track``.
    times : TrackConfig
        How a sequence is read.
    given : GivenImage or None
        The image of a finished run: another one is refused.
    """

    source: Path
    config: RunConfig
    reference: Path | None = None
    tracks: Path | None = None
    times: TrackConfig = TrackConfig()
    given: GivenImage | None = None

    def of_result(self) -> ImageToOpen:
        """Return the image of the result or tracks that a folder or report has, with its settings; itself of an image.

        Settings that are given here override those of the result.

        Raises
        ------
        InputError
            As `finished_run`.
        """
        finished = finished_run(self.source)
        if finished is None:
            return self
        given, before = finished
        tracks, times = self.tracks, self.times
        if isinstance(before, TrackConfig):
            tracks = tracks or (self.source if self.source.is_dir() else self.source.parent)
            times = before.replace(**{**_given(times), "run": before.run})
            before = before.run
        config = before.replace(**_given(self.config))
        return replace(
            self, source=given.path, config=config, tracks=tracks, times=times, given=given
        )

    def start_reading(self) -> Callable[[], OpenedImage]:
        """Begin to read; return a function that waits for the image.

        A single image is read in a thread. Of a sequence headers and one frame are read, when it is waited for.

        Raises
        ------
        InputError
            When the header cannot be read; other errors are raised by the returned function.
        UsageError
            When a time between frames was given for a single image.
        """
        given = self.tracks is not None or self.times.frames_from_slices
        if given or is_sequence(self.source, self.config.reading):
            return self._sequence
        if self.times.frame_time is not None:
            raise UsageError(
                "frame_time: it was given for a single image",
                "leave it out, or add --frames-from-slices",
            )
        with naming(self.source):
            form = format_of(self.source)
        # Loaded here: two threads that load the same library may see it half loaded.
        functions_of(form)
        return in_background(self._image, "accelsurf reading").result

    def _image(self) -> OpenedImage:
        volume, *more = read_channels(self.source, self.config.reading)
        if self.given is not None:
            self.given.check([volume, *more], "run accelsurf segment again")
        truth = self._truth()
        return OpenedImage(
            volume,
            self.config,
            split_name(self.source)[0],
            self.source,
            tuple(more),
            None if truth is None else io.on_grid(truth, volume.geometry),
            str(volume.metadata.get(io.WARNING_KEY, "")),
            is_result=self.given is not None,
        )

    def _sequence(self) -> OpenedImage:
        """Open a sequence at a frame, 0 unless the settings name one."""
        path, times = self.source, self.times
        sequence = io.read_sequence(
            path,
            frame_time=times.frame_time,
            frames_from_slices=times.frames_from_slices,
            options=replace(self.config.reading, time_index=None),
        )
        name = image_name(path)
        home = self.config.time_index or 0
        volume, *more = sequence.channels(home)
        saved = None if self.tracks is None else SavedTracks(self.tracks, name, sequence)
        is_file = not path.is_dir() and not is_pattern(path)
        has_time = is_file and not times.frames_from_slices
        alone = volume.source or path
        return OpenedImage(
            volume,
            self.config.replace(time_index=home if has_time else None),
            name,
            path if has_time else None if times.frames_from_slices else alone,
            tuple(more),
            self._truth(),
            "; ".join(sequence.notes),
            SequenceView(sequence, home, saved),
            is_result=self.given is not None and self.tracks is None,
        )

    def _truth(self) -> Volume | None:
        return None if self.reference is None else io.read_labels(self.reference)


def _given(config: RunConfig | TrackConfig) -> dict[str, Any]:
    """Return the settings that were given."""
    return {key: getattr(config, key) for key in config.model_fields_set}


def read_path(path: Path, config: RunConfig, results: bool = True) -> OpenedImage | list[Choice]:
    """Read the image that a path stands for, or that of a result, or return the images to choose from.

    Parameters
    ----------
    path : Path
        A file or folder, or the report of a result.
    config : RunConfig
        Settings of the run of an image; a result has those of its own run.
    results : bool, optional
        Whether a result may be opened: it names files anywhere on this machine.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    if results and finished_run(path) is not None:
        return ImageToOpen(path, RunConfig()).of_result().start_reading()()
    return choices_of(path, config) or read_image(path, config)


def read_image(path: Path, config: RunConfig) -> OpenedImage:
    """Read an image, of one with levels the finest whose run fits into the memory.

    Parameters
    ----------
    path : Path
        A file, or a folder that is an image.
    config : RunConfig
        Settings of the run; options of reading that the format of the file lacks are left out.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    with naming(path):
        asked = config.reading.restricted_to(format_of(path).options)
    config = config.replace(
        **{name: getattr(asked, name) for name in OF_ONE_IMAGE if hasattr(asked, name)}
    )
    config, note = _with_level(path, config)
    opened = ImageToOpen(path, config)._image()
    notes = "; ".join(filter(None, (note, opened.note)))
    return replace(opened, note=notes, frames=frames_of(path, config))


def read_unsaved(unsaved: Unsaved, path: Path) -> OpenedImage:
    """Read the image of a session that was not saved, to go on with it.

    Parameters
    ----------
    unsaved : Unsaved
    path : Path
        Its file.

    Raises
    ------
    InputError
        When it cannot be read, or is not the image of that session any more.
    """
    read = read_image(path, unsaved.config)
    if fingerprint(read.volume, read.channels) != unsaved.image:
        raise InputError(
            f"{path}: the image has changed since it was clicked",
            "the clicks are kept; they are offered when the image is as it was",
        )
    return replace(read, config=unsaved.config, unsaved=unsaved)


def frames_of(path: Path, config: RunConfig) -> SequenceView | None:
    """The sequence of which one time point is read; None of an image without time, or where time is channels.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    if config.time_index is None:
        return None
    sequence = io.read_sequence(path, options=replace(config.reading, time_index=None))
    return SequenceView(sequence, config.time_index)


def _with_level(path: Path, config: RunConfig) -> tuple[RunConfig, str]:
    """The settings with the level that is read, and a remark about it."""
    if config.level not in (0, "auto"):
        return config, ""
    try:
        found = fitting_level(path, config, allowed_bytes(None, io.available_memory()))
    except InputError:  # packed as a whole: reading raises the error, if there is one
        found = None
    if found is None or found.levels == 1:
        return config.replace(level=0), ""
    return config.replace(level=found.level), found.text


def make_phantom(name: str, config: RunConfig) -> OpenedImage:
    """Make one of the phantoms that come with accelsurf; its truth is the reference.

    Raises
    ------
    UsageError
        When none has this name.
    """
    recipe = recipes.load_recipe(name)
    phantom = recipes.make(recipe)
    return OpenedImage(phantom.image, config, name, None, reference=phantom.truth)


def phantom_texts() -> dict[str, str]:
    """Return the phantoms by name, each with its size."""
    found: dict[str, str] = {}
    for name in recipe_files.recipe_names():
        recipe = recipes.load_recipe(name)
        found[name] = f"{recipe.kind}, {' x '.join(map(str, recipe.shape))} voxels"
    return found


def read_reference(path: Path, geometry: Geometry) -> Volume:
    """Read labels to compare with.

    Raises
    ------
    InputError
        When they cannot be read, or are on another grid.
    """
    labels = io.read_labels(path, grid=geometry)
    with naming(path):
        if not geometry.matches(labels.geometry):
            raise InputError(
                f"the reference is not on the image's grid: {geometry.difference(labels.geometry)}",
                "resample it to the image's grid",
            )
    return labels


#: Largest number of names of a folder that are listed.
MAX_ENTRIES = 500


class Entry(NamedTuple):
    """A name in a folder, and whether it is an ``image`` or a ``folder``; a folder may be both."""

    name: str
    is_image: bool
    is_folder: bool


class ServedFolder:
    """A folder, and the files and folders in it, at any depth; without hidden names, and without links that lead out.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()

    def resolve(self, text: str) -> Path:
        """Return the path that a page names: from the folder on, or whole.

        The message is the same whether the file exists or not.

        Raises
        ------
        UsageError
            When it is not in the folder, links followed.
        """
        refused = UsageError(
            f"{text[:80]}: is not in the folder {self.root.name or self.root}", "give a path in it"
        )
        path = Path(text)
        try:
            check_name(path)
            found = (self.root / path).resolve()
        except (AccelsurfError, OSError, ValueError, RuntimeError):
            raise refused from None
        if ".." in path.parts or not found.is_relative_to(self.root):
            raise refused
        if any(part.startswith(".") for part in found.relative_to(self.root).parts):
            raise refused
        return found

    def shown(self, path: Path) -> str:
        """Return the name of a path of the folder, from the folder on; empty for the folder itself."""
        inner = path.relative_to(self.root).as_posix()
        return "" if inner == "." else inner

    def entries(self, folder: Path) -> tuple[list[Entry], int]:
        """Return the entries of a folder, folders first, and the number of further names that are not listed.

        Raises
        ------
        UsageError
            When the folder cannot be read.
        """
        try:
            found = [
                each
                for each in os.scandir(folder)
                if not each.name.startswith(".") and each.name.isprintable()
            ]
        except OSError as error:
            raise UsageError(
                f"{self.shown(folder)}: {error.strerror or error}", "choose another folder"
            ) from None
        listed = [
            entry for entry in (self._entry(Path(each.path)) for each in found) if entry is not None
        ]
        listed.sort(key=lambda entry: (not entry.is_folder, entry.name.casefold(), entry.name))
        return listed[:MAX_ENTRIES], max(len(listed) - MAX_ENTRIES, 0)

    def _entry(self, path: Path) -> Entry | None:
        """Return the entry of a name; None if it is neither image nor folder, or leads out of the served folder."""
        try:
            if not path.resolve().is_relative_to(self.root):
                return None
            is_named = bool(split_name(path)[1])
            if path.is_dir():
                return Entry(path.name, is_named, not is_named)
            return Entry(path.name, True, False) if is_named and path.is_file() else None
        except (OSError, RuntimeError):
            return None

    def is_image(self, folder: Path) -> bool:
        """Return True if a folder is an image itself: a scan in DICOM, or slices."""
        try:
            return bool(format_of(folder).name)
        except (AccelsurfError, OSError):
            return False
