"""Spacings of the axes that count: an axis of one slice has a thickness, but nothing happens along it."""

from __future__ import annotations

from collections.abc import Sequence


def counted_spacings(shape: Sequence[int], spacing: Sequence[float]) -> tuple[float, ...]:
    """Return the spacings (mm) of the axes with more than one slice, in array order.

    Examples
    --------
    >>> counted_spacings((1, 20, 30), (5.0, 0.5, 0.7))
    (0.5, 0.7)
    """
    return tuple(float(h) for n, h in zip(shape, spacing, strict=True) if n > 1)


def smallest_spacing(shape: Sequence[int], spacing: Sequence[float]) -> float:
    """Return the smallest spacing (mm) among the axes with more than one slice; 1 where there is none."""
    return min(counted_spacings(shape, spacing), default=1.0)


def largest_spacing(shape: Sequence[int], spacing: Sequence[float]) -> float:
    """Return the largest spacing (mm) among the axes with more than one slice; 1 where there is none."""
    return max(counted_spacings(shape, spacing), default=1.0)
