"""Which energy and which flow a configuration means."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import CheckedEnergy
from accelsurf.errors import UsageError
from accelsurf.evolution.convergence import StopRule
from accelsurf.flows import Flow
from accelsurf.settings.catalogue import default_of, energy_settings
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.registry import load
from accelsurf.settings.run_config import RunConfig


def stop_rule(config: RunConfig, levels: int) -> StopRule:
    """When a run on so many levels has converged on the finest one.

    After a coarser level the run begins near its end and is checked more often. The window has an even number of
    steps: what oscillates from step to step is then where it was. The waves of flowable-mass keep its steps short, and
    the Sobolev gradient is small where forces are uneven: there a slow surface has not converged yet.
    """
    if levels == 1:
        return StopRule(motion=config.tolerance)
    if config.flow in ("flowable-mass", "sobolev"):
        return StopRule(10, 0.4 * config.tolerance)
    return StopRule(6, config.tolerance)


def half_width(config: RunConfig) -> float:
    """Half width of the band in voxels: ``auto`` is what the flow needs."""
    if config.half_width == "auto":
        return float(FLOWS[config.flow].half_width)
    return float(config.half_width)


def own_energy(
    energy: Any, config: RunConfig, image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> CheckedEnergy:
    """An energy that has no name, made of image and spacing if it is not made yet, and checked.

    Raises
    ------
    UsageError
        When it lacks something, or a setting was changed that it would not see.
    """
    for key in energy_settings():
        if getattr(config, key) != default_of(key):
            raise UsageError(
                f"{key}: {getattr(config, key)} was given, but the energy is one of your own and would not see it",
                "give it to the energy itself",
            )
    return CheckedEnergy(energy(image, spacing) if is_maker(energy) else energy)


def is_maker(energy: Any) -> bool:
    """Whether an energy of one's own is a class or function that makes it of ``(image, spacing)``."""
    return isinstance(energy, type) or (callable(energy) and not hasattr(energy, "force"))


def make_flow(config: RunConfig) -> Flow:
    """The flow that a configuration asks for."""
    flow: Flow = load(FLOWS[config.flow].make)(config)
    return flow
