"""LevelSet: psi near its zero level, with the closest point of every cell, kept a distance as it moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.grid.geometry import axis_steps
from accelsurf.kernels import band as band_kernels
from accelsurf.kernels import differences, march, motion, region, transport
from accelsurf.kernels.grid import Band, Grid, Lattice
from accelsurf.levelset.threads import Workers, dot

#: Distance from the surface, in voxels, within which cells count as the front: forces, curvature and kicks
#: are evaluated there; the other band cells get the front's values along the normals. Linear interpolation
#: at a foot reaches sqrt(3) voxels.
FRONT_WIDTH = 2.0
#: Rounds of closest points that are passed on: more than the cells of a way through the band.
MAX_ROUNDS = 64
#: What has come further than so many voxels since an earlier surface is still on its way.
FAR = 2.0
#: Components of at most this many voxels are below what the grid resolves (a ball of radius 1.5 voxels).
SMALLEST = 14


class Change(NamedTuple):
    """What a redistancing did to the band.

    ``entered_inside`` and ``left_inside`` are the raveled cells with psi < 0 that came into the band and
    that left it; ``fields`` are the extended fields on the new band.
    """

    entered_inside: np.ndarray
    left_inside: np.ndarray
    fields: list[np.ndarray]


class Snapshot(NamedTuple):
    """Band cells in raster order and their psi (mm) at one moment."""

    cells: np.ndarray
    psi: np.ndarray


class Shift(NamedTuple):
    """How far a surface has come, voxels: the ``mean`` over its area, and the share of it beyond `FAR`."""

    mean: float
    far: float


class LevelSet:
    """A surface as the zero level of psi on a narrow band.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx)
        Any function negative inside and positive outside; its zero level is the surface. Not modified, unless
        ``overwrite`` says so.
    spacing : sequence of 3 floats
        (hz, hy, hx), mm.
    half_width : float
        Half width of the band in voxels along the normal; where the spacings differ the band is wider, see `_slant`.
    workers : Workers
        The threads to use.
    overwrite : bool
        ``psi`` is not needed any more: its memory is used instead of a copy's.

    Attributes
    ----------
    requested_half_width, half_width : float
        As given, and as it is with unequal spacings; voxels.

    Notes
    -----
    psi is a signed distance (mm) in the band and +-gamma outside it, gamma = half_width x max(h). Cells are
    kept in raster order. After `advance` psi is no distance any more until `redistance` is called.
    """

    def __init__(
        self,
        psi: np.ndarray,
        spacing: Sequence[float],
        half_width: float = 3.0,
        workers: Workers | None = None,
        overwrite: bool = False,
    ) -> None:
        shape = psi.shape
        self.shape: tuple[int, int, int] = (shape[0], shape[1], shape[2])
        steps = axis_steps(self.shape, spacing)
        # Nothing happens along an axis of one voxel: for the kernels it is as fine as the others, and the thickness
        # of the slice only scales volumes and areas.
        own = [float(h) if n > 1 else min(steps) for n, h in zip(self.shape, spacing, strict=True)]
        self.grid = Grid(*self.shape, *own)
        self._thickness = math.prod(spacing) / math.prod(own)
        # A stencil across a slanted surface reaches further, in voxels along the normal, the less the spacings are
        # alike: at most by |n/h| |h n| <= (ratio + 1/ratio)/2 (Kantorovich).
        self._slant = 0.5 * (max(steps) / min(steps) + min(steps) / max(steps))
        self._set_width(half_width)
        self.workers = workers or Workers(1)
        self._outwards: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._measured: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._inner = np.zeros(0, np.bool_)
        self._fronts: dict[float, np.ndarray] = {}
        dense = np.array(psi, dtype=np.float32, order="C", copy=None if overwrite else True).ravel()
        self.dense = Lattice(dense, np.full(dense.size, -1, np.int32))
        self._start()

    def _set_width(self, half_width: float) -> None:
        """Half width of the band in voxels along the normal, as the constructor was given it."""
        steps = axis_steps(self.shape, (self.grid.hz, self.grid.hy, self.grid.hx))
        self.requested_half_width, self.half_width = float(half_width), float(half_width) * self._slant
        self.gamma = np.float32(self.half_width * max(steps))

    def _start(self) -> None:
        count = march.front_cells(self.dense, self.grid, np.empty(0, np.int64))
        cells = np.empty(count, np.int64)
        march.front_cells(self.dense, self.grid, cells)
        self.dense.slot[cells] = np.arange(count, dtype=np.int32)
        self.band = Band(cells, self.dense.psi[cells], np.zeros((count, 3), np.float32))
        voxels = self.dense.psi.size
        inside = int(self.workers.sums(region.inside_count, voxels, 1, self.dense.psi)[0])
        self._inside_beyond_band = inside - int(np.count_nonzero(self.band.psi < 0))
        self.redistance()
        self.workers.run(band_kernels.flatten_beyond, voxels, self.dense, self.gamma)

    # -- what it is ----------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of band cells."""
        return int(self.band.cells.size)

    @property
    def psi(self) -> np.ndarray:
        """Signed distance (nz, ny, nx), float32, mm; a read-only view, +-gamma outside the band."""
        view = self.dense.psi.reshape(self.shape)
        view.flags.writeable = False
        return view

    @property
    def labels(self) -> np.ndarray:
        """Voxels whose centre is inside, uint8 (nz, ny, nx)."""
        return (self.dense.psi < 0).view(np.uint8).reshape(self.shape)

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm3."""
        return self.grid.hz * self.grid.hy * self.grid.hx * self._thickness

    def front(self, width: float = FRONT_WIDTH) -> np.ndarray:
        """Mask (n,) of the band cells within ``width`` voxels of the surface; kept, not to be changed."""
        if width not in self._fronts:
            mask = np.empty(self.size, np.bool_)
            self.workers.run(band_kernels.front_mask, self.size, self.grid, self.band, width, mask)
            self._fronts[width] = mask
        return self._fronts[width]

    def curvature(self, front: np.ndarray) -> np.ndarray:
        """Sum of the principal curvatures (1/mm) of the surface at the foot of every front cell, (n,)."""
        out = self._measures()[2].copy()
        off, slots, shares = self._outward_table(self._inner, np.flatnonzero(front & ~self._inner))
        self.workers.run(band_kernels.extend_outwards, off.size, off, slots, shares, out)
        out[~front] = 0.0
        return out

    def fraction_and_area(self) -> tuple[np.ndarray, np.ndarray]:
        """Share of each band voxel that is inside, and its part of the surface's area (mm2), both (n,) float64.

        The area is smeared over 1.5 voxels: sums vary by 1e-4 as a smooth surface moves through the grid. In
        strong noise, where distances to several walls meet, it is a few percent below the mesh's.
        """
        fraction, area, _ = self._measures()
        return fraction, area

    def _measures(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Shares, areas and curvatures of the band as it is; measured once, kept until psi changes."""
        if self._measured is None:
            fraction, area, bend = np.empty(self.size), np.empty(self.size), np.empty(self.size, np.float32)
            # A stencil reaches sqrt(2) voxels further off, and beyond the band psi is no distance.
            within = min(self.half_width - 1.42 * self._slant, FRONT_WIDTH)
            run = self.workers.run
            run(region.measure_band, self.size, self.dense.psi, self.grid, self.band, within, fraction, area, bend)
            area *= self._thickness
            self._measured, self._inner = (fraction, area, bend), self.front(within)
        return self._measured

    def slopes(self) -> np.ndarray:
        """Godunov's |grad psi|, upwind from the front, at the cells within a voxel of the surface."""
        front, norm = self.front(1.0), np.empty(self.size, np.float32)
        # Upwind from the front: as if every cell moved away from it.
        run = self.workers.run
        run(differences.upwind_norms, self.size, self.dense.psi, self.grid, self.band, -self.band.psi, front, norm)
        return norm[front]

    def foot_residues(self) -> np.ndarray:
        """How far psi is from 0, in voxels of the smallest spacing, at the feet of the cells within a voxel."""
        front, value = self.front(1.0), np.empty(self.size, np.float32)
        self.workers.run(motion.sample_image, self.size, self.dense.psi, self.grid, self.band, front, value)
        return np.asarray(np.abs(value[front]) / min(self.grid.hz, self.grid.hy, self.grid.hx))

    def volume(self, fraction: np.ndarray) -> float:
        """Volume inside (mm3), ``fraction`` being the shares of `fraction_and_area`."""
        return (self._inside_beyond_band + float(fraction.sum())) * self.voxel_volume

    @property
    def is_filled(self) -> bool:
        """Whether there is no surface because everything is inside."""
        return self.size == 0 and bool(self.dense.psi[0] < 0)

    def snapshot(self) -> Snapshot:
        """The band as it is now, for `distance_from`."""
        return Snapshot(self.band.cells, self.band.psi)

    def distance_from(self, before: Snapshot) -> Shift:
        """Distance of the surface from an earlier one, in voxels along the normal and weighted by area.

        Measured at the voxels that the surface cuts now; where the earlier band did not reach, its half
        width counts.
        """
        _, area = self.fraction_and_area()
        on = np.flatnonzero(area)
        if on.size == 0 or before.cells.size == 0:
            return Shift(self.half_width, 1.0)
        at = np.minimum(np.searchsorted(before.cells, self.band.cells[on]), before.cells.size - 1)
        known = before.cells[at] == self.band.cells[on]
        moved = np.abs(self.band.psi[on].astype(np.float64) - before.psi[at])
        foot, h = self.band.foot[on].astype(np.float64), np.array([self.grid.hz, self.grid.hy, self.grid.hx])
        per_mm = np.sqrt(((foot / h) ** 2).sum(axis=1) / np.maximum((foot**2).sum(axis=1), 1e-300))
        voxels = np.where(known, moved * per_mm, self.half_width)
        whole = float(area[on].sum())
        return Shift(dot(area[on], voxels) / whole, float(area[on][voxels > FAR].sum()) / whole)

    # -- how it moves --------------------------------------------------------------------------------------

    def advance(self, speed: np.ndarray, dt: float) -> None:
        """psi_t = beta |grad psi| for one step with the speeds ``speed`` (n,), beta > 0 shrinking.

        |grad psi| by Godunov's upwind choice at the front; 1 further off, where psi was a distance.
        """
        norm = np.empty(self.size, np.float32)
        front = self.front()
        run = self.workers.run
        run(differences.upwind_norms, self.size, self.dense.psi, self.grid, self.band, speed, front, norm)
        run(motion.drift, self.size, self.dense.psi, self.band, speed, norm, np.float32(dt))

    def carry(self, velocity: np.ndarray, dt: float) -> None:
        """psi_t = -V . grad psi for one step with the extended velocity ``velocity`` (n, 3), mm per unit time.

        Semi-Lagrangian: psi at the point that the velocity takes to each cell, by cubic interpolation.
        """
        out = np.empty(self.size, np.float32)
        self.workers.run(transport.carry_psi, self.size, self.dense, self.grid, self.band, velocity, dt, out)
        self.dense.psi[self.band.cells] = out

    def normals(self) -> np.ndarray:
        """Inward unit normal N (n, 3), z y x, of the surface at the foot of every cell."""
        out = np.empty((self.size, 3), np.float32)
        self.workers.run(transport.normals, self.size, self.dense.psi, self.grid, self.band, out)
        return out

    def remove_small(self) -> int:
        """Remove components, inside or outside, of at most `SMALLEST` voxels; returns how many.

        Between `advance` and `redistance`: signs are flipped, distances follow in the latter.
        """
        depth = 2.0 * max(self.grid.hz, self.grid.hy, self.grid.hx)
        peak, where = np.empty(self.size, np.bool_), (self.dense, self.grid, self.band)
        self.workers.run(band_kernels.find_peaks, self.size, *where, depth, peak)
        inside, outside, _ = self.workers.alone(
            band_kernels.small_components, *where, np.flatnonzero(peak), SMALLEST
        )
        return int(inside + outside)

    def extend_outwards(self, values: np.ndarray, front: np.ndarray) -> None:
        """Overwrite ``values`` (n,) off the front by those of the front, constant along normals."""
        # Where each cell reads is kept for the next field with the same mask.
        if self._outwards is None or self._outwards[0] is not front:
            self._outwards = front, *self._outward_table(front, np.flatnonzero(~front))
        self.workers.run(band_kernels.extend_outwards, self._outwards[1].size, *self._outwards[1:], values)

    def _outward_table(self, front: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        off = off.astype(np.int32)
        slots, shares = np.empty((off.size, 8), np.int32), np.empty((off.size, 8), np.float32)
        table = band_kernels.outward_table
        self.workers.run(table, off.size, self.dense.slot, self.grid, self.band, front, off, slots, shares)
        return off, slots, shares

    def redistance(
        self, fields: Sequence[np.ndarray] = (), carried: tuple[np.ndarray, float] | None = None
    ) -> Change:
        """Make psi a distance again about its zero level, move the band after it, extend ``fields``.

        Parameters
        ----------
        fields : sequence of ndarray (n,)
            Values on the present band. Each comes back on the new band, constant along normals: at the front by its
            value at the closest point of every cell, further off as `extend_outwards` has it.
        carried : (velocity (n, 3), dt), optional
            The motion since the last redistancing, when the fields are carried along with it: they are then
            sampled at the point that moved to the closest point.

        Returns
        -------
        Change
        """
        run, n = self.workers.run, self.size
        cells, foot, state, total = self._feet()
        keep = np.empty(total, np.bool_)
        run(band_kernels.keep_mask, total, self.grid, foot, state, self.half_width, keep)
        entered = n + np.flatnonzero(keep[n:])
        entered = entered[np.argsort(cells[entered], kind="stable")]
        order = self.workers.alone(band_kernels.merged_order, cells, n, keep, entered)

        size = order.size
        new = Band(np.empty(size, np.int64), np.empty(size, np.float32), np.empty((size, 3), np.float32))
        old = Band(cells, self.band.psi, foot)
        run(band_kernels.gather_band, size, self.dense.psi, self.grid, order, old, new)
        front = np.empty(size, np.bool_)
        run(band_kernels.front_mask, size, self.grid, new, FRONT_WIDTH, front)
        extended = self._sampled(new, front, fields) if carried is None else self._carried(new, fields, carried)

        entered_cells, left_cells = cells[entered], cells[:n][~keep[:n]]
        change = Change(
            entered_cells[self.dense.psi[entered_cells] < 0], left_cells[self.dense.psi[left_cells] < 0], extended
        )
        self._inside_beyond_band += change.left_inside.size - change.entered_inside.size
        run(band_kernels.drop_cells, total, self.dense, cells, keep, self.gamma)
        run(band_kernels.store_band, size, self.dense, new)
        self.take_band(new)
        self._fronts = {FRONT_WIDTH: front}
        if carried is None:
            for field in extended:
                self.extend_outwards(field, front)
        return change

    def take_band(self, band: Band) -> None:
        """Take up a band that the dense arrays hold already; what was measured on the last one is forgotten."""
        self.band, self._outwards, self._measured, self._fronts = band, None, None, {}

    def reinitialize(self, half_width: float) -> None:
        """Take the dense psi, changed by hand, for any function as the constructor does."""
        self.dense.slot[self.band.cells] = -1
        self._set_width(half_width)
        self._start()

    def _feet(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Closest points of psi as it is: (cells, feet, states, n), the band's slots, then those that may enter."""
        run, grid, dense, n = self.workers.run, self.grid, self.dense, self.size
        # Room for the cells that a step takes in.
        room = n + n // 4 + 1024
        cells, foot, state = np.empty(room, np.int64), np.empty((room, 3), np.float32), np.empty(room, np.int8)
        cells[:n] = self.band.cells
        inner, found = self.gamma - 1.5 * max(grid.hz, grid.hy, grid.hx), np.empty(n, np.int8)
        run(march.find_feet, n, dense, grid, self.band, inner, foot, found)
        run(march.review_feet, n, dense, grid, self.band.cells, foot, found, state)
        known = n
        loose, sources = np.flatnonzero(state[:n] == march.OPEN), np.flatnonzero(state[:n] == march.EDGE)
        stirred = np.zeros(room, np.bool_)
        stirred[loose] = True
        again = []
        for _ in range(MAX_ROUNDS):
            cells, foot, state, stirred, total = self.workers.alone(
                march.spread, dense, grid, cells, foot, state, known, sources, self.half_width, stirred
            )
            loose, known = np.concatenate([loose, np.arange(known, total)]), total
            on = loose[stirred[loose]]
            if on.size == 0:
                break
            better, changed = np.empty((on.size, 3), np.float32), np.empty(on.size, np.bool_)
            was_open = state[on] == march.OPEN
            run(march.pull_feet, on.size, dense, grid, cells, foot, state, on, better, changed)
            run(march.take_feet, on.size, on, better, changed, foot, state)
            # A cell's first foot is polished at once: what it hands on reaches further for it. The others at the end.
            first = on[changed & was_open]
            run(march.polish_feet, first.size, dense.psi, grid, cells, first, foot)
            again.append(on[changed & ~was_open])
            stirred[on] = False
            sources = on[changed]
        later = np.unique(np.concatenate([loose[:0], *again]))
        run(march.polish_feet, later.size, dense.psi, grid, cells, later, foot)
        return cells, foot, state, known

    def _carried(
        self, new: Band, fields: Sequence[np.ndarray], carried: tuple[np.ndarray, float]
    ) -> list[np.ndarray]:
        velocity, dt = carried
        values = np.stack(fields, axis=1).astype(np.float32, copy=False)
        out = np.empty((new.cells.size, len(fields)), np.float32)
        self.workers.run(
            transport.carry_fields, new.cells.size, self.dense.slot, self.grid, new, velocity, dt, values, out
        )
        return [np.ascontiguousarray(out[:, c]) for c in range(len(fields))]

    def _sampled(self, new: Band, front: np.ndarray, fields: Sequence[np.ndarray]) -> list[np.ndarray]:
        if not fields:
            return []
        values = np.stack([np.asarray(field, np.float32) for field in fields])
        out = np.empty((len(fields), new.cells.size), np.float32)
        self.workers.run(
            band_kernels.sample_at_feet, new.cells.size, self.dense.slot, self.grid, new, front, values, out
        )
        return list(out)
