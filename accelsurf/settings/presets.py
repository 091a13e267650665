"""Presets: settings for a kind of scan, each with the meaning of its values and the scans that it was tried on.

A preset names quantities of the object and of the modality (Hounsfield units, widths of structures, voxels), never of a
file. Where the values of a modality have no unit, or depend on contrast agent and sequence, bounds and models are
learned from the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from accelsurf.settings.registry import Registry


class Preset(NamedTuple):
    """Settings for a kind of scan.

    Attributes
    ----------
    name : str
        As it is given to ``--preset``.
    summary : str
        For what, and the start that it needs.
    settings : mapping
        Values of `RunConfig` by name; those not named keep their defaults.
    reasons : mapping
        What each of these values means, by the same names.
    tried : mapping of str to str
        The volumes that it was tried on, by public source, and how it did.
    """

    name: str
    summary: str
    settings: Mapping[str, Any]
    reasons: Mapping[str, str]
    tried: Mapping[str, str]


_LEARNED = (
    "values within 2.5 standard deviations of those in the start (as ConfidenceConnected of ITK takes them): "
    "they differ "
    "with contrast agent, phase and dose, so they are learned"
)
_ABDOMEN = "abdominal CT, portal phase, 20 slices of 2 mm (TotalSegmentator tests; automatic reference)"
_HEAD = "CT of a head phantom, oblique, 2.4 mm slices (niivue-images)"
_BRAIN = "T1 brain at 1 mm, skull-stripped (niivue demo images; FreeSurfer)"
_OBLIQUE = "T1 brain at 1 mm, oblique, skull-stripped (nii2meshCPP; FSL FAST)"

PRESETS: Registry[Preset] = Registry(
    "preset",
    Preset(
        "ct-bone",
        "Bone in CT, calibrated in HU. Unless a start is given, it is all above 226 HU; --start largest:226, or "
        "ball:... for one bone.",
        {"start": ("threshold:226,",), "energy": "threshold:226,", "presmooth": 0.0, "smoothness": 0.2},
        {
            "start": "all above the bound of the energy",
            "energy": "226 HU is the customary lower bound of bone: soft tissue with contrast agent ends at about 150, "
            "compact bone begins at 300. Spongy bone below it is left out; metal is included",
            "presmooth": "none: thin walls are a voxel wide",
            "smoothness": "0.2 mm: removes single voxels of noise, keeps what is thicker than half a millimetre",
        },
        {
            _HEAD: "no reference; one surface of the skull, converged in 40 steps",
            _ABDOMEN: "Dice 0.49 against all bones: spongy bone is left out, the table and calcium are included",
        },
    ),
    Preset(
        "ct-vessel",
        "Vessels with contrast agent in CT: balls well inside the lumen.",
        {"energy": "threshold:half:50,learned", "presmooth": 0.5, "smoothness": 0.5},
        {
            "energy": "from half-way between soft tissue (50 HU) and the mean in the start, as lumens are measured "
            "(full width at half maximum), to 2.5 standard deviations above that mean: bone and plaque are brighter. "
            "Learned, as contrast differs with phase and dose",
            "presmooth": "0.5 mm: a fraction of what CT resolves",
            "smoothness": "0.5 mm: keeps tubes down to a radius of 0.5 mm, closes thin bridges to bone",
        },
        {
            _ABDOMEN: "aorta Dice 0.83: the lumen; the reference has wall and plaque. Otherwise phantoms",
        },
    ),
    Preset(
        "ct-organ",
        "Uniform organs in CT (liver, spleen): balls of more than 5 mm well inside, in its bright and dim parts.",
        {"energy": "threshold:learned,learned", "presmooth": 2.0, "smoothness": 2.0, "stop_at_rest": True},
        {
            "stop_at_rest": "organs touch muscle and others of the same brightness: a front that rested and breaks "
            "through has found a hole in the edge",
            "energy": _LEARNED + ". With presmooth it lies one to two millimetres within the edge to fat and lung: "
            "small organs come out small (Dice 0.75 for a ball of 15 mm radius; with --presmooth 1 it is 0.88)",
            "presmooth": "2 mm: the noise of a CT is 15 to 20 HU for a voxel, and correlated over a millimetre or two; "
            "muscle is some 30 HU from liver: means over more than that are needed to tell them apart",
            "smoothness": "2 mm: the force is at most 1, so the surface does not get through holes of a radius below "
            "twice this, about the thickness of a slice. Balls smaller than that vanish, sharper corners are rounded",
        },
        {
            _ABDOMEN: "liver from three balls Dice 0.91, spleen from one 0.90; as much with either length at 3 mm. "
            "With either at 1 mm the liver leaks (0.71), with smoothness at 1 mm the spleen too (0.32). The stomach, "
            "which is not uniform, fails (0.11). Otherwise phantoms",
        },
    ),
    Preset(
        "mr-brain",
        "Brain in T1 MR after skull stripping: a ball in it. Not for scans with skull.",
        {"energy": "chan-vese", "balance": 2.0, "epsilon": 0.0, "smoothness": 0.0},
        {
            "energy": "two means: bright tissue on a background of zeros, whatever the scanner's unit",
            "balance": "2: with exact zeros outside, two means put the boundary at half the brightness of "
            "tissue; a larger weight of the fit inside moves it to about two thirds, above fluid and remains of the "
            "stripping",
            "epsilon": "0: sulci are a voxel or two wide, a smeared interface closes them",
            "smoothness": "0: the cortex is folded",
        },
        {
            _BRAIN: "Dice 0.965 from one ball (defaults 0.948)",
            _OBLIQUE: "Dice 0.972 from the middle (defaults 0.952; a threshold 0.986, as fluid is left out there)",
        },
    ),
    Preset(
        "mr-ventricle",
        "Ventricles in T1 MR: a small ball in each, well inside.",
        {"energy": "threshold:,auto", "presmooth": 0.0, "smoothness": 0.5},
        {
            "energy": "fluid is dark in T1: all below Otsu's threshold between tissue and the dark rest, which "
            "lies about "
            "half-way; by the image, as MR has no unit",
            "presmooth": "none: horns are a few voxels wide",
            "smoothness": "0.5 mm: keeps horns of 1 mm, closes thin passages to other fluid",
        },
        {
            _BRAIN: "Dice 0.73 for the lateral ventricles: their bodies; it stops before the temporal horns, whose "
            "voxels are half tissue. Bounds learned from the start: 0.57. Otherwise a phantom",
        },
    ),
    Preset(
        "mr-cord",
        "Spinal cord in MR: small balls along it, about one every 10 mm, well inside.",
        {"energy": "likelihood:histogram,no", "presmooth": 0.0, "smoothness": 0.0, "levels": 1},
        {
            "energy": "histograms learned once from the balls and from all else: grey and white matter are two values, "
            "the fluid around has another; updated histograms leak along the fluid",
            "presmooth": "none: the cord is about 10 mm wide, in few voxels",
            "smoothness": "0: the energy is of many voxels already",
            "levels": "1: the cord has few voxels across",
        },
        {"T2 cervical cord at 1 mm (sct_testing_data; manual reference)": "Dice 0.955 from five balls"},
    ),
    Preset(
        "fluorescence-nucleus",
        "Nuclei as bright blobs in fluorescence, all as one object; voxels, as units differ between files.",
        {"start": ("otsu",), "energy": "local-region", "presmooth": "1vox"},
        {
            "start": "brighter than Otsu's threshold; --start ball:... for one nucleus",
            "energy": "means within 8 voxels: brightness differs from cell to cell and falls with depth",
            "presmooth": "1 voxel: photon noise is independent from voxel to voxel",
        },
        {
            "fluorescence, 100^3 (plant-seg tests)": "all nuclei as one object: Dice 0.71, and 7 large parts on necks",
        },
    ),
)
