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


_MOMENTUM = ("k", "t0", "lam", "rho", "friction", "noise", "noise_length", "noise_time", "diffusion")
_MAKERS = "accelsurf.run.makers"

FLOWS: Registry[FlowSpec] = Registry(
    "flow",
    FlowSpec("constant-density", "momentum, the default", f"{_MAKERS}:constant_density", _MOMENTUM),
    FlowSpec(
        "flowable-mass",
        "momentum with mass that flows along the surface",
        f"{_MAKERS}:flowable_mass",
        (*_MOMENTUM, "gravity"),
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
    FlowSpec("gradient", "descent, the plain baseline", f"{_MAKERS}:gradient", ("diffusion",)),
    FlowSpec("sobolev", "descent along the smoothed gradient", f"{_MAKERS}:sobolev", ("sobolev_length",)),
    FlowSpec(
        "momentum",
        "descent that adds a fraction of the last step (Andersson et al. 2013)",
        f"{_MAKERS}:heavy_ball",
        ("blend",),
    ),
)
