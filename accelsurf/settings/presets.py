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


_BY_CLICKS: Mapping[str, Any] = {"energy": "seeded", "start": ("clicks",)}
_WHY_CLICKS: Mapping[str, str] = {
    "energy": "what is nearer to the clicks inside, by brightness and edges, than to those outside and to the "
    "surroundings",
    "start": "where the model of the clicks says so",
}
_TUNING = "public scans, tuning half of the click benchmark, clicks at the deepest point"
_ABDOMEN = "abdominal CT, portal phase, 20 slices of 2 mm (TotalSegmentator tests; automatic reference)"
_HEAD = "CT of a head phantom, oblique, 2.4 mm slices (niivue-images)"
_BRAIN = "T1 brain at 1 mm, skull-stripped (niivue demo images; FreeSurfer)"
_OBLIQUE = "T1 brain at 1 mm, oblique, skull-stripped (nii2meshCPP; FSL FAST)"

PRESETS: Registry[Preset] = Registry(
    "preset",
    Preset(
        "ct-bone",
        "One bone in CT, calibrated in HU: --inside in its marrow or shell, --outside where it goes on into another.",
        {**_BY_CLICKS, "closing": 6.0, "clip": ",250"},
        {
            **_WHY_CLICKS,
            "closing": "6 mm: marrow and spongy bone up to 12 mm wide between two shells become as bright as these, so "
            "that shell and marrow are one tissue to the model of the clicks",
            "clip": "250 HU: above it bone is bone, however dense. The surface lies half way to soft tissue, at about "
            "150 HU, where soft tissue with contrast agent ends",
        },
        {
            _ABDOMEN: "one click at the deepest point: humeri Dice 0.92 and 0.89, nine ribs 0.65 to 0.86; vertebrae, "
            "which touch the next ones and ribs, fail (0.27 and 0.56). 5 of 13 below 0.8, of the eight that length and "
            "bound were not chosen on 3. Energy seeded alone: humeri 0.53 and 0.70, three ribs 0.26 to 0.34. Two "
            "clicks: humeri and ribs 0.71 to 0.92, three 0.78 to 0.92",
            "a shell around marrow (phantom)": "1 click: Dice 0.81, 0 of 3 failed; 3 clicks: 0.91",
        },
    ),
    Preset(
        "ct-skeleton",
        "All bone in CT, calibrated in HU, as one object: what is above 226 HU, unless a start is given; --start "
        "largest:226, for the largest part of it.",
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
        "Vessels with contrast agent in CT: --inside or balls well inside the lumen.",
        {"energy": "threshold:half:50,learned", "presmooth": 0.5, "smoothness": 0.5},
        {
            "energy": "from half-way between soft tissue (50 HU) and the mean in the start, as lumens are measured "
            "(full width at half maximum), to 2.5 standard deviations above that mean: bone and plaque are brighter. "
            "Learned, as contrast differs with phase and dose",
            "presmooth": "0.5 mm: a fraction of what CT resolves",
            "smoothness": "0.5 mm: keeps tubes down to a radius of 0.5 mm, closes thin bridges to bone",
        },
        {
            _ABDOMEN: "aorta Dice 0.82: the lumen; the reference has wall and plaque. The vena cava, as bright as the "
            "organs around it, fails (0.03 after any number of clicks); without a preset 0.58, and 0.84 after two. "
            "1 of 2 failed. Otherwise phantoms",
        },
    ),
    Preset(
        "ct-organ",
        "Organs in CT, one at a time: --inside in it, and --outside where it goes too far.",
        _BY_CLICKS,
        _WHY_CLICKS,
        {
            _TUNING: "one click: spleen Dice 0.86; the stomach, which is not uniform, fails (0.54); three "
            "clicks: 0.89, 0.82. 1 of 2 failed",
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
            _BRAIN: "Dice 0.97 from one ball (defaults 0.95)",
            _OBLIQUE: "Dice 0.98 from the middle (defaults 0.95; a threshold 0.986, as fluid is left out there). "
            "0 of 2 failed",
        },
    ),
    Preset(
        "mr-vessel",
        "Bright vessels in MR angiography: --inside well in the lumen, more of them along thin branches.",
        {"energy": "threshold:learned,", "start": ("clicks",), "presmooth": 0.5, "smoothness": 0.2},
        {
            "energy": "all above 2.5 standard deviations below the mean in the clicks: MR has no unit, and flow makes "
            "parts of a lumen brighter than the click",
            "start": "the clicks",
            "presmooth": "0.5 mm: at 1 mm thin branches are lost",
            "smoothness": "0.2 mm: keeps tubes down to a radius of a voxel",
        },
        {
            "branching vessel in noise (phantom, three seeds)": "1 click: Dice 0.83, 0.34, 0.46, 2 of 3 failed: "
            "branches are missing; 3 clicks: 0.84, 0.78, 0.64. No scan yet",
        },
    ),
    Preset(
        "mr-white-matter",
        "White matter in T1 MR after skull stripping: --inside in it, in each half.",
        {
            "energy": "threshold:learned,learned + 2*local-region:R=15", "presmooth": 0.0, "smoothness": 0.0,
            "levels": 1,
        },
        {
            "energy": "values near those in the clicks, and brighter than the mean within 15 voxels: the coil makes "
            "one side brighter than the other",
            "presmooth": "none: gyri are a few voxels wide",
            "smoothness": "0: white matter is folded",
            "levels": "1: gyri are gone on a coarser grid",
        },
        {
            "T1 brain, oblique (nii2meshCPP; FSL FAST)": "1 click: Dice 0.59, 1 of 1 failed; 3 clicks: 0.77 (energy "
            "seeded 0.10 and 0.23). With bounds chosen by hand in place of learned ones 0.93 from two balls",
        },
    ),
    Preset(
        "mr-nuclei",
        "Deep grey nuclei, cerebellum, brain stem in MR, one at a time: --inside in it, --outside beyond its edges.",
        _BY_CLICKS,
        _WHY_CLICKS,
        {
            _TUNING: "one click without --size: thalamus 0.74, caudate 0.69, pallidum 0.66, putamen 0.57, 4 of 4 below "
            "0.8 (grey matter beside them is as bright and connected); three clicks: 0.78, 0.81, 0.79, 0.89. Give "
            "--size, and --outside",
        },
    ),
    Preset(
        "mr-ventricle",
        "Ventricles in T1 MR: --inside or a small ball in each, well inside.",
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
            "voxels are half tissue. Bounds learned from the start: 0.57. One of them from one click 0.71, from two "
            "0.85; the third ventricle 0.00, as fluid around it is as dark and connected: 2 of 2 failed at the first "
            "click",
        },
    ),
    Preset(
        "tumour",
        "A mass in any scan, of one brightness or with a rim: --inside in it.",
        _BY_CLICKS,
        _WHY_CLICKS,
        {"a lobed mass with a bright rim (phantom, three seeds)": "1 click: Dice 0.99, 0 of 3 failed. No scan with a "
            "reference yet"},
    ),
    Preset(
        "membrane-cells",
        "Touching cells between membranes, all at once: --objects with a table of clicks, one in each cell.",
        {"energy": "partition:0", "presmooth": "1vox", "smoothness": 0.0, "levels": 1},
        {
            "energy": "each voxel is nearest to one click, where membranes are far: neighbours look alike, and "
            "only what lies between them tells them apart. Without a weight of the area, which opens gaps where "
            "three meet",
            "presmooth": "1 voxel: noise makes holes in membranes",
            "smoothness": "0: corners where three cells meet are sharp",
            "levels": "1: membranes are gone on a coarser grid",
        },
        {
            "12 cells in noise, membranes of 2.4 voxels (phantom)": "mean Dice 0.977 (with the default area 0.961, "
            "energy seeded 0.52; a watershed at its best blur 0.980). No scan yet",
        },
    ),
    Preset(
        "em-cell",
        "A cell or an organelle in electron microscopy: --inside in it, --outside beyond weak membranes.",
        _BY_CLICKS,
        _WHY_CLICKS,
        {"a cell with organelles in a membrane (phantom, three seeds)": "1 click: Dice 0.87, 0 of 3 failed; 3 clicks: "
            "0.90. No scan with a reference yet"},
    ),
    Preset(
        "nuclei",
        "Nuclei in fluorescence, one at a time: --inside in it; with --objects all at once.",
        {**_BY_CLICKS, "presmooth": "1vox"},
        {**_WHY_CLICKS, "presmooth": "1 voxel: photon noise is independent from voxel to voxel"},
        {
            _TUNING: "one click: Dice 0.82, 0.87, 0.80, 0 of 3 failed; three clicks: 0.87, 0.91, 0.85 (without "
            "presmooth 0.83, 0.90, 0.84 and 0.91, 0.92, 0.89)",
        },
    ),
    Preset(
        "mr-cord",
        "Spinal cord in MR: --inside in it, or small balls along it, about one every 10 mm, well inside.",
        {"energy": "likelihood:histogram,no", "presmooth": 0.0, "smoothness": 0.0, "levels": 1},
        {
            "energy": "histograms learned once from the balls and from all else: grey and white matter are two values, "
            "the fluid around has another; updated histograms leak along the fluid",
            "presmooth": "none: the cord is about 10 mm wide, in few voxels",
            "smoothness": "0: the energy is of many voxels already",
            "levels": "1: the cord has few voxels across",
        },
        {"T2 cervical cord at 1 mm (sct_testing_data; manual reference)": "Dice 0.956 from five balls, 0.973 from one "
            "click at its deepest point (energy seeded 0.86)"},
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
