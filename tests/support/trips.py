"""Trips: the files that an argument, or a click, passes on its way to the first kernel of the loop.

A trip is recorded while it is made: every call of a function of accelsurf is seen (`sys.setprofile`). Compiled kernels
are no calls that can be seen, so a trip ends where the first step of `Evolution` calls what calls the first kernel,
`LevelSet.fraction_and_area`. Folders called kernels do not count, nor does what a module does while it is imported.

    python -m tests.support.trips [WORD]

prints the files of each trip whose name contains the word, in the order of the first calls.
"""

from __future__ import annotations

import functools
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import accelsurf
from accelsurf import RunConfig, Volume

ROOT = str(Path(accelsurf.__file__).parent) + "/"
#: Where the loop calls its first kernel: a function, and the one that calls it.
KERNEL, CALLER = "fraction_and_area", "_step"
#: The image of all trips, and where its object is clicked or a surface starts in it; world of the new click.
SHAPE, SEED, START, NEW = (14, 16, 18), "ball:7,8,7,2", "ball:8,8,7,3", (14.0, 8.0, 7.0)


class Trip:
    """The files of a trip, in the order of the first calls; a context that records it.

    Parameters
    ----------
    counts : callable
        Called with the frame of a call that begins: whether it belongs to the trip.

    Attributes
    ----------
    files : dict of str to str
        Path below ``accelsurf/``, and the function that was called first there.
    called : set of str
        The files of all functions that were called meanwhile, also of those that are not counted.
    ended : bool
        Whether the loop has called its first kernel.
    """

    def __init__(self, counts: Callable[[FrameType], bool]) -> None:
        self.files: dict[str, str] = {}
        self.called: set[str] = set()
        self.ended, self.recording = False, False
        self._counts = counts

    def __enter__(self) -> Trip:
        self.recording = True
        threading.setprofile(self._see)
        sys.setprofile(self._see)
        return self

    def __exit__(self, *error: object) -> None:
        sys.setprofile(None)
        threading.setprofile(None)
        self.recording = False

    def _see(self, frame: FrameType, event: str, _: Any) -> None:
        if event != "call" or self.ended or not self.recording:
            return
        code = frame.f_code
        path = code.co_filename.removeprefix(ROOT)
        if path == code.co_filename or "kernels" in Path(path).parts or _is_import(frame):
            return
        self.called.add(path)
        if path not in self.files and self._counts(frame):
            self.files[path] = code.co_qualname
        if (
            code.co_name == KERNEL
            and frame.f_back is not None
            and frame.f_back.f_code.co_name == CALLER
        ):
            self.ended = True

    def lines(self) -> list[str]:
        """Return a line for each file."""
        return [f"{path}  {name}" for path, name in self.files.items()]


def _is_import(frame: FrameType) -> bool:
    """Return True if a module of accelsurf is being imported."""
    at: FrameType | None = frame
    while at is not None:
        if at.f_code.co_name == "<module>" and at.f_code.co_filename.startswith(ROOT):
            return True
        at = at.f_back
    return False


def arguments(frame: FrameType) -> Iterator[Any]:
    """Yield the arguments of a call, self among them; of a function of a function what it has from there, too."""
    code = frame.f_code
    count = (
        code.co_argcount
        + code.co_kwonlyargcount
        + bool(code.co_flags & 0x04)
        + bool(code.co_flags & 0x08)
    )
    for name in (*code.co_varnames[:count], *code.co_freevars):
        if name in frame.f_locals:
            yield frame.f_locals[name]


def parts(value: Any) -> Iterator[Any]:
    """Yield the attributes of an object, the values of a collection, what a partial function holds."""
    if isinstance(value, dict):
        yield from value.values()
    elif isinstance(value, (tuple, list)):
        yield from value[:20]
    elif isinstance(value, functools.partial):
        yield from (*value.args, *value.keywords.values())
    elif hasattr(value, "__dict__") and not isinstance(value, type):
        yield from list(vars(value).values())
    for kind in type(value).__mro__:
        for name in getattr(kind, "__slots__", ()):
            if isinstance(name, str) and hasattr(value, name):
                yield getattr(value, name)


def holds(value: Any, wanted: Callable[[Any], bool]) -> bool:
    """Return True for what is wanted, a collection of it, and an object that has either as an attribute."""
    if wanted(value):
        return True
    for part in parts(value):
        if wanted(part) or (
            isinstance(part, (tuple, list, dict)) and any(wanted(each) for each in parts(part))
        ):
            return True
        if isinstance(value, (tuple, list, dict)) and any(wanted(each) for each in parts(part)):
            return True
    return False


def has_voxels(value: Any) -> bool:
    """Return True for a Volume, and for values of the image's grid or of a box of it."""
    if isinstance(value, Volume):
        return True
    if not isinstance(value, np.ndarray) or value.ndim != 3 or value.dtype == bool:
        return False
    return all(4 <= n <= whole for n, whole in zip(value.shape, SHAPE, strict=True))


def has_config(value: Any) -> bool:
    """Return True for settings: those of a run, and those of the solver that are made of them."""
    return isinstance(value, RunConfig) or type(value).__name__ == "SolverSetup"


def has_click(value: Any) -> bool:
    """Return True for the new click: where the mouse is, its place, text, voxels, and the correction that it is."""
    if type(value).__name__ in ("Clicks", "Correction", "Refinement", "Edit"):
        return holds(value, _is_click)
    return _is_click(value)


def _is_click(value: Any) -> bool:
    if isinstance(value, str):
        return value.startswith(("ball:", "point:", "path:")) and value not in (SEED, START)
    if type(value).__name__ == "Click":
        return bool(value.box[2].start <= NEW[0] < value.box[2].stop)
    if (
        isinstance(value, (tuple, list, np.ndarray))
        and getattr(value, "shape", (3,)) == (3,)
        and len(value) == 3
    ):
        if all(isinstance(each, (float, int)) for each in value):
            return any(np.abs(np.subtract(value, place)).max() < 0.6 for place in (NEW, NEW[::-1]))
    return type(value).__name__ == "Picked"


def image() -> np.ndarray:
    """Return a bright ball in noise."""
    z, y, x = np.indices(SHAPE, dtype=np.float64)
    ball = (z - 7) ** 2 + (y - 8) ** 2 + (x - 8) ** 2 < 5**2
    return (100.0 * ball + np.random.default_rng(0).normal(0.0, 8.0, SHAPE)).astype(np.float32)


def options(clicked: bool) -> RunConfig:
    """Return the settings of a run from a click, or from a ball."""
    return (
        RunConfig(inside=SEED, levels=1, threads=1)
        if clicked
        else RunConfig(start=START, levels=1, threads=1)
    )


def argument_trip(wanted: Callable[[Any], bool], clicked: bool) -> Trip:
    """Return the trip of an argument of `segment` to the loop: ``has_voxels`` or ``has_config``."""
    volume, config = Volume.from_array(image()), options(clicked)
    with Trip(lambda frame: any(holds(each, wanted) for each in arguments(frame))) as trip:
        accelsurf.segment(volume, config=config, on_step=lambda record: True)
    assert trip.ended
    return trip


def click_trip(clicked: bool, after_end: bool) -> Trip:
    """Return the trip of a click with the tool Inside, from the press of the button to the step that obeys it.

    Parameters
    ----------
    clicked : bool
        Whether the run was begun by a click.
    after_end : bool
        Whether it has ended; a run that is paused ends by the click.
    """
    from accelsurf.viewer.actions.actions import Actions
    from accelsurf.viewer.core.session import Session
    from accelsurf.viewer.scene.scene import Scene

    at: list[float] = []
    trip = Trip(
        lambda frame: any(
            holds(each, lambda it: has_click(it) or _among(it, at)) for each in arguments(frame)
        )
    )
    volume = Volume.from_array(image())
    threading.setprofile(trip._see)  # the session's thread is seen from its beginning
    try:
        session = Session(volume, options(clicked).replace(keep_state="yes"))
        scene = Scene(volume, size=(960, 544))
        with session:
            (session.play() if after_end else session.play(3)).result(60)
            assert session.wait(120) and (session.status.stop is not None) == after_end
            actions = Actions(session, scene)
            while (view := session.next_view()) is None:
                pass
            actions.update(view)
            scene.render()
            for name, *values in (("cursor", 8.0, 8.0, 7.0), ("radius", 1.6), ("tool", "inside")):
                actions.request(name, *values)
            at += _in_slice(scene, NEW)
            with trip:
                actions.request("press", *at)
                actions.request("release")
                sys.setprofile(None)
                assert not actions.message, actions.message
                assert session.wait(60)
        scene.close()
    finally:
        threading.setprofile(None)
    assert trip.ended
    return trip


def _among(value: Any, numbers: list[float]) -> bool:
    return isinstance(value, float) and value in numbers


def _in_slice(scene: Any, world: tuple[float, float, float]) -> tuple[float, float]:
    """Return where a point lies in the axial slice, parts of the width and of the height from the top."""
    width, height = scene.plotter.render_window.GetSize()
    tile = scene.slice_tiles["axial"]
    place = np.array(tile.to_tile(scene.geometry.world_to_index(np.asarray(world))))
    low, high = np.array(tile.to_plane(0.0, 0.0)), np.array(tile.to_plane(1.0, 1.0))
    right, up = (place - low) / (high - low)
    left, bottom, far, top = scene.tiles.renderer("axial").GetViewport()
    return left + right * (far - left), 1.0 - (bottom + up * (top - bottom))


TRIPS: dict[str, Callable[[], Trip]] = {
    "volume, from a ball": lambda: argument_trip(has_voxels, False),
    "volume, from a click": lambda: argument_trip(has_voxels, True),
    "config, from a ball": lambda: argument_trip(has_config, False),
    "config, from a click": lambda: argument_trip(has_config, True),
    "click after the end": lambda: click_trip(True, True),
    "click after the end of a run from a ball": lambda: click_trip(False, True),
    "click in a paused run": lambda: click_trip(True, False),
}


if __name__ == "__main__":
    for name in (name for name in TRIPS if not sys.argv[1:] or sys.argv[1] in name):
        made = TRIPS[name]()
        print(f"{name}: {len(made.files)} files; functions of {len(made.called)} files were called")
        print("\n".join(f"    {line}" for line in made.lines()), flush=True)
