"""The energy that an expression means, of an image: terms made, learned, weighted and added."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import (
    Area,
    Balloon,
    ChanVese,
    Energy,
    GaussianLikelihood,
    Geodesic,
    HistogramLikelihood,
    LocalRegion,
    Parzen,
    Threshold,
    WeightedSum,
    gaussian_of,
)
from accelsurf.energies.geodesic import edge_contrast as strong_edge
from accelsurf.energies.geodesic import edge_indicator_of, gradient_magnitude
from accelsurf.energies.likelihood import least_variance
from accelsurf.energies.threshold import soft_edge
from accelsurf.errors import UsageError
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import axis_steps
from accelsurf.initialization.region_growing import otsu_level
from accelsurf.settings import energy_expression
from accelsurf.settings.energy_expression import Term
from accelsurf.settings.run_config import RunConfig

#: R of local-region unless given, voxels of the largest spacing.
WINDOW_VOXELS = 8.0
#: A learned bound lies so many standard deviations from the mean of the start's values: 98.8 % of a Gaussian lie
#: between two of them, and ConfidenceConnected of ITK takes as many.
LEARNED_DEVIATIONS = 2.5
#: Terms whose energy is a mean over channels, or a sum: what several channels say together.
MEAN_OVER_CHANNELS, SUM_OVER_CHANNELS = ("chan-vese", "local-region"), ("likelihood",)

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
_EVERYWHERE: Box = (slice(None), slice(None), slice(None))
Kept = TypeVar("Kept")


class Scale(NamedTuple):
    """How a channel came to its values: (I - ``low``)/``width``, I being the file's."""

    low: float = 0.0
    width: float = 1.0


class ImageContext:
    """What energies are told of an image besides the image on the grid at hand.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels as energies see them, on the image's own grid.
    scales : sequence of Scale
        Of each channel.
    spacing : (hz, hy, hx)
        Of that grid, mm.
    foreground, background : ndarray (nz, ny, nx) of bool, optional
        Where likelihood learns; without ``background`` all that is not foreground.
    others : callable, optional
        The other channels, after the first, on the grid of a given shape and spacing.
    raw : callable, optional
        Values of a channel before any presmoothing, on the scale of ``images``, where a mask of a box is set.
    is_start : bool, optional
        Whether the foreground is the start and nothing else: of several objects, each then learns from its own.

    Attributes
    ----------
    resolved_settings : dict of int to dict
        For each term by its place: name, weight, and every setting with the value that it has in the run, also where
        that was chosen from the image; image values in the file's unit.
    """

    def __init__(
        self,
        images: Sequence[Image],
        scales: Sequence[Scale],
        spacing: tuple[float, float, float],
        foreground: Mask | None = None,
        background: Mask | None = None,
        others: Callable[[tuple[int, ...], tuple[float, float, float]], list[Image]] | None = None,
        raw: Callable[[int, Box, Mask], NDArray[Any]] | None = None,
        is_start: bool = False,
    ) -> None:
        self.images, self.scales, self.spacing = list(images), list(scales), spacing
        self.foreground, self.background = foreground, background
        self._is_start = is_start
        #: A box of the grid and where in it to learn; None where there is nothing.
        self._inside = None if foreground is None else (_EVERYWHERE, foreground)
        self._raw = raw or (lambda channel, box, mask: self.images[channel][box][mask])
        self.others = others or (lambda shape, spacing: self.images[1:])
        self.resolved_settings: dict[int, dict[str, Any]] = {}
        self._learned: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}
        self._outside: dict[int, NDArray[Any]] = {}
        self._kept: dict[tuple[Any, ...], Any] = {}

    @property
    def terms(self) -> list[dict[str, Any]]:
        """What was chosen, term by term."""
        return [self.resolved_settings[place] for place in sorted(self.resolved_settings)]

    def of_object(self, corner: tuple[int, int, int], start: Mask) -> ImageContext:
        """The facts for one of several objects, which ``start``, from voxel ``corner`` on, has inside.

        Where the start is what models learn from, it learns from its own. What is found of whole images stays common.
        """
        part = copy.copy(self)
        part.resolved_settings = {}
        if self._is_start:
            z, y, x = (slice(c, c + n) for c, n in zip(corner, start.shape, strict=True))
            part._inside, part._learned = ((z, y, x), start), {}
        return part

    def on(self, box: Box) -> ImageContext:
        """The same facts for energies on a box of the image's own grid; what they choose is kept in common."""
        part = copy.copy(self)
        part.others = lambda shape, spacing: [np.ascontiguousarray(image[box]) for image in self.images[1:]]
        return part

    def once(self, make: Callable[..., Kept], channel: int, *args: Any) -> Kept:
        """``make(image, *args)`` of a whole channel, found once: many objects ask for it."""
        key = (make, channel, args)
        if key not in self._kept:
            self._kept[key] = make(self.images[channel], *args)
        return cast("Kept", self._kept[key])

    def samples(self, channel: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Values of a channel inside and outside, where likelihood is to learn."""
        if channel not in self._learned:
            if self._inside is None:
                raise UsageError(
                    "energy: likelihood with update=no was given nothing to learn from",
                    "give --foreground, or use update=yes",
                )
            image, (box, mask) = self.images[channel], self._inside
            if channel not in self._outside:
                assert self.foreground is not None
                # Without a background all that is foreground of no object.
                self._outside[channel] = image[~self.foreground if self.background is None else self.background]
            self._learned[channel] = image[box][mask], self._outside[channel]
        return self._learned[channel]

    def learned(self, channel: int) -> tuple[float, float]:
        """Values of a channel between which the foreground's lie: its mean and `LEARNED_DEVIATIONS` to either side."""
        if self._inside is None:
            raise UsageError("energy: a learned bound was given nothing to learn from", "give --foreground")
        # Before presmoothing: what is left of noise after it says how wide the object's values are, not its edges'.
        mean, variance = gaussian_of(self._raw(channel, *self._inside), self.once(least_variance, channel))
        reach = LEARNED_DEVIATIONS * variance**0.5
        return mean - reach, mean + reach

    def bound(self, channel: int, value: float | str, upper: bool) -> float | None:
        """A bound of threshold on the scale of the image as energies see it; None for an open side."""
        if value == "":
            return None
        if value == "auto":
            return self.once(otsu_level, channel)
        if value == "learned":
            return self.learned(channel)[1 if upper else 0]
        if isinstance(value, str) and value.startswith(energy_expression.HALF):
            low, high = self.learned(channel)
            given, scale = float(value.removeprefix(energy_expression.HALF)), self.scales[channel]
            other = (given - scale.low) / scale.width
            return 0.5 * (0.5 * (low + high) + other)
        if isinstance(value, str):
            return float(self.once(np.percentile, channel, float(value.removesuffix("%"))))
        scale = self.scales[channel]
        return (value - scale.low) / scale.width


def area_weight(config: RunConfig) -> float:
    """Weight of the surface's area: ``smoothness`` and the area terms of the energy."""
    return config.smoothness + sum(t.weight for t in energy_expression.parse(config.energy) if t.name == "area")


def make_energy(
    config: RunConfig, image: Image, spacing: tuple[float, float, float], context: ImageContext | None = None
) -> Energy:
    """The energy that a configuration asks for, of an image on a grid of ``spacing`` (hz, hy, hx) mm.

    Parameters
    ----------
    config : RunConfig
    image : ndarray (nz, ny, nx), float32
        First channel, 0 and 1 at its percentiles; on any level.
    spacing : (hz, hy, hx)
        mm.
    facts : Facts, optional
        Of the image on its own grid; without them the image is the whole truth, in its own unit.

    Raises
    ------
    UsageError
        When a term asks for a channel that there is not, or for something to learn from that it would not use.
    """
    if context is None:
        context = ImageContext([image], [Scale()], spacing)
    terms = energy_expression.parse(config.energy)
    # Of an energy before, which may have had more terms.
    context.resolved_settings.clear()
    channels = [image, *context.others(image.shape, spacing)]
    if len(terms) == 1 and terms[0].weight == 1.0 and len(_seen(terms[0], channels)) == 1:
        # The term carries the area itself.
        return _make(terms[0], 0, config, channels, spacing, context, config.smoothness)[0][1]
    made: list[tuple[float, Energy]] = []
    for place, term in enumerate(terms):
        parts = _make(term, place, config, channels, spacing, context, 0.0)
        made += [(term.weight * share, energy) for share, energy in parts]
    if config.smoothness > 0:
        made.append((config.smoothness, Area()))
    return WeightedSum(made)


def _seen(term: Term, channels: Sequence[Image]) -> list[int]:
    """Indices of the channels that a term sees."""
    given = term.settings.get("channel")
    if isinstance(given, float):
        if given != int(given) or given > len(channels):
            raise UsageError(
                f"energy: channel {given:g} of {term.name} was given, expected 1 to {len(channels)}",
                "--channel FILE adds one to those of the input",
            )
        return [int(given) - 1]
    many = term.name in MEAN_OVER_CHANNELS + SUM_OVER_CHANNELS
    return list(range(len(channels))) if many else [0]


def _make(
    term: Term,
    place: int,
    config: RunConfig,
    channels: Sequence[Image],
    spacing: tuple[float, float, float],
    context: ImageContext,
    alpha: float,
) -> list[tuple[float, Energy]]:
    """The energies of a term, one for each channel that it sees, with their shares."""
    seen = _seen(term, channels)
    share = 1.0 / len(seen) if term.name in MEAN_OVER_CHANNELS else 1.0
    told: dict[str, Any] = {"term": term.name, "weight": term.weight}
    made: list[tuple[float, Energy]] = []
    for channel in seen:
        energy, settings = MAKERS[term.name](term.settings, config, channels[channel], spacing, context, channel, alpha)
        made.append((share, energy))
        if len(channels) > 1 and term.name not in ("balloon", "area"):
            told.setdefault("channels", []).append({"channel": channel + 1, **settings})
        else:
            told |= settings
    context.resolved_settings[place] = told
    return made


Made = tuple[Energy, dict[str, Any]]
Settings = Mapping[str, energy_expression.Value]
Spacing = tuple[float, float, float]


def _number(settings: Settings, key: str, default: float) -> float:
    return float(settings.get(key, default))


def _chan_vese(
    settings: Settings,
    config: RunConfig,
    image: Image,
    spacing: Spacing,
    context: ImageContext,
    channel: int,
    alpha: float,
) -> Made:
    balance = _number(settings, "balance", config.balance)
    epsilon = _number(settings, "epsilon", config.epsilon)
    return ChanVese(image, alpha, epsilon=epsilon, balance=balance), {"balance": balance, "epsilon": epsilon}


def _local_region(
    settings: Settings,
    config: RunConfig,
    image: Image,
    spacing: Spacing,
    context: ImageContext,
    channel: int,
    alpha: float,
) -> Made:
    # Of the image's own grid, on every level.
    radius = _number(settings, "R", WINDOW_VOXELS * max(axis_steps(context.images[0].shape, context.spacing)))
    epsilon = _number(settings, "epsilon", config.epsilon)
    return LocalRegion(image, radius, alpha, epsilon), {"R": radius, "epsilon": epsilon}


def _likelihood(
    settings: Settings,
    config: RunConfig,
    image: Image,
    spacing: Spacing,
    context: ImageContext,
    channel: int,
    alpha: float,
) -> Made:
    given = bool(config.foreground or config.background)
    update = settings.get("update", "no" if given else "yes")
    if update == "yes" and given:
        raise UsageError(
            "energy: likelihood:update=yes was given with --foreground or --background, which it would not use",
            "with update=no it learns from them once; with update=yes from the surface, again in each step",
        )
    # Sharp unless told: a narrow distribution fears the other side of the edge, which a smeared interface sees.
    model, epsilon = settings.get("model", "gauss"), _number(settings, "epsilon", 0.0)
    used: dict[str, Any] = {"model": model, "update": update, "epsilon": epsilon}
    if model == "histogram":
        learned = context.samples(channel) if update == "no" else None
        return HistogramLikelihood(image, alpha, learned, epsilon, context.once(Parzen, channel)), used
    if update == "yes":
        return GaussianLikelihood(image, alpha, epsilon=epsilon), used
    one, other = (gaussian_of(values, context.once(least_variance, channel)) for values in context.samples(channel))
    low, width = context.scales[channel]
    for name, (mean, variance) in (("inside", one), ("outside", other)):
        used[name] = {"mean": low + width * mean, "deviation": width * variance**0.5}
    return GaussianLikelihood(image, alpha, (one, other), epsilon), used


def _threshold(
    settings: Settings,
    config: RunConfig,
    image: Image,
    spacing: Spacing,
    context: ImageContext,
    channel: int,
    alpha: float,
) -> Made:
    low, high = (context.bound(channel, settings.get(key, ""), key == "HI") for key in ("LO", "HI"))
    start, width = context.scales[channel]
    given = settings.get("soft")
    soft = soft_edge(context.once(np.ptp, channel), low, high) if given is None else float(given) / width
    used = {key: None if v is None else start + width * v for key, v in (("LO", low), ("HI", high))}
    return Threshold(image, low, high, soft, alpha), {**used, "soft": soft * width}


def _geodesic(
    settings: Settings,
    config: RunConfig,
    image: Image,
    spacing: Spacing,
    context: ImageContext,
    channel: int,
    alpha: float,
) -> Made:
    scale = settings.get("scale", config.edge_scale)
    contrast = settings.get("contrast", config.edge_contrast)
    balloon = _number(settings, "balloon", config.balloon)
    scale = max(axis_steps(image.shape, spacing)) if isinstance(scale, str) else float(scale)
    gradient = gradient_magnitude(image, spacing, scale)
    contrast = strong_edge(gradient) if isinstance(contrast, str) else float(contrast)
    used = {"scale": scale, "contrast": contrast, "balloon": balloon}
    return Geodesic(edge_indicator_of(gradient, contrast), alpha, balloon), used


#: How each term is made; each gives its energy and the settings that it has.
MAKERS: dict[str, Callable[..., Made]] = {
    "chan-vese": _chan_vese,
    "local-region": _local_region,
    "likelihood": _likelihood,
    "threshold": _threshold,
    "geodesic": _geodesic,
    "balloon": lambda *_: (Balloon(), {}),
    "area": lambda *_: (Area(), {}),
}
