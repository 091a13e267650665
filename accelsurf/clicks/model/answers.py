"""Answers to the first click: the likeliest, a part of it, and all that is alike and connected.

Alike voxels are found by values alone, through every contact with something as bright: an answer that a person may
choose, never the likeliest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from skimage.morphology import reconstruction

from accelsurf.clicks.model.features import CUT, SMOOTHING, at_bins, likelihood_ratio
from accelsurf.clicks.model.fronts import MIN_RANGE, MIN_VOXELS, robust
from accelsurf.clicks.model.windows import Window
from accelsurf.grid.arrays import Mask, Singles
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    connected_to,
    corner_of,
    on_box,
    placed_at,
    widened,
    with_halo,
)

#: A block is object from this probability on.
FROM = 0.47
#: A part is an answer of at most this part of the likeliest one's volume.
PART = 1.0 / 1.5
#: Probabilities whose volumes tell how sure a first answer is.
LOW = 0.25
HIGH = 0.7
#: Levels at which other answers are looked for.
LEVELS = tuple(round(0.05 * k, 2) for k in range(1, 20))
#: Values beyond the answer are learned in a rim as wide as the answer is deep; least width of it, in steps.
RIM = 2.0
#: Gaussians are cut off at this number of standard deviations.
REACH = 4.0
#: Numbers of the answers to a first click.
LIKELIEST = 1
OF_PART = 2
OF_ALIKE = 3


class Answer(NamedTuple):
    """An answer to the first click.

    Attributes
    ----------
    level : float or None
        From which probability on a block belongs to it; None of all that is alike and connected.
    volume_mm3 : float or None
        Approximate volume; None of all that is alike, as long as nobody has asked for that.
    number : int
        1 the likeliest, 2 a part of it, 3 all that is alike and connected.
    """

    level: float | None
    volume_mm3: float | None
    number: int = LIKELIEST


class Levels:
    """Objects around a click by the probability from which on a block belongs to them.

    Parameters
    ----------
    probability : ndarray (nz, ny, nx) float32
        Of the blocks of a window.
    window : Window

    Attributes
    ----------
    window : Window
    blocks : ndarray (nz, ny, nx) float32
        Of each block the largest probability at which it is connected to the click.
    """

    def __init__(self, probability: Singles, window: Window) -> None:
        self.window = window
        top = np.where(window.mine, np.float32(1.0), probability)
        start = np.where(window.mine, top, np.float32(0.0))
        self.blocks: Singles = reconstruction(start, top, "dilation").astype(np.float32)
        self._sorted = np.sort(self.blocks.ravel())[::-1]

    def volume(self, level: float) -> float:
        """Volume (mm3) of the blocks connected to the click at a level."""
        return float(np.searchsorted(-self._sorted, -level, "left")) * self.window.block_mm3

    def volume_spread(self) -> float:
        """Logarithm of the volume from a low probability on over that from a high one."""
        return float(np.log(max(self.volume(LOW), 1e-9) / max(self.volume(HIGH), 1e-9)))

    def of_volume(self, volume_mm3: float) -> Answer:
        """The answer of about a volume."""
        index = min(max(round(volume_mm3 / self.window.block_mm3), 1), len(self._sorted) - 1)
        return Answer(float(0.5 * (self._sorted[index - 1] + self._sorted[index])), volume_mm3)

    def likeliest(self) -> Answer:
        """The likeliest answer, as large as the scene says that the object may be."""
        found, sizes = self.volume(FROM), self.window.scene.sizes
        wanted = found if sizes is None else min(max(found, sizes[0]), sizes[1])
        return Answer(FROM, found) if wanted == found else self.of_volume(wanted)

    def answers(self) -> tuple[Answer, ...]:
        """The likeliest answer; a part of it, where the volume changes least with the level; all that is alike."""
        first = self.likeliest()
        likeliest = first.volume_mm3
        assert likeliest is not None
        volumes = [self.volume(level) for level in LEVELS]
        parts = [
            (before / max(after, self.window.block_mm3), level, volume)
            for before, level, volume, after in zip(
                volumes, LEVELS[1:], volumes[1:], volumes[2:], strict=False
            )
            if 0.0 < volume <= PART * likeliest
        ]
        part = [Answer(*min(parts)[1:], OF_PART)] if parts else []
        return (first, *part, Answer(None, None, OF_ALIKE))


class Alike(NamedTuple):
    """Box of the images at hand, score on it, below 0 where voxels are alike, and mask of those that are connected."""

    box: Box
    score: Singles
    inside: Mask


def grown(window: Window, box: Box, inside: Mask) -> Alike:
    """All that is alike and connected to an answer.

    Values in the answer, a voxel below its boundary, and in a rim around it give the ratio (p - q)/(p + q) of their
    densities p and q; the score is its negative. Voxels below 0 connected to the answer by faces are alike.

    Parameters
    ----------
    window : Window
        That the answer was found in: it combines the channels.
    box : tuple of slice
        Of the images at hand.
    inside : ndarray of bool
        The answer on the box.

    Raises
    ------
    LeavesWindow
        When it comes near an open face of the scene's part.
    """
    scene = window.scene
    tight = bounding_box(inside)
    assert tight is not None  # the click is in it
    found = placed_at(tight, corner_of(box))
    median, spread, ratio = _learned(window, found, inside[tight])
    shape, margin = scene.shape, [(s.stop - s.start) // 4 + 4 for s in found]
    while True:
        here = widened(found, shape, margin)
        score = -_ratio_on(window, here, median, spread, ratio)
        mask = on_box(inside, box, here, False)
        is_open = score < 0
        if scene.open is not None:
            is_open &= scene.open[here]
        alike = connected_to(is_open | mask, mask)
        if not _goes_on(alike, here, shape):
            return Alike(here, score, alike)
        margin = [2 * n for n in margin]


def _learned(window: Window, box: Box, inside: Mask) -> tuple[float, float, Singles]:
    """Median and spread of the values in an answer, and the ratio of densities at bins of values in spreads."""
    scene, step = window.scene, window.scene.step
    deep = ndimage.distance_transform_edt(np.pad(inside, 1), sampling=scene.spacing)[
        1:-1, 1:-1, 1:-1
    ]
    core = inside & (deep > 1.01 * step)
    if np.count_nonzero(core) < MIN_VOXELS:
        core = inside
    rim = max(RIM * step, float(deep.max())) + step
    wide = widened(box, scene.shape, [int(np.ceil(rim / h)) for h in scene.spacing])
    inside, core = on_box(inside, box, wide, False), on_box(core, box, wide, False)
    values = _smoothed(window, wide)
    median, spread = robust(values[core])
    spread = max(spread, MIN_RANGE * float(np.ptp(values)), 1e-9)
    apart = ndimage.distance_transform_edt(~inside, sampling=scene.spacing)
    beyond = (apart > 1.01 * step) & (apart <= rim)
    z = np.clip((values - median) / spread, -CUT, CUT)
    return median, spread, likelihood_ratio(z[core], z[beyond])


def _smoothed(window: Window, box: Box) -> Singles:
    """The image on a box, smoothed as if there were no box."""
    scene = window.scene
    sigma = [SMOOTHING * scene.step / h for h in scene.spacing]

    def smooth(part: Box) -> Singles:
        if scene.part is not None:
            scene.part.check_box(part)
        return np.asarray(
            ndimage.gaussian_filter(window.image_on(part), sigma, truncate=REACH), np.float32
        )

    return with_halo(smooth, box, scene.shape, [int(REACH * s + 0.5) for s in sigma])


def _ratio_on(window: Window, box: Box, median: float, spread: float, ratio: Singles) -> Singles:
    z = np.clip((_smoothed(window, box) - np.float32(median)) / np.float32(spread), -CUT, CUT)
    return at_bins(z, ratio).astype(np.float32)


def _goes_on(mask: Mask, box: Box, shape: tuple[int, int, int]) -> bool:
    """Test if a mask touches a face of its box beyond which the images go on."""
    for axis, (side, n) in enumerate(zip(box, shape, strict=True)):
        ends = np.moveaxis(mask, axis, 0)
        if (side.start > 0 and ends[0].any()) or (side.stop < n and ends[-1].any()):
            return True
    return False
