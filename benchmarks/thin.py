"""Does redistancing move what is thin? Slabs, cylinders and balls at rest and on the move, in eleven orientations.

Each case starts from the exact distance at the voxel centres. The displacement is free of the measure's own bias: at
every grid edge that the exact surface crosses, the error of psi, which is a distance, at the edge's two ends is
interpolated to the crossing. It is counted in voxels of the finest axis, positive outwards, more than `MARGIN` voxels
from the border, which slabs and cylinders cross.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.levelset import LevelSet

Floats = NDArray[np.floating[Any]]
SHAPE, MARGIN = (28, 28, 28), 9
UNIT = (1.0, 1.0, 1.0)
#: Normals of the slabs and axes of the cylinders, z y x: along axes, faces' and space diagonals, and oblique.
DIRECTIONS = np.array(
    [
        (1, 0, 0),
        (0, 0, 1),
        (0, 1, 1),
        (1, 1, 0),
        (1, 1, 1),
        (1, 2, 0),
        (1, 2, 3),
        (3, 1, 1),
        (0.31, 0.74, 0.6),
        (0.9, 0.2, -0.39),
        (3, 1, 0),
    ]
)
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]
#: Where the centre lies between voxel centres, of each orientation.
OFFSETS = np.array(
    [
        (0, 0, 0),
        (0.5, 0.5, 0.5),
        (0.25, 0.4, 0.1),
        (0.37, 0.11, 0.72),
        (0.13, 0.81, 0.46),
        (0.5, 0, 0.25),
        (0.05, 0.6, 0.33),
        (0.71, 0.29, 0.9),
        (0.62, 0.18, 0.47),
        (0.33, 0.33, 0.8),
        (0.5, 0.17, 0.29),
    ]
)
#: Widths of slabs and radii of cylinders and balls, mm, by spacing. With unequal spacings slabs are from 1.5 voxels of
#: the coarsest axis on.
SIZES = {
    UNIT: {"slab": (1.5, 2.0, 3.0), "cylinder": (1.0, 1.5, 2.0, 3.0), "ball": (2.5, 4.0, 8.0)},
    (2.0, 1.0, 1.0): {"slab": (3.0, 3.5, 4.0), "cylinder": (2.0, 3.0), "ball": (3.0, 5.0)},
    (1.0, 3.0, 1.0): {"slab": (4.5, 6.0), "cylinder": (3.0, 4.5), "ball": (4.5,)},
    (3.0, 1.5, 1.0): {"slab": (4.5, 6.0), "cylinder": (3.0,), "ball": (4.5,)},
    (4.0, 1.0, 1.0): {"slab": (6.0, 8.0), "cylinder": (4.0,), "ball": (6.0,)},
}
#: Spacings of what moves.
MOVED_SPACINGS = UNIT, (2.0, 1.0, 1.0), (3.0, 1.5, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--count", type=int, default=50, help="redistances, or steps")
    options = parser.parse_args()
    rows = []
    for spacing, kinds in SIZES.items():
        for kind, sizes in kinds.items():
            for size in sizes:
                for sign in (1, -1):
                    found = [
                        after_redistances(kind, size, k, spacing, sign, options.count)
                        for k in range(len(DIRECTIONS))
                    ]
                    rows.append(row("at rest", kind, size, spacing, found, sign=sign))
    for step, spacing in itertools.product((0.05, 0.2), MOVED_SPACINGS):
        for kind in ("slab", "cylinder"):
            for size in SIZES[spacing][kind]:
                found = [
                    moved_by_speed(kind, size, k, step, options.count, spacing)
                    for k in range(len(DIRECTIONS))
                ]
                rows.append(row(f"velocity, {step:g} voxel a step", kind, size, spacing, found))
    for first, last in ((3.0, 1.0), (1.0, 3.0)):
        found = [resized(first, last, k, options.count) for k in range(len(DIRECTIONS))]
        rows.append(row(f"speed, radius from {first:g} to {last:g}", "cylinder", last, UNIT, found))
    options.output.mkdir(parents=True, exist_ok=True)
    results = {"what": __doc__, "count": options.count, "rows": rows}
    (options.output / "thin.json").write_text(json.dumps(results, indent=1) + "\n")
    print(f"written: {options.output / 'thin.json'}")


def row(
    case: str,
    kind: str,
    size: float,
    spacing: tuple[float, ...],
    found: list[tuple[Floats, int]],
    sign: int = 1,
) -> dict[str, Any]:
    """One row of the table, printed too: over all orientations."""
    means = [float(moved.mean()) for moved, _ in found]
    out = {
        "case": case,
        "kind": kind,
        "size_mm": size,
        "spacing_mm": spacing,
        "gap": sign < 0,
        "least_mean": min(means),
        "largest_mean": max(means),
        "largest": max(float(np.abs(moved).max()) for moved, _ in found),
        "voxels_that_change_side": sum(flipped for _, flipped in found),
        "means": [round(mean, 4) for mean in means],
    }
    voxels = " ".join(f"{h:g}" for h in spacing)
    print(
        f"{case:26s} {kind:9s}{size:5.1f} spacing {voxels:7s} {'gap' if sign < 0 else '   '} mean "
        f"{min(means):+.3f} .. {max(means):+.3f}, largest {out['largest']:.3f}",
        flush=True,
    )
    return out


def lattice(shape: tuple[int, ...], spacing: tuple[float, ...], offset: Any) -> Floats:
    """Coordinates (3, nz, ny, nx), mm, of the voxel centres from a centre beside the middle of the volume."""
    centre = (np.array(shape) - 1) / 2 + np.asarray(offset) - 0.5
    return np.stack(
        [(i - c) * h for i, c, h in zip(np.indices(shape), centre, spacing, strict=True)]
    )


def exact_distance(
    kind: str,
    size: float,
    number: int,
    spacing: tuple[float, ...] = UNIT,
    shift: Any = (0.0, 0.0, 0.0),
) -> NDArray[np.float32]:
    """Signed distance of a slab of width ``size``, or a cylinder or ball of that radius, moved by ``shift`` (mm)."""
    at = lattice(SHAPE, spacing, OFFSETS[number]) - np.reshape(shift, (3, 1, 1, 1))
    along = np.tensordot(DIRECTIONS[number], at, 1)
    if kind == "slab":
        return np.float32(np.abs(along) - size / 2)
    square = (at**2).sum(axis=0) - (along**2 if kind == "cylinder" else 0.0)
    return np.float32(np.sqrt(np.maximum(square, 0.0)) - size)


def displacement(
    exact: Floats, psi: Floats, spacing: tuple[float, ...], margin: int
) -> tuple[Floats, int]:
    """Displacement at every edge that the exact surface crosses, voxels, and how many voxels changed side."""
    inner = (slice(margin, -margin),) * 3
    before, error = exact[inner].astype(float), (psi - exact)[inner].astype(float)
    out = []
    for axis in range(3):
        first, last = np.arange(before.shape[axis] - 1), np.arange(1, before.shape[axis])
        a, b = (np.take(before, at, axis) for at in (first, last))
        crossed = (a < 0) != (b < 0)
        share = a[crossed] / (a[crossed] - b[crossed])
        ends = (np.take(error, at, axis)[crossed] for at in (first, last))
        out.append(-((1 - share) * next(ends) + share * next(ends)) / min(spacing))
    # Voxels on the exact surface are on neither side.
    flipped = ((psi[inner] < 0) != (before < 0)) & (before != 0)
    return np.concatenate(out), int(np.count_nonzero(flipped))


def after_redistances(
    kind: str,
    size: float,
    number: int,
    spacing: tuple[float, ...] = UNIT,
    sign: int = 1,
    count: int = 50,
) -> tuple[Floats, int]:
    """`displacement` after ``count`` redistances at rest; ``sign`` -1: of what surrounds the object."""
    exact = exact_distance(kind, size, number, spacing)
    surface = LevelSet(sign * exact, spacing)
    for _ in range(count):
        surface.redistance()
    return displacement(exact, sign * surface.psi, spacing, 2 if kind == "ball" else MARGIN)


def moved_by_speed(
    kind: str, size: float, number: int, step: float, count: int, spacing: tuple[float, ...] = UNIT
) -> tuple[Floats, int]:
    """`displacement` after ``count`` steps of ``step`` mm under a constant velocity, across the object."""
    direction = DIRECTIONS[number]
    velocity = direction if kind == "slab" else np.cross(direction, (0.48, 0.6, 0.64))
    velocity = velocity / np.linalg.norm(velocity)
    way = 0.5 * count * step * velocity
    surface = LevelSet(exact_distance(kind, size, number, spacing, -way), spacing)
    for _ in range(count):
        surface.advect(np.tile(np.float32(velocity), (surface.size, 1)), step)
        surface.redistance()
    return displacement(
        exact_distance(kind, size, number, spacing, way), surface.psi, spacing, MARGIN
    )


def resized(first: float, last: float, number: int, count: int) -> tuple[Floats, int]:
    """`displacement` of a cylinder whose radius changes at a constant speed, in ``count`` steps."""
    surface = LevelSet(exact_distance("cylinder", first, number), UNIT)
    for _ in range(count):
        surface.advance(np.full(surface.size, (first - last) / count, np.float32), 1.0)
        surface.redistance()
    return displacement(exact_distance("cylinder", last, number), surface.psi, UNIT, MARGIN)


if __name__ == "__main__":
    main()
