"""What is written over the picture: step, level and volume, and what each colour is."""

from __future__ import annotations

from collections.abc import Sequence

from accelsurf.grid.geometry import Geometry
from accelsurf.settings.wording import in_unit
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.scene.colors import REFERENCE
from accelsurf.viewer.scene.object_styles import ObjectStyle, unnamed

#: Lines of the legend at most.
MAX_LEGEND = 20
#: From this volume on ml are written, mm3.
MIN_ML = 100.0


def caption(frame: Frame, geometry: Geometry, unit: str = "mm") -> list[str]:
    """Return step and level, or frame and time, and the volume (of one slice the area), in the file's unit."""
    step = frame.said or f"step {frame.step}" + (f", level {frame.level} (coarse grid)" if frame.level else "")
    step += ", corrected" if frame.corrected_at is not None else ""
    axis = geometry.slice_axis
    if axis is None:
        return [step, f"volume {volume_line(frame.volume_mm3, unit)}"]
    return [step, f"area {measure(in_unit(frame.volume_mm3 / geometry.spacing[axis], unit, 2))} {unit}2"]


def volume_line(mm3: float, unit: str = "mm") -> str:
    """Return a volume in the unit of the file, with ml beside it where people use them.

    Examples
    --------
    >>> volume_line(67033.2), volume_line(12.5), volume_line(4.2e-7, "um")
    ('67 033 mm3 = 67.03 ml', '12.5 mm3', '420 um3')
    """
    ml = f" = {mm3 / 1000:.4g} ml" if unit == "mm" and mm3 >= MIN_ML else ""
    return f"{measure(in_unit(mm3, unit, 3))} {unit}3{ml}"


def legend_lines(
    frame: Frame, dice: float | None, styles: Sequence[ObjectStyle]
) -> list[tuple[str, str | None]]:
    """Return each line of the legend, and the colour that it names; none for one object without a reference.

    Parameters
    ----------
    frame : Frame
    dice : float, optional
        Of the objects and the reference; None without one.
    styles : sequence of ObjectStyle
        Of the surfaces.
    """
    several = len(frame.surfaces) > 1
    if not several and dice is None:
        return []
    lines: list[tuple[str, str | None]] = [
        # One object alone is the surface, unless somebody has named it.
        (style.name if several or style.name != unnamed(one.id) else "surface", style.color)
        for one, style in zip(frame.surfaces[:MAX_LEGEND], styles, strict=False)
        if style.visible
    ]
    if len(frame.surfaces) > MAX_LEGEND:
        lines.append((f"and {len(frame.surfaces) - MAX_LEGEND} more", None))
    return lines if dice is None else [*lines, (f"reference, Dice {dice:.3f}", REFERENCE)]


def measure(value: float) -> str:
    """Return a measure with four digits, or all before the point, in groups of three.

    Examples
    --------
    >>> measure(0.123456), measure(1234567.8)
    ('0.1235', '1 234 568')
    """
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:,.0f}".replace(",", " ")
