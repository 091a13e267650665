"""Presets: settings for a kind of scan, each with what its values mean and the scans that it was tried on.

A preset names quantities of the object and of the modality (Hounsfield units, widths of structures, voxels), never of a
file. Where the values of a modality have no unit, or depend on contrast agent and sequence, bounds and models are
learned from the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

PresetName = Literal[
    "ct-bone", "ct-vessel", "ct-organ", "mr-brain", "mr-ventricle", "mr-cord", "fluorescence-nucleus"
]


class Preset(NamedTuple):
    """Settings for a kind of scan.

    Attributes
    ----------
    summary : str
        For what, and what start it wants.
    settings : mapping
        Values of `RunConfig` by name; those not named keep their defaults.
    reasons : mapping
        What each of these values means, by the same names.
    tried : mapping of str to str
        The volumes that it was tried on, by public source, and how it did.
    """

    summary: str
    settings: Mapping[str, Any]
    reasons: Mapping[str, str]
    tried: Mapping[str, str]


_LEARNED = (
    "values within 2.5 standard deviations of those in the start (as ConfidenceConnected of ITK takes them): they differ "
    "with contrast agent, phase and dose, so they are learned"
)
_ABDOMEN = "abdominal CT, portal phase, 20 slices of 2 mm (TotalSegmentator tests; automatic reference)"
_HEAD = "CT of a head phantom, oblique, 2.4 mm slices (niivue-images)"
_BRAIN = "T1 brain at 1 mm, skull-stripped (niivue demo images; FreeSurfer)"
_OBLIQUE = "T1 brain at 1 mm, oblique, skull-stripped (nii2meshCPP; FSL FAST)"

PRESETS: dict[str, Preset] = {
    "ct-bone": Preset(
        "Bone in CT, calibrated in HU. Its own start is the largest part above 226 HU; --start ball:... for one bone.",
        {"start": ("largest:226,",), "energy": "threshold:226,", "presmooth": 0.0, "smoothness": 0.2},
        {
            "start": "what hangs together above 226 HU",
            "energy": "226 HU is the customary lower bound of bone: soft tissue with contrast agent ends at about 150, "
            "compact bone begins at 300. Spongy bone below it is left out; metal is taken in",
            "presmooth": "none: thin walls are a voxel wide",
            "smoothness": "0.2 mm: takes single voxels of noise, keeps what is thicker than half a millimetre",
        },
        {},
    ),
    "ct-vessel": Preset(
        "Vessels with contrast agent in CT: a ball well inside the lumen.",
        {"energy": "threshold:learned,learned", "presmooth": 1.0, "smoothness": 0.5},
        {
            "energy": _LEARNED + "; bounded above too, as bone and plaque are brighter",
            "presmooth": "1 mm: noise of CT is of the size of a voxel, vessels that CT shows are 2 mm wide or more",
            "smoothness": "0.5 mm: keeps tubes down to a radius of 0.5 mm, closes thin bridges to bone",
        },
        {},
    ),
    "ct-organ": Preset(
        "Organs of even values in CT (liver, spleen, kidney): balls well inside, in all of its brightnesses.",
        {"energy": "threshold:learned,learned", "presmooth": 2.0, "smoothness": 2.0},
        {
            "energy": _LEARNED,
            "presmooth": "2 mm: single voxels of organs a few HU apart overlap in noise, means over a few voxels do not",
            "smoothness": "2 mm: bridges to neighbours (muscle, vessels) of less than about 4 mm close; organs are rounder",
        },
        {},
    ),
    "mr-brain": Preset(
        "Brain in T1 MR after skull stripping: a ball in it. Not for scans with skull.",
        {"energy": "chan-vese", "balance": 2.0, "epsilon": 0.0, "smoothness": 0.0},
        {
            "energy": "two means: bright tissue on a background of zeros, whatever the scanner's unit",
            "balance": "2: with exact zeros outside, two means put the boundary at half the brightness of tissue; asking "
            "the inside to fit more closely moves it to about two thirds, above fluid and remains of the stripping",
            "epsilon": "0: sulci are a voxel or two wide, a smeared interface closes them",
            "smoothness": "0: the cortex is folded",
        },
        {},
    ),
    "mr-ventricle": Preset(
        "Ventricles in T1 MR: a small ball in each, well inside.",
        {"energy": "threshold:,learned", "presmooth": 0.0, "smoothness": 0.5},
        {
            "energy": "fluid is the darkest in T1: all darker than 2.5 standard deviations above the start's mean",
            "presmooth": "none: horns are a few voxels wide",
            "smoothness": "0.5 mm: keeps horns of 1 mm, closes thin passages to other fluid",
        },
        {},
    ),
    "mr-cord": Preset(
        "Spinal cord in MR: small balls along it, about one every 10 mm, well inside.",
        {"energy": "likelihood:histogram,no", "presmooth": 0.0, "smoothness": 0.0, "levels": 1},
        {
            "energy": "histograms learned once from the balls and from all else: grey and white matter are two values, "
            "fluid around is of another; updated ones leak along the fluid",
            "presmooth": "none: the cord is about 10 mm wide, in few voxels",
            "smoothness": "0: the energy is of many voxels already",
            "levels": "1: the cord has few voxels across",
        },
        {},
    ),
    "fluorescence-nucleus": Preset(
        "Nuclei as bright blobs in fluorescence, all as one object; voxels, as units differ between files.",
        {"start": ("otsu",), "energy": "local-region", "presmooth": "1vox"},
        {
            "start": "brighter than Otsu's threshold; --start ball:... for one nucleus",
            "energy": "means within 8 voxels: brightness differs from cell to cell and falls with depth",
            "presmooth": "1 voxel: photon noise is independent from voxel to voxel",
        },
        {},
    ),
}
