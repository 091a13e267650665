"""The stages of a step, for ``--profile``: each kernel that the package calls names its own."""

from __future__ import annotations

from enum import Enum


class Stage(Enum):
    """What a kernel is a part of, in the order of a step; the values are as people read them."""

    CLOSEST_POINTS = "closest points"
    BAND = "band"
    EXTENSION = "extension"
    ADVANCE = "advance"
    ENERGY = "energy and force"
    FLOW = "flow"
    DIFFUSION = "diffusion"


#: Stage by name of a kernel: filled by `accelsurf.kernels._jit.kernel` as the kernels are defined, and by nothing else.
STAGE_OF_KERNEL: dict[str, Stage] = {}
