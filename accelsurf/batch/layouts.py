"""Cases in folders: a folder of images, nnU-Net's, a BIDS tree, a pattern, a list of files."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from accelsurf.batch.case import Case
from accelsurf.errors import InputError, UsageError
from accelsurf.io import is_stored, split_name
from accelsurf.settings.file_formats import image_suffixes, input_help

#: How a folder is read; auto looks at its names.
Layout = Literal["auto", "folder", "nnunet", "bids"]

_CHANNEL = re.compile(r"(.+)_(\d{4})")
_SUBJECTS = ("sub-*/anat/*", "sub-*/ses-*/anat/*")
#: Endings of BIDS names that are no images of a scanner.
_NOT_SCANS = re.compile(r"_(?:\w*mask|dseg|probseg)$")


def in_folder(folder: Path, layout: Layout = "auto") -> tuple[list[Case], str]:
    """Return the cases of a folder, and its layout in words.

    Parameters
    ----------
    folder : Path
    layout : {"auto", "folder", "nnunet", "bids"}
        auto: a BIDS tree where it has one's folders; nnU-Net's where all names end in channels from _0000 on.

    Raises
    ------
    InputError
        When there is no image in it, or a channel is missing; UsageError when auto cannot decide.
    """
    if layout == "bids" or (
        layout == "auto" and not images_among(folder.iterdir()) and any(folder.glob("sub-*"))
    ):
        return _bids(folder), "a BIDS tree"
    images = images_among(folder.iterdir())
    if not images:
        raise InputError(
            f"{folder}: no image in this folder, {input_help()} expected",
            "for images in folders below write a pattern in quotes, such as 'scans/**/*.nii.gz'",
        )
    channels = _channels(images)
    if layout == "nnunet" or (layout == "auto" and _is_nnunet(folder, images, channels)):
        cases = _nnunet(folder, images, channels)
        count = max(len(case.channels) for case in cases) + 1
        return cases, f"nnU-Net's folder, {count} channel{'s' if count > 1 else ''}"
    return [
        Case(split_name(image)[0], image.absolute(), place=str(image)) for image in images
    ], "a folder of images"


def of_files(images: Sequence[Path]) -> list[Case]:
    """Return a case for each file; its id is its name, or where names repeat its path from their common folder on."""
    names = [split_name(image)[0] for image in images]
    if len({name.casefold() for name in names}) < len(names):
        full = [image.absolute() for image in images]
        common = Path(os.path.commonpath([path.parent for path in full]))
        names = [
            "_".join((*path.parent.relative_to(common).parts, split_name(path)[0])) for path in full
        ]
    return [
        Case(name, image.absolute(), place=str(image))
        for name, image in zip(names, images, strict=True)
    ]


def images_among(paths: Iterable[Path]) -> list[Path]:
    """Return the files with names of images, in order, without hidden files and files of a run."""
    of_runs = ("_state.npz", "_checkpoint.npz")
    visible = (
        path for path in paths if not path.name.startswith(".") and not path.name.endswith(of_runs)
    )
    named = (path for path in visible if split_name(path)[1] in image_suffixes())
    return sorted((path for path in named if not path.is_dir() or is_stored(path)), key=str)


def _bids(folder: Path) -> list[Case]:
    found = images_among(path for pattern in _SUBJECTS for path in folder.glob(pattern))
    scans = [path for path in found if _NOT_SCANS.search(split_name(path)[0]) is None]
    if not scans:
        raise InputError(
            f"{folder}: no image in sub-*/anat or sub-*/ses-*/anat", "is it the top of a BIDS tree?"
        )
    return [Case(split_name(path)[0], path.absolute(), place=str(path)) for path in scans]


def _channels(images: Sequence[Path]) -> dict[str, dict[int, Path]]:
    """Files by case and number of the channel; those with another name are left out."""
    found: dict[str, dict[int, Path]] = {}
    for image in images:
        if (parts := _CHANNEL.fullmatch(split_name(image)[0])) is not None:
            found.setdefault(parts[1], {})[int(parts[2])] = image
    return found


def _is_nnunet(folder: Path, images: Sequence[Path], channels: dict[str, dict[int, Path]]) -> bool:
    """Return True if the names follow nnU-Net; raise where they may as well number the images of a series."""
    if sum(map(len, channels.values())) < len(images) or not all(
        0 in numbers for numbers in channels.values()
    ):
        return False
    if (
        len(channels) > 1
        or len(images) == 1
        or any((at / "dataset.json").is_file() for at in (folder, folder.parent))
    ):
        return True
    raise UsageError(
        f"{folder}: {images[0].name} to {images[-1].name} may be the channels of one case (nnU-Net) or "
        f"{len(images)} images",
        "say which: --layout nnunet or --layout folder",
    )


def _nnunet(
    folder: Path, images: Sequence[Path], channels: dict[str, dict[int, Path]]
) -> list[Case]:
    named = {path for numbers in channels.values() for path in numbers.values()}
    if others := [image for image in images if image not in named]:
        raise InputError(
            f"{others[0]}: a name as CASE_0000 expected in nnU-Net's folder",
            "or use --layout folder",
        )
    most = max(max(numbers) for numbers in channels.values())
    cases = []
    for name, numbers in sorted(channels.items()):
        if missing := [number for number in range(most + 1) if number not in numbers]:
            of_others = f", other cases have {most + 1} channels" if len(channels) > 1 else ""
            raise InputError(
                f"{folder}: case {name} has no channel {name}_{missing[0]:04d}{of_others}",
                "copy the missing file, or use --layout folder",
            )
        first, *more = (numbers[number].absolute() for number in range(most + 1))
        settings = {"channel": tuple(str(path) for path in more)} if more else {}
        cases.append(Case(name, first, settings, place=str(numbers[0])))
    return cases
