"""Slices through the image with the contours of the result, as radiologists hang them.

Slices are reoriented to the nearest anatomical axes: the patient's left at the right, front at the top (axial) or head
at the top (coronal, sagittal). Their axes are mm: world coordinates where the grid is parallel to the world, so that a
`--start` can be read off the picture, otherwise mm along the grid from its first voxel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.orientation import IN_PLANE, LETTERS, PLANES, DisplayOrientation
from accelsurf.report.canvas import GREEN, INK, ORANGE, SKY, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from accelsurf.report.preview_content import PreviewContent


def middle_voxel(content: PreviewContent) -> tuple[int, int, int]:
    """Voxel of the reoriented volume in the middle of the object, or of the volume when there is none."""
    psi = DisplayOrientation.of(content.geometry).reorient(content.psi)
    inside = psi < 0
    if not inside.any():
        return psi.shape[0] // 2, psi.shape[1] // 2, psi.shape[2] // 2
    columns = np.count_nonzero(inside, axis=0)
    counts = [np.count_nonzero(inside.reshape(len(inside), -1), axis=1), columns.sum(axis=1), columns.sum(axis=0)]
    z, y, x = (int(round(float(np.average(np.arange(len(c)), weights=c)))) for c in counts)
    return z, y, x


def draw_slice(axes: Axes, content: PreviewContent, plane: int, place: tuple[int, int, int]) -> None:
    """Draw one slice through the voxel ``place`` of the reoriented volume: plane 0 is axial, 1 coronal, 2 sagittal."""
    up = DisplayOrientation.of(content.geometry)
    vertical, horizontal = IN_PLANE[plane]
    section = tuple(place[axis] if axis == plane else slice(None) for axis in range(3))
    values = np.asarray(up.reorient(content.image)[section], dtype=np.float64)
    low, high = np.percentile(values, (1, 99))
    edges = [
        up.coordinate(axis, index)
        for axis, n in ((horizontal, values.shape[1]), (vertical, values.shape[0]))
        for index in (-0.5, n - 0.5)
    ]
    # Front at the top (y runs down) in the axial slice; head at the top (z runs up) in the other two.
    extent = (edges[0], edges[1], edges[3], edges[2]) if plane == 0 else (edges[0], edges[1], edges[2], edges[3])
    axes.imshow(
        values,
        cmap="gray",
        vmin=low,
        vmax=high if high > low else low + 1,
        extent=extent,
        origin="upper" if plane == 0 else "lower",
        interpolation="nearest",
        aspect="equal",
    )
    _draw_contours(axes, content, up, plane, section)
    where = f"{up.names[plane]} = {up.coordinate(plane, place[plane]):.4g} mm"
    kind = PLANES[plane] if content.anatomical else "Slice"
    axes.set_title(f"{kind}, {where}", fontsize=10, color=INK)
    style_axes(axes, f"{up.names[horizontal]} (mm)", f"{up.names[vertical]} (mm)", lines=False)
    if content.anatomical:
        _write_letters(axes, horizontal, vertical, top_is_low=plane == 0)


def _draw_contours(
    axes: Axes, content: PreviewContent, up: DisplayOrientation, plane: int, section: tuple[int | slice, ...]
) -> None:
    """Draw the contours of result, reference and start in a slice, with a legend when there are several."""
    vertical, horizontal = IN_PLANE[plane]
    lines: list[tuple[str, NDArray[Any], str, Any]] = []
    if content.labels is None:
        lines.append(("result", np.asarray(up.reorient(content.psi)[section]), ORANGE, "solid"))
    else:
        labels = up.reorient(content.labels)[section]
        for number in np.unique(labels[labels > 0]):
            _contour(axes, np.where(labels == number, -0.5, 0.5), up, vertical, horizontal, ORANGE, "solid")
    if content.reference is not None:
        mask = np.where(up.reorient(content.reference)[section] > 0, -0.5, 0.5)
        lines.append(("reference", mask, SKY, (0, (2, 1.5))))
    if content.start is not None:
        lines.append(("start", np.asarray(up.reorient(content.start)[section]), GREEN, (0, (4, 2))))
    for name, level, color, dashes in lines:
        _contour(axes, level, up, vertical, horizontal, color, dashes)
        axes.plot([], [], color=color, linestyle=dashes, label=name)
    if len(lines) > 1 or content.labels is not None and lines:
        axes.legend(fontsize=8, loc="lower right", framealpha=0.75, borderpad=0.3, labelcolor=INK)


def _contour(
    axes: Axes, psi: NDArray[Any], up: DisplayOrientation, vertical: int, horizontal: int, color: str, dashes: Any
) -> None:
    """Draw the zero level, dark below and coloured above, so that it shows on any grey."""
    if min(psi.shape) < 2 or not (psi < 0).any() or not (psi > 0).any():
        return
    x = [up.coordinate(horizontal, i) for i in range(psi.shape[1])]
    y = [up.coordinate(vertical, i) for i in range(psi.shape[0])]
    axes.contour(x, y, psi, levels=[0.0], colors=["black"], linewidths=2.6, alpha=0.55)
    axes.contour(x, y, psi, levels=[0.0], colors=[color], linewidths=1.5, linestyles=[dashes])


def _write_letters(axes: Axes, horizontal: int, vertical: int, top_is_low: bool) -> None:
    """Write the patient's directions at the edges of a slice."""
    left, right = LETTERS[2 - horizontal]
    low, high = LETTERS[2 - vertical]
    top, bottom = (low, high) if top_is_low else (high, low)
    for x, y, letter in ((0.045, 0.5, left), (0.955, 0.5, right), (0.5, 0.95, top), (0.5, 0.05, bottom)):
        axes.text(
            x,
            y,
            letter,
            transform=axes.transAxes,
            ha="center",
            va="center",
            fontsize=9,
            color="white",
            fontweight="bold",
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "black", "edgecolor": "none", "alpha": 0.45},
        )
