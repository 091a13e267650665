"""Region of interest of a run, box around the object, and mask: the voxels where the surface may be."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import Box, Corner, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import part_of
from accelsurf.grid.window import Window
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.wording import shown
from accelsurf.text.coordinates import SUFFIXES
from accelsurf.text.starts import extent_hint, label_box, parse_start

#: Least margin, voxels, of the region of a run around the box of --box: models learn the surroundings there.
_AROUND_BOX = 10


def region_of_interest(text: str | None, geometry: Geometry, name: str = "roi") -> Box:
    """Voxels of a box, the whole grid for None; on an oblique grid all between the box's corners along its axes.

    Messages call it ``name``.

    Raises
    ------
    UsageError
        When the text is no box.
    InputError
        When fewer than two voxels along an axis (with more than one) are in it.

    Examples
    --------
    >>> region_of_interest("1,1,0,3,4,9", Geometry((8, 6, 4), (1.0, 1.0, 1.0)))
    (slice(0, 8, None), slice(1, 5, None), slice(1, 4, None))
    """
    if text is None:
        return slice(0, geometry.shape[0]), slice(0, geometry.shape[1]), slice(0, geometry.shape[2])
    try:
        box = parse_start(f"box:{text}").on(geometry)
    except UsageError:
        raise UsageError(
            f"{name}: {shown(text)} was given, expected X0,Y0,Z0,X1,Y1,Z1 with the first corner below the second",
            f"world mm (LPS), or with {SUFFIXES}",
        ) from None
    corners = np.array(
        [[box.numbers[3 * (i >> axis & 1) + axis] for axis in range(3)] for i in range(8)]
    )
    index = (
        corners[:, ::-1]
        if box.vox
        else np.array([geometry.world_to_index(corner) for corner in corners])
    )
    slices = []
    for axis, n in enumerate(geometry.shape):
        low = max(int(np.ceil(index[:, axis].min() - 1e-6)), 0)
        high = min(int(np.floor(index[:, axis].max() + 1e-6)), n - 1)
        if high - low + 1 < min(n, 2):
            raise InputError(
                f"{name}: {shown(text)} was given, which contains fewer than two of the image's voxels along "
                f"{'zyx'[axis]}",
                extent_hint(geometry),
            )
        slices.append(slice(low, high + 1))
    return slices[0], slices[1], slices[2]


def cropped(geometry: Geometry, box: Box) -> Geometry:
    """The grid of some of the voxels of another."""
    shape = tuple(s.stop - s.start for s in box)
    if shape == geometry.shape:
        return geometry
    origin = geometry.index_to_world(np.array([float(s.start) for s in box]))
    return part_of(geometry, (shape[0], shape[1], shape[2]), origin.tolist())


def closed_on(psi: NDArray[np.float32], corner: Corner, box: Box) -> NDArray[np.float32]:
    """Psi on a larger ``box`` of the image, known from voxel ``corner`` on: all beyond is outside.

    An object that the region of interest cuts ends half a voxel beyond it.
    """
    before = [(c - s.start, s.stop - c - n) for s, c, n in zip(box, corner, psi.shape, strict=True)]
    out = np.abs(np.pad(psi, before, mode="edge"))
    out[tuple(slice(k, k + n) for (k, _), n in zip(before, psi.shape, strict=True))] = psi
    return out


def region_of_run(config: RunConfig, geometry: Geometry) -> Box:
    """Voxels that a run is made on: of --roi, or of --box with as much around it as half its extent; else all."""
    if config.roi is not None or config.box is None:
        return region_of_interest(config.roi, geometry)
    box = region_of_interest(config.box, geometry, "box")
    margin = [max(_AROUND_BOX, math.ceil(0.5 * (s.stop - s.start))) for s in box]
    return widened(box, geometry.shape, margin)


def distance_of_mask(
    config: RunConfig, given: Mapping[str, NDArray[np.float32]], window: Window, box: Box
) -> NDArray[np.float32] | None:
    """Signed distance, mm, of mask and box on the region ``box`` of a window; None without both."""
    # Not with the module: the viewer reads boxes before it loads the solver.
    from accelsurf.energies import mask_distance

    if "mask" in given:
        mask = np.asarray(given["mask"] < 0)
    elif config.mask is not None:
        mask = _read_mask(config.mask, window)
    elif config.box is not None:
        mask = np.ones(window.shape, np.bool_)
    else:
        return None
    if config.box is not None:
        within = np.zeros(window.shape, np.bool_)
        part = window.local(region_of_interest(config.box, window.geometry, "box"))
        within[part] = mask[part]
        mask = within
    return mask_distance(np.ascontiguousarray(mask[box]), window.geometry.spacing)


def _read_mask(file: str, window: Window) -> NDArray[np.bool_]:
    """Voxels above 0 of a label map on the image's grid, in a window of it.

    Raises
    ------
    InputError
        When there is none, or the file cannot be read; GeometryError when it lies on another grid.
    """
    mask = np.asarray(label_box(file, window, f"mask {file}") > 0)
    if not mask.any():
        there = "" if window.is_whole else " there"
        raise InputError(
            f"mask {file}: it is empty{there}",
            "give one with voxels above 0, where the surface may be",
        )
    return mask
