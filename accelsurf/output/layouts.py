"""Names and folders that other tools expect: BIDS derivatives, and folders of label maps as of nnU-Net.

Only the label map and the extra files of BIDS get other names. The other files of a run keep theirs: BIDS is told
to leave them alone, by a ``.bidsignore``.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from accelsurf.errors import UsageError
from accelsurf.io import split_name, write_bytes
from accelsurf.output.reports import FAILED
from accelsurf.settings.run_config import RunConfig
from accelsurf.version import __version__

BIDS_VERSION = "1.9.0"
#: Kinds of the files that BIDS has beside a label map.
SIDECAR = "sidecar"
TABLE = "also-tsv"
#: Entities of the names of images, in the order that BIDS asks for; ``seg`` and ``desc`` are added here.
ENTITIES = (
    "sub",
    "ses",
    "sample",
    "task",
    "tracksys",
    "acq",
    "nuc",
    "voi",
    "ce",
    "trc",
    "stain",
    "rec",
    "dir",
    "run",
    "mod",
    "echo",
    "flip",
    "inv",
    "mt",
    "part",
    "proc",
    "hemi",
    "space",
    "split",
    "recording",
    "chunk",
    "seg",
    "res",
    "den",
    "label",
    "desc",
)
#: Formats of label maps in BIDS.
_NIFTI = ("nii.gz", "nii")
#: Files of a run that BIDS has no names for, and files of a batch.
_IGNORED = (
    "*_surface*.*",
    "*_contour*.*",
    "*_report.json",
    "*_trace.csv",
    "*_preview.png",
    "*_statistics.*",
    "*_objects.csv",
    "*_seg.*",
    "*_sdf.*",
    "*_state.npz",
    "*_run.toml",
    "*_checkpoint.npz",
    "*_case.json",
    "*_labels.*",
    "*_segmentation.*",
    "*.dcm",
    "batch*.*",
)
_PAIR = re.compile(r"([a-z]+)-([A-Za-z0-9]+)")
_SUFFIX = re.compile(r"[A-Za-z0-9]+")
_CHANNEL = re.compile(r"(.+)_\d{4}")
_HINT = "name the image as sub-01_T1w.nii.gz, or leave out --layout"


@dataclass(frozen=True)
class BidsName:
    """The name of an image in a BIDS data set.

    Attributes
    ----------
    entities : dict of str to str
        In the order of BIDS.
    suffix : str
        The modality, as T1w.
    """

    entities: dict[str, str]
    suffix: str

    @classmethod
    def of(cls, name: str) -> BidsName:
        """Take a name apart, without its ending.

        Raises
        ------
        UsageError
            When it is no name of BIDS.

        Examples
        --------
        >>> BidsName.of("sub-01_ses-2_run-1_T1w").label_map
        'sub-01_ses-2_run-1_seg-accelsurf_desc-T1w_dseg'
        """
        *pairs, suffix = name.split("_")
        found = [_PAIR.fullmatch(pair) for pair in pairs]
        keys = [pair.group(1) for pair in found if pair is not None]
        ordered = [key for key in ENTITIES if key in keys]
        if (
            None in found
            or keys != ordered
            or keys[:1] != ["sub"]
            or _SUFFIX.fullmatch(suffix) is None
        ):
            raise UsageError(f"layout: bids was given, and {name[:80]} is no name of BIDS", _HINT)
        return cls({pair.group(1): pair.group(2) for pair in found if pair is not None}, suffix)

    @property
    def label_map(self) -> str:
        """Name of the label map, without its ending. The suffix of the image tells two images apart."""
        entities = {
            **self.entities,
            "seg": "accelsurf",
            "desc": self.entities.get("desc", "") + self.suffix,
        }
        return "_".join(
            [*(f"{key}-{entities[key]}" for key in ENTITIES if key in entities), "dseg"]
        )

    def folder(self, source: Path) -> Path:
        """Return its folder in a data set: subject, session, and sort of data as of the image's folder, else anat."""
        parts = [f"{key}-{self.entities[key]}" for key in ("sub", "ses") if key in self.entities]
        folder = source.absolute().parent
        return Path(*parts, folder.name if folder.parent.name == parts[-1] else "anat")


def check_layout(config: RunConfig, source: Path, folder: Path, name: str) -> None:
    """Refuse settings and images that a layout cannot have, before anything is computed.

    Parameters
    ----------
    config : RunConfig
    source : Path
        The image.
    folder : Path
        Of its files.
    name : str
        Beginning of their names.

    Raises
    ------
    UsageError
        When the image has no name of BIDS, the format is another, or the label map would replace an image.
    """
    if config.layout == "bids":
        stem = split_name(source)[0]
        BidsName.of(stem)
        if name != stem:
            raise UsageError(
                f"layout: bids was given, and the id {name[:80]} is not the name of the image {stem[:80]}",
                "leave out the ids, or the layout",
            )
        if config.format not in (None, *_NIFTI):
            raise UsageError(
                f"format: {config.format} was given with the layout bids, expected {' or '.join(_NIFTI)}",
                "leave out --format; --also writes the label map in further formats",
            )
    if config.layout == "nnunet":
        stem = _nnunet_stem(source, name)
        images = [
            source.absolute().resolve(),
            *(Path(image).absolute().resolve() for image in config.channel),
        ]
        if any(
            image.parent == folder.absolute().resolve() and split_name(image)[0] == stem
            for image in images
        ):
            raise UsageError(
                f"layout: the label map {stem} would lie on the image",
                "choose another folder with -o",
            )


def layout_folder(config: RunConfig, source: Path, folder: Path) -> Path:
    """Return the folder of an image's files within the folder that was given; nothing is made."""
    return (
        folder / BidsName.of(split_name(source)[0]).folder(source)
        if config.layout == "bids"
        else folder
    )


def renamed(config: RunConfig, source: Path, name: str, names: dict[str, str]) -> dict[str, str]:
    """Names of the files by kind as a layout has them; names of a failed run beside a result stay."""
    if name.endswith(FAILED):
        return names
    ending = names["labels"].removeprefix(f"{name}_seg")
    if config.layout == "nnunet":
        return {**names, "labels": f"{_nnunet_stem(source, name)}{ending}"}
    stem = BidsName.of(split_name(source)[0]).label_map
    return {**names, "labels": f"{stem}{ending}", SIDECAR: f"{stem}.json", TABLE: f"{stem}.tsv"}


def _nnunet_stem(source: Path, name: str) -> str:
    """Name of a case: that of its file without the number of the channel, or the one that was given."""
    numbered = _CHANNEL.fullmatch(name) if name == split_name(source)[0] else None
    return name if numbered is None else numbered.group(1)


def sidecar(source: Path, energy: str) -> str:
    """Return the JSON that BIDS has beside a label map: its image, and that no person has drawn it."""
    bids = BidsName.of(split_name(source)[0])
    image = f"bids:raw:{bids.folder(source).as_posix()}/{source.name}"
    said = {
        "Description": f"Surface of accelsurf {__version__}, energy {energy}",
        "Manual": False,
        "Sources": [image],
        "SpatialReference": image,
    }
    return json.dumps(said, indent=2) + "\n"


def complete_layout(config: RunConfig, source: Path, folder: Path) -> None:
    """Write the files that a data set of BIDS has once, unless they exist: its description, and paths to leave alone.

    Parameters
    ----------
    config : RunConfig
    source : Path
        The image.
    folder : Path
        Of its files, from `layout_folder`.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    if config.layout != "bids":
        return
    inner = BidsName.of(split_name(source)[0]).folder(source).parts
    depth = len(inner)
    if folder.absolute().parts[-depth:] != inner:
        return  # a corrected result in a folder of its own
    top = folder.absolute().parents[depth - 1]
    said: dict[str, object] = {
        "Name": "Segmentations of accelsurf",
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "accelsurf", "Version": __version__}],
    }
    whole = source.absolute()
    if whole.parts[-depth - 1 : -1] == inner:  # the image lies in a data set itself
        said["DatasetLinks"] = {"raw": Path(os.path.relpath(whole.parents[depth], top)).as_posix()}
    for name, text in (
        ("dataset_description.json", json.dumps(said, indent=2) + "\n"),
        (".bidsignore", "\n".join(_IGNORED) + "\n"),
    ):
        if not (top / name).exists():
            write_bytes(top / name, text.encode())
