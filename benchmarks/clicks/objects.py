"""The objects that are clicked at, in public scans, and their fixed split into a half to tune on and a half to report.

The list names what a person would click: deep grey nuclei, ventricles, cerebellum and brain stem in an MRI of the head
(FreeSurfer's table of colours numbers the labels), organs, vessels, bones and muscle of an abdominal CT
(TotalSegmentator's table of classes), white matter, the cervical cord, single nuclei in fluorescence. It was fixed
before anything was run (record 0023). The abdominal CT shows no kidney.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.image.volume import Volume
from benchmarks.peers.work import scan

HALVES = ("tune", "report")
#: What the size that a person states beside the first click is, as a part of the true one: 25 % too large, 20 % too
#: small, in turn along each half.
SIZE_FACTORS = (1.25, 0.8)


@dataclass(frozen=True)
class ClickObject:
    """One object: a short name, the scan's file without its ending, and the labels of the reference that make it."""

    name: str
    volume: str
    labels: tuple[int, ...]


_BRAIN, _CT, _NUCLEI = "mri_brain256", "ct_abdomen_hires", "fluo_nuclei1136"
#: In any order: `OBJECTS` has them in the order that counts.
_NAMED = (
    ClickObject("spleen", _CT, (1,)),
    ClickObject("liver", _CT, (5,)),
    ClickObject("stomach", _CT, (6,)),
    ClickObject("vertebra-T12", _CT, (32,)),
    ClickObject("vertebra-T11", _CT, (33,)),
    ClickObject("aorta", _CT, (52,)),
    ClickObject("vena-cava", _CT, (63,)),
    ClickObject("humerus-left", _CT, (69,)),
    ClickObject("cord-ct", _CT, (79,)),
    ClickObject("back-muscle-left", _CT, (86,)),
    # Nuclei: the three that do not touch the border, and the three largest of those that do.
    ClickObject("nucleus-17", _NUCLEI, (17,)),
    ClickObject("nucleus-18", _NUCLEI, (18,)),
    ClickObject("nucleus-19", _NUCLEI, (19,)),
    ClickObject("nucleus-26", _NUCLEI, (26,)),
    ClickObject("nucleus-27", _NUCLEI, (27,)),
    ClickObject("nucleus-28", _NUCLEI, (28,)),
    ClickObject("ventricle-left", _BRAIN, (4,)),
    ClickObject("cerebellum-left", _BRAIN, (7, 8)),
    ClickObject("thalamus-left", _BRAIN, (10,)),
    ClickObject("caudate-left", _BRAIN, (11,)),
    ClickObject("putamen-left", _BRAIN, (12,)),
    ClickObject("pallidum-left", _BRAIN, (13,)),
    ClickObject("third-ventricle", _BRAIN, (14,)),
    ClickObject("fourth-ventricle", _BRAIN, (15,)),
    ClickObject("brain-stem", _BRAIN, (16,)),
    ClickObject("ventricle-right", _BRAIN, (43,)),
    ClickObject("cerebellum-right", _BRAIN, (46, 47)),
    ClickObject("thalamus-right", _BRAIN, (49,)),
    ClickObject("caudate-right", _BRAIN, (50,)),
    ClickObject("putamen-right", _BRAIN, (51,)),
    ClickObject("pallidum-right", _BRAIN, (52,)),
    ClickObject("white-matter", "mri_brain_oblique", (2,)),
    ClickObject("cord", "mri_cord_iso", (1,)),
)
#: Sorted by the scan's name and the lowest label.
OBJECTS = tuple(sorted(_NAMED, key=lambda one: (one.volume, min(one.labels))))


def half_of(one: ClickObject) -> str:
    """Which half an object is in: odd positions (from 1) are there to tune on, even ones to report."""
    return HALVES[OBJECTS.index(one) % 2]


def size_factor(one: ClickObject) -> float:
    """What a stated size is, as a part of the true one."""
    return SIZE_FACTORS[OBJECTS.index(one) // 2 % 2]


def chosen(half: str = "", names: Iterable[str] = ()) -> list[ClickObject]:
    """The objects of a half (all for ""), and of those the ones that are named, in order.

    Raises
    ------
    ValueError
        When a name is none of theirs.

    Examples
    --------
    >>> [one.name for one in chosen("tune", ["cord", "spleen"])]
    ['spleen', 'cord']
    """
    named, own = set(names), [one for one in OBJECTS if not half or half_of(one) == half]
    unknown = named - {one.name for one in own}
    if unknown:
        raise ValueError(f"{min(unknown)}: no such object; there are {', '.join(one.name for one in own)}")
    return [one for one in own if not named or one.name in named]


@lru_cache(maxsize=2)
def _read(folder: Path, name: str) -> tuple[Volume, NDArray[np.integer]]:
    labels = io.read_labels(scan(folder, f"{name}_ref.nii.gz")).array
    return io.read(scan(folder, f"{name}.nii.gz")), np.asarray(labels)


@lru_cache(maxsize=1)
def load(one: ClickObject, folder: Path | None) -> tuple[Volume, NDArray[np.bool_]]:
    """The whole scan, and the object in it as a mask; the last two scans, and the last object, are kept in memory.

    Raises
    ------
    MissingError
        When there is no folder, or not this scan in it.
    """
    image, labels = _read(scan(folder, f"{one.volume}.nii.gz").parent, one.volume)
    return image, np.isin(labels, one.labels)
