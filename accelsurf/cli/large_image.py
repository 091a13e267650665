"""Images that are read in parts: where they do not fit into the memory, or are a level of a store's pyramid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from accelsurf.batch import Limits
from accelsurf.cases import Watcher
from accelsurf.cli.options import FILES
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.image.volume import Volume
from accelsurf.io import LazyVolume, count_values, is_store, open_channels, split_name
from accelsurf.large import fitting_level
from accelsurf.output import OutputFolder
from accelsurf.run import allowed_bytes, run_bytes
from accelsurf.settings.file_formats import image_format
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.cases import Compute, Log
    from accelsurf.large import LargeImage
    from accelsurf.run import Result

#: Formats of label maps that are written box by box.
STORES = ("ome.zarr", "nii")
OBJECTS = Group("Many objects in a large image", sort_key=0)


@Parameter(name="*")
@dataclass(frozen=True)
class ImageParts:
    """Options for the memory of a run."""

    max_memory: Annotated[
        str | None, Parameter(group=FILES, show_default="0.8 of what is free")
    ] = None
    """Memory that the run may take, as 4GB. A larger image is read in parts near the object, with the same result; one
    whose object needs more is refused."""

    @property
    def allowed_bytes(self) -> int:
        """Memory that the run may take."""
        from accelsurf import io

        return allowed_bytes(self.max_memory, io.available_memory())


def choose_computation(
    place: OutputFolder, config: RunConfig, image: LargeImage | None
) -> tuple[RunConfig, Compute | None]:
    """Return the settings and the function by which a case is computed: None where the image is read as a whole.

    Raises
    ------
    UsageError
        When a setting needs the whole image in memory.
    """
    if image is None:
        return config, None
    if fits(image, config):
        return config, _in_memory(image, not config.reading.given)
    return settings_in_windows(place, config), _in_windows(image)


def fits(image: LargeImage, config: RunConfig) -> bool:
    """Return True if a run on the whole image is within the memory that it may take."""
    values = math.prod(image.geometry.shape) * len(image.channels)
    return run_bytes(values, config.energy.uses_model, config.flow.name) <= image.max_bytes


def large_image(
    source: Path, config: RunConfig, parts: ImageParts, in_parts: bool = False
) -> LargeImage | None:
    """Return the image, opened, where it may be read in parts; None where it is an ordinary one that fits.

    With ``in_parts`` it is opened even if it fits.

    Raises
    ------
    InputError
        When it cannot be read in parts.
    """
    from accelsurf.io import functions_of
    from accelsurf.run import run_bytes

    form = image_format(split_name(source)[1])
    is_level = form is not None and form.folder_marks and config.reading.given
    if not (in_parts or is_level or is_store(source)):
        if parts.max_memory is None and (form is None or functions_of(form).open is None):
            return None  # it is read as a whole or not at all
        try:
            values = count_values(source, config.reading)
            needed = run_bytes(values, config.energy.uses_model, config.flow.name)
        except InputError:
            return None  # said again where it is read, with the name of the file
        if needed <= parts.allowed_bytes:
            return None
    from accelsurf.large import LargeImage

    paths = (source, *map(Path, config.channel))
    channels = [channel for path in paths for channel in open_channels(path, config.reading)]
    return LargeImage.of(channels, parts.allowed_bytes)


def whole_volume(channel: LazyVolume) -> Volume:
    """Read all of a channel that was opened to be read in parts."""
    return Volume(
        channel.read(whole_box(channel.shape)),
        channel.geometry,
        dict(channel.metadata),
        channel.source,
    )


def with_level(source: Path, config: RunConfig, parts: ImageParts, quiet: bool) -> RunConfig:
    """The settings with the number of a level in place of auto: the finest whose run fits into the memory, and say it.

    Raises
    ------
    InputError
        When the image cannot be opened.
    """
    if config.level != "auto":
        return config
    found = fitting_level(source, config, parts.allowed_bytes)
    if found is None:
        return config.replace(level=0)
    if not quiet:
        print(found.text)
    return config.replace(level=found.level)


def settings_in_windows(place: OutputFolder, config: RunConfig) -> RunConfig:
    """The settings of a run in windows: its label map is written box by box."""
    if config.format is not None and config.format not in STORES:
        raise UsageError(
            f"format: {config.format} was given, and the image is read in parts, expected {' or '.join(STORES)}",
            "leave it out, or let the image be read into memory (more --max-memory)",
        )
    keys = ("save_sdf", "also", "label_group", "mesh_smooth", "mesh_faces", "mesh_error")
    asked = {key: bool(getattr(config, key)) for key in keys} | {
        "keep_state": config.keep_state == "yes"
    }
    for name, given in asked.items():
        if given:
            raise UsageError(
                f"{name.replace('_', '-')}: it was given, and the image is read in parts",
                "leave it out, or give --roi",
            )
    label_format = place.label_format(config)
    return config if label_format in STORES else config.replace(format="nii")


def _in_memory(image: LargeImage, has_checksum: bool) -> Compute:
    """The computation of a case whose image is read as a whole from a part of its file.

    Without a checksum where that part is a small one of many: a store may have any size.
    """

    def compute(place: OutputFolder, config: RunConfig, watcher: Watcher, log: Log) -> Result:
        from accelsurf.cases import check_formats, evolve_at

        read = image.channels[
            : len(image.channels) - len(config.channel)
        ]  # a run reads the other files itself
        volume, *more = log.timed("load", lambda: [whole_volume(channel) for channel in read])
        if has_checksum:
            log.timed("load", lambda: log.take_checksum(place.image))
        log.note_voxels([volume, *more])
        check_formats(place, config, volume, log)
        return evolve_at(place, volume, more, config, watcher, log)

    return compute


def _in_windows(image: LargeImage) -> Compute:
    """The computation of a case in windows of its image."""

    def compute(place: OutputFolder, config: RunConfig, watcher: Watcher, log: Log) -> Result:
        from accelsurf.cases import state_of
        from accelsurf.large import segment_in_windows

        log.note_grid(image.geometry)
        log.note_written(place.image)
        state = state_of(place, config)
        with watcher.watch(place.name, config.max_steps):
            result = segment_in_windows(
                image,
                config,
                lambda record, object_id: watcher.on_step(record),
                watcher.on_warning,
                watcher.on_window,
                state,
            )
        log.warnings.extend(result.warnings)
        return result

    return compute


@Parameter(name="*")
@dataclass(frozen=True)
class ObjectOptions:
    """Options for the objects of a large image."""

    jobs: Annotated[int | None, Parameter(group=OBJECTS, metavar="N", show_default="1")] = None
    """With --objects: read the image in parts, and run this number of groups of objects at once, each in a process of
    its own. They share --max-memory. The result is the same."""

    scheduler: Annotated[str | None, Parameter(group=OBJECTS, metavar="ADDRESS")] = None
    """With --objects: the same on a Dask cluster: the address of its scheduler, or its scheduler file. --max-memory is
    that of each worker then. Image and outputs must have the same paths there."""

    @property
    def given(self) -> bool:
        """True if the image is to be read in parts even if it fits."""
        return self.jobs is not None or self.scheduler is not None

    def check(self, config: RunConfig) -> None:
        """Refuse options that exclude each other.

        Raises
        ------
        UsageError
        """
        if not self.given:
            return

        if config.objects is None:
            raise UsageError(
                "--jobs, --scheduler: were given without --objects",
                "accelsurf batch runs many images",
            )
        Limits(self.jobs, scheduler=self.scheduler)
