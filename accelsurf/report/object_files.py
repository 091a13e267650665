"""The files of each of several objects: surfaces or contours with its id in their names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

#: Kinds of outputs of which each object has its own.
EACH = ("surface", "contour")


def name_of(name: str, own: int) -> str:
    """Return the name of a file for the object ``own``.

    Examples
    --------
    >>> name_of("scan_surface.ply", 7)
    'scan_surface_7.ply'
    """
    stem, _, suffix = name.rpartition(".")
    return f"{stem}_{own}.{suffix}"


def existing(folder: Path, names: Mapping[str, str]) -> list[Path]:
    """Return the files in a folder that are named as the surface or contour of an object, of any id.

    Parameters
    ----------
    folder : Path
    names : mapping of str to str
        Name of the file by kind, as of a run of one object.
    """
    parts = [names[kind].rpartition(".") for kind in names if kind.startswith(EACH)]
    known = re.compile("|".join(rf"{re.escape(stem)}_[1-9][0-9]*\.{suffix}" for stem, _, suffix in parts))
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in files if known.fullmatch(path.name))
