"""Makers of flows from a configuration, and of energies from the terms of an expression.

A maker of a term returns the energy and the settings that it has in the run, also those that were taken from the image;
image values in the file's unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from accelsurf.energies import (
    TENT,
    Area,
    Balloon,
    ChanVese,
    Energy,
    GaussianLikelihood,
    Geodesic,
    HistogramLikelihood,
    LocalRegion,
    Parzen,
    RegionField,
    RegionMoments,
    Threshold,
    TwoGaussians,
    TwoHistograms,
    edge_indicator,
    gaussian_of_sums,
    least_variance,
    moments_of,
    robust_gaussian_of,
    soft_edge,
)
from accelsurf.energies import edge_contrast as strong_edge
from accelsurf.errors import UsageError
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
from accelsurf.grid.geometry import axis_steps
from accelsurf.image.noise import area_for_noise, noise_of
from accelsurf.image.smoothing import gradient_magnitude
from accelsurf.run.image_context import TermInputs
from accelsurf.settings import budgets
from accelsurf.settings.expression import Values
from accelsurf.settings.run_config import RunConfig

#: R of local-region unless given, voxels of the largest spacing.
_WINDOW_VOXELS = 8.0
Made = tuple[Energy, dict[str, Any]]


def constant_density(config: RunConfig) -> Flow:
    """Momentum of a surface of constant density."""
    return ConstantDensity(**_heavy_ball(config))


def flowable_mass(config: RunConfig) -> Flow:
    """Momentum of a surface whose mass is conserved and flows along it."""
    area_weight = config.smoothness + sum(
        term.weight for term in config.terms if term.name == "area"
    )
    return FlowableMass(_gravity(config), area_weight, **_heavy_ball(config))


def region_mass(config: RunConfig) -> Flow:
    """Momentum of mass on the whole grid, or with gravity inside the surface."""
    gravity = _gravity(config)
    return (
        RegionPressure(gravity, **_clock(config)) if gravity > 0 else RegionMass(**_clock(config))
    )


def gradient(config: RunConfig) -> Flow:
    """Descent. With diffusion ``auto`` it has no diffusion: it is the plain baseline."""
    return Gradient(0.0 if config.diffusion == "auto" else _number(config.diffusion))


def sobolev(config: RunConfig) -> Flow:
    """Descent along the smoothed force."""
    return Sobolev(**config.flow.numbers)


def heavy_ball(config: RunConfig) -> Flow:
    """Descent that adds a fraction of the last step."""
    return HeavyBall(**config.flow.numbers)


def _heavy_ball(config: RunConfig) -> dict[str, Any]:
    """Arguments of both flows with momentum of the surface."""
    return {**_clock(config), "diffusion": _number(config.diffusion), "noise": _noise(config)}


def _clock(config: RunConfig) -> dict[str, Any]:
    """Arguments of all flows with momentum."""
    given = config.flow.numbers
    names = {"k": "k", "t0": "t0", "lam": "lambda_", "rho": "rho"}
    clock = {names[key]: value for key, value in given.items() if key in names}
    return {"friction": _number(config.friction), **clock}


def _gravity(config: RunConfig) -> float:
    return config.flow.numbers.get("gravity", 0.0)


def _noise(config: RunConfig) -> Noise | None:
    if config.noise == 0:
        return None
    if config.seed is None:
        raise ValueError("noise needs a seed: accelsurf.run.setup.seeded draws one")
    given = config.flow.numbers
    return Noise(config.noise, given.get("noise_length"), config.seed, given.get("noise_time"))


def _number(value: float | str) -> float | None:
    """A setting that is a number or a word: None for the word."""
    return None if isinstance(value, str) else value


def chan_vese(inputs: TermInputs) -> Made:
    """Two regions, each with its own mean."""
    balance = inputs.number("balance", inputs.config.balance)
    epsilon = inputs.number("epsilon", inputs.config.epsilon)
    context, channel = inputs.context, inputs.channel
    elsewhere = context.moments_elsewhere(channel)
    by_noise = area_for_noise(
        context.once(noise_of, channel), context.images[channel].shape, context.spacing
    )
    area = inputs.number("area", by_noise)
    energy = ChanVese(
        inputs.image,
        inputs.alpha + area,
        None,
        epsilon,
        balance,
        elsewhere,
        _moments_of_whole(inputs),
    )
    return energy, {"balance": balance, "epsilon": epsilon, "area": area}


def _moments_of_whole(inputs: TermInputs) -> RegionMoments | None:
    """Sums over the whole image where the one at hand is a window of it."""
    sums = inputs.context.whole_sums(inputs.channel, inputs.spacing, "moments", moments_of)
    return None if sums is None else RegionMoments(*(float(v) for v in sums))


def local_region(inputs: TermInputs) -> Made:
    """Two regions, each with its mean in a window."""
    context = inputs.context
    # Of the image's own grid, on every level.
    radius = inputs.number(
        "R", _WINDOW_VOXELS * max(axis_steps(context.images[0].shape, context.spacing))
    )
    epsilon = inputs.number("epsilon", inputs.config.epsilon)
    return LocalRegion(inputs.image, radius, inputs.alpha, epsilon), {
        "R": radius,
        "epsilon": epsilon,
    }


def local_region_reach(settings: Values, largest_spacing: float) -> float:
    """Return the reach of the windows of local-region beyond an object, mm.

    An object cuts windows whose middle is half a width away, and these reach half a width further.
    """
    return 2.0 * TENT * float(settings.get("R", _WINDOW_VOXELS * largest_spacing))


def likelihood(inputs: TermInputs) -> Made:
    """Two regions by their distributions.

    Raises
    ------
    UsageError
        When training voxels are given that it would not use.
    """
    image = inputs.image
    context = inputs.context
    channel = inputs.channel
    given = bool(inputs.config.foreground or inputs.config.background)
    update = inputs.settings.get("update", "no" if given else "yes")
    if update == "yes" and given:
        raise UsageError(
            "energy: likelihood:update=yes was given with --foreground or --background, which it would not use",
            "with update=no it learns from them once; with update=yes from the surface, again in each step",
        )
    # Sharp unless given: a smeared interface mixes in values from across the edge, and under a narrow distribution
    # these are so unlikely that they push the surface away from the edge.
    model, epsilon = inputs.settings.get("model", "gauss"), inputs.number("epsilon", 0.0)
    used: dict[str, Any] = {"model": model, "update": update, "epsilon": epsilon}
    if model == "histogram":
        parzen = context.once(Parzen.of_image, channel)
        learned = None
        if update == "no":
            counts = parzen.histogram(context.sample(channel))
            learned = TwoHistograms(
                counts, context.sums_of_background(channel, "histogram", parzen.histogram)
            )
        elsewhere = context.histograms_elsewhere(channel, parzen)
        whole = context.whole_sums(channel, inputs.spacing, "histogram", parzen.histogram)
        return HistogramLikelihood(
            image, inputs.alpha, learned, epsilon, parzen, elsewhere, whole
        ), used
    least = context.once(least_variance, channel)
    of_whole = _moments_of_whole(inputs)
    if update == "yes":
        moments = context.moments_elsewhere(channel)
        return GaussianLikelihood(
            image, inputs.alpha, None, epsilon, moments, of_whole, least
        ), used
    # Outliers of a sample of the object are no part of it; the background is of many kinds, which all count.
    inside = robust_gaussian_of(context.sample(channel), least)
    other = gaussian_of_sums(
        RegionMoments(*context.sums_of_background(channel, "moments", moments_of)), least
    )
    low, width = context.scales[channel]
    for name, (mean, variance) in (("inside", inside), ("outside", other)):
        used[name] = {"mean": low + width * mean, "deviation": width * variance**0.5}
    return GaussianLikelihood(
        image, inputs.alpha, TwoGaussians(inside, other), epsilon, whole=of_whole
    ), used


def threshold(inputs: TermInputs) -> Made:
    """A window of values."""
    context, channel = inputs.context, inputs.channel
    low, high = (
        context.bound(channel, inputs.settings.get(key, ""), key == "HI") for key in ("LO", "HI")
    )
    start, width = context.scales[channel]
    given = inputs.settings.get("soft")
    soft = (
        soft_edge(context.once(np.ptp, channel), low, high)
        if given is None
        else float(given) / width
    )
    used = {key: None if v is None else start + width * v for key, v in (("LO", low), ("HI", high))}
    return Threshold(inputs.image, low, high, soft, inputs.alpha), {**used, "soft": soft * width}


def geodesic(inputs: TermInputs) -> Made:
    """The area, counted less on edges."""
    image = inputs.image
    spacing = inputs.spacing
    config = inputs.config
    scale = inputs.settings.get("scale", config.edge_scale)
    contrast = inputs.settings.get("contrast", config.edge_contrast)
    balloon = inputs.number("balloon", config.balloon)
    scale = max(axis_steps(image.shape, spacing)) if isinstance(scale, str) else float(scale)
    voxels = math.ceil(scale / min(axis_steps(image.shape, spacing)))
    budgets.SMOOTHING.check(voxels, f"edge-scale: a sigma of {scale:g} mm", kind=UsageError)
    gradient = gradient_magnitude(image, spacing, scale)
    contrast = strong_edge(gradient) if isinstance(contrast, str) else float(contrast)
    used = {"scale": scale, "contrast": contrast, "balloon": balloon}
    return Geodesic(edge_indicator(gradient, contrast), inputs.alpha, balloon), used


def seeded(inputs: TermInputs) -> Made:
    """The field of the model of clicks, which is made of all channels."""
    from accelsurf.clicks import surface_offset

    area = inputs.number("area", inputs.context.model_area())
    # The area smooths the object; its size is that of the clicks.
    lower = surface_offset(area, inputs.context.model_curvature())
    energy: Energy = RegionField(
        inputs.context.model_field() - np.float32(lower), inputs.alpha + area
    )
    used = {"area": area, "offset": lower}
    return energy, used


def balloon(inputs: TermInputs) -> Made:
    """The volume."""
    return Balloon(), {}


def area(inputs: TermInputs) -> Made:
    """The area."""
    return Area(), {}


#: The makers of flows by the names of `accelsurf.settings.flow_specs.FLOWS`.
FLOW_MAKERS: dict[str, Callable[[RunConfig], Flow]] = {
    "constant-density": constant_density,
    "flowable-mass": flowable_mass,
    "region-mass": region_mass,
    "gradient": gradient,
    "sobolev": sobolev,
    "momentum": heavy_ball,
}
#: The makers of terms by the names of `accelsurf.settings.energy_terms.TERMS`.
TERM_MAKERS: dict[str, Callable[[TermInputs], Made]] = {
    "chan-vese": chan_vese,
    "local-region": local_region,
    "likelihood": likelihood,
    "threshold": threshold,
    "geodesic": geodesic,
    "balloon": balloon,
    "seeded": seeded,
    "partition": seeded,
    "area": area,
}
#: Of the settings of a term and the largest spacing, mm: how far beyond an object it sees the image, mm. The other
#: terms see the narrow band, and means over the whole image.
TERM_REACHES: dict[str, Callable[[Values, float], float]] = {"local-region": local_region_reach}
