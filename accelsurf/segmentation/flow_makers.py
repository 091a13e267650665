"""Makers of each flow from a configuration; `accelsurf.settings.flow_specs` names these functions."""

from __future__ import annotations

from typing import Any

from accelsurf.flows import (
    ConstantDensity,
    Flow,
    FlowableMass,
    Gradient,
    HeavyBall,
    Noise,
    RegionMass,
    RegionPressure,
    Sobolev,
)
from accelsurf.settings import energy_expression
from accelsurf.settings.run_config import RunConfig


def constant_density(config: RunConfig) -> Flow:
    """Momentum of a surface of constant density."""
    return ConstantDensity(**_heavy_ball(config))


def flowable_mass(config: RunConfig) -> Flow:
    """Momentum of a surface whose mass is conserved and flows along it."""
    terms = energy_expression.parse(config.energy)
    area_weight = config.smoothness + sum(term.weight for term in terms if term.name == "area")
    return FlowableMass(config.gravity, area_weight, **_heavy_ball(config))


def region_mass(config: RunConfig) -> Flow:
    """Momentum of mass on the whole grid, or with gravity inside the surface."""
    if config.gravity > 0:
        return RegionPressure(config.gravity, **_clock(config))
    return RegionMass(**_clock(config))


def gradient(config: RunConfig) -> Flow:
    """Descent. With diffusion ``auto`` it has no diffusion: it is the plain baseline."""
    return Gradient(0.0 if config.diffusion == "auto" else _number(config.diffusion))


def sobolev(config: RunConfig) -> Flow:
    """Descent along the smoothed force."""
    return Sobolev(_number(config.sobolev_length))


def heavy_ball(config: RunConfig) -> Flow:
    """Descent that adds a fraction of the last step."""
    return HeavyBall(config.blend)


def _heavy_ball(config: RunConfig) -> dict[str, Any]:
    """Arguments of both flows with momentum of the surface."""
    return {**_clock(config), "diffusion": _number(config.diffusion), "noise": _noise(config)}


def _clock(config: RunConfig) -> dict[str, Any]:
    """Arguments of all flows with momentum."""
    return {
        "k": config.k,
        "lambda_": config.lam,
        "rho": config.rho,
        "friction": _number(config.friction),
        "t0": _number(config.t0),
    }


def _noise(config: RunConfig) -> Noise | None:
    if config.noise == 0:
        return None
    if config.seed is None:
        raise ValueError("noise needs a seed: accelsurf.segmentation.run.seeded draws one")
    return Noise(config.noise, _number(config.noise_length), config.seed, _number(config.noise_time))


def _number(value: float | str) -> float | None:
    """A setting that is a number or a word: None for the word."""
    return None if isinstance(value, str) else value
