"""The objects that are clicked at: of public scans by a fixed rule (`choice`), and a phantom of each kind (`phantoms`).

A person would say each object's name. ``objects.json`` is what the rule gives; objects of the former list that it does
not choose are in it too, and played only when they are named.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.grid.boxes import Box
from accelsurf.image.volume import Volume
from benchmarks.clicks import phantoms
from benchmarks.clicks.folds import NAMES, fold_of_scan
from benchmarks.clicks.references import SLABS, THRESHOLDS, labelled, within
from benchmarks.peers.measure import scans_folder
from benchmarks.peers.work import scan

TABLE = Path(__file__).resolve().parent / "objects.json"
#: What the size that a person states beside the first click is, as a part of the true one: 25 % too large, 20 % too
#: small, in turn along the list.
SIZE_FACTORS = (1.25, 0.8)
PHANTOM = "phantom"


@dataclass(frozen=True)
class ClickObject:
    """One object: a short name, the scan's file without its ending, and the labels of the reference that make it.

    ``labels``: none for all above 0, or for an object by thresholds or a phantom. ``part``: of the connected parts of
    the labels the one of this rank by size, 0 for all together. ``selected``: the rule took it.
    """

    name: str
    volume: str
    labels: tuple[int, ...] = ()
    family: str = "other"
    part: int = 0
    selected: bool = True

    @property
    def fold(self) -> str:
        """Name of its fold."""
        return fold_of_scan(self.volume)


@dataclass(frozen=True)
class Scene:
    """A scan, the object in it as a mask, and the box that is compared (None: all)."""

    image: Volume
    truth: NDArray[np.bool_]
    region: Box | None = None


@cache
def objects() -> tuple[ClickObject, ...]:
    """All objects, by fold: those of the table, then the phantoms."""
    rows: list[dict[str, Any]] = json.loads(TABLE.read_text())
    scans = [ClickObject(**{**row, "labels": tuple(row["labels"])}) for row in rows]
    made = [ClickObject(name, PHANTOM, (), kind.family) for name, kind in phantoms.KINDS.items()]
    return (*scans, *made)


def written(found: Sequence[ClickObject]) -> str:
    """Text of a table of objects, one a line."""
    rows = [
        {
            "name": each.name,
            "volume": each.volume,
            "labels": list(each.labels),
            "family": each.family,
            **({"part": each.part} if each.part else {}),
            **({} if each.selected else {"selected": False}),
        }
        for each in found
    ]
    return "[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]\n"


def size_factor(which: ClickObject) -> float:
    """Stated size as a part of the true one."""
    return SIZE_FACTORS[objects().index(which) % 2]


def selected(folds: Collection[str] = (), names: Iterable[str] = ()) -> list[ClickObject]:
    """The objects of some folds (none: of all), or of those the ones that are named, in order.

    Raises
    ------
    ValueError
        When there is no such fold, or a name is none of theirs.

    Examples
    --------
    >>> [each.name for each in selected(["3"], ["aorta-mra"])]
    ['aorta-mra']
    """
    for fold in folds:
        if fold not in NAMES:
            raise ValueError(f"{fold}: no such fold; there are {', '.join(NAMES)}")
    held = [each for each in objects() if not folds or each.fold in folds]
    named = set(names)
    unknown = named - {each.name for each in held}
    if unknown:
        raise ValueError(
            f"{min(unknown)}: no such object; there are {', '.join(each.name for each in held)}"
        )
    return [each for each in held if (each.name in named if named else each.selected)]


@lru_cache(maxsize=2)
def _image(path: Path) -> Volume:
    return io.read(path)


@lru_cache(maxsize=2)
def _labels(path: Path) -> NDArray[np.integer]:
    return np.asarray(io.read_labels(path).array)


@lru_cache(maxsize=1)
def load(which: ClickObject, folder: Path | None = None) -> Scene:
    """The whole scan with the object; the last two scans, and the last object, are kept in memory.

    Parameters
    ----------
    which : ClickObject
    folder : Path, optional
        Of the scans; by default the one that ``ACCELSURF_VOLUMES`` names. Phantoms need none.

    Raises
    ------
    MissingError
        When there is no folder, or not this scan in it.
    """
    if which.volume == PHANTOM:
        return Scene(*phantoms.made(which.name))
    path = scan(folder or scans_folder(), f"{which.volume}.nii.gz")
    image = _image(path)
    if which.name in THRESHOLDS:
        return Scene(image, THRESHOLDS[which.name].mask(image.array))
    reference = _labels(scan(path.parent, f"{which.volume}_ref.nii.gz"))
    region = SLABS.get(which.volume)
    return Scene(image, within(labelled(reference, which.labels, which.part), region), region)
