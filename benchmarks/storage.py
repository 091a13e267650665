"""Window or bricks: how much memory and time would either take to hold psi, slots and image near the surface?

Memory: the box around each object with a margin (a window), and cubes of 8, 16, 32 voxels that hold a voxel within
6 voxels of the surface (bricks), both 12 bytes a voxel: image, psi, slot. Time: what the hot kernels read of psi, dense
or by bricks through a table, in the order of the band. Trees of large phantoms are counted by distances on a coarse
grid. With ``ACCELSURF_VOLUMES`` real objects too, by their references. Writes results/storage.json.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import io
from accelsurf.kernels._jit import kernel
from accelsurf.kernels.simd.cubic import cubic
from accelsurf.levelset import LevelSet
from accelsurf.phantoms import recipes
from benchmarks.large.scene import Scene
from benchmarks.large.voxels import tree_distance

NEAR, MARGIN, SIDES, BYTES = 6.0, 12, (8, 16, 32), 12
#: Neighbours beyond a brick that a copy beside it would need, so that a kernel reads one brick only, voxels.
HALO = 2
#: Bytes of the table for each brick of the volume, and of a cell of the band in a whole run: the fit of
#: `scripts/benchmark memory` (results/benchmark_memory.json). The band has half as many cells as are within `NEAR`.
TABLE_BYTES, ROW_BYTES = 4, 156
#: Name in the table, file, labels of its reference (none: all above 0).
REAL = (
    ("brain (niivue mri_brain256)", "mri_brain256", ()),
    ("white matter (niivue mri_brain256)", "mri_brain256", (2, 41, 77, 251, 252, 253, 254, 255)),
    ("liver (TotalSegmentator tests, 20 slices)", "ct_abdomen_hires", (5,)),
    ("aorta (TotalSegmentator tests, 20 slices)", "ct_abdomen_hires", (52,)),
    ("cord (sct_testing_data)", "mri_cord_iso", ()),
    ("all nuclei as one (plant-seg tests)", "fluo_nuclei1136", ()),
    ("one nucleus (plant-seg tests)", "fluo_nuclei1136", None),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "-o", "--output", type=Path, default=Path(__file__).parent / "results" / "storage.json"
    )
    parser.add_argument("--sizes", default="512,1024,2048", help="of the trees")
    parser.add_argument("--repeats", type=int, default=15)
    given = parser.parse_args()
    rows = [*real_objects(), *phantoms(), *(tree(int(size)) for size in given.sizes.split(","))]
    for row in rows:
        bricks = ", ".join(f"{mib(row['bricks'][str(side)]['bytes'])}" for side in SIDES)
        band, window = mib(row["band_rows_bytes"]), mib(row["window_bytes"])
        print(f"{row['object']:45s} MiB: band {band}, window {window}, bricks {bricks}", flush=True)
    times = access_times(given.repeats)
    print(json.dumps(times, indent=1))
    given.output.write_text(
        json.dumps({"what": __doc__, "objects": rows, "access": times}, indent=1) + "\n"
    )


def mib(count: int) -> str:
    return f"{count / 2**20:9.1f}"


def counted(
    name: str, shape: tuple[int, ...], box: list[slice], near: Callable[[int], int], band: int
) -> dict[str, Any]:
    """A row of the table; ``near(side)`` is the number of bricks that hold something near the surface."""
    sides = [
        min(s.stop + MARGIN, n) - max(s.start - MARGIN, 0) for s, n in zip(box, shape, strict=True)
    ]
    window = int(np.prod(sides)) * BYTES
    bricks = {}
    for side in SIDES:
        count = near(side)
        table = int(np.prod([-(-n // side) for n in shape])) * TABLE_BYTES
        taken = count * side**3 * BYTES + table
        bricks[str(side)] = {
            "count": count,
            "bytes": taken,
            "bytes_with_halo": count * (side + 2 * HALO) ** 3 * BYTES + table,
            "window_over_bricks": round(window / taken, 2),
        }
    return {
        "object": name,
        "shape": list(shape),
        "voxels": int(np.prod(shape)),
        "window_bytes": window,
        "whole_bytes": int(np.prod(shape)) * BYTES,
        "band_voxels": band,
        "band_rows_bytes": band // 2 * ROW_BYTES,
        "bricks": bricks,
    }


def of_mask(name: str, inside: NDArray[np.bool_]) -> dict[str, Any]:
    """A row for an object whose voxels are given."""
    box = ndimage.find_objects(inside.astype(np.uint8))[0]
    grown = tuple(slice(max(s.start - 40, 0), s.stop + 40) for s in box)
    part = inside[grown]
    distance = ndimage.distance_transform_edt(part) + ndimage.distance_transform_edt(~part)
    cells = np.argwhere(distance <= NEAR) + [s.start for s in grown]

    def near(side: int) -> int:
        return len(np.unique(cells // side, axis=0))

    return counted(name, inside.shape, list(box), near, len(cells))


def real_objects() -> list[dict[str, Any]]:
    """Objects of public scans, where the folder is named."""
    folder = os.environ.get("ACCELSURF_VOLUMES")
    rows = []
    for name, file, labels in REAL if folder else ():
        array = np.asarray(io.read(Path(str(folder)) / f"{file}_ref.nii.gz").array)
        if labels is None:  # the one of middle size
            ids, sizes = np.unique(array[array > 0], return_counts=True)
            rows.append(of_mask(name, array == ids[np.argsort(sizes)[len(ids) // 2]]))
        else:
            rows.append(of_mask(name, np.isin(array, labels) if labels else array > 0))
    return rows


def phantoms() -> list[dict[str, Any]]:
    """Objects of recipes, and a ball that fills its volume."""
    rows = []
    for name in ("torus", "vessel", "ball"):
        made = recipes.make(recipes.load_recipe(name))
        rows.append(of_mask(f"{name} (accelsurf synth)", np.asarray(made.truth.array) > 0))
    at = np.indices((256,) * 3, np.float32) - 127.5
    rows.append(of_mask("ball of radius 80 in 256^3", (at**2).sum(axis=0) < 80.0**2))
    return rows


def tree(size: int) -> dict[str, Any]:
    """The tree of a large phantom, by distances at the centres of bricks and of cubes of 4 voxels.

    A brick counts where its centre is so near to the surface as a ball of its volume, which is exact to a few percent.
    """
    scene = Scene.of(size, cells=0)
    ends, radius = scene.capsules[:, :6].reshape(-1, 2, 3), scene.capsules[:, 6:]
    low, high = (ends.min(axis=1) - radius).min(axis=0), (ends.max(axis=1) + radius).max(axis=0)
    box = [slice(max(int(a), 0), min(int(b) + 1, size)) for a, b in zip(low, high, strict=True)]

    def near(side: int) -> int:
        within = NEAR + 0.62 * side
        return int(np.count_nonzero(np.abs(tree_distance(scene, side, within + side)) <= within))

    step = 1 if size <= 512 else 4
    band = int(np.count_nonzero(np.abs(tree_distance(scene, step, 2 * NEAR)) <= NEAR)) * step**3
    return counted(f"tree of {size}^3", (size,) * 3, box, near, band)


# ----------------------------------------------------------------------------------------------------------- time


@kernel
def read_dense(psi, shape, cells, closest_points, out):
    """Cubic value and slopes at each cell's closest point."""
    ny, nx = shape[1], shape[2]
    for i in range(len(cells)):
        bz = int(closest_points[i, 0]) - 1
        by = int(closest_points[i, 1]) - 1
        bx = int(closest_points[i, 2]) - 1
        uz = closest_points[i, 0] - bz
        uy = closest_points[i, 1] - by
        ux = closest_points[i, 2] - bx
        value, gz, gy, gx = cubic(psi, (bz * ny + by) * nx + bx, nx, ny * nx, uz, uy, ux)
        out[i] = value + gz + gy + gx


@kernel
def read_table(psi, table, bricks, bits, closest_points, out):
    """The same by bricks: 4^3 neighbours are copied row by row through the table, then computed with."""
    low = (1 << bits) - 1
    local = np.empty(64, np.float32)
    for i in range(len(closest_points)):
        bz = int(closest_points[i, 0]) - 1
        by = int(closest_points[i, 1]) - 1
        bx = int(closest_points[i, 2]) - 1
        uz = closest_points[i, 0] - bz
        uy = closest_points[i, 1] - by
        ux = closest_points[i, 2] - bx
        if (
            bz & low <= low - 3 and by & low <= low - 3 and bx & low <= low - 3
        ):  # one brick has them all
            brick = table[((bz >> bits) * bricks[1] + (by >> bits)) * bricks[2] + (bx >> bits)]
            at = (((((brick << bits) + (bz & low)) << bits) + (by & low)) << bits) + (bx & low)
            value, gz, gy, gx = cubic(psi, at, 1 << bits, 1 << (2 * bits), uz, uy, ux)
        else:
            for a in range(4):
                for b in range(4):
                    z, y = bz + a, by + b
                    row = ((z >> bits) * bricks[1] + (y >> bits)) * bricks[2]
                    inner = (((z & low) << bits) + (y & low)) << bits
                    for c in range(4):
                        x = bx + c
                        local[16 * a + 4 * b + c] = psi[
                            (table[row + (x >> bits)] << (3 * bits)) + inner + (x & low)
                        ]
            value, gz, gy, gx = cubic(local, 0, 4, 16, uz, uy, ux)
        out[i] = value + gz + gy + gx


@kernel
def read_halo(psi, table, bricks, bits, closest_points, out):
    """The same by bricks that have their neighbours' outer voxels beside their own."""
    low, wide = (1 << bits) - 1, (1 << bits) + 4
    for i in range(len(closest_points)):
        bz = int(closest_points[i, 0]) - 1
        by = int(closest_points[i, 1]) - 1
        bx = int(closest_points[i, 2]) - 1
        uz = closest_points[i, 0] - bz
        uy = closest_points[i, 1] - by
        ux = closest_points[i, 2] - bx
        # the brick of the second node
        z = bz + 1
        y = by + 1
        x = bx + 1
        brick = table[((z >> bits) * bricks[1] + (y >> bits)) * bricks[2] + (x >> bits)]
        at = ((brick * wide + (z & low) + 1) * wide + (y & low) + 1) * wide + (x & low) + 1
        value, gz, gy, gx = cubic(psi, at, wide, wide * wide, uz, uy, ux)
        out[i] = value + gz + gy + gx


@kernel
def cross_dense(psi, shape, cells, out):
    """Two neighbours to each side along each axis, as the differences read them."""
    row, plane = shape[2], shape[1] * shape[2]
    for i in range(len(cells)):
        c = cells[i]
        out[i] = (
            psi[c - 2 * plane]
            + psi[c - plane]
            + psi[c + plane]
            + psi[c + 2 * plane]
            + psi[c - 2 * row]
            + psi[c - row]
            + psi[c + row]
            + psi[c + 2 * row]
            + psi[c - 2]
            + psi[c - 1]
            + psi[c + 1]
            + psi[c + 2]
        )


@kernel
def cross_table(psi, table, bricks, bits, places, out):
    """The same by bricks, from the (z, y, x) of each cell: a step within the brick, through the table at its faces."""
    low = (1 << bits) - 1
    by_plane, by_row = 1 << (2 * bits), 1 << bits
    for i in range(len(places)):
        z, y, x = places[i]
        lz = z & low
        ly = y & low
        lx = x & low
        above = ((z >> bits) * bricks[1] + (y >> bits)) * bricks[2] + (x >> bits)
        c = (table[above] << (3 * bits)) + (lz << (2 * bits)) + (ly << bits) + lx
        total = np.float32(0.0)
        if lz >= 2 and ly >= 2 and lx >= 2 and lz <= low - 2 and ly <= low - 2 and lx <= low - 2:
            for d in (-2, -1, 1, 2):
                total += psi[c + d * by_plane] + psi[c + d * by_row] + psi[c + d]
        else:
            for d in (-2, -1, 1, 2):
                for axis in range(3):
                    a = z + d * (axis == 0)
                    b = y + d * (axis == 1)
                    e = x + d * (axis == 2)
                    brick = table[((a >> bits) * bricks[1] + (b >> bits)) * bricks[2] + (e >> bits)]
                    total += psi[
                        (brick << (3 * bits))
                        + ((a & low) << (2 * bits))
                        + ((b & low) << bits)
                        + (e & low)
                    ]
        out[i] = total


def bricks_of(
    psi: NDArray[np.float32], cells: NDArray[np.int64], side: int, halo: int
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Values of the bricks that hold a cell or a neighbour, and the table of their numbers (-1: none)."""
    counts = np.array(psi.shape) // side
    held = np.zeros(counts, bool)
    held[tuple((cells // side).T)] = True
    held = ndimage.binary_dilation(held, np.ones((3, 3, 3)))
    table = np.where(held, np.cumsum(held).reshape(held.shape) - 1, -1)
    padded = np.pad(psi, halo, mode="edge")
    values = [
        padded[tuple(slice(at * side, at * side + side + 2 * halo) for at in place)].ravel()
        for place in np.argwhere(held)
    ]
    return np.concatenate(values), table.ravel()


def access_times(repeats: int, size: int = 256, radius: float = 80.0) -> dict[str, Any]:
    """Nanoseconds of a read, one thread, programs in turns; ratios are medians over the turns."""
    numba.set_num_threads(1)
    at = np.indices((size,) * 3, np.float32) - (size - 1) / 2
    bumpy = radius + 3 * np.sin(at[0] / 5) * np.sin(at[1] / 7)
    surface = LevelSet((np.sqrt((at**2).sum(axis=0)) - bumpy).astype(np.float32), (1.0, 1.0, 1.0))
    surface.redistance()
    psi = surface.psi
    cells = surface.band.cells.astype(np.int64)
    places = np.stack(np.unravel_index(cells, psi.shape), axis=1).astype(np.int64)
    closest_points = np.ascontiguousarray(places + surface.band.to_closest, np.float32)
    shape = np.array(psi.shape, np.int64)
    flat = psi.ravel()
    programs: dict[str, Callable[[NDArray[np.float32]], None]] = {
        "cubic, dense": lambda out: read_dense(flat, shape, cells, closest_points, out),
        "cross, dense": lambda out: cross_dense(flat, shape, cells, out),
    }
    for bits in (3, 4, 5):
        side = 1 << bits
        plain, table = bricks_of(psi, places, side, 0)
        halo, _ = bricks_of(psi, places, side, HALO)
        n = np.array(psi.shape, np.int64) // side
        programs |= {
            f"cubic, bricks of {side}, gathered": lambda out, v=plain, t=table, n=n, b=bits: (
                read_table(v, t, n, b, closest_points, out)
            ),
            f"cubic, bricks of {side}, halo": lambda out, v=halo, t=table, n=n, b=bits: read_halo(
                v, t, n, b, closest_points, out
            ),
            f"cross, bricks of {side}": lambda out, v=plain, t=table, n=n, b=bits: cross_table(
                v, t, n, b, places, out
            ),
        }
    return _in_turns(programs, len(cells), repeats)


def _in_turns(
    programs: dict[str, Callable[[NDArray[np.float32]], None]], count: int, repeats: int
) -> dict[str, Any]:
    """Time programs one after the other, again and again; all must find what the dense one of their kind finds."""
    out, first = np.empty(count, np.float32), {}
    for name, program in programs.items():
        program(out)
        kind = name.split(",")[0]
        np.testing.assert_allclose(out, first.setdefault(kind, out.copy()), atol=2e-4)
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in programs.items():
            began = time.thread_time()
            program(out)
            seconds[name].append(time.thread_time() - began)
    found = {}
    for name, taken in seconds.items():
        dense = seconds[f"{name.split(',')[0]}, dense"]
        found[name] = {
            "ns": round(statistics.median(taken) / count * 1e9, 2),
            "times_dense": round(
                statistics.median(a / b for a, b in zip(taken, dense, strict=True)), 2
            ),
        }
    return {"cells": count, "programs": found}


if __name__ == "__main__":
    main()
