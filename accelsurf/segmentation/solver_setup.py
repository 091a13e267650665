"""Which energy and which flow a configuration means."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import CheckedEnergy
from accelsurf.errors import UsageError
from accelsurf.evolution.convergence import StopRule
from accelsurf.flows import ConstantDensity, Flow, FlowableMass, Gradient, HeavyBall, Noise, Sobolev
from accelsurf.segmentation.energy_assembly import area_weight, make_energy
from accelsurf.settings.run_config import RunConfig

__all__ = ["ENERGY_SETTINGS", "half_width", "is_maker", "make_energy", "make_flow", "own_energy", "stop_rule"]

#: Settings of the energies that have a name; an energy of one's own has its own.
ENERGY_SETTINGS = (
    "smoothness", "balance", "epsilon", "edge_scale", "edge_contrast", "balloon", "foreground", "background",
)


def stop_rule(config: RunConfig, levels: int) -> StopRule:
    """When a run on so many levels has converged on the finest one.

    After a coarser level it begins near its end and is looked at more often. Over an even number of steps: what
    flickers from step to step is where it was. Steps of flowable-mass are kept short by its waves, and the Sobolev
    gradient is small where forces are uneven: a slow surface is not at its end yet.
    """
    if levels == 1:
        return StopRule(motion=config.tolerance)
    if config.flow in ("flowable-mass", "sobolev"):
        return StopRule(10, 0.4 * config.tolerance)
    return StopRule(6, config.tolerance)


def half_width(config: RunConfig) -> float:
    """Half width of the band in voxels: ``auto`` is what the flow needs.

    The mass of flowable-mass is carried along the surface by cubic interpolation, which reaches further.
    """
    if config.half_width == "auto":
        return 4.0 if config.flow == "flowable-mass" else 3.0
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
    for key in ENERGY_SETTINGS:
        if getattr(config, key) != RunConfig.model_fields[key].default:
            raise UsageError(
                f"{key}: {getattr(config, key)} was given, but the energy is one of your own and would not see it",
                "give it to the energy itself",
            )
    return CheckedEnergy(energy(image, spacing) if is_maker(energy) else energy)


def is_maker(energy: Any) -> bool:
    """Whether an energy of one's own is a class or function that makes it of ``(image, spacing)``."""
    return isinstance(energy, type) or (callable(energy) and not hasattr(energy, "force"))


def make_flow(config: RunConfig) -> Flow:
    """The flow that a configuration asks for.

    With diffusion ``auto`` momentum gets its mixing-length diffusion and descent none: it is the plain baseline.
    """
    return FLOWS[config.flow](config)


def _gradient(config: RunConfig) -> Flow:
    diffusion = 0.0 if config.diffusion == "auto" else _number(config.diffusion)
    return Gradient(diffusion)


def _common(config: RunConfig) -> dict[str, Any]:
    noise = None
    if config.noise > 0:
        assert config.seed is not None
        noise = Noise(config.noise, _number(config.noise_length), config.seed, _number(config.noise_time))
    return {
        "k": config.k,
        "lambda_": config.lam,
        "rho": config.rho,
        "friction": _number(config.friction),
        "diffusion": _number(config.diffusion),
        "t0": _number(config.t0),
        "noise": noise,
    }


def _number(value: float | str) -> float | None:
    """A setting that is a number or a word: None for the word."""
    return None if isinstance(value, str) else value


#: How to make each flow from a configuration.
FLOWS: dict[str, Callable[[RunConfig], Flow]] = {
    "constant-density": lambda config: ConstantDensity(**_common(config)),
    "flowable-mass": lambda config: FlowableMass(config.gravity, area_weight(config), **_common(config)),
    "gradient": _gradient,
    "sobolev": lambda config: Sobolev(_number(config.sobolev_length)),
    "momentum": lambda config: HeavyBall(config.blend),
}
