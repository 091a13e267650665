"""Knowledge of an image that the energies of a run share: channels, scales, training voxels, clicks."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import (
    MIN_DEVIATION,
    Elsewhere,
    Parzen,
    RegionMoments,
    Summing,
    moments_of,
    robust_gaussian_of,
    sums_by_plane,
)
from accelsurf.errors import UsageError
from accelsurf.grid.arrays import Image, Mask, Psi, Singles, Spacing
from accelsurf.grid.boxes import Box, as_corner, box_at, whole_box
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.geometry import Geometry, axis_steps
from accelsurf.grid.pyramid import Level, levels
from accelsurf.grid.window import Window
from accelsurf.run.region_totals import RegionTotals
from accelsurf.settings.expression import HALF, Values
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import otsu_level

if TYPE_CHECKING:
    from accelsurf.clicks import BasinsOnce, ClickModel, Confidence, GivenMask, Scene

#: Standard deviations of a learned bound from the mean of the start's values: 98.8 % of a Gaussian lie
#: between two of them, and ConfidenceConnected of ITK takes as many.
_LEARNED_DEVIATIONS = 2.5
#: No voxel is nearer to the first surface of the clicks' model than this part of half a voxel.
_MIN_DEPTH = 0.02
#: A stated size counts as at most this part of the image.
_FILLS = 0.75
#: Weight of the area of objects that fill a space, of the smallest spacing.
_PARTITION_AREA = 0.3
#: The problem and the hint where likelihood has no sample.
_NO_SAMPLE = (
    "likelihood with update=no was given nothing to learn from",
    "give --foreground, or use update=yes",
)

_EVERYWHERE: Box = (slice(None), slice(None), slice(None))
Found = TypeVar("Found")


class Scale(NamedTuple):
    """Scale of a channel: its values are (I - ``low``)/``width``, I being the file's."""

    low: float = 0.0
    width: float = 1.0


class WholeChannel(Protocol):
    """Numbers of a whole channel of which only a window is in memory."""

    geometry: Geometry

    @property
    def scale(self) -> Scale:
        """Scale by the percentiles of the whole channel."""
        ...

    def found(self, make: Callable[..., Any], *args: Any) -> Any:
        """Return ``make(image, *args)`` of the scaled channel."""
        ...

    def sums(
        self, grids: Sequence[Level], level: int, kind: str, summing: Summing
    ) -> NDArray[np.float64]:
        """Return sums over the scaled channel on a level, of which ``kind`` is the name."""
        ...


class TrainingVoxels(NamedTuple):
    """Voxels from which models learn the object.

    Attributes
    ----------
    box : Box
        Part of the grid.
    inside : ndarray of bool
        Voxels of the object in that box.
    foreground : ndarray (nz, ny, nx) of bool
        Voxels of all objects.
    background : ndarray (nz, ny, nx) of bool or None
        Voxels of no object; None for all voxels that are not foreground.
    """

    box: Box
    inside: Mask
    foreground: Mask
    background: Mask | None


class ModelInputs(NamedTuple):
    """Inputs of the model of clicks besides images and clicks.

    Attributes
    ----------
    size_mm3 : float or None
        About how large the object is.
    mask : ndarray (nz, ny, nx) of bool or None
        Where it may be.
    partition : BasinsOnce or None
        Shared by objects that part the space between them at edges, where nothing else counts; else None.
    window : Window or None
        The part of the whole grid that the images are; None for all of it.
    answer : int
        Which answer to the first click is taken, from 1.
    given : GivenMask or None
        The object before any click, where a label map shows it.
    box_mm3 : float or None
        Volume of the box that was drawn around the object.
    """

    size_mm3: float | None = None
    mask: Mask | None = None
    partition: BasinsOnce | None = None
    window: Window | None = None
    answer: int = 1
    given: GivenMask | None = None
    box_mm3: float | None = None


class ImageContext:
    """Inputs of energies besides the image on the grid at hand; not changed once it is made.

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
    is_start : bool, optional
        Whether the foreground is the start and nothing else: of several objects, each then learns from its own.
    whole : sequence of WholeChannel, optional
        Of each channel, where ``images`` are a window of larger ones: statistics of whole channels are then of these.

    Notes
    -----
    Quantities of whole channels and learned values are computed once and stored.
    """

    def __init__(
        self,
        images: Sequence[Image],
        scales: Sequence[Scale],
        spacing: tuple[float, float, float],
        foreground: Mask | None = None,
        background: Mask | None = None,
        is_start: bool = False,
        whole: Sequence[WholeChannel] = (),
    ) -> None:
        self.images, self.scales, self.spacing = list(images), list(scales), spacing
        self.foreground, self.background = foreground, background
        self._is_start, self._whole = is_start, tuple(whole)
        self._training = (
            None
            if foreground is None
            else TrainingVoxels(_EVERYWHERE, foreground, foreground, background)
        )
        self.others = tuple(self.images[1:])
        self._background: dict[tuple[int, str], NDArray[np.float64]] = {}
        self._found: dict[tuple[Any, ...], Any] = {}
        self._totals: RegionTotals | None = None
        self._box, self._has_box = _EVERYWHERE, False
        self.clicks: Clicks | None = None
        self._model_inputs = ModelInputs()
        self._model: list[ClickModel] = []
        self._field: Callable[[], Image] | None = None
        self._model_curvature: Callable[[], float] | None = None

    def of_object(self, corner: tuple[int, int, int], start: Mask) -> ImageContext:
        """The context of one of several objects; ``start`` is its mask, from voxel ``corner`` on.

        Where models learn from the start, each object learns from its own. Quantities of whole images are shared; sums
        over regions are of the object's box.
        """
        training = self._training
        if self._is_start and training is not None:
            training = training._replace(box=box_at(corner, start.shape), inside=start)
        return self._with(_has_box=True, _training=training)

    def _with(self, **changed: Any) -> ImageContext:
        """Return a copy in which some attributes are others."""
        part = copy.copy(self)
        vars(part).update(changed)
        return part

    def with_channels(
        self,
        images: Sequence[Image],
        field: Callable[[], Singles] | None = None,
        curvature: Callable[[], float] | None = None,
    ) -> ImageContext:
        """The same context for energies on another grid, where the channels after the first are ``images``.

        ``field`` returns that of the clicks' model there, ``curvature`` the mean curvature of its object, 1/mm.
        """
        return self._with(others=tuple(images), _field=field, _model_curvature=curvature)

    def seeing_elsewhere(self, totals: RegionTotals, box: Box) -> ImageContext:
        """The same context for energies on a box of the image's grid that count the object beyond it too."""
        return self._with(_totals=totals, _box=box)

    def moments_elsewhere(self, channel: int) -> Elsewhere | None:
        """Sums of a channel over the voxels beyond the grid at hand; None where that is the whole image's."""
        if self._totals is None:
            return None
        inside, whole = self._totals.beyond(self._box, channel, "moments", moments_of)
        return Elsewhere(RegionMoments(*inside), RegionMoments(*whole))

    def histograms_elsewhere(self, channel: int, parzen: Parzen) -> Elsewhere | None:
        """The same as histograms."""
        if self._totals is None:
            return None
        return Elsewhere(*self._totals.beyond(self._box, channel, "histogram", parzen.histogram))

    # -- clicks --------------------------------------------------------------------------------------------

    def with_model_inputs(self, inputs: ModelInputs) -> ImageContext:
        """The same context with the inputs of the model of clicks."""
        return self._with(_model_inputs=inputs)

    @property
    def model_inputs(self) -> ModelInputs:
        """Inputs of the model of clicks."""
        return self._model_inputs

    def with_clicks(self, clicks: Clicks) -> ImageContext:
        """The context of an object that a person has clicked, as `Clicks.of` returns it."""
        return self._with(clicks=clicks, _model=[])

    def scene(self) -> Scene:
        """The images as the model of clicks reads them."""
        from accelsurf.clicks import Scene, sizes_in_box

        size, mask, _, window, _, _, box_mm3 = self._model_inputs
        sizes = None if size is not None or box_mm3 is None else sizes_in_box(box_mm3)
        return Scene(tuple(self.images), self.spacing, mask, window, sizes)

    def click_model(self, previous: ClickModel | None = None) -> ClickModel:
        """The model of the clicks on the object, computed once; it goes on from that of the first of them, if given.

        Raises
        ------
        UsageError
            When there is no click inside, and no mask shows the object.
        """
        from accelsurf.clicks import click_model, corrected_model, partition_model

        size, mask, partition, _, answer, given, _ = self._model_inputs
        if given is None and (self.clicks is None or not self.clicks.mask("inside").any()):
            raise UsageError(
                "energy: seeded was given without a click inside", "give --inside point:X,Y,Z"
            )
        clicks = self.clicks or Clicks((), self._shape)
        if not self._model:
            if given is not None:
                made = corrected_model(self.scene(), given, clicks, previous=previous)
            elif partition is not None:
                made = partition_model(
                    self.images, self.spacing, clicks, mask=mask, basins=partition
                )
            else:
                scene = self.scene()
                if size is not None:  # an object that fills the image has no surface
                    size = min(
                        size, _FILLS * float(np.prod(scene.whole_shape) * np.prod(self.spacing))
                    )
                made = click_model(scene, clicks, size_mm3=size, answer=answer, previous=previous)
            self._model.append(made)
        return self._model[0]

    @property
    def _shape(self) -> tuple[int, int, int]:
        return as_corner(self.images[0].shape)

    def confidence(self, model: ClickModel | None = None) -> Confidence | None:
        """Measure how sure a model of the clicks is, by default the present one; None of a mask that was given."""
        from accelsurf.clicks import confidence_of

        return (
            None
            if self._model_inputs.given is not None
            else confidence_of(model or self.click_model())
        )

    def model_start(self, box: Box | None = None) -> Psi:
        """Psi, mm, of the first surface that the model gives, on a box of the grid; by default on all of it."""
        model, shape = self.click_model(), self.images[0].shape
        box = whole_box(shape) if box is None else box
        inside, half = model.inside_on(box), np.float32(0.5 * min(axis_steps(shape, self.spacing)))
        # F crosses 0 between voxels: the surface begins there, and not at the faces of voxels.
        depth = half * np.clip(np.abs(model.field_on(box)), np.float32(_MIN_DEPTH), np.float32(1.0))
        return np.asarray(np.where(inside, -depth, depth), np.float32)

    def model_field(self) -> Singles:
        """The field of the model on the grid at hand."""
        return (
            self.click_model().field_on(whole_box(self.images[0].shape))
            if self._field is None
            else self._field()
        )

    def model_curvature(self) -> float:
        """Mean curvature of the model's object, 1/mm; 0 of one among several that fill a space."""
        if self._model_curvature is not None:
            return self._model_curvature()
        return self.click_model().mean_curvature(self.spacing)

    def model_area(self) -> float:
        """Weight of the area, mm, that suits the model's object."""
        from accelsurf.clicks import area_weight

        model = self.click_model()
        if model.is_partition:
            return _PARTITION_AREA * min(self.spacing)
        inside = model.inside_on(whole_box(self.images[0].shape))
        return area_weight(self.images, self.spacing, inside, self._model_inputs.mask)

    def once(self, make: Callable[..., Found], channel: int, *args: Any) -> Found:
        """``make(image, *args)`` of a whole channel, computed once for all objects."""
        key = (make, channel, args)
        if key not in self._found:
            found = (
                self._whole[channel].found(make, *args)
                if self._whole
                else make(self.images[channel], *args)
            )
            self._found[key] = found
        return cast("Found", self._found[key])

    def whole_sums(
        self, channel: int, spacing: Spacing, kind: str, summing: Summing
    ) -> NDArray[np.float64] | None:
        """Sums over a whole channel on the level with a ``spacing``, mm; None where the image at hand counts."""
        if not self._whole or self._has_box:
            return None
        whole = self._whole[channel]
        grids = levels(whole.geometry.shape, whole.geometry.spacing)
        number = [grid.spacing for grid in grids].index(spacing)
        return whole.sums(grids, number, kind, summing)

    def sample(self, channel: int) -> NDArray[np.float32]:
        """Values of a channel inside, from which likelihood learns."""
        training = self._trained_on(*_NO_SAMPLE)
        return self.images[channel][training.box][training.inside]

    def sums_of_background(self, channel: int, kind: str, summing: Summing) -> NDArray[np.float64]:
        """Sums of a channel over the background that likelihood learns from; ``kind`` is their name.

        Unless voxels of the background are given, they are the whole's less the foreground's: the same,
        wherever the image ends beyond the foreground.
        """
        training, image = self._trained_on(*_NO_SAMPLE), self.images[channel]
        if (channel, kind) not in self._background:
            if training.background is not None:
                sums = sums_by_plane(image, summing, training.background)
            else:
                whole = self.whole_sums(channel, self.spacing, kind, summing)
                of_whole = sums_by_plane(image, summing) if whole is None else whole
                sums = of_whole - sums_by_plane(image, summing, training.foreground)
            self._background[channel, kind] = sums
        return self._background[channel, kind]

    def _trained_on(self, problem: str, hint: str) -> TrainingVoxels:
        if self._training is None:
            raise UsageError(f"energy: {problem}", hint)
        return self._training

    def learned(self, channel: int) -> tuple[float, float]:
        """Values of a channel between which the foreground's lie: its median and `_LEARNED_DEVIATIONS` to either side.

        Of the image as it is evolved, with the deviation by the median absolute deviation: a stone or an organelle in
        the start changes neither.
        """
        training = self._trained_on(
            "a learned bound was given nothing to learn from", "give --foreground"
        )
        values = self.images[channel][training.box][training.inside]
        # A part of the range between percentiles: that between the extremes is of metal or a stone.
        middle, variance = robust_gaussian_of(values, MIN_DEVIATION**2)
        width = _LEARNED_DEVIATIONS * variance**0.5
        return middle - width, middle + width

    def bound(self, channel: int, value: float | str, upper: bool) -> float | None:
        """A bound of threshold on the scale of the image as energies see it; None for an open side."""
        if value == "":
            return None
        if value == "auto":
            return self.once(otsu_level, channel)
        if value == "learned":
            return self.learned(channel)[1 if upper else 0]
        if isinstance(value, str) and value.startswith(HALF):
            low, high = self.learned(channel)
            given, scale = float(value.removeprefix(HALF)), self.scales[channel]
            other = (given - scale.low) / scale.width
            return 0.5 * (0.5 * (low + high) + other)
        if isinstance(value, str):
            return float(self.once(np.percentile, channel, float(value.removesuffix("%"))))
        scale = self.scales[channel]
        return (value - scale.low) / scale.width


@dataclass(frozen=True, eq=False)
class TermInputs:
    """The input of a maker of a term; see `accelsurf.settings.energy_terms.TermSpec`.

    Attributes
    ----------
    settings : mapping of str to float or str
        The ones written after the colon, by key.
    config : RunConfig
    image : ndarray (nz, ny, nx), float32
        The channel that it sees, on the grid at hand, 0 and 1 at its percentiles.
    spacing : (hz, hy, hx)
        Of that grid, mm.
    context : ImageContext
        Of the image on its own grid.
    channel : int
        Number of the channel, the first is 0.
    alpha : float
        Weight of the surface's area that the energy includes itself.
    """

    settings: Values
    config: RunConfig
    image: Image
    spacing: Spacing
    context: ImageContext
    channel: int = 0
    alpha: float = 0.0

    def number(self, key: str, default: float) -> float:
        """A setting that is a number."""
        return float(self.settings.get(key, default))
