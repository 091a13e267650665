"""What accelsurf makes of one input: read, refused with one clear line, or a fault."""

import json
import os
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from accelsurf import io
from accelsurf.cli.options import run_config
from accelsurf.cli.segment import Settings
from accelsurf.errors import AccelsurfError
from accelsurf.image.volume import Volume
from accelsurf.io import channels, meshes
from accelsurf.io.states import from_bytes
from accelsurf.settings.energy_expression import EnergyText
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.objects import read_objects
from accelsurf.text.point_files import read_points
from accelsurf.text.starts import psi_of_starts, read_starts
from tests.fuzz import independent, judges
from tests.fuzz.inputs import DATA_FILE, VALUES, Input, Wrong


class Point(NamedTuple):
    """A record of the checkpoint of the corpus."""

    place: Any
    values: Any


CHECKPOINT_TYPES = {"Point": Point}


class Verdict(NamedTuple):
    """``outcome`` is read, refused, or the kind of a fault: traceback, wrong, unclear, memory, hang, crash."""

    outcome: str
    text: str = ""

    @property
    def is_fault(self) -> bool:
        return self.outcome not in ("read", "refused")


def judge(given: Input, folder: Path) -> Verdict:
    """Give an input to what reads it.

    Parameters
    ----------
    given : Input
    folder : Path
        An empty one, for its file.
    """
    where = folder / (given.case or "")
    for name, content in {DATA_FILE: VALUES.tobytes(), **given.written()}.items():
        (where / name).parent.mkdir(parents=True, exist_ok=True)
        if name != DATA_FILE or not given.case or name in dict(given.files):
            (where / name).write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter(
                "ignore", ResourceWarning
            )  # what Python does by default; nobody sees it
            if given.kind in judges.JUDGES:
                note = judges.JUDGES[given.kind](given, where)
            else:
                note = _JUDGES[given.kind](given, where / f"input{given.suffix}")
    except AccelsurfError as error:
        return _of_refusal(error)
    except Wrong as error:
        return Verdict("wrong", str(error))
    except BaseException as error:
        import traceback

        last = traceback.extract_tb(error.__traceback__)[-1]
        text = (
            f"{type(error).__name__}: {str(error)[:300]} ({Path(last.filename).name}:{last.lineno})"
        )
        return Verdict("traceback", text)
    return Verdict("read", note or "")


def _of_refusal(error: AccelsurfError) -> Verdict:
    """Whether a refusal is one clear line, and not of a reader that ran out of memory."""
    if isinstance(error.__cause__ or error.__context__, MemoryError):
        return Verdict("memory", error.message[:300])
    if "\n" in str(error) or not error.hint or len(error.message) > 1500:
        return Verdict(
            "unclear",
            f"{len(error.message)} characters, hint {error.hint[:80]!r}: {error.message[:300]}",
        )
    return Verdict("refused", error.message[:300])


def _image(given: Input, path: Path) -> str:
    volume = io.read(path, memory_bytes=judges.MEMORY)
    seen = independent.look(given.content, given.suffix, VALUES.tobytes())
    judges.check_grid(volume)
    judges.check_boxes(path, volume)
    return judges.check_look(volume, seen)


def _channels(given: Input, path: Path) -> None:
    channels.read_channels(path)


def _sequence(given: Input, path: Path) -> None:
    """Each of the ways in which a file of several channels, time points and levels is asked for."""
    every = [ReadOptions(), ReadOptions(spacing=(1.0, 2.0, 3.0))]
    if path.suffix == ".tif":
        every += [ReadOptions(time_index=1), ReadOptions(level=1)]
        every += [ReadOptions(channels_from_time=True, channel_index=0)]
    for asked in every:
        try:
            found = channels.read_channels(path, asked)
        except AccelsurfError as error:
            if (verdict := _of_refusal(error)).is_fault:
                raise Wrong(f"{verdict.outcome}: {verdict.text}") from error
            continue
        if any(volume.array.shape != found[0].geometry.shape for volume in found):
            raise Wrong(f"shapes {[volume.array.shape for volume in found]}")


def _mesh(given: Input, path: Path) -> None:
    points, triangles = meshes.read_mesh(path)
    if not np.isfinite(points).all() or triangles.min() < 0 or triangles.max() >= len(points):
        raise Wrong(f"{len(points)} points, triangles {triangles.min()} to {triangles.max()}")
    meshes.voxels_in_mesh(path, _volume().geometry)


def _volume() -> Volume:
    return Volume.from_array(VALUES.astype(np.float32))


def _text(given: Input) -> str:
    return given.content.decode("utf-8", "surrogateescape")


def _energy(given: Input, path: Path) -> None:
    RunConfig(energy=_text(given))
    EnergyText(_text(given))


def _start(given: Input, path: Path) -> None:
    psi = psi_of_starts(read_starts([_text(given)]), _volume())
    if not np.isfinite(psi).all():
        raise Wrong("psi is not finite")


def _edit(given: Input, path: Path) -> None:
    RunConfig(edit=[_text(given)])


def _toml(given: Input, path: Path) -> None:
    config = RunConfig.from_toml(path)
    path.write_text(config.to_toml(), encoding="utf-8")
    if RunConfig.from_toml(path) != config:
        raise Wrong("the configuration is not the one written")


def _argv(given: Input, path: Path) -> None:
    """Options of a run as the command line has them."""
    words = _text(given).split("\n")
    given: dict[str, Any] = {}
    for word, value in zip(words[::2], words[1::2], strict=False):
        key = word.removeprefix("--").replace("-", "_")
        if key in RunConfig.model_fields:
            many = isinstance(RunConfig.model_fields[key].default, tuple) and key != "mesh"
            given[key] = (value,) if many else value
    run_config(Settings(**given))


def _table(given: Input, path: Path) -> None:
    for start in read_objects(str(path), _volume().geometry, 2):
        if not np.isfinite(start.psi).all():
            raise Wrong(f"psi of object {start.id} is not finite")


def _points(given: Input, path: Path) -> None:
    for place in read_points(str(path)):
        if len(place.numbers) != 3 or not np.isfinite(place.numbers).all():
            raise Wrong(f"a point has the coordinates {place.numbers}")


def _run(given: Input, path: Path) -> None:
    """A run of three steps with settings and values as they are written."""
    from accelsurf import segment

    try:
        table = json.loads(_text(given))
        values = {key: str(value) for key, value in table["values"].items()}
        settings = {str(key): str(value) for key, value in table["settings"].items()}
        numbers = [float(values.get(key, "0")) for key in ("scale", "offset", "voxel", "spacing")]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return
    z, y, x = np.indices((10, 10, 10)) - 4.5
    with np.errstate(all="ignore"):
        image = (
            100.0 / (1 + np.exp(z * z + y * y + x * x - 9.0)) * numbers[0] + numbers[1]
        ).astype(np.float32)
        if numbers[2]:
            image[1, 2, 3] = numbers[2]
    result = segment(image, spacing=numbers[3], **{"max_steps": 3, "threads": 1, **settings})
    if result.labels.shape != image.shape or not np.isfinite(result.psi).all():
        raise Wrong("psi is not finite")


def _checkpoint(given: Input, path: Path) -> None:
    from_bytes(given.content, CHECKPOINT_TYPES)


def _crash(given: Input, path: Path) -> None:
    """What the watching processes are tested with."""
    os.abort()


def _sleep(given: Input, path: Path) -> None:
    time.sleep(60)


def _reserve(given: Input, path: Path) -> None:
    np.zeros(5 << 26, np.float64)  # 2.5 GiB, of which nothing is used


_JUDGES = {
    **{"crash": _crash, "sleep": _sleep, "reserve": _reserve, "sequence": _sequence},
    **{
        "image": _image,
        "channels": _channels,
        "mesh": _mesh,
        "energy": _energy,
        "start": _start,
        "edit": _edit,
    },
    **{
        "toml": _toml,
        "argv": _argv,
        "table": _table,
        "points": _points,
        "run": _run,
        "checkpoint": _checkpoint,
    },
}
