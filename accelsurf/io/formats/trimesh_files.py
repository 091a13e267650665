"""Meshes that trimesh reads: PLY, STL, OBJ."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray


def _read(content: bytes, kind: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Points and triangles as the file has them; textures and materials, which are other files, are not looked for."""
    import trimesh

    with warnings.catch_warnings(), np.errstate(all="ignore"), _silent(trimesh.util.log):
        warnings.simplefilter("ignore")
        # numpy stops reading a line of numbers at the first that is none, and only warns.
        warnings.filterwarnings("error", message="string or file could not be read to its end")
        mesh = trimesh.load_mesh(
            io.BytesIO(content), file_type=kind, process=False, validate=False, skip_materials=True
        )
    points, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points of {points.shape[-1]} coordinates")
    return points, triangles


read_ply, read_stl, read_obj = (partial(_read, kind=kind) for kind in ("ply", "stl", "obj"))


@contextmanager
def _silent(logger: logging.Logger) -> Iterator[None]:
    """Nothing logged for a moment: without a handler, Python prints warnings to the screen."""
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before
