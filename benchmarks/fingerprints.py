"""Fingerprints of many small runs: whether a change of the code has changed a byte of what comes out.

    scripts/fingerprints --save before.json          on the code as it was
    scripts/fingerprints --compare before.json       with the change: every run whose bytes differ is named

`benchmarks/results/fingerprints.json` has those of the present code.

A fingerprint is the SHA-256 of labels, psi, mesh or contours, and of the trace without its seconds. Compiled code may
round otherwise on another kind of processor or with another numpy or numba: both are kept in the file, and a comparison
across them says so.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

import accelsurf
from accelsurf.settings.trace_columns import row_values

#: Columns that are not compared: the clock's.
CLOCK = ("seconds",)
PACKAGES = ("numpy", "scipy", "numba", "scikit-image")


def distance(shape, spacing, centre, radius):
    """Distance (mm) of voxel centres to a sphere, negative inside."""
    axes = [(np.arange(n) - c) * h for n, c, h in zip(shape, centre, spacing, strict=True)]
    return (
        np.sqrt(
            axes[0][:, None, None] ** 2 + axes[1][None, :, None] ** 2 + axes[2][None, None, :] ** 2
        )
        - radius
    )


def cube(n=32, noise=0.3, spacing=(1.0, 1.0, 1.0), seed=0):
    """A noisy cube with sides of half the volume."""
    image = np.zeros((n, n, n), np.float32)
    image[n // 4 : -n // 4, n // 4 : -n // 4, n // 4 : -n // 4] = 1.0
    image += np.random.default_rng(seed).normal(0, noise, image.shape).astype(np.float32)
    return accelsurf.Volume.from_array(image, spacing)


def disc(n=48, noise=0.2):
    """A disc in one slice."""
    image = (distance((1, n, n), (1, 1, 1), (0, 23.0, 24.5), 13.0) < 0).astype(np.float32)
    image += np.random.default_rng(1).normal(0, noise, image.shape).astype(np.float32)
    return accelsurf.Volume.from_array(image, (2.0, 0.5, 0.7))


def thick():
    """A ball in thick slices."""
    spacing = (2.5, 1.0, 0.8)
    image = (distance((14, 36, 40), spacing, (6.7, 17.2, 19.8), 10.0) < 0).astype(np.float32)
    image += np.random.default_rng(2).normal(0, 0.2, image.shape).astype(np.float32)
    return accelsurf.Volume.from_array(image, spacing)


def pair(spacing=(1.0, 1.0, 1.0), noise=0.25):
    """Two touching balls, and a label map of their starts."""
    shape = (28, 28, 46)
    shape = tuple(round(n / h) for n, h in zip(shape, spacing, strict=True))
    places = ((14, 13.5, 15), (14, 13.5, 30))
    centres = [tuple(c / h for c, h in zip(place, spacing, strict=True)) for place in places]
    away = np.array([distance(shape, spacing, centre, 9.0) for centre in centres])
    image = np.clip(0.5 - away.min(axis=0), 0, 1) + np.random.default_rng(3).normal(0, noise, shape)
    starts = np.zeros(shape, np.int32)
    for own, one in zip((3, 260), away, strict=True):
        starts[one < -4.5] = own
    return accelsurf.Volume.from_array(image.astype(np.float32), spacing), starts


def own_energy(image, spacing):
    """An energy of somebody's own."""
    from accelsurf.energies import ChanVese

    return ChanVese(image, 0.3)


BALL = "ball:12,12,13,5vox"
BASE: dict[str, Any] = {"start": BALL, "max_steps": 25, "levels": 1, "threads": 1}


def runs(folder: Path) -> dict[str, Callable[[], Any]]:
    """Every run by its name; ``folder`` takes what they read."""
    one = cube()
    flat = disc()
    slab = thick()
    second = np.asarray(ndimage.gaussian_filter(one.array, 1.0), np.float32)
    mask = np.zeros(one.array.shape, np.uint8)
    mask[6:27, 5:28, 7:26] = 1
    accelsurf.write(one.with_array(mask), folder / "mask.nii.gz")
    two, starts = pair()
    tall, tall_starts = pair((2.0, 1.0, 1.25))

    def single(volume=one, **settings: Any) -> Callable[[], Any]:
        return lambda: accelsurf.segment(volume, **{**BASE, **settings})

    def several(volume=two, given=starts, **settings: Any) -> Callable[[], Any]:
        return lambda: accelsurf.segment_objects(
            volume, given, **{"max_steps": 30, "threads": 1, **settings}
        )

    def clicked(**settings: Any) -> Callable[[], Any]:
        given = {
            "inside": "ball:15,15,15,4vox",
            "outside": "ball:4,4,4,2vox",
            "max_steps": 40,
            "threads": 1,
        }
        return lambda: accelsurf.segment(one, **{**given, **settings})

    out: dict[str, Callable[[], Any]] = {}
    for flow in (
        "constant-density",
        "flowable-mass",
        "region-mass",
        "gradient",
        "sobolev",
        "momentum",
    ):
        out[f"flow {flow}"] = single(flow=flow)
        out[f"flow {flow}, thick slices"] = single(slab, flow=flow, start="ball:19,17,6,4vox")
        out[f"flow {flow}, one slice"] = single(flat, flow=flow, start="ball:24,23,0,6vox")
        out[f"flow {flow}, two objects"] = several(flow=flow, max_steps=12)
    for energy in (
        "local-region:R=6",
        "likelihood",
        "likelihood:model=histogram",
        "threshold:auto",
        "threshold:learned,learned",
        "geodesic:balloon=-1",
        "local-region:R=6 + 0.3*geodesic + 0.1*area",
        "chan-vese - 0.1*balloon",
        "chan-vese:balance=2,epsilon=0",
    ):
        out[f"energy {energy}"] = single(energy=energy)
    out["energy likelihood learned"] = single(
        energy="likelihood:update=no", foreground="ball:15,15,15,6vox", background="ball:4,4,4,3vox"
    )
    out["energy local-region, thick slices"] = single(
        slab, energy="local-region:R=6", start="ball:19,17,6,4vox"
    )
    out["energy geodesic, one slice"] = single(
        flat, energy="geodesic:balloon=-1", start="ball:24,23,0,6vox"
    )
    out["energy seeded, clicks"] = clicked()
    out["energy seeded, size"] = clicked(size="9ml")
    out["energy chan-vese, clicks"] = clicked(energy="chan-vese", outside="point:3,15,15vox")
    out["energy partition, clicks"] = clicked(energy="partition")
    out["extension fast-marching"] = single(extension="fast-marching")
    out["energy of one's own"] = single(energy=own_energy)
    out["energy local-region, two objects"] = several(energy="local-region:R=6", max_steps=15)
    out["energy threshold learned, two objects"] = several(
        energy="threshold:learned,learned", max_steps=15
    )
    out["smoothness"] = single(smoothness=0.5, presmooth=0.8)
    out["noise"] = single(noise=0.2, seed=7)
    out["noise, two objects"] = several(noise=0.1, seed=7, max_steps=12)
    out["constant friction"] = single(friction=2.0, diffusion=0.5, flow="constant-density:k=1.5")
    out["gravity"] = single(flow="flowable-mass:gravity=0.05", smoothness=0.3)
    out["region mass under gravity"] = single(flow="region-mass:gravity=0.002", levels=1)
    out["presmooth in voxels"] = single(presmooth="1vox")
    out["no limiter, long steps"] = single(percentile=100.0, cfl=0.9, half_width=4)
    out["to the end"] = single(max_steps=300)
    out["to the end, auto levels"] = single(
        cube(48), max_steps=300, levels="auto", start="ball:20,20,20,9vox"
    )
    out["two levels"] = single(cube(48), levels=2, start="ball:20,20,20,9vox", max_steps=60)
    out["two levels, flowable mass"] = single(
        cube(48), levels=2, start="ball:20,20,20,9vox", max_steps=40, flow="flowable-mass"
    )
    out["two levels, edits"] = single(
        cube(48),
        levels=2,
        start="ball:20,20,20,9vox",
        max_steps=50,
        edit=["step=5 smoothness=0.4", "step=12 half_width=5"],
    )
    out["edits"] = single(
        edit=[
            "step=6 smoothness=0.5",
            "step=10 half_width=5",
            "step=15 flow=gradient",
            "step=20 energy=local-region:R=6",
        ],
    )
    out["mask"] = single(mask=str(folder / "mask.nii.gz"))
    out["mask, two levels"] = single(mask=str(folder / "mask.nii.gz"), levels=2)
    out["region of interest"] = single(roi="4,3,5,27,26,28vox")
    out["two channels"] = lambda: accelsurf.segment(one, channels=[second], **BASE)
    out["largest volume"] = single(max_volume=1500.0, max_steps=60)
    out["several starts"] = single(start=("ball:10,10,10,4vox", "box:18,18,18,22,22,22vox"))
    out["start from Otsu"] = single(start="otsu", presmooth=1.0)
    out["vanishes"] = single(smoothness=60.0, max_steps=80, start="ball:12,12,12,3vox")
    out["two objects"] = several()
    out["two objects, thick slices"] = several(tall, tall_starts)
    out["two objects to the end"] = several(max_steps=300)
    out["two objects in a region"] = several(roi="2,2,2,43,25,25vox", max_steps=15)
    for name in ("to the end", "two levels", "two objects", "flow flowable-mass"):
        work = {"to the end": dict(max_steps=300), "flow flowable-mass": dict(flow="flowable-mass")}
        if name == "two objects":
            out["two threads: two objects"] = several(threads=2)
        elif name == "two levels":
            out["two threads: two levels"] = single(
                cube(48), levels=2, start="ball:20,20,20,9vox", max_steps=60, threads=2
            )
        else:
            out[f"two threads: {name}"] = single(**work[name], threads=2)
    return out


def _digest(*arrays: Any) -> str:
    sha = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        sha.update(f"{array.dtype.str}{array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()[:16]


def _trace(history) -> str:
    """What the trace says, but for the clock: numbers by column, whatever the columns are called."""
    rows = [
        [float(value) for key, value in row_values(row).items() if key not in CLOCK]
        for row in history
    ]
    return _digest(np.array(rows))


def _history(result) -> Any:
    return getattr(result, "history", None) or result.history


def fingerprint(result: Any) -> dict[str, str]:
    """The hashes of a result, of each object for several."""
    parts = result.objects
    if len(parts) > 1:
        out = {"labels": _digest(result.labels)}
        for one in parts:
            for key, value in _of_one(one).items():
                out[key] = hashlib.sha256((out.get(key, "") + value).encode()).hexdigest()[:16]
        return out
    return _of_one(result)


def _of_one(result: Any) -> dict[str, str]:
    out = {
        "labels": _digest(result.labels),
        "psi": _digest(result.psi),
        "trace": _trace(_history(result)),
    }
    if result.labels.any():
        if result.geometry.slice_axis is not None:
            out["mesh"] = _digest(*[np.asarray(line) for line in result.contours.loops])
        else:
            out["mesh"] = _digest(result.surface.vertices, result.surface.faces)
    return out


def processor() -> str:
    """The kind of processor, as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--save", type=Path, metavar="FILE")
    parser.add_argument("--compare", type=Path, metavar="FILE")
    parser.add_argument("--only", default="", metavar="TEXT", help="runs whose name has this in it")
    options = parser.parse_args()
    where = {"processor": processor(), **{name: version(name) for name in PACKAGES}}
    before = json.loads(options.compare.read_text()) if options.compare else None
    if before is not None and before["where"] != where:
        print(
            f"warning: saved on another machine: {before['where']}, this is {where}",
            file=sys.stderr,
        )
    found: dict[str, dict[str, str]] = {}
    changed = []
    with tempfile.TemporaryDirectory() as folder:
        for name, run in runs(Path(folder)).items():
            if options.only not in name:
                continue
            found[name] = fingerprint(run())
            if before is not None and found[name] != before["runs"].get(name):
                then = before["runs"].get(name) or {}
                what = [key for key in found[name] if found[name][key] != then.get(key)]
                changed.append(name)
                print(f"changed: {name}: {', '.join(what) or 'parts'}", flush=True)
    if options.save:
        options.save.write_text(
            json.dumps({"where": where, "runs": found}, indent=1, sort_keys=True) + "\n"
        )
    print(f"{len(found)} runs" + (f", {len(changed)} changed" if before is not None else ""))
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())
