"""Presets: settings for a kind of scan, each with what its values mean and the scans that it was tried on.

A preset names quantities of the object and of the modality (Hounsfield units, widths of structures, what is known of the
values around), never of a file. Where the values of a modality have no unit, models learn from the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, get_args

PresetName = Literal[
    "ct-bone", "ct-vessel", "ct-organ", "mr-brain", "mr-ventricle", "mr-cord", "fluorescence-nucleus"
]


class Preset(NamedTuple):
    """Settings for a kind of scan.

    Attributes
    ----------
    summary : str
        For what, and what it wants to be told besides.
    settings : mapping
        Values of `RunConfig` by name; those not named keep their defaults.
    reasons : mapping
        What each of these values means, by the same names.
    tried : str
        The volumes that it was tried on, by public source, and how it did.
    """

    summary: str
    settings: Mapping[str, Any]
    reasons: Mapping[str, str]
    tried: str


PRESETS: dict[str, Preset] = {
    "ct-bone": Preset(
        "Bone in CT without contrast agent, calibrated in HU.",
        {"start": ("largest:226,",), "energy": "threshold:226,", "presmooth": 0.0, "smoothness": 0.2},
        {
            "start": "the largest connected part above 226 HU; give --start ball:... for one bone among several",
            "energy": "226 HU is the usual lower bound of bone: soft tissue ends at about 100, spongy bone begins at 150, "
            "compact bone is above 300; no upper bound, metal and teeth are taken in",
            "presmooth": "none: lamellae are as thin as a voxel",
            "smoothness": "0.2 mm: takes single voxels of noise, keeps what is thicker than about half a millimetre",
        },
        "",
    ),
}
assert set(PRESETS) <= set(get_args(PresetName))
