"""How the files of a run are named and laid out: as accelsurf does, as BIDS derivatives, or as nnU-Net has labels.

BIDS: the label map of ``sub-01_ses-2_T1w.nii.gz`` is ``sub-01/ses-2/anat/sub-01_ses-2_dseg.nii.gz``, with a sidecar and
a table of labels, in a folder with a ``dataset_description.json``. ``.bidsignore`` has the files that BIDS has no name
for.
nnU-Net: the label map of ``CASE_0000.nii.gz`` is ``CASE.nii.gz``.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf import __version__
from accelsurf.errors import UsageError
from accelsurf.io.files import write_bytes
from accelsurf.settings.output_fields import Layout

if TYPE_CHECKING:
    from accelsurf.segmentation.result import Result
    from accelsurf.settings.labels import LabelTable

#: Entities of a BIDS name in the order of the specification, then the suffix.
_ENTITIES = re.compile(
    r"(sub-[0-9A-Za-z]+)(_ses-[0-9A-Za-z]+)?((?:_(?:sample|task|acq|ce|trc|stain|rec|dir|run|echo|part|chunk|space|desc)"
    r"-[0-9A-Za-z]+)*)_([0-9A-Za-z]+)"
)
_TYPES = ("anat", "func", "dwi", "fmap", "perf", "pet", "micr")
_CHANNEL = re.compile(r"(.+)_[0-9]{4}")
_IGNORED = (
    "*_report.json", "*_statistics.*", "*_trace.csv", "*_preview.png", "*_surface*", "*_contour*", "*_objects.csv",
    "*_state.npz", "*_run.toml", "*_sdf.*", "*_rest*", "*_seg.*", "*_segmentation.*", "*_labels.*", "*_checkpoint.npz",
)


def place_of(layout: Layout, source: Path, name: str, folder: Path) -> tuple[str, Path]:
    """Return the first part of the names of an image's files, and the folder for them.

    Parameters
    ----------
    layout : {"plain", "bids", "nnunet"}
    source : Path
        The image.
    name : str
        Its name without suffix.
    folder : Path
        That was asked for.

    Raises
    ------
    UsageError
        When the image is not named as BIDS asks for.

    Examples
    --------
    >>> source = Path("raw/sub-01/ses-2/anat/sub-01_ses-2_run-1_T1w.nii.gz")
    >>> name, place = place_of("bids", source, "sub-01_ses-2_run-1_T1w", Path("out"))
    >>> name, place.as_posix()
    ('sub-01_ses-2_run-1', 'out/sub-01/ses-2/anat')
    >>> place_of("nnunet", Path("CASE_0000.nii.gz"), "CASE_0000", Path("out"))[0]
    'CASE'
    """
    if layout == "nnunet":
        found = _CHANNEL.fullmatch(name)
        return (found.group(1) if found else name), folder
    if layout == "bids":
        parts = _ENTITIES.fullmatch(name)
        if parts is None:
            raise UsageError(
                f"layout: bids was given for {source.name}, expected an image named as BIDS does",
                "as sub-01_T1w.nii.gz, or leave --layout out",
            )
        kind = source.parent.name if source.parent.name in _TYPES else "anat"
        session = [parts.group(2).lstrip("_")] if parts.group(2) else []
        stem = name[: -len(parts.group(4)) - 1]
        return stem, folder.joinpath(parts.group(1), *session, kind)
    return name, folder


def label_ending(layout: Layout, labels: str) -> str:
    """Return the end of the name of the label map.

    Examples
    --------
    >>> label_ending("plain", "nii.gz"), label_ending("bids", "nii.gz"), label_ending("nnunet", "nii.gz")
    ('seg.nii.gz', 'dseg.nii.gz', '.nii.gz')
    """
    return {"plain": f"seg.{labels}", "bids": f"dseg.{labels}", "nnunet": f".{labels}"}[layout]


def joined(name: str, ending: str) -> str:
    """Return the name of a file.

    Examples
    --------
    >>> joined("CASE", ".nii.gz"), joined("scan", "seg.nii.gz")
    ('CASE.nii.gz', 'scan_seg.nii.gz')
    """
    return name + ending if ending.startswith(".") else f"{name}_{ending}"


def write_sidecar(result: Result, table: LabelTable, path: Path) -> None:
    """Write what BIDS wants to know of a discrete segmentation."""
    source = result.volume.source
    said = {
        "Description": f"segmentation of {', '.join(table[one.id].name for one in result.objects)}",
        "Manual": False,
        "Sources": [source.name] if source is not None else [],
        "SpatialReference": "orig",
        "GeneratedBy": [{"Name": "accelsurf", "Version": __version__}],
    }
    write_bytes(path, (json.dumps(said, indent=2) + "\n").encode())


def complete(layout: Layout, folder: Path) -> None:
    """Write what makes a folder a BIDS dataset, where that is the layout and it is not there.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    if layout != "bids":
        return
    description = folder / "dataset_description.json"
    if not description.exists():
        said = {
            "Name": "accelsurf segmentations",
            "BIDSVersion": "1.9.0",
            "DatasetType": "derivative",
            "GeneratedBy": [{"Name": "accelsurf", "Version": __version__}],
        }
        write_bytes(description, (json.dumps(said, indent=2) + "\n").encode())
    ignored = folder / ".bidsignore"
    if not ignored.exists():
        write_bytes(ignored, ("\n".join(_IGNORED) + "\n").encode())
