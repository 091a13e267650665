"""Files that runs leave behind: states, checkpoints, reports, settings; of small runs that are made here."""

import hashlib
import json
import tempfile
from pathlib import Path

import numpy as np

from tests.fuzz.inputs import Input, of_folder

#: The image of the runs: a ball.
SHAPE = (10, 11, 12)
#: Stands for the file of the image.
_IMAGE = b"image"


def image() -> np.ndarray:
    """A ball with a soft edge."""
    z, y, x = (np.indices(SHAPE).T - (np.array(SHAPE) - 1) / 2).T
    return (100 / (1 + np.exp(z * z + y * y + x * x - 9.0))).astype(np.float32)


def every() -> list[Input]:
    """All of them."""
    return [*_of_segment(), *_of_track()]


def _of_segment():
    from accelsurf.api.segment import segment
    from accelsurf.image.volume import Volume
    from accelsurf.interact.state_file import state_bytes
    from accelsurf.run.checkpoint import checkpoint_header, save_checkpoint
    from accelsurf.run.run import Run
    from accelsurf.settings.run_config import RunConfig

    volume = Volume.from_array(image(), 1.0)
    config = RunConfig(start=["ball:5,5,5,3"], max_steps=3, threads=1, levels=1)
    content = state_bytes(
        segment(volume, config=config), hashlib.sha256(volume.array.tobytes()).hexdigest()
    )
    yield Input("state", ".npz", "zip", content)
    with tempfile.TemporaryDirectory() as folder, Run(volume, config) as run:
        run.step()
        path = Path(folder) / "a.npz"
        save_checkpoint(path, run.checkpoint(), checkpoint_header(run))
        yield Input("checkpoint-file", ".npz", "zip", path.read_bytes())
    yield from of_folder(
        "report", "folder", _result(config, content), {".json": "json"}, only=("a_report.json",)
    )


def _result(config, state: bytes) -> dict[str, bytes]:
    """A report as `accelsurf segment` writes it, with the state that it names."""
    entry = {"kind": "state", "path": "a_state.npz", "sha256": hashlib.sha256(state).hexdigest()}
    report = {
        "schema_version": 1,
        "status": "ok",
        "exit_code": 0,
        "config": config.model_dump(mode="json"),
        "input": {
            "path": "a.nii",
            "sha256": hashlib.sha256(_IMAGE).hexdigest(),
            "shape": SHAPE,
            "spacing": [1, 1, 1],
        },
        "stop": {"reason": "max-steps", "steps": 3},
        "outputs": [entry, {"kind": "labels", "path": "a_seg.nii.gz", "sha256": "1" * 64}],
        "warnings": [],
    }
    return {
        "a_report.json": json.dumps(report, indent=1).encode(),
        "a_state.npz": state,
        "a.nii": _IMAGE,
    }


def _of_track():
    from accelsurf.image.volume import Volume
    from accelsurf.io.library_images import VolumeSequence
    from accelsurf.settings.track_config import TrackConfig
    from accelsurf.track.output.frames import FrameStore
    from accelsurf.track.track import track

    frames = [Volume.from_array(np.roll(image(), n, axis=2), 1.0) for n in range(2)]
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base)
        config = TrackConfig().replace(start=["ball:5,5,5,3"], max_steps=3, threads=1, levels=1)
        store = FrameStore(folder / "frames")
        for result in track(
            VolumeSequence(frames), config, checkpoint_to=folder / "a_track_state.npz"
        ):
            store.put(result)
        yield Input("track-state", ".npz", "zip", (folder / "a_track_state.npz").read_bytes())
        stored = {
            f"frames/{path.name}": path.read_bytes()
            for path in sorted((folder / "frames").glob("*.npz"))
        }
        yield from of_folder("store", "frames", stored, {".npz": "zip"})
        yield Input("track-toml", ".toml", "text", config.to_toml().encode())
