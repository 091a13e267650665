"""The image of ``accelsurf view FILE``: read in a thread, while what draws it is loaded.

Loading takes longer than reading and holds Python's lock nearly always; unpacking works without it.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.errors import UsageError
from accelsurf.settings.registry import load
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

if TYPE_CHECKING:
    from accelsurf.grid.volume import Volume
    from accelsurf.viewer.core.opening import OpenedImage


@dataclass(frozen=True)
class FirstImage:
    """What the command line says of the image that is opened first.

    Attributes
    ----------
    source : Path
        A file or folder.
    config : RunConfig
        Settings of its run; among them how it is read.
    reference : Path or None
        Labels to compare with.
    tracks : Path or None
        Folder of what ``accelsurf track`` has found in it.
    times : TrackConfig
        How a sequence is read.
    """

    source: Path
    config: RunConfig
    reference: Path | None
    tracks: Path | None
    times: TrackConfig

    def start_reading(self) -> Callable[[], OpenedImage]:
        """Begin to read; return what waits for the image.

        A single image is read in a thread. Of a sequence headers and one frame are read, when it is waited for.

        Raises
        ------
        InputError
            When the header cannot be read; what is wrong with the rest is raised by what is returned.
        UsageError
            When a time between frames was given for a single image.
        """
        from accelsurf.io import channels, headers, sequences
        from accelsurf.io.files import naming
        from accelsurf.viewer.core.command_queue import in_background

        reading = self.config.reading
        if self.tracks is not None or self.times.frames_from_slices or sequences.is_sequence(self.source, reading):
            return self._sequence
        if self.times.frame_time is not None:
            raise UsageError("frame_time: it was given for a single image", "leave it out, or add --frames-from-slices")
        with naming(self.source):
            form = headers.format_of(self.source)
        # Loaded here: two threads that load the same library may see it half loaded.
        for work in (form.parse, form.read, form.read_channels):
            if work is not None:
                load(work)
        volumes = in_background(lambda: channels.read(self.source, reading), "accelsurf reading")
        return partial(self._image, volumes)

    def _image(self, volumes: Future[list[Volume]]) -> OpenedImage:
        from accelsurf.io import on_grid, split_name
        from accelsurf.viewer.core.opening import OpenedImage

        truth = self._truth()
        volume, *more = volumes.result()
        truth = None if truth is None else on_grid(truth, volume.geometry)
        return OpenedImage(volume, self.config, split_name(self.source)[0], self.source, tuple(more), truth)

    def _sequence(self) -> OpenedImage:
        from accelsurf.viewer.core.opening import read_tracked

        truth, times = self._truth(), self.times
        found = read_tracked(self.source, self.config, self.tracks, times.frame_time, times.frames_from_slices)
        return replace(found, reference=truth)

    def _truth(self) -> Volume | None:
        from accelsurf.io import read_labels

        return None if self.reference is None else read_labels(self.reference)


@contextmanager
def loading() -> Iterator[None]:
    """Let Python not look for garbage while many modules are loaded, nor afterwards among what they are made of.

    The searches are a sixth of the time of loading. One over all that was loaded, of which nothing is garbage, takes as
    long as the window's first picture.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_enabled:
            gc.enable()
