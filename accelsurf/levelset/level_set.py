"""LevelSet: psi near its zero level, with the closest point of every cell, redistanced as it moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import axis_steps
from accelsurf.kernels import band as band_kernels
from accelsurf.kernels import components, differences, motion, region, residues, transport
from accelsurf.kernels.grid import Band, DenseArrays, Grid
from accelsurf.levelset.closest_points import find_closest_points, find_residues
from accelsurf.levelset.extension import (
    CLOSEST_POINT,
    FAST_MARCHING,
    ExtensionTable,
    FrontRows,
    advected,
    extension_table,
    four_columns,
    front_rows,
    sampled,
)
from accelsurf.levelset.fast_marching import UpwindExtension, extension_from, march_outwards
from accelsurf.levelset.measures import (
    BandChange,
    Displacement,
    Measures,
    Motion,
    Snapshot,
    displacement,
)
from accelsurf.levelset.threads import Workers

#: Distance from the surface, in voxels, within which cells count as the front: forces, curvature and kicks
#: are evaluated there; the other band cells get the front's values along the normals. Linear interpolation
#: at a closest point needs cells up to sqrt(3) voxels off.
FRONT_WIDTH = 2.0
#: Components of at most this many voxels are below the resolution of the grid (a ball of radius 1.5 voxels).
MAX_UNRESOLVED = 14
NO_CELLS = np.empty(0, np.int64)


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
        Half width of the band in voxels along the normal; where the spacings differ the band is wider, see `slant`.
    workers : Workers
        The threads to use.
    overwrite : bool
        ``psi`` is not needed any more: its memory is used instead of a copy's.
    extension : {"closest-point", "fast-marching"}
        How distances and fields get from the front to the cells further off, see `levelset.fast_marching`.

    Attributes
    ----------
    requested_half_width, half_width : float
        As given, and as it is with unequal spacings; voxels.
    inside_beyond_band : int
        Number of voxels inside that are not in the band.

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
        extension: str = CLOSEST_POINT,
    ) -> None:
        shape = psi.shape
        self.shape: tuple[int, int, int] = (shape[0], shape[1], shape[2])
        spacings = axis_steps(self.shape, spacing)
        # Nothing happens along an axis of one voxel: for the kernels it is as fine as the others, and the thickness
        # of the slice only scales volumes and areas.
        steps = [
            float(h) if n > 1 else min(spacings) for n, h in zip(self.shape, spacing, strict=True)
        ]
        self.grid = Grid(*self.shape, *steps)
        self._thickness = math.prod(spacing) / math.prod(steps)
        # A stencil across a slanted surface extends further, in voxels along the normal, the less the spacings are
        # alike: at most by |n/h| |h n| <= (ratio + 1/ratio)/2 (Kantorovich).
        self.slant = 0.5 * (max(spacings) / min(spacings) + min(spacings) / max(spacings))
        self._set_half_width(half_width)
        self.workers = workers or Workers(1)
        self.extension = extension
        self._extension: ExtensionTable | UpwindExtension | None = None
        self._rows: FrontRows | None = None
        self._measured: Measures | None = None
        self._fronts: dict[float, np.ndarray] = {}
        dense = np.array(psi, dtype=np.float32, order="C", copy=None if overwrite else True).ravel()
        self.dense = DenseArrays(dense, np.full(dense.size, -1, np.int32))
        self._build_band()

    def _set_half_width(self, half_width: float) -> None:
        """Half width of the band in voxels along the normal, as the constructor was given it."""
        self.requested_half_width, self.half_width = (
            float(half_width),
            float(half_width) * self.slant,
        )
        self.gamma = np.float32(self.half_width * max(self.spacings, default=1.0))

    def _build_band(self) -> None:
        workers = self.workers
        psi = self.dense.psi
        voxels = self.dense.psi.size
        rows = self.shape[0] * self.shape[1]
        row_inside, counts = np.empty(rows, np.int32), np.empty(rows, np.int64)
        workers.parallel(band_kernels.count_inside, rows, psi, self.grid, row_inside)
        workers.parallel(band_kernels.count_front, rows, psi, self.grid, row_inside, counts)
        ends = np.cumsum(counts)
        cells = np.empty(int(counts.sum()), np.int64)
        workers.parallel(band_kernels.front_cells, rows, psi, self.grid, row_inside, ends, cells)
        self.dense.slot[cells] = np.arange(cells.size, dtype=np.int32)
        self.band = Band(cells, psi[cells], np.zeros((cells.size, 3), np.float32))
        inside = int(row_inside.sum(dtype=np.int64))
        self.inside_beyond_band = inside - int(np.count_nonzero(self.band.psi < 0))
        self._residues: np.ndarray | None = None
        self._was_distance = False
        self.redistance()
        workers.parallel(band_kernels.flatten_beyond, voxels, self.dense, self.gamma)

    # -- properties ----------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of band cells."""
        return int(self.band.cells.size)

    @property
    def psi(self) -> np.ndarray:
        """Signed distance (nz, ny, nx), float32, mm; a read-only view, +-gamma outside the band."""
        view = self.dense.psi.reshape(self.shape)
        view.setflags(write=False)
        return view

    @property
    def labels(self) -> np.ndarray:
        """Voxels whose centre is inside, uint8 (nz, ny, nx)."""
        return (self.dense.psi < 0).view(np.uint8).reshape(self.shape)

    @property
    def spacings(self) -> tuple[float, ...]:
        """Spacing (mm) along each axis with more than one slice, in the order z, y, x."""
        grid = self.grid
        return axis_steps(self.shape, (grid.hz, grid.hy, grid.hx))

    @property
    def smallest_spacing(self) -> float:
        """Smallest of `spacings`, mm."""
        return min(self.spacings)

    @property
    def largest_spacing(self) -> float:
        """Largest of `spacings`, mm."""
        return max(self.spacings)

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel, mm3."""
        return self.grid.hz * self.grid.hy * self.grid.hx * self._thickness

    def front(self, width: float = FRONT_WIDTH) -> np.ndarray:
        """Mask (n,) of the band cells within ``width`` voxels of the surface; cached, not to be changed."""
        if width not in self._fronts:
            mask = np.empty(self.size, np.bool_)
            self.workers.parallel(
                band_kernels.front_mask, self.size, self.grid, self.band, width, mask
            )
            self._fronts[width] = mask
        return self._fronts[width]

    def curvature(self, front: np.ndarray) -> np.ndarray:
        """Sum of the principal curvatures (1/mm) of the surface at the closest point of every front cell, (n,)."""
        return self._extended_to(front, self._measures().curvature)

    def area_variation(self, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """First variation of the area within the volume, per area (1/mm), at every front cell's closest point, (n,).

        dA = -int (variation x d) dA for a motion d inward. It is the ``curvature``, from `curvature`, but at the
        border: there it also has the force on the contact line that turns the surface to a right angle.
        """
        measures = self._measures()
        if np.array_equal(measures.variation, measures.curvature):
            return curvature
        return self._extended_to(front, measures.variation)

    def _extended_to(self, front: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """A measure of the band on the ``front`` (n,), where it could not be measured from nearer cells."""
        resolved = self._measures().resolved
        out = measured.copy()
        off = np.flatnonzero(front & ~resolved)
        extension_table(self, resolved, off).extend(self.workers, out)
        out[~front] = 0.0
        return out

    def fraction_and_area(self) -> tuple[np.ndarray, np.ndarray]:
        """Share of each band voxel that is inside, and its part of the surface's area (mm2), both (n,) float64.

        The area is smeared over 1.5 voxels: sums vary by 1e-4 as a smooth surface moves through the grid. In
        strong noise, where distances to several walls meet, it is a few percent below the mesh's.
        """
        measures = self._measures()
        return measures.fraction, measures.area

    def _measures(self) -> Measures:
        """Return the measures of the present band: computed once, cached until psi changes."""
        if self._measured is None:
            fraction, area = np.empty(self.size), np.empty(self.size)
            curvature, variation = np.empty(self.size, np.float32), np.empty(self.size, np.float32)
            # A stencil needs psi sqrt(2) voxels further off, and beyond the band psi is no distance.
            within = min(self.half_width - 1.42 * self.slant, FRONT_WIDTH)
            out = fraction, area, curvature, variation
            self.workers.parallel(
                region.measure_band, self.size, self.dense.psi, self.grid, self.band, within, out
            )
            area *= self._thickness
            self._measured = Measures(*out, self.front(within))
        return self._measured

    def volume(self, fraction: np.ndarray) -> float:
        """Volume inside (mm3), ``fraction`` being the shares of `fraction_and_area`."""
        return (self.inside_beyond_band + float(fraction.sum())) * self.voxel_volume

    def extent(self, inside_only: bool = False) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First voxel (3,) of the band, or of its voxels inside, and the one after the last; both 0 without any."""
        cells, out = (
            self.band.cells[self.band.psi < 0] if inside_only else self.band.cells,
            np.zeros((2, 3), np.int64),
        )
        if cells.size:
            self.workers.serial(band_kernels.extent, cells, self.grid, out)
        return out[0], out[1]

    @property
    def is_filled(self) -> bool:
        """True if there is no surface because everything is inside."""
        return self.size == 0 and bool(self.dense.psi[0] < 0)

    def snapshot(self) -> Snapshot:
        """The present band, for `distance_from`."""
        return Snapshot(self.band.cells, self.band.psi)

    def distance_from(self, before: Snapshot) -> Displacement:
        """Distance of the surface from an earlier one, see `displacement`."""
        return displacement(self, before)

    # -- motion --------------------------------------------------------------------------------------------

    def advance(self, speed: np.ndarray, dt: float) -> None:
        """psi_t = beta |grad psi| for one step with the speeds ``speed`` (n,), beta > 0 shrinking.

        |grad psi| by Godunov's upwind choice at the front; 1 further off, where psi was a distance.
        """
        self._find_residues()
        norm = np.empty(self.size, np.float32)
        front = self.front()
        parallel = self.workers.parallel
        parallel(
            differences.upwind_norms,
            self.size,
            self.dense.psi,
            self.grid,
            self.band,
            speed,
            front,
            norm,
        )
        parallel(
            motion.advance_psi, self.size, self.dense.psi, self.band, speed, norm, np.float32(dt)
        )

    def advect(self, velocity: np.ndarray, dt: float) -> None:
        """psi_t = -V . grad psi for one step with the extended velocity ``velocity`` (n, 3), mm per unit time.

        Semi-Lagrangian: psi at the point that the velocity takes to each cell, by cubic interpolation.
        """
        out = np.empty(self.size, np.float32)
        where = self.dense, self.grid, self.band
        self.workers.parallel(
            transport.advect_psi, self.size, *where, four_columns(velocity), dt, out
        )
        self.dense.psi[self.band.cells] = out
        # The interpolation at the departure points errs too: its residue at the points that V moved is known now.
        self._residues = None
        self._find_residues(Motion(velocity, dt))

    def normals(self) -> np.ndarray:
        """Inward unit normal N (n, 3), z y x, of the surface at the closest point of every cell."""
        out = np.empty((self.size, 3), np.float32)
        self.workers.parallel(
            transport.normals, self.size, self.dense.psi, self.grid, self.band, out
        )
        return out

    def remove_small(self, held: np.ndarray = NO_CELLS) -> int:
        """Remove components, inside or outside, of at most `MAX_UNRESOLVED` voxels, but those with ``held`` cells.

        Returns how many. Between `advance` and `redistance`: signs are flipped, distances follow in the latter.
        """
        self._find_residues()
        depth = 2.0 * max(self.grid.hz, self.grid.hy, self.grid.hx)
        where, (peak, flipped) = (
            (self.dense, self.grid, self.band),
            np.zeros((2, self.size), np.bool_),
        )
        self.workers.parallel(components.find_peaks, self.size, *where, depth, peak)
        inside, outside, _ = self.workers.serial(
            components.small_components, *where, np.flatnonzero(peak), MAX_UNRESOLVED, held, flipped
        )
        if inside + outside:
            here, marked = (self.dense.slot, self.grid), np.zeros(self.size, np.bool_)
            self.workers.serial(
                residues.mark_below, 0, self.size, *here, self.band.cells, flipped, marked
            )
            marks = (flipped, marked), self._residues
            self.workers.parallel(residues.drop_residues, self.size, *here, self.band, *marks)
        return int(inside + outside)

    def extend_outwards(self, values: np.ndarray, front: np.ndarray) -> None:
        """Overwrite ``values`` (n,) off the front by the front's, constant along normals."""
        # Cached for the next field with the same mask.
        if self._extension is None or self._extension.front is not front:
            self._extension = extension_from(self, front)
        self._extension.extend(self.workers, values)

    def front_rows(self, front: np.ndarray, component: int = -1) -> FrontRows:
        """The ``front`` (n,) and the cells beside it in rows, with an extension fit for second differences; cached.

        Of a scalar, or (0, 1, 2) of a vector's component along z, y, x: the border mirrors it with the other sign.
        """
        if self._rows is None or self._rows.front is not front:
            self._rows = front_rows(self, front)
        return self._rows if component < 0 else self._rows.turned(self, component)

    def redistance(
        self, fields: Sequence[np.ndarray] = (), advection: Motion | None = None
    ) -> BandChange:
        """Make psi a distance again about its zero level, move the band after it, extend ``fields``.

        Parameters
        ----------
        fields : sequence of ndarray (n,)
            Values on the present band. Each comes back on the new band, constant along normals: at the front by its
            value at the closest point of every cell, further off as `extend_outwards` has it.
        advection : Motion, optional
            The motion since the last redistancing, when the fields are advected with it: they are then
            sampled at the point that moved to the closest point.

        Returns
        -------
        BandChange
        """
        parallel, n = self.workers.parallel, self.size
        marching = self.extension == FAST_MARCHING
        cells, to_closest, state, total = (march_outwards if marching else find_closest_points)(
            self
        )
        keep = np.empty(total, np.bool_)
        known = cells, to_closest, state
        parallel(
            band_kernels.keep_mask, total, self.dense.psi, self.grid, known, self.half_width, keep
        )
        entered = n + np.flatnonzero(keep[n:])
        entered = entered[np.argsort(cells[entered], kind="stable")]
        order = self.workers.serial(band_kernels.merged_order, cells, n, keep, entered)

        size = order.size
        new = Band(
            np.empty(size, np.int64), np.empty(size, np.float32), np.empty((size, 3), np.float32)
        )
        old = Band(cells, self.band.psi, to_closest)
        parallel(band_kernels.gather_band, size, self.dense.psi, self.grid, order, old, new)
        front = np.empty(size, np.bool_)
        parallel(band_kernels.front_mask, size, self.grid, new, FRONT_WIDTH, front)
        extended = (
            sampled(self, new, front, fields)
            if advection is None
            else advected(self, new, fields, advection)
        )

        entered_cells, left_cells = cells[entered], cells[:n][~keep[:n]]
        change = BandChange(
            entered_cells[self.dense.psi[entered_cells] < 0],
            left_cells[self.dense.psi[left_cells] < 0],
            extended,
        )
        self.inside_beyond_band += change.left_inside.size - change.entered_inside.size
        parallel(band_kernels.drop_cells, total, self.dense, cells, keep, self.gamma)
        parallel(band_kernels.store_band, size, self.dense, new)
        self._replace_band(new)
        self._fronts = {FRONT_WIDTH: front}
        if advection is None or marching:
            for field in extended:
                self.extend_outwards(field, front)
        return change

    @property
    def residues(self) -> np.ndarray | None:
        """Psi (mm) interpolated at the closest point of every cell, (n,) float32, see `kernels.residues`.

        None until psi is a distance.
        """
        if self._was_distance:
            self._find_residues()
        return self._residues

    def _find_residues(self, motion: Motion | None = None) -> None:
        """Find the residues if they are not known: of psi as a distance, or moved by ``motion`` since."""
        if self._residues is None:
            self._residues = find_residues(self, motion or Motion(self.band.to_closest, 0.0))

    def _replace_band(self, band: Band) -> None:
        """Replace the band by the one in the dense arrays, and clear the caches for the old one."""
        self.band = band
        self._extension = None
        self._rows = None
        self._measured = None
        self._fronts = {}
        # Found when psi moves, as `advect` replaces them.
        self._residues, self._was_distance = None, True

    def restore(
        self, band: Band, inside: np.ndarray, inside_beyond_band: int, half_width: float
    ) -> None:
        """Go back to an earlier surface on the same grid.

        Parameters
        ----------
        band : Band
        inside : ndarray (nz * ny * nx,) of bool
            Side of every voxel beyond the band; those in it do not count.
        inside_beyond_band : int
            How many voxels beyond the band are inside.
        half_width : float
            As the constructor was given it.
        """
        self._set_half_width(half_width)
        self.dense.psi.fill(self.gamma)
        np.copyto(self.dense.psi, -self.gamma, where=inside)
        self.dense.slot.fill(-1)
        self.inside_beyond_band = inside_beyond_band
        self.workers.parallel(band_kernels.store_band, band.cells.size, self.dense, band)
        self._replace_band(band)

    def reinitialize(self, half_width: float) -> None:
        """Redistance the dense psi after a change from outside: any function is valid, as in the constructor."""
        self.dense.slot[self.band.cells] = -1
        self._set_half_width(half_width)
        self._build_band()
