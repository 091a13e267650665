"""Estimates and intervals of volume, area and diameter: how often intervals hold the truth, on drawn phantoms.

``python -m benchmarks.intervals`` draws phantoms with partial volume, blur, fading contrast and a neighbour, each in
slices of 1, 3 and 5 mm and with noise up to the contrast, segments each from clicks, and counts; about half an hour of
a core. The weights of `accelsurf.measure.intervals` come from the part ``fit`` alone: ``--fit`` prints them. The part
``report`` has other objects, drawn with other seeds, and shapes that the fit has none of. ``--surfaces FOLDER`` keeps
the surfaces there, and a second call measures those again.
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
    MAX_NOISE_OF_DIAMETER,
    EdgeMeasures,
    edge_measures,
    estimates,
    is_uneven,
    signs,
    units,
)

Floats = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / "intervals.json"
#: The phantoms: extent and fine step (mm), slices, and noise in parts of the contrast.
EXTENT, FINE, THICKNESSES = 45.0, 1 / 3, (1.0, 3.0, 5.0)
NOISES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)
#: Directions (n, 3) in which the width of an object is looked for: 2 degrees apart.
_UP, _TURN = 1 - (2 * np.arange(4000) + 1) / 4000, np.pi * (1 + 5**0.5) * np.arange(4000)
_ACROSS = np.sqrt(1 - _UP**2)
DIRECTIONS = np.stack([_ACROSS * np.cos(_TURN), _ACROSS * np.sin(_TURN), _UP], axis=1)
#: Phantoms of each part, each in all slices.
NUMBERS = {"fit": range(83), "report": range(99)}
#: A result with a smaller Dice is another object, of which no interval can hold; a person clicks again below the other,
#: so often at most.
MIN_DICE, GOOD_DICE, MAX_CLICKS = 0.8, 0.88, 4
KEYS = ("volume_mm3", "area_mm2", "diameter_mm")
#: Measures with another factor where the contrast is uneven.
UNEVEN_KEYS = ("volume_mm3",)
#: Of the fit: degrees of freedom of the errors, weight of small weights, parts that are left out.
FREEDOM, RIDGE, FOLDS = 6.0, 0.5, 5
#: No measure is surer than that, in its unit: other scanners blur in other ways.
LEAST = {"volume_mm3": 0.01, "area_mm2": 0.02, "diameter_mm": 0.1}


class Shape(NamedTuple):
    """A drawn object: its field (mm, negative inside), and its area and diameter where a formula has them."""

    field: Floats
    area_mm2: float | None = None
    diameter_mm: float | None = None


class Truth(NamedTuple):
    """A phantom's object: its figures, and its voxels."""

    volume_mm3: float
    area_mm2: float
    diameter_mm: float
    inside: NDArray[np.bool_]


def turned(random: np.random.Generator) -> Floats:
    """A random rotation."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.diag(r)))


def ball(p: Floats, random: np.random.Generator) -> Shape:
    return Shape(np.linalg.norm(p, axis=0) - random.uniform(4, 14))


def ellipsoid(p: Floats, random: np.random.Generator) -> Shape:
    axes = random.uniform((3, 6, 6), (14, 15, 15))
    return Shape(
        (np.sqrt(sum((c / a) ** 2 for c, a in zip(p, axes, strict=True))) - 1) * axes.min()
    )


def box(p: Floats, random: np.random.Generator) -> Shape:
    half = random.uniform(4, 11, 3)
    field = np.max([np.abs(c) - a for c, a in zip(p, half, strict=True)], axis=0)
    a, b, c = 2 * half
    return Shape(field, 2 * (a * b + b * c + c * a), float(np.hypot(np.hypot(a, b), c)))


def tube(p: Floats, random: np.random.Generator) -> Shape:
    """A tube of constant width along an arc, with round ends."""
    radius = random.uniform(9, 40)
    width = random.uniform(3.5, 6)
    half = random.uniform(8, 13)
    half_angle = min(half / radius, 2.2)
    middle = radius * 0.5 * (1 + np.cos(half_angle))
    angle = np.clip(np.arctan2(p[1], p[0] + middle), -half_angle, half_angle)
    axis = np.stack([radius * np.cos(angle) - middle, radius * np.sin(angle), np.zeros_like(angle)])
    return Shape(np.linalg.norm(p - axis, axis=0) - width)


def torus(p: Floats, random: np.random.Generator) -> Shape:
    width = random.uniform(3.5, 5.5)
    return Shape(np.hypot(np.hypot(p[0], p[1]) - random.uniform(8, 11), p[2]) - width)


def lobes(p: Floats, random: np.random.Generator) -> Shape:
    """Three balls that run into each other."""
    at, radii = random.uniform(-6, 6, (3, 3)), random.uniform(5, 9, 3)
    balls = [
        np.linalg.norm(p - c[:, None, None, None], axis=0) - r
        for c, r in zip(at, radii, strict=True)
    ]
    return Shape(np.min(balls, axis=0))


def potato(p: Floats, random: np.random.Generator) -> Shape:
    """A ball with waves on it."""
    waves = sum(
        random.uniform(0.3, 0.9)
        * np.sin(np.tensordot(random.normal(0, 0.25, 3), p, 1) + random.uniform(0, 6))
        for _ in range(6)
    )
    return Shape(np.linalg.norm(p, axis=0) - random.uniform(8, 13) - waves)


def cylinder(p: Floats, random: np.random.Generator) -> Shape:
    """A cylinder with flat ends."""
    half, radius = random.uniform(5, 12), random.uniform(4, 8)
    field = np.maximum(np.hypot(p[0], p[1]) - radius, np.abs(p[2]) - half)
    area = 2 * np.pi * radius * (radius + 2 * half)
    return Shape(field, area, float(2 * np.hypot(radius, half)))


Maker = Callable[[Floats, np.random.Generator], Shape]
#: The shapes that the weights come from, with whether they lie along the grid; and those that are reported besides.
SHAPES: dict[str, tuple[Maker, bool]] = {
    "ball": (ball, False),
    "ellipsoid": (ellipsoid, False),
    "box": (box, True),
    "turned box": (box, False),
    "tube": (tube, False),
    "torus": (torus, False),
}
OTHERS: dict[str, tuple[Maker, bool]] = {
    "lobes": (lobes, False),
    "potato": (potato, False),
    "cylinder": (cylinder, False),
}
PARTS = {"fit": list(SHAPES), "report": [*SHAPES, *OTHERS]}


def draw(part: str, number: int) -> Iterator[tuple[dict[str, Any], accelsurf.Volume, Truth]]:
    """Yield a phantom in slices of each thickness, each with noise of its own."""
    random = np.random.default_rng([len(part), number])
    n = round(EXTENT / FINE)
    p = np.indices((n, n, n)) * FINE - 0.5 * EXTENT + random.uniform(-1, 1, 3)[:, None, None, None]
    name = PARTS[part][number % len(PARTS[part])]
    maker, along_grid = (SHAPES | OTHERS)[name]
    rotation = turned(random)
    p = p if along_grid else np.tensordot(rotation, p, 1)
    shape = maker(p, random)
    field, area, diameter = shape
    steep = np.sqrt(sum(np.square(slope) for slope in np.gradient(field, FINE)))
    inside = np.clip(0.5 - field / np.maximum(steep, 0.3) / FINE, 0, 1).astype(np.float32)
    if area is None or diameter is None:
        vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(FINE,) * 3)
        area = float(mesh_surface_area(vertices, faces))
        diameter = float(np.ptp(vertices @ DIRECTIONS.T, axis=0).max())
    volume = float(inside.sum(dtype=float)) * FINE**3
    kind = ("plain", "plain", "fading", "neighbour")[random.integers(4)]
    direction = random.normal(size=3)
    along = np.tensordot(direction / np.linalg.norm(direction), p, 1)
    image = inside.copy()
    if kind == "fading":
        image *= (1 - random.uniform(0.3, 0.7) * (0.5 + 0.5 * np.tanh(along / 6))).astype(
            np.float32
        )
    elif kind == "neighbour":
        image += (1 - inside) * np.float32(random.uniform(0.3, 0.6)) * (along > 6)
    blur = random.uniform(0.3, 1.0)
    image = ndimage.gaussian_filter(image, blur / FINE)
    results = {"part": part, "number": number, "shape": name, "kind": kind, "blur": blur}
    for thickness in THICKNESSES:
        steps = (round(thickness / FINE), round(1 / FINE), round(1 / FINE))
        voxels, share = _averaged(image, steps), _averaged(inside, steps)
        noise = float(random.choice(NOISES))
        voxels = voxels + random.normal(0, noise, voxels.shape)
        scan = accelsurf.Volume.from_array((100 * voxels).astype(np.float32), (thickness, 1.0, 1.0))
        results_here = {**results, "noise": noise, "thickness": thickness}
        yield results_here, scan, Truth(volume, area, diameter, share > 0.5)


def _averaged(values: NDArray[Any], steps: tuple[int, int, int]) -> Floats:
    """Means over the fine voxels of each voxel."""
    z, y, x = (n // s for n, s in zip(values.shape, steps, strict=True))
    part = values[: z * steps[0], : y * steps[1], : x * steps[2]]
    return np.asarray(
        part.reshape(z, steps[0], y, steps[1], x, steps[2]).mean(axis=(1, 3, 5), dtype=np.float64)
    )


def clicked(scan: accelsurf.Volume, truth: Truth) -> tuple[accelsurf.Result, float, int]:
    """Segment as a person does who clicks where most is wrong; return the result, its Dice, and the clicks."""
    clicks: dict[str, list[str]] = {"inside": [], "outside": []}
    wrong = truth.inside
    side = "inside"
    spacing = scan.geometry.spacing
    for _ in range(MAX_CLICKS):
        deep = ndimage.distance_transform_edt(np.pad(wrong, 1), spacing)[1:-1, 1:-1, 1:-1]
        z, y, x = (int(v) for v in np.unravel_index(int(deep.argmax()), deep.shape))
        clicks[side].append(f"ball:{x},{y},{z},{max(0.5 * float(deep.max()), 0.5):.2f}vox")
        options: dict[str, Any] = {key: value for key, value in clicks.items() if value}
        result = accelsurf.segment(scan, **options, threads=1)
        found = result.labels > 0
        missing, extra = truth.inside & ~found, found & ~truth.inside
        dice = 2 * float((truth.inside & found).sum()) / float(truth.inside.sum() + found.sum())
        if dice >= GOOD_DICE:
            break
        side, wrong = ("inside", missing) if missing.sum() >= extra.sum() else ("outside", extra)
    return result, dice, sum(map(len, clicks.values()))


def played(part: str, numbers: range, surfaces: Path | None) -> Iterator[dict[str, Any]]:
    """Yield a row for each phantom in slices of each thickness: its facts, the truth, and the measures of its edge."""
    for number in numbers:
        for results, scan, truth in draw(part, number):
            name = f"{part}_{number}_{results['thickness']:g}.npz"
            kept = None if surfaces is None else surfaces / name
            if kept is None or not kept.exists():
                result, dice, clicks = clicked(scan, truth)
                one = result.objects[0]
                psi = one.psi
                image = one.image
                surface = one.volume_mm3
                if kept is not None:
                    np.savez(kept, psi=psi, image=image, figures=(surface, dice, clicks))
            else:
                with np.load(kept) as arrays:
                    psi, image = arrays["psi"], arrays["image"]
                    surface, dice, clicks = arrays["figures"].tolist()
            edge = edge_measures(psi, image, scan.geometry, surface)
            print(results, f"Dice {dice:.3f}", flush=True)
            yield {
                **results,
                "dice": round(dice, 4),
                "clicks": int(clicks),
                "true": {key: round(getattr(truth, key), 3) for key in KEYS},
                "edge": edge and {key: round(value, 6) for key, value in edge._asdict().items()},
                "surface": round(surface, 3),
            }


def edge_of(row: dict[str, Any]) -> EdgeMeasures:
    """Measures of the edge of a row."""
    return EdgeMeasures(**row["edge"])


def right(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of which an interval can hold: the object is found, and has an edge."""
    return [row for row in rows if row["dice"] >= MIN_DICE and row["edge"]]


def _noise_text(noise: float) -> str:
    return "to .2" if noise <= 0.2 else ".3 and .5" if noise <= 0.5 else ".75 and 1"


#: How the rows are counted.
GROUPS: dict[str, Callable[[dict[str, Any]], str]] = {
    "all": lambda row: "all",
    "shape": lambda row: row["shape"],
    "slices": lambda row: f"{row['thickness']:g} mm",
    "noise": lambda row: f"{row['noise']:g}",
    "image": lambda row: row["kind"],
    "contrast": lambda row: "uneven" if is_uneven(edge_of(row)) else "even",
    "slices and noise": lambda row: f"{row['thickness']:g} mm, {_noise_text(row['noise'])}",
}


def counted(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count by measure how often intervals hold the truth, their median half width, and the estimates' errors."""
    found = right(rows)
    made = [estimates(edge_of(row)) for row in found]
    out: dict[str, Any] = {"cases": len(rows), "another object": len(rows) - len(found)}
    for key in KEYS:
        true = np.array([row["true"][key] for row in found])
        best = np.array([getattr(each, key) for each, _ in made])
        low, high = np.array([getattr(each, key) or (np.nan, np.nan) for _, each in made]).T
        told, holds = np.isfinite(low), (low <= true) & (true <= high)
        of_measure: dict[str, Any] = {
            "below": int((true < low).sum()),
            "above": int((true > high).sum()),
        }
        for group, name in GROUPS.items():
            names = np.array([name(row) for row in found])
            of_measure[group] = {
                each: _counts(told[names == each], holds[names == each])
                | _sizes((best / true)[names == each], ((high - low) / 2 / true)[names == each])
                for each in sorted(set(names))
            }
        out[key] = of_measure
    surface = np.abs([row["surface"] / row["true"]["volume_mm3"] - 1 for row in found])
    out["surface's own volume, median error in percent"] = round(100 * float(np.median(surface)), 1)
    return out


def _counts(told: NDArray[np.bool_], holds: NDArray[np.bool_]) -> dict[str, Any]:
    share = round(float(holds[told].mean()), 3) if told.any() else None
    return {"count": int(told.size), "cannot be told": int((~told).sum()), "holds": share}


def _sizes(ratio: Floats, half: Floats) -> dict[str, Any]:
    half = half[np.isfinite(half)]
    return {
        "half_width_percent": round(100 * float(np.median(half)), 1) if half.size else None,
        "error_percent": round(100 * float(np.median(np.abs(ratio - 1))), 1),
        "mean_error_percent": round(100 * float(np.median(ratio - 1)), 1),
    }


def errors_of(key: str, rows: list[dict[str, Any]]) -> tuple[Floats, Floats, Floats]:
    """Return the errors of a measure in its unit, what tells them, and the deviations that are known."""
    edges = [edge_of(row) for row in rows]
    true, found = np.array(
        [(row["true"][key], getattr(edge, key)) for row, edge in zip(rows, edges, strict=True)]
    ).T
    error = true - found if key == "volume_mm3" else np.log(true / found)
    known = [edge.noise_mm3 / edge.layer_mm3 * (key == "volume_mm3") for edge in edges]
    unit = np.array([units(edge)[key] for edge in edges])
    return error / unit, np.array([signs(edge, key) for edge in edges]), np.array(known)


def deviations_of(key: str, rows: list[dict[str, Any]], weights: Floats) -> Floats:
    """Return the error of each row in the deviations that weights, of bias and of spread, give it."""
    error, values, known = errors_of(key, rows)
    bias, spread = np.split(weights, 2)
    sigma = np.sqrt(known**2 + np.square(values) @ np.square(spread))
    return np.asarray((error - values @ bias) / sigma)


def weights_of(key: str, rows: list[dict[str, Any]]) -> Floats:
    """Return the weights of the largest likelihood: of the bias, then of the spread.

    Errors have the distribution of Student with 6 degrees of freedom, so that a case without an edge counts little.
    """
    error, values, known = errors_of(key, rows)
    scale, width = np.sqrt(np.square(values).mean(axis=0)), float(error.std())
    values = values / scale

    def cost(weights: Floats) -> tuple[float, Floats]:
        bias, spread = np.split(weights, 2)
        off = error - values @ bias
        variance = known**2 + np.square(values) @ np.square(spread)
        ratio = np.square(off) / variance / FREEDOM
        total = 0.5 * ((FREEDOM + 1) * np.log1p(ratio) + np.log(variance)).sum()
        pull = (FREEDOM + 1) / (1 + ratio) / FREEDOM
        by_bias = -(pull * off / variance) @ values
        by_spread = (0.5 / variance - 0.5 * pull * ratio * FREEDOM / variance) @ np.square(values)
        small = np.where(np.arange(bias.size) > 0, RIDGE * bias / width**2, 0.0)
        return float(total + 0.5 * small @ bias), np.r_[by_bias + small, 2 * spread * by_spread]

    start = np.r_[np.zeros(len(scale)), np.full(len(scale), 0.25 * width)]
    bounds = [(None, None)] * len(scale) + [(LEAST[key], None)] + [(0, None)] * (len(scale) - 1)
    options = {"maxiter": 2000}
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    bias, spread = np.split(found.x, 2)
    return np.r_[bias / scale, spread / scale]


def fitted(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the weights of each measure, and the deviations of 95 % of the cases.

    The deviations are of objects that were left out of the fit, a fifth after another.
    """
    rows = right(rows)
    for key in KEYS:
        deviations = np.zeros(len(rows))
        for fold in range(FOLDS):
            mine = np.array([row["number"] % FOLDS == fold for row in rows])
            others = [row for row, is_mine in zip(rows, mine, strict=True) if not is_mine]
            held = [row for row, is_mine in zip(rows, mine, strict=True) if is_mine]
            deviations[mine] = deviations_of(key, held, weights_of(key, others))
        bias, spread = np.split(weights_of(key, rows).round(3), 2)
        told = np.array(
            [key != "diameter_mm" or row["edge"]["noise"] <= MAX_NOISE_OF_DIAMETER for row in rows]
        )
        uneven = np.array([is_uneven(edge_of(row)) for row in rows])
        groups = (~uneven & told, uneven & told) if key in UNEVEN_KEYS else (told, told)
        factors = [f"{np.quantile(np.abs(deviations[each]), 0.95):.2f}" for each in groups]
        yield f"{key}: _Weights({tuple(bias.tolist())}, {tuple(spread.tolist())}, {', '.join(factors)})"


def main() -> None:
    """Play, keep, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--again", action="store_true", help="count again, with the measures that are kept"
    )
    parser.add_argument("--fit", action="store_true", help="print the weights")
    parser.add_argument("--surfaces", type=Path, help="a folder that keeps the surfaces")
    given = parser.parse_args()
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if not given.again:
        if given.surfaces is not None:
            given.surfaces.mkdir(parents=True, exist_ok=True)
        kept["rows"] = [
            row
            for part, numbers in NUMBERS.items()
            for row in played(part, numbers, given.surfaces)
        ]
    parts = {part: [row for row in kept["rows"] if row["part"] == part] for part in NUMBERS}
    if given.fit:
        print("\n".join(fitted(parts["fit"])))
    kept["counted"] = {part: counted(rows) for part, rows in parts.items()}
    rows = ",\n".join(json.dumps(row) for row in kept["rows"])
    RESULTS.write_text(
        f'{{"counted": {json.dumps(kept["counted"], indent=1)},\n"rows": [\n{rows}\n]}}\n'
    )
    print(json.dumps(kept["counted"]["report"], indent=1))


if __name__ == "__main__":
    main()
