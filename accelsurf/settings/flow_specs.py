"""The flows: one entry each, with the settings that it uses and the function that makes it of a configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from accelsurf.settings.registry import Registry


@dataclass(frozen=True)
class FlowSpec:
    """The entry of a flow.

    Attributes
    ----------
    name : str
        As it is given to ``--flow``.
    help : str
        What it is, in a few words.
    make : str or callable
        ``"module:function"`` or a function: of a RunConfig, returns the `accelsurf.flows.Flow`. It is imported when
        a run begins.
    uses : tuple of str
        Settings of the run that act on it, besides those of all flows.
    half_width : int
        Half width of the narrow band that it needs, in voxels.
    voxel_bytes : int
        Memory that it takes for each voxel, beside what every run takes.
    """

    name: str
    help: str
    make: str | Callable[[Any], Any]
    uses: tuple[str, ...] = ()
    half_width: int = 3
    voxel_bytes: int = 0


#: The flow is chosen when the image is known, of the next two (`accelsurf.run.setup`).
AUTO, MOMENTUM, DESCENT = "auto", "constant-density", "gradient"
_WITH_MOMENTUM = (
    "k",
    "t0",
    "lam",
    "rho",
    "friction",
    "noise",
    "noise_length",
    "noise_time",
    "diffusion",
)
_MAKERS = "accelsurf.run.makers"

FLOWS: Registry[FlowSpec] = Registry(
    "flow",
    FlowSpec(
        MOMENTUM,
        "momentum of a constant mass per area",
        f"{_MAKERS}:constant_density",
        _WITH_MOMENTUM,
    ),
    FlowSpec(
        "flowable-mass",
        "momentum with mass that flows along the surface",
        f"{_MAKERS}:flowable_mass",
        (*_WITH_MOMENTUM, "gravity"),
        # The mass is transported along the surface by cubic interpolation, which needs a wider band.
        half_width=4,
    ),
    FlowSpec(
        "region-mass",
        "momentum of mass on the whole grid",
        f"{_MAKERS}:region_mass",
        ("k", "t0", "lam", "rho", "friction", "gravity"),
        # The surface moves with means over a layer to either side of it; mass and momentum are on the grid.
        half_width=4,
        voxel_bytes=64,
    ),
    FlowSpec(DESCENT, "descent, the plain baseline", f"{_MAKERS}:gradient", ("diffusion",)),
    FlowSpec(
        "sobolev", "descent along the smoothed gradient", f"{_MAKERS}:sobolev", ("sobolev_length",)
    ),
    FlowSpec(
        "momentum",
        "descent that adds a fraction of the last step (Andersson et al. 2013)",
        f"{_MAKERS}:heavy_ball",
        ("blend",),
    ),
)


def spec_of(name: str) -> FlowSpec:
    """The entry of a flow; before `AUTO` is resolved, that of momentum, which needs all that descent does."""
    return FLOWS[MOMENTUM if name == AUTO else name]


def flow_names() -> dict[str, str]:
    """The names that a run takes, with their meaning."""
    meaning = "momentum or descent, by the noise of the image and the energy; the report says which and why"
    return {AUTO: meaning} | {name: flow.help for name, flow in FLOWS.items()}
