"""A run on an image that is not in memory: in a window that is made larger until the surface stays within it.

The result has the bytes of a run on the whole image, whatever windows came before the last one: see
`accelsurf.grid.window`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from accelsurf.errors import InputError, UsageError
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import widened
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import GUARD, LeavesWindow, NeedsLevels, Window, aligned, enlarged
from accelsurf.image.volume import Volume
from accelsurf.interact import OnObjectStep, finished
from accelsurf.io import LazyVolume, available_memory, open_with
from accelsurf.large.first_window import first_box
from accelsurf.large.whole_image import Numbers, WholeImage
from accelsurf.run import (
    CheckpointFile,
    Result,
    Run,
    WindowInput,
    allowed_bytes,
    bytes_text,
    check_grids,
    cropped,
    filters_of,
    has_region,
    plateaus_on_whole,
    region_of_run,
    run_bytes,
    seeded,
    split_given,
    values_within,
    with_options,
)
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart

#: Statistics of an image of more voxels are a coarser level's, where one of at most this number is stored.
MAX_STREAMED = 1 << 31
#: Growth of a window where it was left, in extents of it; less where the memory is too small for that.
GROWTH = 1.0
#: Levels for which a first window has room, where their number is selected by the start.
_FIRST_LEVELS = 3
#: Margin, voxels, around the voxels of a region of interest: a result ends half a voxel beyond the region.
_AROUND_REGION = 2


@dataclass(frozen=True)
class LargeImage:
    """The channels of an image that is read in parts, and the memory that a run on it may take.

    Attributes
    ----------
    channels : tuple of LazyVolume
        On one grid.
    max_bytes : int
        Estimates of a run's peak (`accelsurf.run.setup`) stay within it.
    statistics : tuple of LazyVolume or None
        A coarser level of each channel that percentiles and the like are taken from; None: the channel itself.
    """

    channels: tuple[LazyVolume, ...]
    max_bytes: int
    statistics: tuple[LazyVolume | None, ...] = ()

    @classmethod
    def of(cls, channels: Sequence[LazyVolume], max_bytes: int) -> LargeImage:
        """The image, with statistics of a coarser level where it has more than `MAX_STREAMED` voxels and one is stored.

        Raises
        ------
        InputError
            When a coarser level cannot be read.
        """
        return cls(
            tuple(channels), max_bytes, tuple(_for_statistics(channel) for channel in channels)
        )

    @property
    def geometry(self) -> Geometry:
        """The whole grid."""
        return self.channels[0].geometry

    def check(self) -> None:
        """Refuse channels that lie on different grids.

        Raises
        ------
        GeometryError
        """
        check_grids(self.channels)

    def whole(self, config: RunConfig, numbers: Sequence[Numbers] = ()) -> tuple[WholeImage, ...]:
        """Return the numbers of each whole channel, which is read through when it is first asked for.

        ``numbers`` are the known ones of each channel.
        """
        filters = filters_of(config, self.geometry)
        count = len(self.channels)
        levels, known = self.statistics or (None,) * count, numbers or [{}] * count
        whole = []
        for place, parts in enumerate(zip(self.channels, levels, known, strict=True)):
            channel, coarse, of_it = parts
            image = WholeImage(
                channel, filters, coarse, numbers=of_it, channel=place, channels=count
            )
            whole.append(image)
        return tuple(whole)


class LargeRun(NamedTuple):
    """A large image, numbers of each whole channel (none with a region of interest), and the settings of a run."""

    image: LargeImage
    whole: tuple[WholeImage, ...]
    config: RunConfig

    def in_window(self, window: Window, starts: tuple[ObjectStart, ...] | None = None) -> Run:
        """Return the run in a window; ``starts`` as of `WindowInput`.

        Raises
        ------
        LeavesWindow
            When the window is too small for the model of clicks.
        """
        image, geometry = self.image, cropped(window.geometry, window.box)
        volumes = [
            Volume(channel.read(window.box), geometry, dict(channel.metadata), channel.source)
            for channel in image.channels
        ]
        filtered = tuple(
            channel.window(window.box) for channel in self.whole or image.whole(self.config)
        )
        part = WindowInput(window, filtered, self.whole, starts)
        return Run(volumes[0], self.config, channels=volumes[1:], part=part)


def _for_statistics(image: LazyVolume) -> LazyVolume | None:
    found: LazyVolume | None = image
    while found is not None and math.prod(found.geometry.shape) > MAX_STREAMED:
        found = found.coarser()
    return None if found is image else found


def segment_lazily(
    volume: LazyVolume,
    config: RunConfig | None,
    on_step: OnObjectStep | None,
    on_warning: Callable[[str], None] | None,
    checkpoint_to: str | Path | CheckpointFile | None,
    options: dict[str, Any],
) -> Result:
    """Segment one object of an image that is read in parts: `accelsurf.segment` of a `LazyVolume`.

    Raises
    ------
    UsageError
        When something is given as an array, or the energy is one of the user's own.
    """
    spacing, channels, energy = (options.pop(key) for key in ("spacing", "channels", "energy"))
    max_memory = options.pop("max_memory", None)
    texts, given = split_given(options)
    wrong = [*given, *(["spacing"] if spacing is not None else [])]
    wrong += [] if energy is None or isinstance(energy, str) else ["energy"]
    wrong += [] if all(isinstance(channel, LazyVolume) for channel in channels) else ["channels"]
    if wrong:
        raise UsageError(
            f"{wrong[0]}: an array or a function was given with an image that is read in parts",
            "give texts and open_volume(), or read the image with accelsurf.read",
        )
    config, _ = with_options(config, energy, texts)
    others = [*channels, *(open_with(file, config.reading) for file in config.channel)]
    image = LargeImage.of((volume, *others), allowed_bytes(max_memory, available_memory()))
    return segment_in_windows(image, config, on_step, on_warning, checkpoint_to=checkpoint_to)


def segment_in_windows(
    image: LargeImage,
    config: RunConfig,
    on_step: OnObjectStep | None = None,
    on_warning: Callable[[str], None] | None = None,
    on_window: Callable[[Window], None] | None = None,
    checkpoint_to: str | Path | CheckpointFile | None = None,
) -> Result:
    """Segment one object in an image that is read in parts.

    Parameters
    ----------
    image : LargeImage
    config : RunConfig
        Its start and clicks are near the object, or it has a region of interest.
    on_step, on_warning : callable, optional
        As of `accelsurf.segment`; steps of a window that is left are told too.
    on_window : callable, optional
        Called with each window before its run begins.
    checkpoint_to : str or Path, optional
        As of `accelsurf.segment`.

    Returns
    -------
    Result
        On the grid of its ``window``.

    Raises
    ------
    UsageError
        When a setting needs the whole image in memory.
    InputError
        As of `accelsurf.segment`, and when the window that the object needs is larger than memory.
    """
    checkpoints = CheckpointFile.of(checkpoint_to)
    config = seeded(config if checkpoints is None else checkpoints.begun(config))
    _check_settings(config)
    image.check()
    saved = None if checkpoints is None else checkpoints.window(image.geometry)
    window = saved or first_window(config, image.geometry)
    large = LargeRun(image, () if has_region(config) else image.whole(config), config)
    while True:
        _refuse_too_large(window, image, config)
        if on_window is not None:
            on_window(window)
        try:
            result = finished(large.in_window(window), on_step, on_warning, checkpoints)
            return _in_window(result, window, large.whole)
        except LeavesWindow as face:
            if checkpoints is not None:
                checkpoints.clear()
            most = values_within(
                image.max_bytes, config.energy.uses_model, config.flow.name
            ) // len(image.channels)
            window = larger(window, face, most)
        except NeedsLevels as more:
            window = _on_levels(window, more.count)


def first_window(config: RunConfig, geometry: Geometry) -> Window:
    """Return the window that a run begins in.

    Parameters
    ----------
    config : RunConfig
    geometry : Geometry
        Of the whole grid.
    """
    if has_region(config):
        return Window(
            geometry, widened(region_of_run(config, geometry), geometry.shape, [_AROUND_REGION] * 3)
        )
    window = Window(geometry, first_box(config, geometry))
    return _on_levels(window, _FIRST_LEVELS if config.levels == "auto" else config.levels)


def _on_levels(window: Window, count: int) -> Window:
    """Return the smallest window around another whose blocks are the whole grid's on a number of levels."""
    return Window(
        window.geometry,
        aligned(window.box, window.geometry, _blocks_of(window.geometry, count)),
        count,
    )


def _in_window(result: Result, window: Window, whole: Sequence[WholeImage]) -> Result:
    """Return the result of a run in a window, with places on the whole grid and notes on the statistics."""
    objects = tuple(
        replace(segmented, plateaus=plateaus_on_whole(segmented.plateaus, window))
        for segmented in result.objects
    )
    warnings = [*result.warnings, *notes_of(whole)]
    return replace(result, objects=objects, window=window, state=None, warnings=warnings)


def notes_of(whole: Sequence[WholeImage]) -> list[str]:
    """Return a note for each coarser image that statistics are taken from.

    Where all are of the whole image there is none.
    """
    found = {channel.statistics for channel in whole} - {"exact"}
    return [f"values of the whole image are those of {where}" for where in sorted(found)]


def _blocks_of(geometry: Geometry, count: int) -> tuple[int, int, int]:
    """Voxels of a block of the coarsest of ``count`` levels, or of all if there are fewer, along each axis."""
    return pyramid.levels(geometry.shape, geometry.spacing, count)[-1].factors


def _refuse_too_large(window: Window, image: LargeImage, config: RunConfig) -> None:
    """Refuse a window whose run would take more memory than it may.

    Raises
    ------
    InputError
        With the estimate.
    """
    values = math.prod(window.shape) * len(image.channels)
    needed = run_bytes(values, config.energy.uses_model, config.flow.name)
    if needed > image.max_bytes:
        size = " x ".join(str(n) for n in reversed(window.shape))
        what = "the region has" if has_region(config) else "the object needs a window of"
        unsized = config.energy.uses_model and config.size is None and not has_region(config)
        raise InputError(
            f"{what} {size} voxels, for which a run takes about {bytes_text(needed)} of memory; "
            f"{bytes_text(image.max_bytes)} are allowed",
            ("say about how large it is (--size), " if unsized else "")
            + "take a coarser level of the image (--level), a smaller --roi, or more --max-memory",
        )


def larger(window: Window, face: LeavesWindow, most: int) -> Window:
    """Return the next window: larger where it was left, with at most ``most`` voxels.

    Where that does not go far enough, the smallest that is larger is returned, which is refused then.
    """
    factor, blocks = GROWTH, _blocks_of(window.geometry, window.levels)
    while True:
        box = enlarged(window, face, blocks, factor)
        if math.prod(s.stop - s.start for s in box) <= most:
            break
        if all(factor * (s.stop - s.start) <= GUARD for s in window.box):
            break
        factor *= 0.7
    return Window(window.geometry, box, window.levels)


def _check_settings(config: RunConfig) -> None:
    """Refuse settings that a run in a window cannot have.

    Raises
    ------
    UsageError
        Naming the setting.
    """
    hint = "give --roi around the object, or let the image be read into memory (more --max-memory)"
    wrong = {
        f"{name}: it was given, and the image is read in parts": bool(getattr(config, name))
        for name in ("edit", "refine")
    }
    if not has_region(config):
        flow = config.flow.name
        has_noise = config.noise > 0
        has_mask = config.mask is not None and config.energy.uses_model
        wholes = [term.name for term in config.terms if TERMS[term.name].needs_whole]
        wrong |= {
            f"noise: {config.noise:g} was given, which is laid over the whole image": has_noise,
            "flow: flowable-mass compares masses on a lattice over the whole image": (
                flow == "flowable-mass"
            ),
            "flow: region-mass has mass in the whole image, which is read in parts": (
                flow == "region-mass"
            ),
            f"energy: {''.join(wholes[:1])} looks at the whole image, which is read in parts": bool(
                wholes
            ),
            "mask: it was given with clicks, whose model looks at all of it": has_mask,
        }
    for text, is_wrong in wrong.items():
        if is_wrong:
            raise UsageError(text, hint)
