"""Intervals of volume, area and diameter: how often they hold the truth, on phantoms that nothing was tuned on.

``python -m benchmarks.intervals`` draws phantoms with partial volume, blur, noise, fading contrast and a neighbour,
each in slices of 1, 3 and 5 mm, segments each from a click, and counts; about 20 minutes of a core. ``--again``
counts again with the measures that are kept. The weights of `accelsurf.measure.intervals` come from the part ``fit``
alone, whose shapes are others than those of the part ``report``: ``--fit`` prints them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import minimize
from skimage.measure import marching_cubes, mesh_surface_area

import accelsurf
from accelsurf.measure.intervals import (
    BIASED,
    EdgeMeasures,
    Interval,
    Intervals,
    edge_measures,
    intervals,
    signs,
    units,
)

Floats = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / "intervals.json"
#: The phantoms: extent and fine step (mm), and slices.
EXTENT, FINE, THICKNESSES = 45.0, 1 / 3, (1.0, 3.0, 5.0)
#: Directions (n, 3) in which the width of an object is looked for: 2 degrees apart.
_UP, _TURN = 1 - (2 * np.arange(4000) + 1) / 4000, np.pi * (1 + 5**0.5) * np.arange(4000)
_ACROSS = np.sqrt(1 - _UP**2)
DIRECTIONS = np.stack([_ACROSS * np.cos(_TURN), _ACROSS * np.sin(_TURN), _UP], axis=1)
#: Phantoms of each part; those of the report before this were seen when it was chosen how the volume's factor is made.
NUMBERS, SEEN = {"fit": range(60), "thin": range(30), "report": range(165)}, 132
#: A result with a smaller Dice is another object, of which no interval can hold.
MIN_DICE = 0.8


class Truth(NamedTuple):
    """A phantom's object: its figures, and a voxel index (z, y, x) in it."""

    volume_mm3: float
    area_mm2: float
    diameter_mm: float
    inside: NDArray[np.bool_]
    click: tuple[int, int, int]


def turned(random: np.random.Generator) -> Floats:
    """A random rotation."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.diag(r)))


def ball(p: Floats, random: np.random.Generator) -> Floats:
    return np.asarray(np.linalg.norm(p, axis=0) - random.uniform(7, 14))


def ellipsoid(p: Floats, random: np.random.Generator) -> Floats:
    axes = random.uniform(6, 15, 3)
    return np.asarray(
        (np.sqrt(sum((c / a) ** 2 for c, a in zip(p, axes, strict=True))) - 1) * axes.min()
    )


def box(p: Floats, random: np.random.Generator) -> Floats:
    half = random.uniform(5, 11, 3)
    return np.asarray(np.max([np.abs(c) - a for c, a in zip(p, half, strict=True)], axis=0))


def torus(p: Floats, random: np.random.Generator) -> Floats:
    tube = random.uniform(3.5, 5.5)
    return np.asarray(np.hypot(np.hypot(p[0], p[1]) - random.uniform(8, 10), p[2]) - tube)


def lobes(p: Floats, random: np.random.Generator) -> Floats:
    """Three balls that run into each other."""
    at, radii = random.uniform(-6, 6, (3, 3)), random.uniform(5, 9, 3)
    balls = [
        np.linalg.norm(p - c[:, None, None, None], axis=0) - r
        for c, r in zip(at, radii, strict=True)
    ]
    return np.asarray(np.min(balls, axis=0))


def potato(p: Floats, random: np.random.Generator) -> Floats:
    """A ball with waves on it."""
    waves = sum(
        random.uniform(0.3, 0.9)
        * np.sin(np.tensordot(random.normal(0, 0.25, 3), p, 1) + random.uniform(0, 6))
        for _ in range(6)
    )
    return np.asarray(np.linalg.norm(p, axis=0) - random.uniform(8, 13) - waves)


def rod(p: Floats, random: np.random.Generator) -> Floats:
    """A cylinder with round ends."""
    half = random.uniform(5, 11)
    return np.asarray(
        np.linalg.norm([p[0], p[1], p[2] - np.clip(p[2], -half, half)], axis=0)
        - random.uniform(4, 7)
    )


def small(p: Floats, random: np.random.Generator) -> Floats:
    return np.asarray(np.linalg.norm(p, axis=0) - random.uniform(4, 8))


def plate(p: Floats, random: np.random.Generator) -> Floats:
    """A flat ellipsoid."""
    axes = random.uniform((3, 7, 9), (5, 12, 14))
    return np.asarray(
        (np.sqrt(sum((c / a) ** 2 for c, a in zip(p, axes, strict=True))) - 1) * axes.min()
    )


#: The shapes that the weights come from, two parts, and those that are reported.
SHAPES: dict[str, tuple[Callable[[Floats, np.random.Generator], Floats], ...]] = {
    "fit": (ball, ellipsoid, box),
    "thin": (small, plate),
    "report": (torus, lobes, potato, rod),
}


def draw(part: str, number: int) -> Iterator[tuple[dict[str, Any], accelsurf.Volume, Truth]]:
    """Yield a phantom in slices of each thickness."""
    random = np.random.default_rng([len(part), number])
    n = round(EXTENT / FINE)
    p = np.indices((n, n, n)) * FINE - 0.5 * EXTENT + random.uniform(-1, 1, 3)[:, None, None, None]
    p = np.tensordot(turned(random), p, 1)
    shape = SHAPES[part][number % len(SHAPES[part])]
    field = shape(p, random)
    inside = field < 0
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(FINE,) * 3)
    first, second, third = vertices[faces].swapaxes(0, 1)
    volume = abs(float((first * np.cross(second, third)).sum())) / 6
    widths = np.ptp(vertices @ DIRECTIONS.T, axis=0)
    kind = ("plain", "plain", "fading", "neighbour")[random.integers(4)]
    direction = random.normal(size=3)
    along = np.tensordot(direction / np.linalg.norm(direction), p, 1)
    image = inside.astype(np.float32)
    if kind == "fading":
        image *= (1 - random.uniform(0.3, 0.7) * (0.5 + 0.5 * np.tanh(along / 6))).astype(
            np.float32
        )
    elif kind == "neighbour":
        image[(along > 6) & ~inside] = random.uniform(0.3, 0.6)
    blur, noise = random.uniform(0.3, 1.0), random.choice([0.02, 0.05, 0.1, 0.2, 0.3])
    image = ndimage.gaussian_filter(image, blur / FINE)
    facts = {
        "part": part,
        "number": number,
        "shape": shape.__name__,
        "kind": kind,
        "blur": blur,
        "noise": noise,
    }
    for thickness in THICKNESSES:
        steps = (round(thickness / FINE), round(1 / FINE), round(1 / FINE))
        voxels, share = _averaged(image, steps), _averaged(inside, steps)
        voxels = voxels + random.normal(0, noise, voxels.shape)
        deep = ndimage.distance_transform_edt(share > 0.99, (thickness, 1, 1))
        click = np.unravel_index(int(deep.argmax()), deep.shape)
        measures = volume, float(mesh_surface_area(vertices, faces)), float(widths.max())
        truth = Truth(*measures, share > 0.5, tuple(int(v) for v in click))
        scan = accelsurf.Volume.from_array((100 * voxels).astype(np.float32), (thickness, 1.0, 1.0))
        yield {**facts, "thickness": thickness}, scan, truth


def _averaged(values: NDArray[Any], steps: tuple[int, int, int]) -> Floats:
    """Means over the fine voxels of each voxel."""
    z, y, x = (n // s for n, s in zip(values.shape, steps, strict=True))
    part = values[: z * steps[0], : y * steps[1], : x * steps[2]]
    return np.asarray(
        part.reshape(z, steps[0], y, steps[1], x, steps[2]).mean(axis=(1, 3, 5), dtype=np.float64)
    )


def played(part: str, numbers: range) -> Iterator[dict[str, Any]]:
    """Yield a row for each phantom in slices of each thickness: its facts, the truth, and the measures of its edge."""
    for number in numbers:
        for facts, scan, truth in draw(part, number):
            z, y, x = truth.click
            result = accelsurf.segment(scan, inside=f"point:{x},{y},{z}vox", threads=1)
            found = result.objects[0]
            edge = edge_measures(
                found.psi, found.image, found.geometry, found.volume_mm3, found.area_mm2
            )
            common = truth.inside & (found.labels > 0)
            dice = 2 * common.sum() / (truth.inside.sum() + found.labels.sum())
            true = {key: round(getattr(truth, key), 3) for key in Intervals._fields}
            edges = (
                None
                if edge is None
                else {key: round(value, 5) for key, value in edge._asdict().items()}
            )
            print(facts, f"Dice {dice:.3f}", flush=True)
            yield {
                **facts,
                "dice": round(float(dice), 4),
                "true": true,
                "edge": edges,
                "surface": round(found.volume_mm3, 3),
            }


def edge_of(row: dict[str, Any]) -> EdgeMeasures:
    """Measures of the edge of a row; rows that were played before the area was measured have none."""
    return EdgeMeasures(
        **{key: np.nan if value is None else value for key, value in row["edge"].items()}
    )


def counted(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count by measure how often intervals hold the truth, and their median half width in percent of it."""
    right = [row for row in rows if row["dice"] >= MIN_DICE and row["edge"]]
    made = [intervals(edge_of(row)) for row in right]
    groups: dict[str, Callable[[dict[str, Any]], str]] = {
        "all": lambda row: "all",
        "slices": lambda row: f"{row['thickness']:g} mm",
        "image": lambda row: row["kind"],
        "shape": lambda row: row["shape"],
        "noise": lambda row: f"{row['noise']:g}",
        "seen": lambda row: "seen" if row["number"] < SEEN else "not seen",
    }
    out: dict[str, Any] = {"cases": len(rows), "another object": len(rows) - len(right)}
    for key in Intervals._fields:
        pairs = [(row, getattr(each, key)) for row, each in zip(right, made, strict=True)]
        pairs = [(row, each) for row, each in pairs if np.isfinite(each.low)]
        if not pairs:
            continue
        true = np.array([row["true"][key] for row, _ in pairs])
        low, high = np.array([each for _, each in pairs]).T
        holds, half = (low <= true) & (true <= high), 50 * (high - low) / true
        out[key] = {"below": int((true < low).sum()), "above": int((true > high).sum())}
        for group, name in groups.items():
            names = np.array([name(row) for row, _ in pairs])
            out[key][group] = {
                each: {
                    "count": int((names == each).sum()),
                    "holds": round(float(holds[names == each].mean()), 3),
                    "half_width_percent": round(float(np.median(half[names == each])), 1),
                }
                for each in sorted(set(names))
            }
    surface = np.array([abs(row["surface"] / row["true"]["volume_mm3"] - 1) for row in right])
    middles = np.array([sum(each.volume_mm3) / 2 for each in made])
    edge = np.abs(middles / [row["true"]["volume_mm3"] for row in right] - 1)
    out["median error of the volume, percent"] = {
        name: round(100 * float(np.median(error)), 2)
        for name, error in (("surface", surface), ("edge", edge))
    }
    out["stable"] = stable(right, made)
    return out


def stable(rows: list[dict[str, Any]], made: list[Intervals]) -> dict[str, Any]:
    """Count objects whose intervals of the volume in slices of all thicknesses meet; say how their middles differ."""
    by_object: dict[Any, list[tuple[Interval, float]]] = {}
    for row, each in zip(rows, made, strict=True):
        by_object.setdefault((row["part"], row["number"]), []).append(
            (each.volume_mm3, row["surface"])
        )
    whole = [
        zip(*each, strict=True) for each in by_object.values() if len(each) == len(THICKNESSES)
    ]
    pairs = [(list(found), np.array(surfaces)) for found, surfaces in whole]
    meet = [max(each.low for each in some) <= min(each.high for each in some) for some, _ in pairs]
    spread = [float(np.ptp([sum(each) for each in some])) / sum(some[0]) for some, _ in pairs]
    of_surface = [float(np.ptp(surfaces)) / surfaces[0] for _, surfaces in pairs]
    return {
        "objects": len(pairs),
        "meet": round(float(np.mean(meet)), 3),
        "middles_differ_percent": round(100 * float(np.median(spread)), 1),
        "surfaces_differ_percent": round(100 * float(np.median(of_surface)), 1),
    }


def error_of(key: str, edge: EdgeMeasures, true: float) -> float:
    """The error of a measure of the edge, in its unit."""
    found, unit = getattr(edge, key), units(edge)[Intervals._fields.index(key)]
    return float(np.log(true / found) if key == "area_mm2" else true - found) / unit


def fitted(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the weights of each measure, and the deviations of 95 % of the cases.

    Those of the volume are of shapes that were left out of the fit, one after another: then they hold for others, too.
    Those of area and diameter are of all: a box alone has sharp edges.
    """
    rows = [row for row in rows if row["dice"] >= MIN_DICE and row["edge"]]
    shapes = sorted({row["shape"] for row in rows})
    for key in Intervals._fields:
        usable = [row for row in rows if np.isfinite(getattr(edge_of(row), key))]
        weights = weights_of(key, usable)
        deviations = deviations_of(key, usable, weights)
        if key == "volume_mm3":
            left_out = []
            for shape in shapes:
                others = weights_of(key, [row for row in usable if row["shape"] != shape])
                left_out.append(
                    deviations_of(key, [row for row in usable if row["shape"] == shape], others)
                )
            deviations = np.concatenate(left_out)
        bias, wide = (
            weights[: len(BIASED)].round(3).tolist(),
            np.abs(weights[len(BIASED) :]).round(3).tolist(),
        )
        yield f"{key}: _Weights({tuple(bias)}, {tuple(wide)}, {float(np.quantile(np.abs(deviations), 0.95)):.2f})"


def likely(key: str, rows: list[dict[str, Any]]) -> tuple[Floats, Floats, Floats]:
    """Return the errors of a measure, what tells them, and the deviations that are known."""
    edges = [edge_of(row) for row in rows]
    error = np.array(
        [error_of(key, edge, row["true"][key]) for edge, row in zip(edges, rows, strict=True)]
    )
    known = np.array(
        [edge.noise_mm3 / edge.layer_mm3 if key == "volume_mm3" else 0.0 for edge in edges]
    )
    return error, np.array([signs(edge) for edge in edges]), known


def deviations_of(key: str, rows: list[dict[str, Any]], weights: Floats) -> Floats:
    """Return the error of each row in the deviations that weights give it."""
    error, values, known = likely(key, rows)
    return _in_deviations(weights, error, values, known)[0]


def _in_deviations(
    weights: Floats, error: Floats, values: Floats, known: Floats
) -> tuple[Floats, Floats]:
    sigma = np.sqrt(known**2 + np.square(values * weights[len(BIASED) :]).sum(axis=1) + 1e-8)
    return (error - values[:, BIASED] @ weights[: len(BIASED)]) / sigma, sigma


def weights_of(key: str, rows: list[dict[str, Any]]) -> Floats:
    """Return the weights of the largest likelihood of normal errors: of the bias, then of the spread."""
    error, values, known = likely(key, rows)

    def cost(weights: Floats) -> float:
        deviations, sigma = _in_deviations(weights, error, values, known)
        return float((np.log(sigma) + 0.5 * np.square(deviations)).sum())

    starts = [
        np.r_[np.zeros(len(BIASED)), np.full(values.shape[1], size * np.std(error))]
        for size in (0.1, 0.5, 2.0)
    ]
    options = {"maxiter": 20_000, "maxfev": 20_000, "adaptive": True}
    found = [minimize(cost, start, method="Nelder-Mead", options=options) for start in starts]
    return np.asarray(min(found, key=lambda each: each.fun).x)


def main() -> None:
    """Play, keep, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--again", action="store_true", help="count again, with the measures that are kept"
    )
    parser.add_argument("--fit", action="store_true", help="print the weights")
    given = parser.parse_args()
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if not given.again:
        kept["rows"] = [row for part, numbers in NUMBERS.items() for row in played(part, numbers)]
    parts = {part: [row for row in kept["rows"] if row["part"] == part] for part in SHAPES}
    if given.fit:
        print("\n".join(fitted(parts["fit"] + parts["thin"])))
    kept["counted"] = {part: counted(rows) for part, rows in parts.items()}
    rows = ",\n".join(json.dumps(row) for row in kept["rows"])
    RESULTS.write_text(
        f'{{"counted": {json.dumps(kept["counted"], indent=1)},\n"rows": [\n{rows}\n]}}\n'
    )
    print(json.dumps(kept["counted"]["report"], indent=1))


if __name__ == "__main__":
    main()
