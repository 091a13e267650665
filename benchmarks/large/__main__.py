"""Make a large phantom: an OME-Zarr store with its pyramid, a table of the cells' starts, and what is in it.

    python -m benchmarks.large FOLDER --size 512

leaves image.ome.zarr (0.5, uint8, chunks compressed by zstd), cells.csv (balls for ``--objects``) and scene.json in
the folder. The truth of any box is `benchmarks.large.voxels.truth`. Memory: a few chunks, whatever the size.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import zarr
from zarr.codecs import ZstdCodec

from benchmarks.large.scene import Scene, table
from benchmarks.large.voxels import Box, halved, image

#: Voxels are cubes of so many mm.
SPACING_MM = 0.01


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.large", description="Make a large phantom."
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=int, default=512, help="voxels along each axis, default 512")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cells", type=int, default=1000)
    parser.add_argument("--levels", type=int, default=4, help="of the pyramid, default 4")
    parser.add_argument(
        "--chunk", type=int, default=128, help="voxels along each axis of a chunk, default 128"
    )
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args(argv)
    began = time.perf_counter()
    scene = Scene.of(given.size, given.seed, given.cells)
    given.folder.mkdir(parents=True)
    make_store(scene, given.folder / "image.ome.zarr", given.levels, given.chunk, given.threads)
    write_table(scene, given.folder / "cells.csv")
    seconds = round(time.perf_counter() - began, 1)
    about = {**description(scene), "chunk": given.chunk, "levels": given.levels, "seconds": seconds}
    (given.folder / "scene.json").write_text(json.dumps(about, indent=1) + "\n")
    print(f"written: {given.folder}, {seconds} s")


def make_store(scene: Scene, path: Path, levels: int, chunk: int, threads: int) -> None:
    """Write the image and its pyramid, each level from the one before.

    Raises
    ------
    zarr.errors.ContainsGroupError
        If there is one.
    """
    group = zarr.create_group(path, zarr_format=3)
    shapes = [scene.size]
    while len(shapes) < levels:
        shapes.append(-(-shapes[-1] // 2))
    arrays = [
        group.create_array(
            str(number),
            shape=(n,) * 3,
            chunks=(chunk,) * 3,
            dtype="uint8",
            compressors=ZstdCodec(level=1),
            dimension_names=("z", "y", "x"),
            fill_value=0,
        )
        for number, n in enumerate(shapes)
    ]
    for number, array in enumerate(arrays):
        finer = arrays[number - 1] if number else None

        def write(box: Box, array: Any = array, finer: Any = finer) -> None:
            array[box] = (
                image(scene, box) if finer is None else halved(finer[_doubled(box, finer.shape[0])])
            )

        each(write, chunks(shapes[number], chunk), threads)
    group.attrs["ome"] = multiscales(levels)


def each(task: Callable[[Box], None], boxes: Iterable[Box], threads: int) -> None:
    """Call a function for each box, on threads; the first error ends it."""
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(task, boxes):
            pass


def chunks(size: int, chunk: int) -> list[Box]:
    """The boxes of all chunks of a cube."""
    sides = [slice(first, min(first + chunk, size)) for first in range(0, size, chunk)]
    return list(itertools.product(sides, repeat=3))


def _doubled(box: Box, size: int) -> Box:
    """The voxels of the finer level that a box is made of."""
    z, y, x = (slice(2 * side.start, min(2 * side.stop, size)) for side in box)
    return z, y, x


def multiscales(levels: int) -> dict[str, Any]:
    """Metadata of the levels, by OME-Zarr 0.5."""
    micron = 1000.0 * SPACING_MM
    datasets = [
        {
            "path": str(level),
            "coordinateTransformations": [
                {"type": "scale", "scale": [micron * 2**level] * 3},
                {"type": "translation", "translation": [micron * (2**level - 1) / 2] * 3},
            ],
        }
        for level in range(levels)
    ]
    axes = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
    return {
        "version": "0.5",
        "multiscales": [{"name": "image", "type": "mean", "axes": axes, "datasets": datasets}],
    }


def write_table(scene: Scene, path: Path) -> None:
    """Write a table of balls, one within each cell."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["id", "x", "y", "z", "r"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table(scene, SPACING_MM))


def description(scene: Scene) -> dict[str, Any]:
    """What the store's folder says of itself."""
    return {
        "what": __doc__,
        "size": scene.size,
        "seed": scene.seed,
        "cells": len(scene.centres),
        "capsules": len(scene.capsules),
        "spacing_mm": SPACING_MM,
        "root_mm_xyz": (scene.capsules[0, 3:6] * SPACING_MM).tolist()[::-1],
        "root_radius_mm": float(scene.capsules[0, 6]) * SPACING_MM,
        "touching": scene.touching.tolist(),
    }


if __name__ == "__main__":
    main()
