"""Region competition: inside and outside each have a distribution of brightness; a voxel goes to the likelier one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from accelsurf.energies.energy import Energy
from accelsurf.energies.front_samples import sample_at_front
from accelsurf.energies.image_energy import AreaTerm, RegionEnergy
from accelsurf.energies.region_sums import (
    Elsewhere,
    Interface,
    MomentTracker,
    RegionMoments,
    sums_by_plane,
)
from accelsurf.errors import InputError
from accelsurf.kernels import statistics
from accelsurf.levelset import BandChange, LevelSet, dot

#: Smallest standard deviation of a Gaussian, as fraction of the image's range: for regions of a single value.
MIN_DEVIATION = 0.01
#: Standard deviation of a normal distribution whose median absolute deviation is 1.
NORMAL_MAD = 1.4826
#: Bins of a histogram between these percentiles of the image, and a margin of this part of them to either side; the
#: percentiles are those of record 0015.
BINS = 64
END_PERCENTILES = (0.5, 99.5)
MARGIN = 0.05
#: Width (sigma) of Parzen's window, bins; and the probability that every value has at least in each region, so that no
#: value decides alone.
_PARZEN_SIGMA = 2.0
_UNIFORM_SHARE = 0.01


class Gaussian(NamedTuple):
    """Mean and variance of a region."""

    mean: float
    variance: float


class TwoGaussians(NamedTuple):
    """Models of inside and outside."""

    inside: Gaussian
    outside: Gaussian


class TwoHistograms(NamedTuple):
    """Histograms (BINS,) of samples inside and outside."""

    inside: np.ndarray
    outside: np.ndarray


class GaussianLikelihood(RegionEnergy):
    """U = -int_in log p1(I) - int_out log p2(I) + alpha A with Gaussians, f = log(p2/p1) + alpha H.

    f = (log(v1/v2) + (I - m1)^2/v1 - (I - m2)^2/v2)/2. Unless given, means and variances are the present
    surface's at each step, which by the envelope theorem adds nothing to f.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit; U is in mm3 and depends on the unit by a constant only.
    alpha : float
        Weight of the area, mm.
    models : TwoGaussians, optional
        Fixed models of inside and outside; `gaussian_of` learns one.
    epsilon : float
        Half width of the smeared interface in voxels; 0 is sharp. See `Interface`.
    elsewhere : Elsewhere, optional
        `RegionMoments` of the part of the object and of the image that are not on this grid; they count in the models.
    whole : RegionMoments, optional
        Of the whole image, where this grid is a window of it; by default of ``image``.
    min_variance : float, optional
        Smallest variance of a region; by default `least_variance` of ``image``.
    """

    def __init__(
        self,
        image: np.ndarray,
        alpha: float = 0.0,
        models: TwoGaussians | None = None,
        epsilon: float = 0.0,
        elsewhere: Elsewhere | None = None,
        whole: RegionMoments | None = None,
        min_variance: float | None = None,
    ) -> None:
        super().__init__(image, alpha, epsilon, elsewhere, whole)
        self._min_variance = least_variance(image) if min_variance is None else min_variance
        self._fixed = models
        self.models = models or TwoGaussians(Gaussian(0.0, 1.0), Gaussian(0.0, 1.0))

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; also sets `models` for the next `force`."""
        models, energy = [], 0.0
        for i, sums in enumerate(self.regions(surface, fraction)):
            model = self._fixed[i] if self._fixed else _gaussian(sums, self._min_variance)
            m, v = model
            models.append(model)
            energy += 0.5 * math.log(2.0 * math.pi * v) * sums.voxels
            energy += 0.5 * (sums.squares - 2.0 * m * sums.total + m * m * sums.voxels) / v
        self.models = TwoGaussians(*models)
        return energy * surface.voxel_volume + self._area.value(area)

    def polynomial(self) -> tuple[float, float, float]:
        """Factors of the force, between the models of the last `value`."""
        (m1, v1), (m2, v2) = self.models
        constant = 0.5 * (math.log(v1 / v2) + m1 * m1 / v1 - m2 * m2 / v2)
        return 0.5 / v1 - 0.5 / v2, m2 / v2 - m1 / v1, constant


def _no_sample() -> InputError:
    """Return the error of a region to learn from that has no voxel."""
    return InputError(
        "likelihood: a region to learn from has no voxel",
        "give --foreground and --background voxels",
    )


def least_variance(image: np.ndarray) -> float:
    """Smallest variance that a region of an image is given."""
    return float((MIN_DEVIATION * (float(np.max(image)) - float(np.min(image)))) ** 2) or 1.0


def gaussian_of(values: np.ndarray, min_variance: float) -> Gaussian:
    """Gaussian of sample values; its variance is at least ``min_variance``.

    Raises
    ------
    InputError
        When there are no values.
    """
    if values.size == 0:
        raise _no_sample()
    sample = np.asarray(values, np.float64)
    return Gaussian(float(sample.mean()), max(float(sample.var()), min_variance))


def gaussian_of_sums(sums: RegionMoments, min_variance: float) -> Gaussian:
    """The same as `gaussian_of`, of the sums over a region.

    Raises
    ------
    InputError
        When there are no values.
    """
    if not sums.voxels > 0:
        raise _no_sample()
    return _gaussian(sums, min_variance)


def robust_gaussian_of(values: np.ndarray, min_variance: float) -> Gaussian:
    """Gaussian of sample values by their median and median absolute deviation: a few outliers do not change it.

    Raises
    ------
    InputError
        When there are no values.

    Examples
    --------
    >>> robust_gaussian_of(np.array([1.0, 2.0, 3.0, 4.0, 500.0]), 0.01)
    Gaussian(mean=3.0, variance=2.19810276)
    """
    if values.size == 0:
        raise _no_sample()
    sample = np.asarray(values, np.float64)
    middle = float(np.median(sample))
    return Gaussian(
        middle, max((NORMAL_MAD * float(np.median(np.abs(sample - middle)))) ** 2, min_variance)
    )


def _gaussian(sums: RegionMoments, min_variance: float) -> Gaussian:
    if not sums.voxels > 0:
        return Gaussian(0.0, min_variance)
    mean = sums.total / sums.voxels
    return Gaussian(mean, max(sums.squares / sums.voxels - mean * mean, min_variance))


class Parzen:
    """Densities of brightness on bins: a histogram smoothed by Parzen's window, plus a small uniform density.

    Parameters
    ----------
    low, high : float
        Values between which the bins lie.
    """

    def __init__(self, low: float, high: float) -> None:
        margin = MARGIN * (high - low) or 1.0
        #: (value of the first bin, bins per value)
        self.scale = (low - margin, (BINS - 1) / (high - low + 2.0 * margin))
        away = np.arange(BINS)[:, None] - np.arange(BINS)[None, :]
        window = np.exp(-0.5 * (away / _PARZEN_SIGMA) ** 2)
        # Columns sum to 1: the part of a window beyond the ends goes to the bins near them.
        self._window = window / window.sum(axis=0)

    @classmethod
    def of_image(cls, image: np.ndarray) -> Parzen:
        """The bins for an image: between its percentiles, or its extremes where those are equal."""
        return cls.between(
            np.percentile(image, END_PERCENTILES), np.array([np.min(image), np.max(image)])
        )

    @classmethod
    def between(cls, percentiles: np.ndarray, extremes: np.ndarray) -> Parzen:
        """The same of the `END_PERCENTILES` (2,) and extremes (2,) of an image."""
        low, high = (float(v) for v in percentiles)
        return cls(low, high) if high > low else cls(float(extremes[0]), float(extremes[1]))

    def histogram(self, values: np.ndarray) -> np.ndarray:
        """Histogram (BINS,) of values, each shared by the two bins next to it."""
        place = np.clip(
            (np.asarray(values, np.float64) - self.scale[0]) * self.scale[1], 0, BINS - 1
        )
        below = np.minimum(place.astype(np.int64), BINS - 2)
        share = place - below
        counts = np.bincount(below, 1.0 - share, BINS) + np.bincount(below + 1, share, BINS)
        return np.asarray(counts)

    def density(self, counts: np.ndarray) -> np.ndarray:
        """Density p (BINS,), sum 1, of the values of a histogram."""
        total = counts.sum()
        smooth = (
            (self._window * counts).sum(axis=1) / total if total > 0 else np.full(BINS, 1.0 / BINS)
        )
        return np.asarray((1.0 - _UNIFORM_SHARE) * smooth + _UNIFORM_SHARE / BINS)

    def value_and_slope(self, counts: np.ndarray) -> tuple[float, np.ndarray]:
        """E = -sum_b h_b log p_b for the histogram h = ``counts``, and dE/dh (BINS,): p depends on h, too."""
        total = counts.sum()
        if not total > 0:
            return 0.0, np.zeros(BINS)
        p = self.density(counts)
        ratio = counts / p * (1.0 - _UNIFORM_SHARE) / total
        smooth = (self._window * counts).sum(axis=1) / total
        slope = -np.log(p) - (self._window.T * ratio).sum(axis=1) + dot(ratio, smooth)
        return -dot(counts, np.log(p)), slope


class HistogramLikelihood(Energy):
    """U = -int_in log p1(I) - int_out log p2(I) + alpha A with Parzen densities.

    Fixed densities: f = log(p2/p1) + alpha H. The present surface's depend on it, and smoothing makes them other
    than the likeliest, so that f has two more terms: it is the exact derivative of U with respect to the histograms.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit; U is in mm3.
    alpha : float
        Weight of the area, mm.
    learned : TwoHistograms, optional
        As `Parzen.histogram` makes them, for fixed densities.
    epsilon : float
        Half width of the smeared interface in voxels; 0 is sharp. See `Interface`.
    parzen : Parzen, optional
        The bins; by default from the image.
    elsewhere : Elsewhere, optional
        Histograms (BINS,) of the part of the object and of the image that are not on this grid.
    whole : ndarray (BINS,), optional
        Histogram of the whole image, where this grid is a window of it; by default that of ``image``.

    Raises
    ------
    InputError
        When a sample is empty.
    """

    def __init__(
        self,
        image: np.ndarray,
        alpha: float = 0.0,
        learned: TwoHistograms | None = None,
        epsilon: float = 0.0,
        parzen: Parzen | None = None,
        elsewhere: Elsewhere | None = None,
        whole: np.ndarray | None = None,
    ) -> None:
        self.sums = MomentTracker(image)
        self.alpha = float(alpha)
        self._area = AreaTerm(alpha)
        self._interface = Interface(float(epsilon))
        self._parzen = parzen or Parzen.of_image(image)
        self._beyond_band = np.zeros(BINS)
        self._all = (
            sums_by_plane(np.asarray(image, np.float32), self._parzen.histogram)
            if whole is None
            else whole
        )
        self._elsewhere = elsewhere
        if elsewhere is not None:
            self._all = self._all + elsewhere.all
        self._fixed: np.ndarray | None = None
        if learned is not None:
            # Shares of bins leave rounding errors in differences of histograms.
            if not all(counts.sum() > 0.5 for counts in learned):
                raise _no_sample()
            p1, p2 = (self._parzen.density(counts) for counts in learned)
            self._fixed = np.stack([-np.log(p1), -np.log(p2)])
        self._table = np.zeros(BINS)

    def start(self, surface: LevelSet) -> None:
        """Make the histogram of the inside voxels that are not in the band."""
        self.sums.start(surface)
        self._beyond_band = surface.workers.plane_sums(
            statistics.inside_histogram,
            surface.shape,
            BINS,
            surface.dense,
            self.sums.image,
            surface.grid,
            self._parzen.scale,
        )

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the histogram by the cells that entered or left the band."""
        left, entered = (
            self.sums.image[cells] for cells in (change.left_inside, change.entered_inside)
        )
        self._beyond_band = (
            self._beyond_band + self._parzen.histogram(left) - self._parzen.histogram(entered)
        )

    def state(self) -> np.ndarray:
        """Return the histogram of the inside beyond the band; not to be changed."""
        return self._beyond_band

    def restore(self, surface: LevelSet, state: np.ndarray) -> None:
        """Set the state that `state` returned on this surface."""
        self._beyond_band = state

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; also finds the densities for the next `force`."""
        band = surface.workers.block_sums(
            statistics.weighted_histogram,
            surface.size,
            BINS,
            surface.band.cells,
            self._interface.fraction(surface, fraction),
            self.sums.image,
            self._parzen.scale,
        )
        total = self._beyond_band + band
        if self._elsewhere is not None:
            total = total + self._elsewhere.inside
        # A bin without voxels has a rounding error instead of 0.
        inside = np.clip(total, 0.0, self._all)
        outside = self._all - inside
        if self._fixed is not None:
            energy = dot(self._fixed[0], inside) + dot(self._fixed[1], outside)
            self._table = self._fixed[0] - self._fixed[1]
        else:
            (inner, slope), (outer, outer_slope) = (
                self._parzen.value_and_slope(h) for h in (inside, outside)
            )
            energy, self._table = inner + outer, slope - outer_slope
        return energy * surface.voxel_volume + self._area.value(area)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front: that of the image at each cell's closest surface point, or its mean across.

        Smeared it costs O(volume): the force is then needed as an image.
        """
        if self._interface.epsilon == 0:
            values = sample_at_front(self.sums.image, surface, front)
            force = np.where(front, self._looked_up(values, surface), np.float32(0.0))
        else:
            field = self._looked_up(self.sums.image, surface)
            force = self._interface.force(field, surface, front, curvature, (0.0, 1.0, 0.0))
        self._area.add_force(force, curvature)
        return force

    def _looked_up(self, values: np.ndarray, surface: LevelSet) -> np.ndarray:
        out = np.empty(values.size, np.float32)
        surface.workers.parallel(
            statistics.look_up, values.size, values, self._parzen.scale, self._table, out
        )
        return out
