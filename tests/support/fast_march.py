"""A plain fast march, in Python: the reference of the fast march away from the volume's border."""

from __future__ import annotations

import heapq
import itertools

import numpy as np

from accelsurf.kernels import fast_marching

Voxel = tuple[int, int, int]


class PlainMarch:
    """Distances (mm, signed) and values carried from ``start`` outwards; a field is extended as a cell is accepted.

    ``inside`` bool array; ``start`` {voxel: (distance, closest point (z, y, x) mm from it, value)} of the voxels beside
    the surface; ``order`` has the others as they were accepted.
    """

    def __init__(
        self, inside: np.ndarray, h: tuple[float, ...], start: dict, half_width: float
    ) -> None:
        self.inside, self.h, self.half_width = inside, np.array(h), half_width
        self.known = {p: (abs(d), np.array(f, float), v) for p, (d, f, v) in start.items()}
        self.order: list[Voxel] = []
        queue: list[tuple[float, Voxel]] = []
        for p in start:
            self._hand_on(p, queue)
        while queue:
            _, p = heapq.heappop(queue)
            if p in self.known:
                continue
            self._accept(p)
            if np.linalg.norm(self.known[p][1] / self.h) <= half_width:
                self._hand_on(p, queue)

    def _hand_on(self, p: Voxel, queue: list) -> None:
        for axis, sign in itertools.product(range(3), (-1, 1)):
            q = self._step(p, axis, sign)
            if q is not None and q not in self.known:
                heapq.heappush(queue, (self._estimate(q), q))

    def _step(self, p: Voxel, axis: int, by: int) -> Voxel | None:
        q = list(p)
        q[axis] += by
        return (q[0], q[1], q[2]) if 0 <= q[axis] < self.inside.shape[axis] else None

    def _within(self, q: Voxel | None) -> bool:
        return q in self.known and bool(
            np.linalg.norm(self.known[q][1] / self.h) <= self.half_width
        )

    def _upwind(self, p: Voxel) -> list[tuple[int, int, Voxel]]:
        """(axis, side, voxel) of the nearer known neighbour along each axis."""
        out = []
        for axis in range(3):
            sides = [(s, self._step(p, axis, s)) for s in (-1, 1)]
            near = [(self.known[q][0], s, q) for s, q in sides if self._within(q)]
            if near:
                _, side, q = min(near, key=lambda one: one[0])
                out.append((axis, side, q))
        return out

    @staticmethod
    def _solve(terms: list[tuple[float, float, float]]) -> float:
        """Distance d from rows (d_1, t, e): the largest root of sum ((d - t)/e)^2 = 1, NaN where a d_1 is beyond it."""
        t, w = np.array([one[1] for one in terms]), np.array([one[2] ** -2.0 for one in terms])
        disc = (w * t).sum() ** 2 - w.sum() * ((w * t * t).sum() - 1)
        d = ((w * t).sum() + np.sqrt(disc)) / w.sum() if disc >= 0 else np.nan
        return d if d > max(one[0] for one in terms) else np.nan

    def _estimate(self, p: Voxel) -> float:
        terms = sorted(
            (self.known[q][0], self.known[q][0], self.h[axis]) for axis, _, q in self._upwind(p)
        )
        return next(
            d for n in range(len(terms), 0, -1) if not np.isnan(d := self._solve(terms[:n]))
        )

    def _accept(self, p: Voxel) -> None:
        """Second-order distance, closest point and value of a voxel."""
        rows = []
        for axis, side, q in self._upwind(p):
            d1, h = self.known[q][0], self.h[axis]
            row, beyond = (d1, d1, h), self._step(p, axis, 2 * side)
            if self._within(beyond):
                d2 = self.known[beyond][0] * (1 if self.inside[beyond] == self.inside[q] else -1)
                apart = self.known[beyond][1] - self.known[q][1] + side * h * np.eye(3)[axis]
                if d1 >= d2 and apart @ apart + (d1 - d2) ** 2 <= fast_marching.SAME_SHEET * h * h:
                    row = (d1, (4 * d1 - d2) / 3, 2 * h / 3)
            rows.append((q, beyond if row[2] != h else None, axis, side, row))
        d = self._solve([row[4] for row in rows])
        self.known[p] = (
            min(
                self._estimate(p) if np.isnan(d) else d,
                *(row[4][0] + self.h[row[2]] for row in rows),
            ),
        )
        d = self.known[p][0]
        shares, points, values = [], [], []
        for q, beyond, axis, side, (d1, t, e) in rows:
            w = max(d - t, 0.0) / e**2 if d1 < d else 0.0
            for at, voxels, part in ((q, 1, 4 / 3 if beyond else 1.0), (beyond, 2, -1 / 3)):
                if at is not None:
                    shares.append(w * part)
                    points.append(
                        self.known[at][1] + voxels * side * self.h[axis] * np.eye(3)[axis]
                    )
                    values.append(self.known[at][2])
        share = np.array(shares) / sum(shares)
        closest_point = share @ np.array(points)
        if abs(np.linalg.norm(closest_point) - d) > fast_marching.TRUSTED * d:
            closest_point = min(
                (f for f, s in zip(points, shares, strict=True) if s > 0), key=np.linalg.norm
            )
        value = share @ np.array(values)
        value = np.clip(value, min(values), max(values))
        self.known[p] = (d, closest_point * d / np.linalg.norm(closest_point), float(value))
        self.order.append(p)
