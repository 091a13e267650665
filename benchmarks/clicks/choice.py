"""The rule by which objects are selected from the scans; `python -m benchmarks.clicks.choice` writes ``objects.json``.

1. Candidates are the labels of a reference that have a name a person would say, and groups of them; nuclei by number;
   of one label in many parts (vessels) its parts. A candidate has at least 300 voxels, a vessel 1,000.
2. Maps with hundreds of parcels give only candidates with an edge of d' >= .8 (`references.edge`).
3. At most six a scan, four of vessels. A scan's places go to its families in turn. Within a family candidates are
   sorted by size, and taken at equal steps of rank from the largest to the smallest; a single place takes the largest.
4. Scans without a reference have the objects of `THRESHOLDS`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import io
from accelsurf.grid.boxes import bounding_box
from benchmarks.clicks.folds import FAMILIES, FOLDS
from benchmarks.clicks.objects import TABLE, ClickObject, written
from benchmarks.clicks.references import THRESHOLDS, edge, labelled
from benchmarks.peers.work import scan

LEAST, LEAST_PART, MOST, MOST_PARTS, LEAST_EDGE, MANY = 300, 1000, 6, 4, 0.8, 100


class Named(NamedTuple):
    """A candidate: its name, its family, its labels (none: all above 0), which part of them (0: all)."""

    name: str
    family: str
    labels: tuple[int, ...]
    part: int = 0


#: FreeSurfer's table of colours numbers the labels.
_HEAD = (
    Named("head-brain", "brain", ()),
    Named("head-white-matter", "brain", (2, 41, 77, 251, 252, 253, 254, 255)),
    Named("callosum", "brain", (251, 252, 253, 254, 255)),
    Named("ventricle-left", "brain", (4,)),
    Named("ventricle-right", "brain", (43,)),
    Named("third-ventricle", "brain", (14,)),
    Named("fourth-ventricle", "brain", (15,)),
    Named("cerebellum-left", "brain", (7, 8)),
    Named("cerebellum-right", "brain", (46, 47)),
    Named("brain-stem", "brain", (16,)),
    Named("thalamus-left", "brain", (10,)),
    Named("thalamus-right", "brain", (49,)),
    Named("caudate-left", "brain", (11,)),
    Named("caudate-right", "brain", (50,)),
    Named("putamen-left", "brain", (12,)),
    Named("putamen-right", "brain", (51,)),
    Named("pallidum-left", "brain", (13,)),
    Named("pallidum-right", "brain", (52,)),
    Named("hippocampus-left", "brain", (17,)),
    Named("hippocampus-right", "brain", (53,)),
    Named("amygdala-left", "brain", (18,)),
    Named("amygdala-right", "brain", (54,)),
)
#: NeuroMaps cuts a macaque's brain into parcels: those that are one thing to the eye are put together.
_MACAQUE = (
    Named("macaque-brain", "brain", ()),
    Named(
        "macaque-white-matter",
        "brain",
        (2, 55, 71, 124, 151, 193, 1002, 1055, 1071, 1124, 1151, 1193),
    ),
    Named("macaque-callosum", "brain", (71, 124, 1071, 1124)),
    Named("macaque-ventricle-left", "brain", (73, 197, 201)),
    Named("macaque-ventricle-right", "brain", (1073, 1197, 1201)),
    Named("macaque-putamen-left", "brain", (98,)),
    Named("macaque-putamen-right", "brain", (1098,)),
    Named("macaque-cerebellum-white", "brain", (237, 1237)),
    Named("macaque-fourth-ventricle", "brain", (261, 1261)),
)
#: TotalSegmentator's table of classes numbers the labels.
_ABDOMEN = (
    Named("spleen", "organs", (1,)),
    Named("liver", "organs", (5,)),
    Named("stomach", "organs", (6,)),
    Named("adrenal-right", "organs", (8,)),
    Named("adrenal-left", "organs", (9,)),
    Named("colon", "organs", (20,)),
    Named("vertebra-T12", "bones", (32,)),
    Named("vertebra-T11", "bones", (33,)),
    Named("aorta", "vessels", (52,)),
    Named("vena-cava", "vessels", (63,)),
    Named("portal-vein", "vessels", (64,)),
    Named("humerus-left", "bones", (69,)),
    Named("humerus-right", "bones", (70,)),
    Named("cord-ct", "other", (79,)),
    Named("back-muscle-left", "other", (86,)),
    Named("back-muscle-right", "other", (87,)),
    *(Named(f"rib-left-{n}", "bones", (91 + n,)) for n in range(1, 13)),
    *(Named(f"rib-right-{n}", "bones", (103 + n,)) for n in range(1, 13)),
    Named("rib-cartilage", "bones", (117,)),
)
NAMED: dict[str, tuple[Named, ...]] = {
    "ct_abdomen_hires": _ABDOMEN,
    "mri_cord_iso": (Named("cord", "other", (1,)),),
    "mri_cord_thick": (Named("cord-grey-matter", "other", (1,)),),
    "mri_brain256": _HEAD,
    "ct_vertebra_l3": tuple(Named(f"vertebra-L{n}", "bones", (19 + n,)) for n in (2, 3, 4)),
    "mra_aorta": (Named("aorta-mra", "vessels", (1,)),),
    "mri_macaque": _MACAQUE,
    "mri_lung_0004": (Named("lung-left", "organs", (1,)), Named("lung-right", "organs", (2,))),
    "mri_mni152": (
        Named("mean-brain", "brain", ()),
        Named("mean-grey", "brain", (1,)),
        Named("mean-white", "brain", (2,)),
    ),
    # Its authors added two balls beside the brain.
    "mri_brain_oblique": (
        Named("oblique-brain", "brain", (), 1),
        Named("grey-matter", "brain", (1,)),
        Named("white-matter", "brain", (2,)),
    ),
    "mri_tumour_thick2": (Named("tumour", "lesions", (1,)),),
}
#: Scans with a label per nucleus -> how its nuclei are called.
NUCLEI = {
    "fluo_nuclei1135": "nucleus-b",
    "fluo_nuclei1136": "nucleus",
    "synthetic_nuclei": "nucleus-s",
}
#: Scans with one label in many parts -> how these are called.
PARTS = {"fluo_vessels_bbb": "vessel-b", "fluo_vessels_noleak": "vessel"}
#: Objects of the first version of this benchmark, which stay in the table so that its games can be compared.
FORMER = (
    "spleen",
    "liver",
    "stomach",
    "vertebra-T12",
    "vertebra-T11",
    "aorta",
    "vena-cava",
    "humerus-left",
    "cord-ct",
    "back-muscle-left",
    "nucleus-17",
    "nucleus-18",
    "nucleus-19",
    "nucleus-26",
    "nucleus-27",
    "nucleus-28",
    "ventricle-left",
    "cerebellum-left",
    "thalamus-left",
    "caudate-left",
    "putamen-left",
    "pallidum-left",
    "third-ventricle",
    "fourth-ventricle",
    "brain-stem",
    "ventricle-right",
    "cerebellum-right",
    "thalamus-right",
    "caudate-right",
    "putamen-right",
    "pallidum-right",
    "white-matter",
    "cord",
)


class Candidate(NamedTuple):
    """An object that may be selected, its number of voxels, and the strength of its edge (infinite: not asked)."""

    object: ClickObject
    size: int
    edge: float


def candidates(name: str, values: NDArray[Any], reference: NDArray[Any]) -> Iterator[Candidate]:
    """Candidates of a scan with a reference, of any size."""
    many = np.unique(reference).size > MANY
    for named in _named(name, reference):
        mask = labelled(reference, named.labels, named.part)
        box = bounding_box(mask, 3)
        if box is None:
            continue
        strength = edge(values[box], mask[box]) if many else np.inf
        found = ClickObject(named.name, name, named.labels, named.family, named.part)
        yield Candidate(found, int(mask.sum()), strength)
    if name in PARTS:
        parts, count = ndimage.label(reference > 0, np.ones((3, 3, 3)))
        sizes = np.sort(np.bincount(parts.ravel(), minlength=count + 1)[1:])[::-1]
        for rank, size in enumerate(sizes, 1):
            yield Candidate(
                ClickObject(f"{PARTS[name]}-{rank}", name, (1,), "vessels", rank), int(size), np.inf
            )


def _named(name: str, reference: NDArray[Any]) -> Sequence[Named]:
    if name in NUCLEI:
        return [
            Named(f"{NUCLEI[name]}-{k}", "nuclei", (int(k),)) for k in np.unique(reference) if k > 0
        ]
    return NAMED.get(name, ())


def spread(found: Sequence[Candidate], most: int) -> list[Candidate]:
    """Candidates at equal steps of rank by size; places go to the families in turn.

    Examples
    --------
    >>> found = [Candidate(ClickObject(str(n), "s", (n,), "nuclei"), n, 1.0) for n in range(1, 12)]
    >>> [each.size for each in spread(found, 3)]
    [11, 6, 1]
    """
    families = [
        family for family in FAMILIES if any(each.object.family == family for each in found)
    ]
    held = {
        family: sorted(
            (each for each in found if each.object.family == family),
            key=lambda each: (-each.size, each.object.labels),
        )
        for family in families
    }
    places = dict.fromkeys(families, 0)
    while sum(places.values()) < min(most, len(found)):
        for family in families:
            if places[family] < len(held[family]) and sum(places.values()) < most:
                places[family] += 1
    out = []
    for family, count in places.items():
        step = (len(held[family]) - 1) / max(count - 1, 1)
        out += [held[family][round(i * step)] for i in range(count)]
    return out


def of_scan(name: str, folder: Path | None) -> list[ClickObject]:
    """Objects of a scan: those selected, and those of the former list that are not."""
    by_threshold = [
        ClickObject(which, name, (), THRESHOLDS[which].family)
        for which in THRESHOLDS
        if THRESHOLDS[which].scan == name
    ]
    if by_threshold:
        return by_threshold
    values = io.read(scan(folder, f"{name}.nii.gz")).array
    reference = np.asarray(io.read_labels(scan(folder, f"{name}_ref.nii.gz")).array)
    every = list(candidates(name, values, reference))
    least = LEAST_PART if name in PARTS else LEAST
    fit = [each for each in every if each.size >= least and each.edge >= LEAST_EDGE]
    taken = [each.object for each in spread(fit, MOST_PARTS if name in PARTS else MOST)]
    rest = [
        each.object for each in every if each.object.name in FORMER and each.object not in taken
    ]
    return taken + [replace(each, selected=False) for each in rest]


def main() -> int:
    """Choose the objects of all scans, and write the table."""
    folder = Path(os.environ["ACCELSURF_VOLUMES"])
    found = [each for fold in FOLDS for name in fold.scans for each in of_scan(name, folder)]
    TABLE.write_text(written(found))
    print(f"written: {TABLE}, {sum(each.selected for each in found)} chosen")
    return 0


if __name__ == "__main__":
    sys.exit(main())
