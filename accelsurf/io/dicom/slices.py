"""Places of the slices of a volume: their order along the normal, and whether that is a regular grid.

The order of slices follows from where they lie, never from their numbers or names. A grid is one where no slice lies
farther than `TOLERANCE_MM` from its place. Otherwise each fault is told with the names of the files: voxels between
slices are not made up.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.sources import HEADER_HINT
from accelsurf.io.dicom.volumes import DicomVolume, names_of
from accelsurf.settings.reading import Spacing

#: No slice may lie farther from its place on the grid, at any of its corners, mm.
TOLERANCE_MM = 0.01
#: Of the axes of a slice from unit vectors at a right angle.
_AXES_TOLERANCE = 1e-3
_FAULT_HINT = (
    "give a complete series, without files that do not belong to it; dcm2niix converts a tilted gantry, "
    "uneven distances and gaps"
)


@dataclass(frozen=True, eq=False)
class Slices:
    """Slices in their order, and its faults.

    Attributes
    ----------
    frames : tuple of Frame
        Along the normal.
    axes : ndarray, shape (3, 3)
        Columns: directions along a row (x), along a column (y), and the normal (z); orthonormal.
    spacing : tuple of float
        (z, y, x), mm; z is the mean distance of slices.
    positions : ndarray, shape (n, 3)
        Of the first pixels, mm.
    faults : tuple of str
        Why they make no regular grid, with the names of files.
    note : str
        Note on it for the user; empty for none.
    """

    frames: tuple[Frame, ...]
    axes: Floats
    spacing: tuple[float, float, float]
    positions: Floats
    faults: tuple[str, ...]
    note: str = ""

    @property
    def along(self) -> Floats:
        """Place of each slice along the normal, from the first on, mm."""
        return np.asarray((self.positions - self.positions[0]) @ self.axes[:, 2])

    @property
    def aside(self) -> Floats:
        """Shift of each slice in its plane against the first, mm: along a row, along a column."""
        return np.asarray((self.positions - self.positions[0]) @ self.axes[:, :2])

    @property
    def geometry(self) -> Geometry:
        """The grid.

        Raises
        ------
        GeometryError
            When there is a fault.
        """
        if self.faults:
            raise GeometryError("; ".join(self.faults), _FAULT_HINT)
        first = self.frames[0]
        shape = (len(self.frames), first.rows, first.columns)
        return Geometry(shape, self.spacing, tuple(self.positions[0].tolist()), self.axes)


def ordered(volume: DicomVolume, root: Path, spacing: Spacing | None = None) -> Slices:
    """Put slices in their order along the normal, and find the faults of this order.

    Parameters
    ----------
    volume : DicomVolume
    root : Path
        The folder that messages name files from.
    spacing : tuple of float, optional
        Size of a voxel (x, y, z), mm, for pictures that do not say where they lie.

    Raises
    ------
    GeometryError
        When a slice does not say where it lies; InputError when all do and a spacing was given.
    """
    frames = volume.frames
    placed = [
        frame for frame in frames if frame.position is not None and frame.orientation is not None
    ]
    if placed and spacing is not None:
        raise InputError(
            "spacing: it was given, and the files say where each slice lies", "leave it out"
        )
    if not placed and (len(frames) == 1 or spacing is not None):
        return _pictures(frames, spacing)
    lost = [frame for frame in frames if frame.position is None or frame.orientation is None]
    if lost:
        raise GeometryError(
            f"{len(lost)} of {len(frames)} slices do not say where they lie: {names_of(lost, root)}",
            "give a series of slices with positions, or --spacing X,Y,Z for pictures one above the other",
        )
    axes = _axes(frames[0], root)
    alike, faults = _alike(frames, axes, root)
    positions = np.array([frame.position for frame in alike], np.float64)
    order = np.argsort(positions @ axes[:, 2], kind="stable")
    alike, positions = [alike[n] for n in order], positions[order]
    rows, columns = alike[0].spacing or (1.0, 1.0)
    note = "" if alike[0].spacing else "the files do not say the size of a pixel: 1 mm is assumed"
    step = (
        (float((positions[-1] - positions[0]) @ axes[:, 2]) / (len(alike) - 1))
        if len(alike) > 1
        else 0.0
    )
    if len(alike) == 1:
        step = abs(alike[0].thickness or 1.0)
    found = Slices(tuple(alike), axes, (step, rows, columns), positions, (), note)
    if len(alike) > 1:
        faults += _place_faults(found, root)
    return Slices(found.frames, axes, found.spacing, positions, tuple(faults), note)


def _pictures(frames: Sequence[Frame], spacing: Spacing | None) -> Slices:
    """Pictures that lie nowhere, one above the other in their order, from the world's origin on."""
    first = frames[0]
    note = "the files do not say where the pictures lie: they start at the world's origin"
    if spacing is None:
        note += "" if first.spacing else "; nor the size of a pixel: 1 mm is assumed"
        rows, columns = first.spacing or (1.0, 1.0)
        spacing = Spacing((columns, rows, abs(first.thickness or 1.0)))
    odd = [frame for frame in frames if (frame.rows, frame.columns) != (first.rows, first.columns)]
    if odd:
        raise GeometryError(
            "pictures of several sizes were given with --spacing", "give those of one size"
        )
    positions = np.zeros((len(frames), 3))
    positions[:, 2] = np.arange(len(frames)) * spacing[2]
    if (first.thickness or 0.0) < 0 and len(
        frames
    ) > 1:  # the sign says the way, also where nothing says the place
        frames, positions = frames[::-1], -positions[::-1]
        note += "; they follow against the axis z, as the sign of their distance says"
    return Slices(
        tuple(frames), np.eye(3), (spacing[2], spacing[1], spacing[0]), positions, (), note
    )


def _axes(frame: Frame, root: Path) -> Floats:
    """Orthonormal axes of a slice, as columns."""
    given = np.array(frame.orientation, np.float64).reshape(2, 3)
    product = given @ given.T
    if np.abs(product - np.eye(2)).max() > _AXES_TOLERANCE:
        raise GeometryError(
            f"{names_of([frame], root)}: its axes are no unit vectors at a right angle", HEADER_HINT
        )
    along_row = given[0] / np.linalg.norm(given[0])
    normal = np.cross(along_row, given[1])
    normal /= np.linalg.norm(normal)
    return np.stack([along_row, np.cross(normal, along_row), normal], axis=1)


def _alike(frames: Sequence[Frame], axes: Floats, root: Path) -> tuple[list[Frame], list[str]]:
    """The slices of the commonest size, spacing and direction, and a fault for those that differ."""
    faults = []
    first = frames[0]
    span = max(first.rows, first.columns) * max(first.spacing or (1.0, 1.0))

    def turn(frame: Frame) -> tuple[int, ...]:
        return tuple(round(part * span / TOLERANCE_MM / 2) for part in frame.orientation or ())

    def pixel(frame: Frame) -> tuple[int, ...]:
        return tuple(
            round(part * max(first.rows, first.columns) / TOLERANCE_MM / 2)
            for part in frame.spacing or ()
        )

    def size(frame: Frame) -> tuple[int, ...]:
        return (frame.rows, frame.columns)

    kinds: list[tuple[str, Callable[[Frame], tuple[int, ...]], int]] = [
        ("directions", turn, 2),
        ("sizes", size, 0),
        ("sizes of a pixel", pixel, 2),  # 2: rounding
    ]
    alike = list(frames)
    for what, key, slack in kinds:
        counts = Counter(map(key, alike))
        common = max(counts, key=lambda size: counts[size])
        others = [frame for frame in alike if _differ(key(frame), common, slack)]
        if others:
            alike = [frame for frame in alike if not _differ(key(frame), common, slack)]
            faults.append(
                f"slices of several {what} in one series: {names_of(others, root)} differ from "
                f"{names_of(alike, root, 1)}"
            )
    return alike, faults


def _differ(key: tuple[int, ...], other: tuple[int, ...], slack: int) -> bool:
    """Test if two keys differ by more than their rounding."""
    return len(key) != len(other) or any(
        abs(a - b) > slack for a, b in zip(key, other, strict=True)
    )


def _place_faults(slices: Slices, root: Path) -> list[str]:
    """List the faults in the places of slices that are alike."""
    along, frames = slices.along, slices.frames
    steps = np.diff(along)
    same = np.flatnonzero(steps < TOLERANCE_MM)
    if same.size:
        pair = [frames[same[0]], frames[same[0] + 1]]
        count = "two images lie" if same.size == 1 else f"{same.size} pairs of images lie"
        return [f"{count} at one place: {names_of(pair, root)}"]
    faults = []
    aside = slices.aside
    if np.abs(aside).max() > TOLERANCE_MM:
        slope = aside[-1] / along[-1]
        off = np.linalg.norm(aside - along[:, None] * slope, axis=1)
        if off.max() <= TOLERANCE_MM:
            angle = np.degrees(np.arctan(np.linalg.norm(slope)))
            ends = names_of([frames[0], frames[-1]], root)
            faults.append(
                f"the slices are tilted by {angle:.2f} degrees against their normal: {ends}"
            )
        else:
            worst = int(np.argmax(off))
            which = names_of([frames[worst]], root)
            faults.append(f"slices are shifted sideways, {which} by {off[worst]:.3g} mm")
    regular = np.arange(len(frames)) * slices.spacing[0]
    if np.abs(along - regular).max() > TOLERANCE_MM:
        faults.append(_spacing_fault(slices, steps, root))
    return faults


def _spacing_fault(slices: Slices, steps: Floats, root: Path) -> str:
    """A gap, named, or uneven distances."""
    usual = float(np.median(steps))
    if len(steps) == 2:  # of two distances the smaller is the usual one
        usual = float(steps.min())
    gaps = [n for n in range(len(steps)) if steps[n] > 1.5 * usual]
    multiples = steps / usual
    if gaps and np.abs(multiples - np.rint(multiples)).max() * usual <= max(
        TOLERANCE_MM, 0.02 * usual
    ):
        n = gaps[0]
        between = names_of(slices.frames[n : n + 2], root)
        missing = int(np.rint(multiples[gaps]).sum()) - len(gaps)
        more = f", and in {len(gaps) - 1} more places" if len(gaps) > 1 else ""
        return (
            f"{missing} slice{'s' if missing > 1 else ''} missing: {steps[n]:.4g} mm between {between}{more}, "
            f"{usual:.4g} mm elsewhere"
        )
    n = int(np.argmax(np.abs(steps - usual)))
    return (
        f"distances of slices differ: {steps[n]:.4g} mm between {names_of(slices.frames[n : n + 2], root)}, "
        f"{usual:.4g} mm elsewhere"
    )
