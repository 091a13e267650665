"""The report's entries about files: the image that was read, and each file that was written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelsurf.io import sha256

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry
    from accelsurf.io.file_set import FileSet


def describe_input(
    path: str | Path, *, geometry: Geometry | None = None, checksum: str | None = None
) -> dict[str, Any]:
    """Return the report's entry about the input.

    Parameters
    ----------
    path : str or Path
        The input file.
    geometry : Geometry, optional
        Its grid; None when it could not be read, and then the entries are null.
    checksum : str, optional
        SHA-256 of the file, from `accelsurf.io.sha256`.

    Examples
    --------
    >>> from accelsurf.grid.geometry import Geometry
    >>> entry = describe_input("scan.nii", geometry=Geometry((5, 4, 3), (2.0, 1.0, 0.5)))
    >>> entry["size"], entry["spacing"]
    ([3, 4, 5], [0.5, 1.0, 2.0])
    """
    grid: dict[str, Any] = dict.fromkeys(("size", "spacing", "origin", "direction"))
    if geometry is not None:
        grid = {
            "size": list(geometry.size),
            "spacing": list(geometry.spacing_xyz),
            "origin": list(geometry.origin),
            "direction": geometry.direction.tolist(),
        }
    return {"path": str(Path(path).absolute()), "sha256": checksum, **grid}


def describe_output(path: str | Path, kind: str, draft: Path | None = None) -> dict[str, str]:
    """Return the report's entry about a file that is written.

    Parameters
    ----------
    path : str or Path
        The file.
    kind : str
        What it is: labels, surface, contour, trace, preview, sdf, ...
    draft : Path, optional
        Where its content is until all files of the run are complete.
    """
    return {"path": str(Path(path).absolute()), "kind": kind, "sha256": sha256(draft or path)}


def describe_drafts(files: FileSet, kinds: Mapping[str, str]) -> list[dict[str, str]]:
    """Return the report's entries about all drafts of a set, those with a kind first.

    Parameters
    ----------
    files : FileSet
    kinds : mapping of str to str
        Kind by name; a file that belongs to another one, such as the voxels of an .mhd header, has none: it is "data".
    """
    names = [*kinds, *sorted(path.name for path in files.drafts.iterdir() if path.name not in kinds)]
    return [describe_output(files.folder / name, kinds.get(name, "data"), files.drafts / name) for name in names]
