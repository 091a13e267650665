"""The folds: which scans are reported together, and what of the others may be tuned on.

Scans that may show one body, or that one microscope took of one specimen, are in one fold. A setting that is reported
on a fold is selected on the objects of the other folds alone. Phantoms are a fold of their own: it is reported, and
nothing is selected on it.
"""

from __future__ import annotations

from typing import NamedTuple

#: Kinds of objects, in the order in which scans share their places among them.
FAMILIES = ("organs", "bones", "brain", "vessels", "cells", "nuclei", "lesions", "other")


class Fold(NamedTuple):
    """A fold: its name, its scans, and why these are together."""

    name: str
    scans: tuple[str, ...]
    reason: str


FOLDS = (
    Fold(
        "1",
        ("ct_abdomen_hires", "mri_cord_iso", "mri_cord_thick", "ct_bonsai"),
        "one abdomen; the two cords come from one collection and may be of one person",
    ),
    Fold("2", ("fluo_nuclei1135", "fluo_nuclei1136"), "two stacks of one specimen"),
    Fold(
        "3", ("mri_brain256", "ct_vertebra_l3", "mra_aorta"), "three bodies: brain, bones, a vessel"
    ),
    Fold("4", ("mri_macaque", "mri_lung_0004", "ct_tooth"), "three bodies: brain, organs, bones"),
    Fold(
        "5",
        ("fluo_vessels_bbb", "fluo_vessels_noleak", "mri_mni152"),
        "the two stacks of vessels are from one laboratory and microscope; beside them a mean brain",
    ),
    Fold(
        "6",
        ("synthetic_nuclei", "mri_brain_oblique", "mri_tumour_thick2", "ct_phantom_oblique"),
        "four bodies: nuclei, brain, a lesion, a phantom of a head",
    ),
)
PHANTOMS = "phantoms"
#: All names, in the order of the tables.
NAMES = (*(fold.name for fold in FOLDS), PHANTOMS)


def fold_of_scan(scan: str) -> str:
    """Name of the fold of a scan; `PHANTOMS` for a scan that is made.

    Raises
    ------
    ValueError
        When no fold has it.

    Examples
    --------
    >>> fold_of_scan("mra_aorta"), fold_of_scan("phantom")
    ('3', 'phantoms')
    """
    if scan == "phantom":
        return PHANTOMS
    for fold in FOLDS:
        if scan in fold.scans:
            return fold.name
    raise ValueError(f"{scan}: in no fold")


def tuned_on(fold: str) -> tuple[str, ...]:
    """Names of the folds on which settings for ``fold`` are selected.

    Examples
    --------
    >>> tuned_on("2"), tuned_on("phantoms")
    (('1', '3', '4', '5', '6'), ('1', '2', '3', '4', '5', '6'))
    """
    return tuple(each.name for each in FOLDS if each.name != fold)
