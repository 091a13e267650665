"""A process that draws a movie and dies within pictures, as a fault in a graphics library ends it."""

import json
import os
import signal
import sys
from pathlib import Path

PROGRAM = "from tests.support import dying_scene; dying_scene.serve({!r})"


def program(folder: Path, deaths: dict[int, int], number: int, early: bool = False) -> str:
    """What such a process runs.

    Parameters
    ----------
    folder : Path
        An empty one, where processes note their deaths.
    deaths : dict of int to int
        How often it dies within the picture of a step, by the step; -1 is before there is a scene.
    number : int
        The signal.
    early : bool
        Before the picture is drawn, not after.
    """
    said = {
        "folder": str(folder),
        "deaths": {str(step): times for step, times in deaths.items()},
        "number": number,
    }
    return PROGRAM.format(json.dumps({**said, "early": early}))


def serve(text: str) -> None:
    from accelsurf.viewer import drawing_process
    from accelsurf.viewer.scene.scene import Scene

    said, screenshot = json.loads(text), Scene.screenshot

    def die(step: int) -> None:
        notes = Path(said["folder"])
        if len(list(notes.glob(f"{step}-*"))) < said["deaths"].get(str(step), 0):
            (notes / f"{step}-{os.getpid()}").touch()
            if sys.platform == "win32":
                os._exit(3)
            os.kill(os.getpid(), said["number"])
            signal.pause()

    def dying(scene, *words):
        step = -1 if scene.frame is None else scene.frame.step
        if said["early"]:
            die(step)
        picture = screenshot(scene, *words)
        die(step)
        return picture

    Scene.screenshot = dying  # type: ignore[method-assign]
    die(-1)
    drawing_process.serve()
