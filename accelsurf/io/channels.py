"""Images of several channels: each comes out as a volume of its own, all on one grid."""

from __future__ import annotations

import os
from pathlib import Path

from accelsurf.errors import UsageError
from accelsurf.grid.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import naming
from accelsurf.io.memory import available_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions
from accelsurf.settings.registry import load


def read(
    path: str | os.PathLike[str], options: ReadOptions = AS_IT_IS, *, outside_data: bool = False
) -> list[Volume]:
    """Read an image of one or more channels.

    Parameters
    ----------
    path : path-like
        As for `accelsurf.io.read`; also a NIfTI of vectors or with a few volumes along its fourth axis, or an NRRD or
        MetaImage of vectors.
    options : ReadOptions, optional
        As for `accelsurf.io.read`; a channel index leaves one channel.
    outside_data : bool
        Whether the header may name a data file in another folder than its own.

    Returns
    -------
    list of Volume
        The channels in their order; one for an ordinary image.

    Raises
    ------
    InputError
        As `accelsurf.io.read`, and for more than 16 channels.
    """
    path = Path(path)
    with naming(path), headers.outside_data_allowed(outside_data):
        form, header = headers.parse(path, options)
        available = available_memory()
        if form.read_channels is None:
            return [load(form.read)(path, header, available)]
        volumes: list[Volume] = load(form.read_channels)(path, header, available)
    return volumes


def read_further(paths: tuple[str, ...], options: ReadOptions = AS_IT_IS) -> list[Volume]:
    """Read the files that add channels, in order.

    Parameters
    ----------
    paths : tuple of str
    options : ReadOptions, optional
        Those of the image; a file is read with those of them that its format has.

    Raises
    ------
    UsageError
        When a path is empty.
    """
    if any(not path for path in paths):
        raise UsageError("channel: nothing was given, expected a file", "write --channel FILE")
    return [volume for path in paths for volume in read(path, options.restricted_to(headers.options_of(path)))]
