"""What accelsurf makes of one input: read, refused with one clear line, or a fault."""

import json
import os
import shutil
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from accelsurf import io
from accelsurf.cli.options import run_config
from accelsurf.cli.segment import Settings
from accelsurf.errors import AccelsurfError
from accelsurf.evolution.serialization import from_bytes
from accelsurf.grid.volume import Volume
from accelsurf.initialization import object_starts, starts
from accelsurf.io import channels, meshes
from accelsurf.report import result_sets
from accelsurf.settings import edits, energy_expression
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.run_config import RunConfig
from tests.fuzz import independent
from tests.fuzz.corpus import DATA_FILE, VALUES, ZARR_VOLUME, Input

#: Memory that readers may plan with, bytes.
MEMORY = 256 << 20


class Point(NamedTuple):
    """A record of the checkpoint of the corpus."""

    place: Any
    values: Any


CHECKPOINT_TYPES = {"Point": Point}


class Wrong(Exception):
    """Something was read that the file does not say."""


class Verdict(NamedTuple):
    """``outcome`` is read, refused, or the kind of a fault: traceback, wrong, unclear, memory, hang, crash."""

    outcome: str
    text: str = ""

    @property
    def is_fault(self) -> bool:
        return self.outcome not in ("read", "refused")


def judge(one: Input, folder: Path) -> Verdict:
    """Give an input to what reads it.

    Parameters
    ----------
    one : Input
    folder : Path
        An empty one, for its file.
    """
    path = folder / f"input{one.suffix}"
    path.write_bytes(one.content)
    (folder / DATA_FILE).write_bytes(VALUES.tobytes())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            note = _JUDGES[one.kind](one, path)
    except AccelsurfError as error:
        return _of_refusal(error)
    except Wrong as error:
        return Verdict("wrong", str(error))
    except BaseException as error:
        import traceback

        last = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {str(error)[:300]} ({Path(last.filename).name}:{last.lineno})"
        return Verdict("traceback", text)
    return Verdict("read", note or "")


def _of_refusal(error: AccelsurfError) -> Verdict:
    """Whether a refusal is one clear line, and not of a reader that ran out of memory."""
    if isinstance(error.__cause__ or error.__context__, MemoryError):
        return Verdict("memory", error.message[:300])
    if "\n" in str(error) or not error.hint or len(error.message) > 1500:
        return Verdict("unclear", f"{len(error.message)} characters, hint {error.hint[:80]!r}: {error.message[:300]}")
    return Verdict("refused", error.message[:300])


def _image(one: Input, path: Path) -> str:
    volume = io.read(path, memory_bytes=MEMORY)
    seen = independent.look(one.content, one.suffix, VALUES.tobytes())
    geometry = volume.geometry
    if volume.array.shape != geometry.shape or not all(0 < h < np.inf for h in geometry.spacing):
        raise Wrong(f"shape {volume.array.shape}, grid {geometry}")
    _check_boxes(path, volume)
    if seen is None:
        return "unverified"
    values, spacing = seen
    if values.shape != volume.array.shape:
        raise Wrong(f"shape {volume.array.shape}, the file says {values.shape}")
    if not _same(values, volume.array):
        raise Wrong(f"values {volume.array.ravel()[:4]}, the file says {values.ravel()[:4]}")
    if spacing is not None and not np.allclose(geometry.spacing[::-1], spacing, rtol=2e-3, atol=0):
        raise Wrong(f"spacing {geometry.spacing[::-1]}, the file says {spacing}")
    return "verified"


def _check_boxes(path: Path, volume: Volume) -> None:
    """Compare an image with itself when it is read box by box, where its format can be."""
    try:
        lazy = io.open_volume(path)
    except AccelsurfError as error:
        if "is packed or" in error.message or "are packed" in error.message or "colour" in error.message:
            return
        raise Wrong(f"read as a whole, but box by box: {error.message[:200]}") from error
    found = lazy.read(tuple(slice(0, n) for n in lazy.shape))
    if lazy.geometry.difference(volume.geometry) or found.dtype != volume.array.dtype:
        raise Wrong(f"read as {volume.array.dtype} on {volume.geometry}, box by box {lazy}")
    if not np.array_equal(found, volume.array, equal_nan=found.dtype.kind == "f"):
        raise Wrong("other values are read box by box")


def _zarr(one: Input, path: Path) -> str:
    """One file of a store is the input, the others are good."""
    store = path.parent / "a.ome.zarr"
    if store.exists():
        shutil.rmtree(store)
    io.write(ZARR_VOLUME, store)
    name = one.suffix.removeprefix("@").replace("-", "/")
    (store / name).write_bytes(one.content)
    volume = io.read(store, memory_bytes=MEMORY)
    _check_boxes(store, volume)
    if name.endswith("0/0/0") and not np.array_equal(volume.array, ZARR_VOLUME.array):
        raise Wrong("a damaged chunk was read")
    return ""


def _same(expected: np.ndarray, found: np.ndarray) -> bool:
    if expected.dtype.kind != "f" and found.dtype.kind != "f":
        return np.array_equal(expected, found)
    with np.errstate(all="ignore"):
        a, b = expected.astype(np.float64), found.astype(np.float64)
        a = np.where(np.abs(a) > np.finfo(np.float32).max, np.sign(a) * np.inf, a) if found.itemsize == 4 else a
        near = np.isclose(a, b, rtol=1e-5, atol=1e-30 + 1e-6 * np.nanmax(np.abs(a[np.isfinite(a)]), initial=0.0))
    return bool((near | (np.isnan(a) & np.isnan(b)) | (a == b)).all())


def _channels(one: Input, path: Path) -> None:
    channels.read(path)


def _sequence(one: Input, path: Path) -> None:
    """Each of the ways in which a file of several channels, time points and levels is asked for."""
    every = [ReadOptions(), ReadOptions(spacing=(1.0, 2.0, 3.0))]
    if path.suffix == ".tif":
        every += [ReadOptions(time_index=1), ReadOptions(level=1)]
        every += [ReadOptions(channels_from_time=True, channel_index=0)]
    for asked in every:
        try:
            found = channels.read(path, asked)
        except AccelsurfError as error:
            if (verdict := _of_refusal(error)).is_fault:
                raise Wrong(f"{verdict.outcome}: {verdict.text}") from error
            continue
        if any(volume.array.shape != found[0].geometry.shape for volume in found):
            raise Wrong(f"shapes {[volume.array.shape for volume in found]}")


def _mesh(one: Input, path: Path) -> None:
    points, triangles = meshes.read(path)
    if not np.isfinite(points).all() or triangles.min() < 0 or triangles.max() >= len(points):
        raise Wrong(f"{len(points)} points, triangles {triangles.min()} to {triangles.max()}")
    meshes.inside(path, _volume().geometry)


def _volume() -> Volume:
    return Volume.from_array(VALUES.astype(np.float32))


def _text(one: Input) -> str:
    return one.content.decode("utf-8", "surrogateescape")


def _energy(one: Input, path: Path) -> None:
    RunConfig(energy=_text(one))
    energy_expression.parse(_text(one))


def _start(one: Input, path: Path) -> None:
    psi = starts.build([_text(one)], _volume())
    if not np.isfinite(psi).all():
        raise Wrong("psi is not finite")


def _edit(one: Input, path: Path) -> None:
    edits.edits_of([_text(one)])
    RunConfig(edit=[_text(one)])


def _toml(one: Input, path: Path) -> None:
    config = RunConfig.from_toml(path)
    path.write_text(config.to_toml(), encoding="utf-8")
    if RunConfig.from_toml(path) != config:
        raise Wrong("the configuration is not the one written")


def _argv(one: Input, path: Path) -> None:
    """Options of a run as the command line has them."""
    words = _text(one).split("\n")
    given: dict[str, Any] = {}
    for word, value in zip(words[::2], words[1::2], strict=False):
        key = word.removeprefix("--").replace("-", "_")
        if key in RunConfig.model_fields:
            many = isinstance(RunConfig.model_fields[key].default, tuple) and key != "mesh"
            given[key] = (value,) if many else value
    run_config(Settings(**given))


def _table(one: Input, path: Path) -> None:
    for start in object_starts.read(str(path), _volume().geometry, 2):
        if not np.isfinite(start.psi).all():
            raise Wrong(f"psi of object {start.id} is not finite")


def _run(one: Input, path: Path) -> None:
    """A run of three steps with settings and values as they are written."""
    from accelsurf import segment

    try:
        table = json.loads(_text(one))
        values = {key: str(value) for key, value in table["values"].items()}
        settings = {str(key): str(value) for key, value in table["settings"].items()}
        numbers = [float(values.get(key, "0")) for key in ("scale", "offset", "voxel", "spacing")]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return
    z, y, x = np.indices((10, 10, 10)) - 4.5
    with np.errstate(all="ignore"):
        image = (100.0 / (1 + np.exp(z * z + y * y + x * x - 9.0)) * numbers[0] + numbers[1]).astype(np.float32)
        if numbers[2]:
            image[1, 2, 3] = numbers[2]
    result = segment(image, spacing=numbers[3], **{"max_steps": 3, "threads": 1, **settings})
    if result.labels.shape != image.shape or not np.isfinite(result.psi).all():
        raise Wrong("psi is not finite")


def _checkpoint(one: Input, path: Path) -> None:
    from_bytes(one.content, CHECKPOINT_TYPES)


def _report(one: Input, path: Path) -> None:
    from accelsurf.viewer.frontends.movie_file import run_of_folder

    result_sets.is_failure_report(path)
    os.replace(path, path.with_name("a_report.json"))
    run_of_folder(path.parent)


def _crash(one: Input, path: Path) -> None:
    """What the watching processes are tested with."""
    os.abort()


def _sleep(one: Input, path: Path) -> None:
    time.sleep(60)


_JUDGES = {
    **{"crash": _crash, "sleep": _sleep, "zarr": _zarr, "sequence": _sequence},
    **{"image": _image, "channels": _channels, "mesh": _mesh, "energy": _energy, "start": _start, "edit": _edit},
    **{"toml": _toml, "argv": _argv, "table": _table, "run": _run, "checkpoint": _checkpoint, "report": _report},
}
