"""Windows of voxels to each side of voxels, alike in mm."""

from __future__ import annotations

from collections.abc import Sequence

from accelsurf.energies.seeded.appearance import Mask, Spacing


def voxels_within(reach: float, spacing: Spacing, shape: Sequence[int]) -> list[int]:
    """Number of voxels in a number of the smallest spacings along each axis, at least 1; 0 along an axis of 1.

    Examples
    --------
    >>> voxels_within(4.0, (3.0, 1.0, 1.0), (9, 9, 9))
    [1, 4, 4]
    >>> voxels_within(4.0, (0.5, 1.0, 1.0), (1, 9, 9))
    [0, 4, 4]
    """
    finest = min((h for h, n in zip(spacing, shape, strict=True) if n > 1), default=1.0)
    return [max(round(reach * finest / h), 1) if n > 1 else 0 for h, n in zip(spacing, shape, strict=True)]


def any_around(mask: Mask, reach: Sequence[int]) -> Mask:
    """Mask of the voxels that have one of a mask in the window of a number of voxels to each side along each axis.

    Examples
    --------
    >>> import numpy as np
    >>> any_around(np.array([[[True, False, False, False]]]), (1, 1, 2)).astype(int).tolist()
    [[[1, 1, 1, 0]]]
    """
    for axis, half in enumerate(reach):
        # To one side and to the other; the window doubles, the last time it grows by what is missing.
        for step in (1, -1):
            reached, most = 0, min(half, mask.shape[axis] - 1)
            while reached < most:
                more = min(reached or 1, most - reached)
                mask, reached = _with_shifted(mask, axis, step * more), reached + more
    return mask


def _with_shifted(mask: Mask, axis: int, by: int) -> Mask:
    """A mask and the same moved along an axis; nothing comes in from beyond the border."""
    out = mask.copy()
    to, of = (slice(by, None), slice(None, -by)) if by > 0 else (slice(None, by), slice(-by, None))
    before = (slice(None),) * axis
    out[(*before, to)] |= mask[(*before, of)]
    return out
