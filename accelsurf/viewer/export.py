"""A scene as one HTML file that can be turned in any browser, without this program and without the internet."""

from __future__ import annotations

import base64
import html
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.orientation import LETTERS
from accelsurf.io import write_bytes
from accelsurf.output import png_bytes
from accelsurf.settings.wording import in_unit
from accelsurf.viewer.scene.colors import REFERENCE, SHADES, color_range
from accelsurf.viewer.scene.scene import Scene


def html_page(scene: Scene) -> str:
    """Return the page: the surface in 3D, which can be turned, beside a picture of slices and energies.

    Raises
    ------
    UsageError
        For an image of one slice, which has nothing to turn.
    """
    space = scene.space
    if space is None:
        raise UsageError(
            "html: an image of one slice was given, expected a volume", "save a picture instead"
        )
    middle = scene.geometry.center_world()
    theme = scene.theme
    meshes = [_lines(space.box, theme.lines, middle)]
    for mesh, style in zip(space.meshes, scene.styles.of(scene.frame), strict=True):
        if mesh.n_points and style.visible:
            meshes.append(_triangles(mesh, style.color, middle, style.opacity, space.color))
    if space.reference is not None and space.reference.n_points:
        meshes.append(_triangles(space.reference, REFERENCE, middle, 0.35, "plain"))
    picture = scene.screenshot()
    corners = scene.geometry.corners_world() - middle
    document = {
        "meshes": meshes,
        "ground": _rgb(theme.background),
        "ink": theme.ink,
        "reach": float(np.linalg.norm(corners, axis=1).max()) or 1.0,
        "half": np.abs(corners).max(axis=0).tolist(),
        "unit": [scene.unit, in_unit(1.0, scene.unit)],
        "letters": LETTERS if scene.anatomical else (("-x", "+x"), ("-y", "+y"), ("-z", "+z")),
    }
    page = resources.files("accelsurf.viewer").joinpath("export.html").read_text(encoding="utf-8")
    caption = "\n".join((*space.title.text.split("\n"), *scene.legend))
    parts = {
        "TITLE": html.escape(scene.title or "accelsurf"),
        "CAPTION": html.escape(caption),
        "GROUND": theme.background,
        "INK": theme.ink,
        "PICTURE": base64.b64encode(png_bytes(picture[:, picture.shape[1] // 2 :])).decode(),
        # The data must not end the script that holds them.
        "SCENE": json.dumps(document).replace("<", "\\u003c"),
    }
    # In one pass: the text that is put in may look like a placeholder itself.
    return re.sub("__(" + "|".join(parts) + ")__", lambda found: parts[found.group(1)], page)


def write_html(scene: Scene, path: str | Path) -> None:
    """Write `html_page` to a file, whole or not at all.

    Raises
    ------
    UsageError
        As `html_page`, and for another suffix than .html.
    OutputError
        When the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{path.name}: {path.suffix or 'no suffix'} was given, expected .html")
    write_bytes(path, html_page(scene).encode())


def _triangles(
    mesh: pv.PolyData, color: str, middle: NDArray[Any], opacity: float, quantity: str
) -> dict[str, Any]:
    normals = np.asarray(mesh.point_data.active_normals)
    made = {
        "points": _packed(np.asarray(mesh.points) - middle, np.float32),
        "normals": _packed(np.rint(127 * normals), np.int8),
        "cells": _packed(np.asarray(mesh.faces).reshape(-1, 4)[:, 1:], np.uint32),
        "color": _rgb(color),
        "opacity": opacity,
    }
    if quantity in mesh.point_data:
        shade, values = SHADES[quantity], np.asarray(mesh.point_data[quantity])
        low, high = color_range(values, shade.signed)
        index = np.clip((values - low) / (high - low) * 255.999, 0, 255).astype(int)
        made["colors"] = _packed(
            np.asarray(pv.LookupTable(cmap=shade.cmap, n_values=256).values)[index, :3], np.uint8
        )
    return made


def _lines(mesh: pv.PolyData, color: str, middle: NDArray[Any]) -> dict[str, Any]:
    return {
        "points": _packed(np.asarray(mesh.points) - middle, np.float32),
        "cells": _packed(np.asarray(mesh.lines).reshape(-1, 3)[:, 1:], np.uint32),
        "color": _rgb(color),
        "opacity": 1.0,
    }


def _packed(array: NDArray[Any], kind: Any) -> str:
    little = np.dtype(kind).newbyteorder("<")
    return base64.b64encode(np.ascontiguousarray(array, little).tobytes()).decode()


def _rgb(color: str) -> list[float]:
    return [float(part) for part in pv.Color(color).float_rgb]
