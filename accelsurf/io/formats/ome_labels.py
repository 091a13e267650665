"""A label map in the ``labels`` group of its image, an OME-Zarr 0.5. The image itself is never touched.

Label map and list of the group are one set of files, the list last: a reader never finds a name without its label map.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.io.file_set import open_set, refuse_links
from accelsurf.io.files import read_json, write_bytes
from accelsurf.io.formats import ome_zarr
from accelsurf.io.formats.zarr_pyramid import ZarrPyramid
from accelsurf.io.headers import check_within_store

_NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z_.-]{0,63}")
_VERSION = "0.5"
_GROUP = "labels"
_MARK = "zarr.json"


def check_label_group(image: Path, name: str, overwrite: bool) -> Path:
    """Refuse beforehand a label map that cannot be written.

    Parameters
    ----------
    image : Path
        The OME-Zarr that was read.
    name : str
        Of the label map in its group.
    overwrite : bool
        Whether one of this name may be replaced.

    Returns
    -------
    Path
        Where it would be.

    Raises
    ------
    UsageError
        When the image is no OME-Zarr 0.5, or the name is none.
    OutputError
        When there is a label map of this name, or the store cannot be written to.
    """
    if _NAME.fullmatch(name) is None:
        raise UsageError(
            f"label_group: {name[:80]} was given, expected letters, digits, _ - and .",
            "as --label-group cells",
        )
    if not image.is_dir():
        raise UsageError("label_group: it was given, and the image is no OME-Zarr", "leave it out")
    header = ome_zarr.parse_ome_zarr(image)
    if header.ome.version != _VERSION or not (header.folder / _MARK).is_file():
        raise UsageError(
            f"label_group: it was given, and the image is OME-Zarr {header.ome.version}, expected {_VERSION}",
            "leave it out: the label map is written beside it",
        )
    group = header.folder / _GROUP
    check_within_store(image, group)
    refuse_links(
        group, "replace the link by the folder that it leads to, or leave out --label-group"
    )
    if not os.access(group if group.is_dir() else header.folder, os.W_OK):
        raise OutputError(f"{group}: cannot be written to", "may the store be written to?")
    if (group / name).exists() and not overwrite:
        raise OutputError(
            f"{group / name}: exists already", "choose another --label-group, or add --overwrite"
        )
    return group / name


def put_labels(image: Path, labels: Volume, name: str, overwrite: bool) -> Path:
    """Write a label map into the group of its image, with all its levels, colours and names.

    Parameters
    ----------
    image, name, overwrite
        As of `check`.
    labels : Volume
        On the grid of the image or of one of its levels, of an unsigned type.

    Returns
    -------
    Path
        Its folder.

    Raises
    ------
    OutputError
        When it cannot be written; the image and the other label maps are as they were.
    """
    check_label_group(image, name, overwrite)
    group = ome_zarr.parse_ome_zarr(image).folder / _GROUP
    try:
        group.mkdir(exist_ok=True)
        with open_set(group, name, mend=overwrite) as files:
            pyramid = ZarrPyramid(
                files.staging / name,
                labels.geometry,
                labels.array.dtype,
                labels.metadata,
                name,
                True,
                "../../",
            )
            pyramid.write_whole(labels.array)
            write_bytes(files.staging / _MARK, _listing(group / _MARK, name))
            files.commit(last=_MARK)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(
            f"{group / name}: cannot be written ({reason})", "is there space on the disk?"
        ) from error
    return group / name


def _listing(mark: Path, name: str) -> bytes:
    """The list of a group with a label map in it."""
    node: dict[str, Any] = {"zarr_format": 3, "node_type": "group", "attributes": {}}
    if mark.is_file():
        try:
            node = read_json(mark)
            ome = node.setdefault("attributes", {}).setdefault("ome", {"version": _VERSION})
            known = [known for known in ome.get("labels", []) if isinstance(known, str)]
        except (InputError, AttributeError, TypeError) as error:
            raise OutputError(f"{mark}: is damaged", "repair the store") from error
    else:
        ome = node["attributes"]["ome"] = {"version": _VERSION}
        known = []
    ome["labels"] = known if name in known else [*known, name]
    return (json.dumps(node, indent=2) + "\n").encode()
