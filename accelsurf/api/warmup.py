"""Every kernel compiled and stored before it is needed: small runs that use all flows, terms and kinds of start.

A kernel is compiled for the types of its arguments. Those do not depend on the size of an image, so runs of a few
thousand voxels compile the kernels of large ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from accelsurf.api.segment import segment, segment_objects
from accelsurf.image.blocks import block_means
from accelsurf.image.percentiles import IntegerCounts
from accelsurf.image.volume import Volume
from accelsurf.interact import refine
from accelsurf.run import Result
from accelsurf.settings.energy_terms import image_terms
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig

#: Voxels along each axis of the images, the radius of the balls in them, and of where the surface starts (voxels).
SIDE = 24
RADIUS = 8.0
START = 5.0
#: Steps of each run: restarts, limits and plateaus are met within them.
STEPS = 12
MIDDLE = ",".join([f"{SIDE / 2:g}"] * 3)
#: Terms that want bounds, and those that want clicks.
_AS_GIVEN = {"threshold": "threshold:auto"}
_CLICKED = ("seeded", "partition")


def small_segmentations() -> dict[str, Callable[[], Any]]:
    """Runs by name, that together call every kernel; each computes its measures, its mesh and its quality too."""
    return {
        **{
            f"flow {flow}": _run(
                flow=f"{flow}:gravity=0.05" if "gravity" in spec.settings else flow
            )
            for flow, spec in FLOWS.items()
        },
        "mass on the whole grid": _run(flow="region-mass"),
        **{
            f"energy {term}": _run(energy=_AS_GIVEN.get(term, term))
            for term in image_terms()
            if term not in _CLICKED
        },
        "likelihood by histogram": _run(energy="likelihood:model=histogram"),
        "area": _run(energy="chan-vese + 0.1*area", smoothness=0.3, presmooth=1.0, closing="1vox"),
        "noise": _run(noise=0.2, seed=1, diffusion=0.5),
        "fast marching": _run(extension="fast-marching"),
        "levels": _run(levels=2, start="otsu"),
        "seed": _run(start=f"seed:{MIDDLE},{START}vox"),
        "edit": _run(edit=["step=3 half_width=5", "step=6 flow=gradient"]),
        "one slice": _run(image=_flat(), start=f"ball:{SIDE / 2},{SIDE / 2},0,{START}vox"),
        "clicks": _corrected,
        "partition": _run(
            energy="partition",
            start="clicks",
            inside=f"ball:{MIDDLE},3vox",
            outside="ball:2,2,2,2vox",
        ),
        "objects": _several,
        # Of boxes with many voxels, which no small run has.
        "coarse boxes": lambda: block_means(np.zeros((4, 4, 4), np.float32), (2, 2, 2)),
        "counts of integers": _counted,
    }


def ball() -> Volume:
    """A ball in noise."""
    z, y, x = np.indices((SIDE, SIDE, SIDE)) - SIDE / 2
    noise = np.random.default_rng(0).normal(0.0, 0.2, (SIDE, SIDE, SIDE))
    return Volume.from_array(
        (noise + (z**2 + y**2 + x**2 < RADIUS**2)).astype(np.float32), (1.5, 1.0, 1.0)
    )


def _flat() -> Volume:
    """Its middle slice."""
    return Volume.from_array(ball().array[SIDE // 2 : SIDE // 2 + 1], 1.0)


def _measured(result: Result) -> Result:
    """Compute the outputs of a command."""
    for segmented in result.objects:
        if segmented.has_surface:
            _ = (
                segmented.quality,
                segmented.contours if result.geometry.slice_axis is not None else segmented.surface,
            )
    return result


def _run(image: Volume | None = None, **settings: Any) -> Callable[[], Any]:
    given = {"start": f"ball:{MIDDLE},{START}vox", "max_steps": STEPS, "levels": 1, **settings}
    return lambda: _measured(segment(ball() if image is None else image, config=RunConfig(**given)))


def _corrected() -> Any:
    """A run from a click, and two corrections of it."""
    image = ball()
    found = _measured(segment(image, inside=f"point:{MIDDLE}vox", max_steps=STEPS))
    found = _measured(
        refine(found, outside=f"point:{SIDE / 2},{SIDE / 2},{SIDE / 2 + RADIUS - 1}vox")
    )
    return refine(found, inside=f"point:{SIDE / 2},{SIDE / 2 + RADIUS},{SIDE / 2}vox")


def _counted() -> None:
    """Values of images of integers that are read in parts."""
    for kind in ("uint8", "int8", "uint16", "int16"):
        IntegerCounts(np.dtype(kind)).add(np.zeros(4, kind))


def _several() -> Any:
    """Two objects that touch."""
    image = ball()
    starts = np.zeros(image.array.shape, np.int32)
    middle = SIDE // 2
    for id, begin in ((1, middle - 6), (2, middle + 2)):
        starts[middle - 3 : middle + 3, middle - 3 : middle + 3, begin : begin + 4] = id
    return _measured(segment_objects(image, starts, max_steps=STEPS))
