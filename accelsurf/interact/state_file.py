"""The state of a finished run as a file, from which ``accelsurf refine`` continues.

It has the surfaces, exact to the last bit, and all that the settings do not say. The image is read again from its file
and checked. Of psi there are the values in the band, and one bit for each other voxel.
"""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution import LevelSummary, StepRecord, Stop, without_costs
from accelsurf.grid.boxes import Corner, box_at, corner_of
from accelsurf.grid.pyramid import Level
from accelsurf.io import packed_state, read_state_file
from accelsurf.measure import Plateau
from accelsurf.run import BoxMask, Result
from accelsurf.settings import budgets
from accelsurf.settings.older import modern
from accelsurf.settings.run_config import RunConfig

_AGAIN = "run accelsurf segment again with --keep-state yes"
_LEVEL = 1  # of zlib: more takes longer and saves little


class PackedArray(NamedTuple):
    """An array, packed: ``packed`` bytes (uint8), ``kind`` of its numbers, and its ``shape``."""

    packed: NDArray[np.uint8]
    kind: str
    shape: tuple[int, ...]


class SurfaceFile(NamedTuple):
    """Psi on a box from voxel ``corner`` on: values in the band, beyond it a sign and the one distance ``far``."""

    corner: Corner
    in_band: PackedArray
    inside: PackedArray
    values: PackedArray
    far: float


class ObjectFile(NamedTuple):
    """An object: its ``id``, ``surface``, ``history``, ``stop`` and ``plateaus``.

    ``before`` is the least probability before its corrections by clicks; None where none was made.
    """

    id: int
    surface: SurfaceFile
    history: tuple[StepRecord, ...]
    stop: Stop
    plateaus: tuple[Plateau, ...]
    before: float | None


class MaskFile(NamedTuple):
    """A `BoxMask` of the correction ``number``: its box from voxel ``corner`` on, its voxels packed."""

    number: int
    corner: Corner
    inside: PackedArray


class StateFile(NamedTuple):
    """A finished run.

    Attributes
    ----------
    config : RunConfig
        With all corrections so far; in the file its values.
    image : str
        SHA-256 of the image as it was read, from `accelsurf.image.volume.voxels_sha256`.
    shape : (nz, ny, nx)
        Of the image.
    objects : tuple of ObjectFile
    masks : tuple of MaskFile
        Masks with which corrections that change objects are made again.
    totals : dict of str to ndarray
        As of `accelsurf.run.result.RunState`.
    levels, edits_done, warnings, late_growth
        As of `Result`.
    """

    config: Any
    image: str
    shape: tuple[int, int, int]
    objects: tuple[ObjectFile, ...]
    masks: tuple[MaskFile, ...]
    totals: dict[str, NDArray[np.float64]]
    levels: tuple[LevelSummary, ...]
    edits_done: int
    warnings: tuple[str, ...]
    late_growth: tuple[float, float, float] | None


#: The types in the file, by the names under which they are written.
TYPES: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Level,
        LevelSummary,
        MaskFile,
        ObjectFile,
        PackedArray,
        Plateau,
        StateFile,
        StepRecord,
        Stop,
        SurfaceFile,
    )
}


def state_bytes(result: Result, image: str) -> bytes:
    """Return the state of a result as bytes.

    Parameters
    ----------
    result : Result
        With a state.
    image : str
        SHA-256 of the image as it was read.
    """
    assert result.state is not None
    objects = tuple(
        ObjectFile(
            segmented.id,
            _packed_surface(segmented.psi, corner_of(segmented.box)),
            tuple(without_costs(segmented.history)),
            segmented.stop,
            segmented.plateaus,
            None if segmented.before is None else segmented.before.value,
        )
        for segmented in result.objects
    )
    masks = tuple(
        MaskFile(number, corner_of(array.box), _packed(array.mask))
        for number, array in result.state.masks.items()
    )
    config = result.config.model_dump(mode="json")
    state = StateFile(
        config,
        image,
        result.geometry.shape,
        objects,
        masks,
        dict(result.state.totals),
        tuple(result.levels),
        result.edits_done,
        tuple(result.warnings),
        result.late_leakage,
    )
    return packed_state(state, TYPES)


def read_state(path: Path) -> StateFile:
    """Read a state.

    Raises
    ------
    InputError
        When the file cannot be read, is damaged or of another kind, or is larger than its image allows.
    """
    return read_state_file(path, StateFile, TYPES, _checked, _AGAIN)


def _checked(state: StateFile) -> StateFile:
    """The state with its settings made again; a ValueError where its parts do not fit together."""
    shape = state.shape
    if not all(0 < n < 2**31 for n in shape) or not state.objects:
        raise ValueError("its grid has no size")
    for segmented in state.objects:
        corner, box = segmented.surface.corner, segmented.surface.in_band.shape
        if len(box) != 3 or any(
            c < 0 or n < 1 or c + n > m for c, n, m in zip(corner, box, shape, strict=True)
        ):
            raise ValueError(f"the surface of object {segmented.id} lies beyond the image")
        if segmented.before is not None and not 0.0 <= segmented.before <= 1.0:
            raise ValueError(f"the probability of object {segmented.id} is not one")
        if not segmented.history:
            raise ValueError(f"object {segmented.id} has no history")
    return state._replace(config=RunConfig(**modern(state.config)))


def _packed_surface(psi: NDArray[np.float32], corner: Corner) -> SurfaceFile:
    """Psi as it is written."""
    size = np.abs(psi)
    far = np.float32(size.max())
    in_band = size != far
    return SurfaceFile(
        corner, _packed(in_band), _packed(psi < 0), _packed(psi[in_band]), float(far)
    )


def surface_of(segmented: ObjectFile) -> NDArray[np.float32]:
    """Psi (nz, ny, nx) of an object on its box, the same bytes as it had.

    Raises
    ------
    ValueError
        When the file is damaged.
    """
    stored = segmented.surface
    in_band, inside = _unpacked(stored.in_band), _unpacked(stored.inside)
    if in_band.dtype != np.bool_ or in_band.shape != inside.shape or inside.dtype != np.bool_:
        raise ValueError(f"the surface of object {segmented.id} does not fit its box")
    psi = np.where(inside, np.float32(-stored.far), np.float32(stored.far))
    values = _unpacked(stored.values)
    if values.dtype != np.float32 or values.shape != (int(np.count_nonzero(in_band)),):
        raise ValueError(f"the band of object {segmented.id} does not fit its values")
    psi[in_band] = values
    return psi


def masks_of(state: StateFile) -> dict[int, BoxMask]:
    """The masks of corrections, by their numbers.

    Raises
    ------
    ValueError
        When the file is damaged.
    """
    out = {}
    for image in state.masks:
        mask = _unpacked(image.inside)
        if mask.dtype != np.bool_ or mask.ndim != 3:
            raise ValueError(f"the mask of correction {image.number} is not valid")
        box = box_at(image.corner, mask.shape)
        if any(s.start < 0 or s.stop > n for s, n in zip(box, state.shape, strict=True)):
            raise ValueError(f"the mask of correction {image.number} lies beyond the image")
        out[image.number] = BoxMask(box, mask)
    return out


def box_of(stored: ObjectFile) -> tuple[slice, slice, slice]:
    """The part of the image's grid that an object lies on."""
    return box_at(stored.surface.corner, stored.surface.in_band.shape)


def _packed(array: NDArray[Any]) -> PackedArray:
    """An array, packed: bits of truth values, the bytes of numbers by their significance."""
    if array.dtype == np.bool_:
        raw = np.packbits(array).tobytes()
    else:
        flat = np.ascontiguousarray(array).reshape(-1)
        raw = flat.view(np.uint8).reshape(flat.size, -1).T.tobytes()
    packed = np.frombuffer(zlib.compress(raw, _LEVEL), np.uint8)
    return PackedArray(packed, array.dtype.str, tuple(int(n) for n in array.shape))


def _unpacked(packed: PackedArray) -> NDArray[Any]:
    """The array; never more bytes than its shape says.

    Raises
    ------
    ValueError
        When it is damaged.
    """
    kind, count = np.dtype(packed.kind), math.prod(packed.shape)
    if kind.hasobject or min(packed.shape, default=0) < 0 or packed.packed.ndim != 1:
        raise ValueError(f"it has an array of {packed.kind}")
    size = -(-count // 8) if kind == np.bool_ else count * kind.itemsize
    budgets.STATE_UNPACKED.check(size, "its arrays", factor=len(packed.packed) + 1024)
    unpack = zlib.decompressobj()
    try:
        raw = unpack.decompress(packed.packed.tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if len(raw) != size or not unpack.eof:
        raise ValueError(f"an array has {len(raw)} bytes, {size} expected")
    flat = np.frombuffer(raw, np.uint8)
    if kind == np.bool_:
        return np.unpackbits(flat, count=count).astype(np.bool_).reshape(packed.shape)
    return (
        np.ascontiguousarray(flat.reshape(kind.itemsize, count).T).view(kind).reshape(packed.shape)
    )
