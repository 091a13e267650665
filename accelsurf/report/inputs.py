"""The files that a run reads: they are what it may not write."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from accelsurf.errors import AccelsurfError
from accelsurf.io import headers, is_stored
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

#: Settings that are places, and kinds of places that name a file: ``label:FILE``.
PLACES, FILE_KINDS = ("start", "foreground", "background", "inside", "outside"), ("label", "mesh", "stroke")
#: Settings that name a file.
_FILES = ("mask", "objects", "label_table")
#: Endings of headers whose voxels may lie in another file.
_DETACHED = (".mhd", ".nhdr", ".hdr", ".img")


def named_files(given: RunConfig | TrackConfig) -> list[Path]:
    """Return the files, beside the image, that the settings of a run or a tracking name and that are there."""
    config, corrections = (given.run, given.correct) if isinstance(given, TrackConfig) else (given, ())
    texts = [text for text in (*(getattr(config, key) for key in _FILES), *config.channel) if text]
    wheres = [text for key in PLACES for text in getattr(config, key)]
    for correction in (*config.edit, *config.refine, *corrections):
        wheres += [*(ball for _, ball in correction.balls), *correction.inside, *correction.outside]
    texts += [text.partition(":")[2] for text in wheres if text.partition(":")[0] in FILE_KINDS]
    found = {}
    for text in texts:
        for name in (text, text.rpartition("@")[0]):  # FILE@IDS; a name may have an @ itself
            if name and is_stored(Path(name)):
                found[name] = Path(name)
                break
    return list(found.values())


def inputs_of(image: Path, config: RunConfig | TrackConfig | None, *further: Path | None) -> list[Path]:
    """Return all files that a run reads: image, what its settings name, ``further`` files, and data files of headers.

    Parameters
    ----------
    image : Path
    config : RunConfig or TrackConfig, optional
    *further : Path or None
        Files that the command reads beside: a reference, a configuration.
    """
    named = [image, *(() if config is None else named_files(config)), *(path for path in further if path is not None)]
    return [*named, *(data for path in named for data in _data_of(path))]


def _data_of(path: Path) -> Iterator[Path]:
    """Files with the voxels of an image, where they are others than its own; of a folder or a pattern its files."""
    if headers.is_pattern(path):
        yield from path.parent.glob(path.name)
    elif path.is_dir():
        yield from path.iterdir()
    elif path.suffix.lower() in _DETACHED:
        try:
            _, header = headers.parse(path)
        except AccelsurfError:  # it is refused when it is read
            return
        yield header.data
