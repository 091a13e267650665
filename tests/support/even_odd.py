"""A plain rasteriser of contours: a point is inside when a ray from it meets the contours an odd number of times."""

import numpy as np


def inside(loops, points):
    """Which points (n, 2) are inside an odd number of loops (m, 2), joined at their ends."""
    odd = np.zeros(len(points), bool)
    u, v = points.T
    for loop in loops:
        for (u0, v0), (u1, v1) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            if v0 != v1:
                crosses = (v0 <= v) != (v1 <= v)
                odd ^= crosses & (u < u0 + (v - v0) * (u1 - u0) / (v1 - v0))
    return odd


def area(loops):
    """Of what is inside: outer loops less holes, of (m, 2); a loop inside an odd number of others is a hole."""
    total = 0.0
    for number, loop in enumerate(loops):
        others = [other for k, other in enumerate(loops) if k != number]
        hole = sum(bool(inside([other], loop[:1])[0]) for other in others) % 2
        u, v = (loop - loop[0]).T
        size = abs(float(np.sum(u * np.roll(v, -1) - np.roll(u, -1) * v))) / 2
        total += -size if hole else size
    return total
