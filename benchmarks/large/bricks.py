"""Whether the size of a store's bricks changes a byte: phantoms of 256^3 and 512^3, three sizes, and in memory.

    python -m benchmarks.large.bricks

Adds to results/large.json the digests of labels, mesh and volume of a run from a ball and one from a click.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import accelsurf
from accelsurf.grid.boxes import bounding_box
from benchmarks.large import __main__ as make
from benchmarks.large.study import RESULT, RUNS, settings_of

SIZES, BRICKS = (256, 512), (64, 100, 128)


def main() -> None:
    rows: list[dict[str, Any]] = []
    for size in SIZES:
        for brick in BRICKS:
            with tempfile.TemporaryDirectory() as folder:
                store = Path(folder) / "store"
                make.main([str(store), "--size", str(size), "--chunk", str(brick), "--levels", "1"])
                ways = ("parts", "memory") if brick == BRICKS[0] else ("parts",)
                rows += [
                    row(store, size, brick, run, way)
                    for way in ways
                    for run in ("ball", "click, size")
                ]
    for size in SIZES:
        for run in ("ball", "click, size"):
            found = {one["digest"] for one in rows if (one["size"], one["run"]) == (size, run)}
            print(f"{size}, {run}: {'the same bytes' if len(found) == 1 else 'OTHER BYTES'}")
    about = json.loads(RESULT.read_text()) if RESULT.exists() else {"runs": []}
    RESULT.write_text(json.dumps({**about, "bricks": rows}, indent=1) + "\n")


def row(store: Path, size: int, brick: int, run: str, way: str) -> dict[str, Any]:
    """The digest of a run: labels in their box, its place, the mesh, the volume."""
    image = accelsurf.open_volume(store / "image.ome.zarr")
    options = settings_of(store, run)
    if way == "parts":
        result = accelsurf.segment(image, max_memory="3GB", **options)
    else:
        whole = tuple(slice(0, n) for n in image.geometry.shape)
        result = accelsurf.segment(accelsurf.Volume(image.read(whole), image.geometry), **options)
    box = bounding_box(result.labels > 0)
    assert box is not None
    corner = (0, 0, 0) if result.window is None else result.window.corner
    place = [s.start + c for s, c in zip(box, corner, strict=True)]
    sha = hashlib.sha256(repr((place, result.volume_mm3)).encode())
    for array in (result.labels[box], result.surface.vertices.astype("<f4"), result.surface.faces):
        sha.update(np.ascontiguousarray(array).tobytes())
    return {"size": size, "brick": brick, "run": run, "way": way, "digest": sha.hexdigest()[:16]}


if __name__ == "__main__":
    assert set(RUNS) >= {"ball", "click, size"}
    main()
