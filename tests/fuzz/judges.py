"""What reads the inputs of several files, sequences, tables and what runs leave behind, and whether it is right."""

import contextlib
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.errors import AccelsurfError, AccelsurfWarning
from accelsurf.image.volume import Volume
from tests.fuzz import folders, independent, looks, runs
from tests.fuzz.inputs import FRAMES, SHAPE, VALUES, VOLUME, Input, Wrong

#: Memory that readers may plan with, bytes.
MEMORY = 256 << 20
#: Frames of a sequence that are read.
MOST_FRAMES = 8


def same(expected: np.ndarray, found: np.ndarray) -> bool:
    """Whether values are those of a file, as far as the type that they were read in tells them apart."""
    if expected.shape != found.shape:
        return False
    if expected.dtype.kind != "f" and found.dtype.kind != "f":
        return np.array_equal(expected, found)
    with np.errstate(all="ignore"):
        a, b = expected.astype(np.float64), found.astype(np.float64)
        a = (
            np.where(np.abs(a) > np.finfo(np.float32).max, np.sign(a) * np.inf, a)
            if found.itemsize == 4
            else a
        )
        near = np.isclose(
            a, b, rtol=1e-5, atol=1e-30 + 1e-6 * np.nanmax(np.abs(a[np.isfinite(a)]), initial=0.0)
        )
    return bool((near | (np.isnan(a) & np.isnan(b)) | (a == b)).all())


def check_grid(volume: Volume) -> None:
    """Refuse a grid that is none."""
    geometry = volume.geometry
    if volume.array.shape != geometry.shape or not all(0 < h < np.inf for h in geometry.spacing):
        raise Wrong(f"shape {volume.array.shape}, grid {geometry}")


def check_look(volume: Volume, seen) -> str:
    """Compare a volume with what another program sees, where it sees anything."""
    check_grid(volume)
    if seen is None:
        return "unverified"
    values, spacing = seen
    if values.shape != volume.array.shape:
        raise Wrong(f"shape {volume.array.shape}, the file says {values.shape}")
    if not same(values, volume.array):
        raise Wrong(f"values {volume.array.ravel()[:4]}, the file says {values.ravel()[:4]}")
    if spacing is not None and not np.allclose(
        volume.geometry.spacing[::-1], spacing, rtol=2e-3, atol=0
    ):
        raise Wrong(f"spacing {volume.geometry.spacing[::-1]}, the file says {spacing}")
    return "verified"


def check_boxes(path: Path, volume: Volume) -> None:
    """Compare an image with itself when it is read box by box, where its format can be."""
    try:
        lazy = io.open_volume(path)
    except AccelsurfError as error:
        if (
            "is packed or" in error.message
            or "are packed" in error.message
            or "colour" in error.message
        ):
            return
        raise Wrong(f"read as a whole, but box by box: {error.message[:200]}") from error
    found = lazy.read(tuple(slice(0, n) for n in lazy.shape))
    if lazy.geometry.difference(volume.geometry) or found.dtype != volume.array.dtype:
        raise Wrong(f"read as {volume.array.dtype} on {volume.geometry}, box by box {lazy}")
    if not np.array_equal(found, volume.array, equal_nan=found.dtype.kind == "f"):
        raise Wrong("other values are read box by box")


def paired(given: Input, folder: Path) -> str:
    """A header with its data file."""
    header = looks.header_of(given.written())
    volume = io.read(folder / header, memory_bytes=MEMORY)
    check_boxes(folder / header, volume)
    return check_look(volume, looks.quietly(looks.paired, given.written()))


def zarr(given: Input, folder: Path) -> str:
    """A store; of a chunk the values must be the good ones, or those that its codec gives."""
    store = folder.rename(folder.with_name("a.ome.zarr"))
    volume = io.read(store, memory_bytes=MEMORY)
    check_grid(volume)
    check_boxes(store, volume)
    if "json" in given.name or given.name.rpartition("/")[2].startswith("."):
        return _metadata_of_zarr(given, volume)
    if volume.array.shape != SHAPE:
        raise Wrong(f"shape {volume.array.shape}")
    decoded = looks.chunk(given.content, given.case)
    # The chunk is the first or the second along z.
    number = int(given.name.removeprefix("0/").removeprefix("c/").partition("/")[0])
    for at, (found, good) in enumerate(
        zip(looks.halves(volume.array), looks.halves(VALUES), strict=True)
    ):
        if np.array_equal(found, good) or (
            at == number and decoded is not None and np.array_equal(found, decoded)
        ):
            continue
        if io.WARNING_KEY not in volume.metadata:
            raise Wrong(
                f"a damaged chunk was read: {found.ravel()[:4]}, {good.ravel()[:4]} expected"
            )
    return "verified"


def _metadata_of_zarr(given: Input, volume: Volume) -> str:
    spacing = looks.spacing_of_zarr(given.written())
    if spacing is not None and not np.allclose(volume.geometry.spacing, spacing, rtol=1e-6, atol=0):
        raise Wrong(f"spacing {volume.geometry.spacing}, the file says {spacing}")
    if given.name in ("zarr.json", ".zattrs", ".zgroup"):
        # Axes may be named otherwise; the values stay those of the array.
        if sorted(volume.array.ravel()) != sorted(VALUES.ravel()):
            raise Wrong(f"values {volume.array.ravel()[:4]}")
        return "verified" if spacing is not None else "unverified"
    return "unverified"


def dicom(given: Input, folder: Path) -> str:
    """Slices: those that are good are where they belong, and what is left out is said."""
    volume = io.read(folder, memory_bytes=MEMORY)
    check_grid(volume)
    warning = volume.metadata.get(io.WARNING_KEY, "")
    if "rescal" in warning or "resampl" in warning or "grid" in warning or "filled" in warning:
        return "unverified"  # slices between slices
    slices = given.written()
    count = len(set(slices) - {"seg.dcm"})
    if len(volume.array) != count and not warning:
        raise Wrong(f"{len(volume.array)} of {count} slices without a warning")
    indices = np.stack(
        np.meshgrid(*map(np.arange, volume.array.shape), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    points = volume.geometry.index_to_world(indices).reshape(*volume.array.shape, 3)
    expected = points @ folders.dicom_series.WEIGHTS
    right = (np.abs(volume.array - expected) <= 1.0).all(axis=(1, 2))
    seen = [looks.slice_of(content) for content in slices.values()]
    for number in np.flatnonzero(~right):
        if not warning and not any(
            values is not None and same(values, volume.array[number]) for values in seen
        ):
            raise Wrong(f"slice {number} has values of no file: {volume.array[number].ravel()[:4]}")
    if np.count_nonzero(~right) > 1 and not warning:
        raise Wrong(f"{np.count_nonzero(~right)} slices are not where they belong")
    return "verified"


def frames(given: Input, folder: Path) -> str:
    """A sequence: as many frames and the values that the file says."""
    path = folder / (given.case and given.name.partition("/")[0])
    if not given.case:
        path = folder / f"input{given.suffix}"
    sequence = io.read_sequence(path, memory_bytes=MEMORY)
    if len(sequence.times) != len(sequence) or not (np.diff(sequence.times) > 0).all():
        raise Wrong(f"times {sequence.times[:8]}")
    read = [sequence.frame(n) for n in range(min(len(sequence), MOST_FRAMES))]
    for frame in read:
        check_grid(frame)
        if frame.array.shape != sequence.geometry.shape:
            raise Wrong(
                f"a frame of {frame.array.shape} in a sequence of {sequence.geometry.shape}"
            )
    if given.case:
        return _frame_of(given, sequence, read)
    seen = looks.frames(given.content, given.suffix)
    if seen is None:
        return "unverified"
    if len(seen) != len(sequence):
        raise Wrong(f"{len(sequence)} frames, the file says {len(seen)}")
    for number, frame in enumerate(read):
        if not same(seen[number], frame.array):
            raise Wrong(
                f"frame {number} {frame.array.ravel()[:4]}, the file says {seen[number].ravel()[:4]}"
            )
    return "verified"


def _frame_of(given: Input, sequence: Any, read: list[Volume]) -> str:
    """Of a folder all frames but the mutated one are as they were."""
    if given.case not in ("nifti", "tiff"):
        return "unverified"
    if len(read) != len(FRAMES):
        raise Wrong(f"{len(read)} frames")
    changed = int(given.name[given.name.index("/t") + 2])
    for number, frame in enumerate(read):
        if number != changed and not np.array_equal(frame.array, FRAMES[number]):
            raise Wrong(f"frame {number}: {frame.array.ravel()[:4]}")
    return check_look(
        read[changed], independent.look(given.content, given.suffix, VALUES.tobytes())
    )


def labels(given: Input, folder: Path) -> None:
    """A table of names and colours."""
    from accelsurf.io import label_tables

    for entry in label_tables.read_label_table(folder / f"input{given.suffix}"):
        if not entry.name or not all(0 <= part <= 255 for part in entry.color) or entry.id < 0:
            raise Wrong(f"{entry}")


def evaluate(given: Input, folder: Path) -> str:
    """Two label maps, or a table of pairs of them."""
    from accelsurf.batch.pairs import in_table
    from accelsurf.measure.label_metrics import LabelMap, evaluate_labels, evaluate_object

    if given.case == "table":
        for pair in in_table(folder / "pairs.csv"):
            if pair.pred is None or pair.ref is None or not pair.case:
                raise Wrong(f"{pair}")
        return ""
    pred, ref = (LabelMap(io.read_labels(folder / name)) for name in ("pred.nii.gz", "ref.nii.gz"))
    whole = evaluate_object(pred, ref, (1.0,))
    evaluate_labels(pred, ref, (), (1.0,))
    seen = looks.quietly(independent.look, given.content, ".nii.gz", b"")
    if seen is None:
        return "unverified"
    a, b = seen[0] > 0.5, VALUES > 60  # labels are whole numbers, up to rounding
    dice = 2 * np.count_nonzero(a & b) / max(np.count_nonzero(a) + np.count_nonzero(b), 1)
    if abs(whole.metrics.dice - dice) > 1e-9 and pred.volume.array.shape == a.shape:
        raise Wrong(f"Dice {whole.metrics.dice}, {dice} expected")
    return "verified"


def tracks(given: Input, folder: Path) -> None:
    """Tracks with their tables, scored by themselves."""
    from accelsurf.track.scored_files import compare, open_tracks

    path = folder / "a_labels.nii" if given.case == "labels" else folder
    found = open_tracks(path)
    scores = compare(found, open_tracks(path))
    for name, value in scores._asdict().items() if hasattr(scores, "_asdict") else ():
        if isinstance(value, float) and not (np.isnan(value) or -1e-9 <= value <= 1 + 1e-9):
            raise Wrong(f"{name} {value}")


def cases(given: Input, folder: Path) -> None:
    """A table of cases of ``batch``."""
    from accelsurf.batch import case_table
    from accelsurf.batch.cases import checked_cases

    checked_cases(
        case_table.read_cases(folder / f"input{given.suffix}", tracking=given.kind == "sequences")
    )


def state(given: Input, folder: Path) -> None:
    """The state of a finished run, and its result again."""
    from accelsurf.interact.restored import restored
    from accelsurf.interact.state_file import read_state

    found = read_state(folder / "input.npz")
    result = restored(found, Volume.from_array(runs.image(), 1.0))
    if result.labels.shape != runs.SHAPE or not np.isfinite(result.psi).all():
        raise Wrong("psi is not finite")


def checkpoint(given: Input, folder: Path) -> None:
    """A checkpoint, and the run that goes on from it."""
    from accelsurf.run.checkpoint import load_checkpoint, read_checkpoint
    from accelsurf.run.run import Run

    path = folder / "input.npz"
    _, found = read_checkpoint(path)
    with Run(Volume.from_array(runs.image(), 1.0), found.settings) as run:
        run.restore(load_checkpoint(path, run))
        run.step()


def track_state(given: Input, folder: Path) -> None:
    """The state of a tracking, and the tracking that goes on from it."""
    from accelsurf.track import track as states

    states.read_tracking(folder / "input.npz")


def store(given: Input, folder: Path) -> None:
    """Frames that a tracking was killed after: those that cannot be read are made again."""
    from accelsurf.track.output.frames import FrameStore

    found = FrameStore(folder / "frames")
    for number in found.numbers():
        found.frame_row(number)


def track_toml(given: Input, folder: Path) -> None:
    """Settings of a tracking."""
    from accelsurf.settings.track_config import TrackConfig

    path = folder / "input.toml"
    config = TrackConfig.from_toml(path)
    path.write_text(config.to_toml(), encoding="utf-8")
    if TrackConfig.from_toml(path) != config:
        raise Wrong("the configuration is not the one written")


def report(given: Input, folder: Path) -> None:
    """A report with the state that it names, as ``refine``, ``batch --resume``, ``movie`` and ``view`` read it."""
    from accelsurf.output.folder import OutputFolder
    from accelsurf.output.reports import Report, had_settings
    from accelsurf.settings.run_config import RunConfig
    from accelsurf.viewer.movie_file import run_of_folder

    path = folder / "a_report.json"
    found = Report(path)
    if found.document is not None:
        assert found.is_failure in (True, False)
        assert found.state is None or found.names
        found.unchanged()
        with warnings.catch_warnings():
            # What no run of this machine wrote stays, with a warning.
            warnings.simplefilter("ignore", AccelsurfWarning)
            OutputFolder(folder, "a", overwrite=True).outdated((), failed=False)
        had_settings(found.document, RunConfig())
    elif _is_whole(path):
        raise Wrong("a report with status and outputs was not taken for one")
    with contextlib.chdir(folder):  # the image is named without its folder
        run_of_folder(folder)


def _is_whole(path: Path) -> bool:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return False
    kinds = {"status": str, "outputs": list, "exit_code": int}
    return isinstance(document, dict) and all(
        isinstance(document.get(key), kind) for key, kind in kinds.items()
    )


#: What judges each kind; of an input and the folder that its files lie in.
JUDGES = {
    **{
        "paired": paired,
        "zarr": zarr,
        "dicom": dicom,
        "frames": frames,
        "labels": labels,
        "evaluate": evaluate,
    },
    **{
        "tracks": tracks,
        "cases": cases,
        "sequences": cases,
        "state": state,
        "checkpoint-file": checkpoint,
    },
    **{"track-state": track_state, "store": store, "track-toml": track_toml, "report": report},
}
assert VOLUME.array.shape == SHAPE
