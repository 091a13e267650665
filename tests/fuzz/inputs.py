"""What an input is, and the small image that most of them show."""

from typing import NamedTuple

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

#: Beside each input: what a header may name as its data file.
DATA_FILE = "voxels.raw"
SHAPE = (4, 5, 6)
VALUES = np.arange(120, dtype=np.int16).reshape(SHAPE)
VOLUME = Volume(VALUES, Geometry(SHAPE, (3.0, 0.5, 0.75), (-12.5, 4.0, 100.25)))
#: Frames of the small sequences.
FRAMES = np.stack([VALUES, VALUES + 200, VALUES[::-1]])


class Wrong(Exception):
    """Something was read that the file does not say."""


class Input(NamedTuple):
    """An input.

    Attributes
    ----------
    kind : str
        What reads it.
    suffix : str
        Ending of its file.
    mode : str
        How it is mutated.
    content : bytes
    case, name : str
        Where it is one of several files: what they are called together, and its path among them.
    files : tuple of (str, bytes)
        All of these files as they are valid, by their paths.
    """

    kind: str
    suffix: str
    mode: str
    content: bytes
    case: str = ""
    name: str = ""
    files: tuple[tuple[str, bytes], ...] = ()

    def written(self) -> dict[str, bytes]:
        """The files to write, by their paths."""
        return (
            {**dict(self.files), self.name: self.content}
            if self.case
            else {f"input{self.suffix}": self.content}
        )


def of_folder(
    kind: str, case: str, files: dict[str, bytes], modes: dict[str, str] | None = None, only=None
):
    """An input for each of some files that belong together.

    Parameters
    ----------
    kind, case : str
    files : dict of str to bytes
        By their paths.
    modes : dict of str to str, optional
        Of endings of paths, how such files are mutated; others as bytes.
    only : collection of str, optional
        The files to mutate; by default all.
    """
    kept = tuple(files.items())
    for name, content in kept:
        if only is None or name in only:
            mode = next(
                (mode for end, mode in (modes or {}).items() if name.endswith(end)), "binary"
            )
            suffix = name[name.rfind(".") :] if "." in name else ""
            yield Input(kind, suffix, mode, content, case, name, kept)
