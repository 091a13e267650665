"""Pictures of a run: how the energy fell, where the surface lies in the image, what it looks like.

Pure functions from arrays to PNG bytes. Drawn with matplotlib's objects, never through pyplot, so they keep no state
and need no screen. Colours are Okabe and Ito's, which people with any colour vision can tell apart.

Slices are turned so that the nearest anatomical axes stand as radiologists hang them: the patient's left at the
right, front at the top (axial) or head at the top. Their axes are mm: world coordinates where the grid is parallel to
the world, so that a `--start` can be read off the picture, otherwise mm along the grid from its first voxel.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, LETTERS, PLANES, Upright
from accelsurf.report.rasterizer import render

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from accelsurf.analysis.surface_mesh import Surface
    from accelsurf.evolution.records import StepRecord

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
_INK, _GRID = "#222222", "#D9D9D9"
_RUN_COLORS = (BLUE, VERMILION, GREEN, PURPLE)
_RUN_DASHES = ("solid", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1, 2)))
_DPI = 110


@dataclass(frozen=True, eq=False)
class Scene:
    """What a picture of one run shows.

    Attributes
    ----------
    image : ndarray, shape (nz, ny, nx)
        The image.
    psi : ndarray, shape (nz, ny, nx)
        Level-set function, mm, negative inside.
    geometry : Geometry
        Their grid.
    history : sequence of Row
        One row per step.
    surface : Surface or None
        The surface in world mm; None when there is none (vanished or filled).
    title : str
        One line above the picture.
    anatomical : bool
        Whether the world axes are known to be a patient's, so that letters (R L A P I S) may be written.
    reference : ndarray, shape (nz, ny, nx), optional
        Labels to compare with (> 0 is the object), drawn as a second contour.
    start : ndarray, shape (nz, ny, nx), optional
        psi of the start, drawn for an image of one slice.
    labels : ndarray, shape (nz, ny, nx), optional
        Several objects, each its label: drawn instead of psi, which does not tell where they touch.
    """

    image: NDArray[Any]
    psi: NDArray[Any]
    geometry: Geometry
    history: Sequence[StepRecord]
    surface: Surface | None
    title: str
    anatomical: bool = False
    reference: NDArray[Any] | None = None
    start: NDArray[Any] | None = None
    labels: NDArray[Any] | None = None


def load_meanwhile() -> None:
    """Load the drawing library in a thread of its own: half a second while compiled kernels compute, not after them."""
    threading.Thread(target=_library, name="accelsurf-drawing").start()


def _library() -> tuple[type[Figure], type[FigureCanvasAgg]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    return Figure, FigureCanvasAgg


def preview_png(scene: Scene) -> bytes:
    """Draw one run: three slices with the contour, energies against step, the surface in 3D.

    Of an image of one slice: the image with the contour and the start, and the energies.

    Parameters
    ----------
    scene : Scene
        What to show.

    Returns
    -------
    bytes
        A PNG file.
    """
    if scene.geometry.slice_axis is not None:
        return _flat_png(scene, scene.geometry.slice_axis)
    figure = _figure(12.6, 8.6, scene.title)
    grid = figure.add_gridspec(2, 3, left=0.06, right=0.965, top=0.89, bottom=0.075, hspace=0.27, wspace=0.26)
    place = _centroid(scene)
    for plane in range(3):
        _draw_slice(figure.add_subplot(grid[0, plane]), scene, plane, place)
    _draw_energies(figure.add_subplot(grid[1, :2]), scene.history)
    _draw_surface(figure.add_subplot(grid[1, 2]), scene)
    return _png(figure)


def _flat_png(scene: Scene, axis: int) -> bytes:
    """Draw a run on an image of one slice; the picture is as wide and high as suits the image."""
    order = Upright.of(scene.geometry).order
    plane = order.index(axis)
    tall, wide = (_extent(scene.geometry, order[i]) for i in IN_PLANE[plane])
    inch = min(6.8 / wide, 8.0 / tall)  # per mm
    left, high, right = max(wide * inch, 2.5), max(tall * inch, 4.0), 4.6
    width, height = left + right + 2.7, high + 1.55
    figure = _figure(width, height, scene.title)
    grid = figure.add_gridspec(
        1,
        2,
        left=0.8 / width,
        right=1 - 0.8 / width,
        top=1 - 0.9 / height,
        bottom=0.65 / height,
        wspace=2.2 / (left + right),
        width_ratios=(left, right),
    )
    _draw_slice(figure.add_subplot(grid[0, 0]), scene, plane, _centroid(scene))
    energies = figure.add_subplot(grid[0, 1])
    _draw_energies(energies, scene.history)
    energies.set_box_aspect(min(0.9, high / right))
    return _png(figure)


def _extent(geometry: Geometry, axis: int) -> float:
    return geometry.shape[axis] * geometry.spacing[axis]


def comparison_png(scenes: Mapping[str, Scene], title: str) -> bytes:
    """Draw several runs on the same image side by side: a slice and the surface of each, then all energies.

    Parameters
    ----------
    scenes : mapping of str to Scene
        Name of each run (the heading of its column) and what it shows; at least one.
    title : str
        One line above the picture.

    Returns
    -------
    bytes
        A PNG file.
    """
    count, axis = len(scenes), next(iter(scenes.values())).geometry.slice_axis
    ratios = (1, 1, 0.75) if axis is None else (1, 0.75)  # of one slice there is no surface
    height = 12.0 if axis is None else 8.2
    figure = _figure(max(4.1 * count, 8.2), height, title)
    place = {"left": 0.09, "right": 0.965, "top": 1 - 1.14 / height, "bottom": 0.66 / height}
    grid = figure.add_gridspec(len(ratios), count, hspace=0.24, wspace=0.25, height_ratios=ratios)
    grid.update(**place)
    everything = [scene.surface.vertices for scene in scenes.values() if scene.surface is not None]
    box = np.concatenate(everything) if everything else None
    for column, (name, scene) in enumerate(scenes.items()):
        top = figure.add_subplot(grid[0, column])
        plane = 0 if axis is None else Upright.of(scene.geometry).order.index(axis)
        _draw_slice(top, scene, plane, _centroid(scene))
        top.set_title(f"{name}\n{scene.title}", fontsize=10, color=_INK)
        color = _RUN_COLORS[column % len(_RUN_COLORS)]
        if axis is None:
            _draw_surface(figure.add_subplot(grid[1, column]), scene, box=box, color=color)
    below = figure.add_subplot(grid[-1, :])
    for number, (name, scene) in enumerate(scenes.items()):
        below.plot(
            *_potentials(scene.history),
            color=_RUN_COLORS[number % len(_RUN_COLORS)],
            linestyle=_RUN_DASHES[number % len(_RUN_DASHES)],
            linewidth=1.8,
            label=name,
        )
    _style(below, "step", "energy")
    below.legend(frameon=False, fontsize=9, labelcolor=_INK)
    return _png(figure)


# ------------------------------------------------------------------------------------------------------------ slices


def _centroid(scene: Scene) -> tuple[int, int, int]:
    """Voxel of the upright volume in the middle of the object, or of the volume when there is none."""
    psi = Upright.of(scene.geometry).turn(scene.psi)
    inside = psi < 0
    if not inside.any():
        return psi.shape[0] // 2, psi.shape[1] // 2, psi.shape[2] // 2
    columns = np.count_nonzero(inside, axis=0)
    counts = [np.count_nonzero(inside.reshape(len(inside), -1), axis=1), columns.sum(axis=1), columns.sum(axis=0)]
    z, y, x = (int(round(float(np.average(np.arange(len(c)), weights=c)))) for c in counts)
    return z, y, x


def _draw_slice(axes: Axes, scene: Scene, plane: int, place: tuple[int, int, int]) -> None:
    """Draw one slice through the voxel ``place`` of the upright volume: plane 0 is axial, 1 coronal, 2 sagittal."""
    up = Upright.of(scene.geometry)
    image, psi = up.turn(scene.image), up.turn(scene.psi)
    vertical, horizontal = IN_PLANE[plane]
    cut = tuple(place[axis] if axis == plane else slice(None) for axis in range(3))
    values = np.asarray(image[cut], dtype=np.float64)
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
    lines: list[tuple[str, NDArray[Any], str, Any]] = [("result", np.asarray(psi[cut]), ORANGE, "solid")]
    if scene.reference is not None:
        mask = np.where(up.turn(scene.reference)[cut] > 0, -0.5, 0.5)
        lines.append(("reference", mask, SKY, (0, (2, 1.5))))
    if scene.start is not None:
        lines.append(("start", np.asarray(up.turn(scene.start)[cut]), GREEN, (0, (4, 2))))
    if scene.labels is not None:
        slab = up.turn(scene.labels)[cut]
        for own in np.unique(slab[slab > 0]):
            _contour(axes, np.where(slab == own, -0.5, 0.5), up, vertical, horizontal, ORANGE, "solid")
        lines = lines[1:]
    for name, level, color, dashes in lines:
        _contour(axes, level, up, vertical, horizontal, color, dashes)
        axes.plot([], [], color=color, linestyle=dashes, label=name)
    if len(lines) > 1 or scene.labels is not None and lines:
        axes.legend(fontsize=8, loc="lower right", framealpha=0.75, borderpad=0.3, labelcolor=_INK)
    where = f"{up.names[plane]} = {up.coordinate(plane, place[plane]):.4g} mm"
    kind = PLANES[plane] if scene.anatomical else "Slice"
    axes.set_title(f"{kind}, {where}", fontsize=10, color=_INK)
    _style(axes, f"{up.names[horizontal]} (mm)", f"{up.names[vertical]} (mm)", lines=False)
    if scene.anatomical:
        _write_letters(axes, horizontal, vertical, top_is_low=plane == 0)


def _contour(
    axes: Axes, psi: NDArray[Any], up: Upright, vertical: int, horizontal: int, color: str, dashes: Any
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


# -------------------------------------------------------------------------------------------------- energies, surface


def _draw_energies(axes: Axes, history: Sequence[StepRecord]) -> None:
    steps = [row.step for row in history]
    axes.set_title("Energy and kinetic energy", fontsize=10, color=_INK)
    axes.plot(*_potentials(history), color=BLUE, linewidth=1.8)
    _style(axes, "step", "energy")
    axes.yaxis.label.set_color(BLUE)
    kinetic = [row.kinetic for row in history]
    if any(kinetic):
        right = axes.twinx()
        right.plot(steps, kinetic, color=VERMILION, linewidth=1.5, linestyle=_RUN_DASHES[1])
        _style(right, "", "kinetic energy (dashed)", lines=False)
        right.ticklabel_format(style="sci", scilimits=(-3, 5), axis="y")
        right.yaxis.label.set_color(VERMILION)
        right.set_ylim(bottom=0)
    else:
        axes.text(0.98, 0.93, "no kinetic energy: the flow has no momentum", transform=axes.transAxes, ha="right")
    restarts = [row.step for row in history if row.restarted]
    if restarts:
        bottom = np.zeros(len(restarts))
        axes.plot(restarts, bottom, "^", color=_INK, markersize=6, transform=axes.get_xaxis_transform(), clip_on=False)
        axes.plot([], [], "^", color=_INK, markersize=6, linestyle="none", label="restart (put at rest)")
        axes.legend(frameon=False, fontsize=9, loc="upper right", bbox_to_anchor=(1.0, 0.9), labelcolor=_INK)


def _potentials(history: Sequence[StepRecord]) -> tuple[list[int], list[float]]:
    """Steps and potentials, with a gap where the grid changes: each level has its own image, with its own energies."""
    steps: list[int] = []
    values: list[float] = []
    for place, row in enumerate(history):
        if place and row.level != history[place - 1].level:
            steps.append(row.step)
            values.append(float("nan"))
        steps.append(row.step)
        values.append(row.potential)
    return steps, values


def _draw_surface(axes: Axes, scene: Scene, box: NDArray[Any] | None = None, color: str = SKY) -> None:
    axes.set_axis_off()
    if scene.surface is None or not len(scene.surface.faces):
        axes.text(0.5, 0.5, "no surface", ha="center", va="center", transform=axes.transAxes, color=_INK)
        return
    size = 360  # as many as the picture has there
    red, green, blue = (0.2 + 0.8 * int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    picture = render(scene.surface.vertices, scene.surface.faces, size=size, color=(red, green, blue), box=box)
    axes.imshow(picture.pixels, extent=(0, size, 0, size))
    axes.set_title("Surface", fontsize=10, color=_INK)
    _draw_scale_bar(axes, size, picture.mm_per_pixel)
    letters = "LPS" if scene.anatomical else "xyz"
    for (right, up), letter in zip(picture.axes, letters, strict=True):
        arrow = {"arrowstyle": "-|>", "color": _INK, "lw": 1.1, "shrinkA": 0}
        axes.annotate("", xy=(32 + 34 * right, -42 + 34 * up), xytext=(32, -42), arrowprops=arrow)
        axes.text(32 + 47 * right, -42 + 47 * up, letter, ha="center", va="center", fontsize=8.5, color=_INK)
    axes.set(xlim=(0, size), ylim=(-66, size))


def _draw_scale_bar(axes: Axes, size: int, mm_per_pixel: float) -> None:
    """Draw a bar of a round length, about a fifth of the picture."""
    wanted = 0.22 * size * mm_per_pixel
    decade = 10.0 ** np.floor(np.log10(wanted))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= wanted)
    right, pixels = size - 12, length / mm_per_pixel
    axes.plot([right - pixels, right], [-48, -48], color=_INK, linewidth=2.5, solid_capstyle="butt")
    axes.text(right - pixels / 2, -42, f"{length:g} mm", ha="center", va="bottom", fontsize=8.5, color=_INK)


# ------------------------------------------------------------------------------------------------------------- shared


def _figure(width: float, height: float, title: str) -> Figure:
    new_figure, canvas = _library()
    figure = new_figure(figsize=(width, height), dpi=_DPI, facecolor="white")
    canvas(figure)
    figure.suptitle(title, fontsize=12, color=_INK, y=0.975)
    return figure


def _style(axes: Axes, xlabel: str, ylabel: str, lines: bool = True) -> None:
    axes.set_xlabel(xlabel, fontsize=9, color=_INK)
    axes.set_ylabel(ylabel, fontsize=9, color=_INK)
    axes.tick_params(labelsize=8, colors=_INK, length=3)
    for side in axes.spines.values():
        side.set_color("#999999")
    if lines:
        # Powers of ten as mathematical text would take a third of the picture's time.
        axes.ticklabel_format(style="sci", scilimits=(-3, 5), axis="y")
        axes.locator_params(axis="x", integer=True)  # steps
        axes.grid(color=_GRID, linewidth=0.6)
        axes.set_axisbelow(True)


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": "accelsurf"})
    return stream.getvalue()
