"""Flow, stop rule, band and the user's own energy of a configuration."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import CheckedEnergy
from accelsurf.errors import UsageError
from accelsurf.evolution.convergence import StopRule
from accelsurf.flows import Flow
from accelsurf.settings import energy_expression
from accelsurf.settings.catalogue import default_of, energy_settings
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.registry import load
from accelsurf.settings.run_config import RunConfig

#: Motion in the steps to come, by the trend, that a converged surface may still make, as a share of the tolerance: the
#: trend tells it too low by up to this.
FURTHER = 0.7
#: Flows whose surface moves slowly also where it has not converged, and the share of the tolerance that it then moves.
SHORT_STEPS, SLOW = ("flowable-mass", "region-mass", "sobolev"), 0.4
#: A correction has converged when so many steps have found no lower energy: an oscillation from step to step finds it
#: in two.
PATIENCE = 3


def stop_rule(config: RunConfig, levels: int) -> StopRule:
    """When a run on so many levels has converged on the finest one.

    After a coarser level, and where objects part the space between them, whose start has the boundaries of the model,
    the run begins near its end and is checked more often. The window has an even number of
    steps, so that an oscillation from step to step cancels. The waves of flowable-mass and region-mass keep their steps
    short, and the Sobolev gradient is small where forces are uneven: there a slow surface has not converged yet.
    """
    further = FURTHER * config.tolerance
    slow = SLOW * config.tolerance
    if levels == 1 and not energy_expression.parts_space(config.energy):
        waves = config.flow in ("flowable-mass", "region-mass")
        return StopRule(motion=slow if waves else config.tolerance, further=further)
    if config.flow in SHORT_STEPS:
        return StopRule(10, slow, further=further)
    return StopRule(6, config.tolerance, further=further)


def correction_rule(config: RunConfig) -> StopRule:
    """When a correction has converged: it begins near its end, as a run does after a coarser level."""
    rule = stop_rule(config, 2)
    return rule if config.flow in SHORT_STEPS else rule._replace(patience=PATIENCE)


def half_width(config: RunConfig) -> float:
    """Half width of the band in voxels; ``auto`` is the one that the flow needs."""
    if config.half_width == "auto":
        return float(FLOWS[config.flow].half_width)
    return float(config.half_width)


def own_energy(
    energy: Any, config: RunConfig, image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> CheckedEnergy:
    """An energy of the user's own, made of image and spacing if a class or function is given, with checks.

    Raises
    ------
    UsageError
        When it is incomplete, or a setting was given that it would ignore.
    """
    for key in energy_settings():
        if getattr(config, key) != default_of(key):
            raise UsageError(
                f"{key}: {getattr(config, key)} was given, but the energy is one of your own and would ignore it",
                "give it to the energy itself",
            )
    return CheckedEnergy(energy(image, spacing) if is_maker(energy) else energy)


def is_maker(energy: Any) -> bool:
    """Whether an energy of the user's own is a class or function that makes it of ``(image, spacing)``."""
    return isinstance(energy, type) or (callable(energy) and not hasattr(energy, "force"))


def make_flow(config: RunConfig) -> Flow:
    """The flow of a configuration."""
    flow: Flow = load(FLOWS[config.flow].make)(config)
    return flow
