"""A simulated person at the window: hands on mouse and keys (xdotool), eyes on what it shows; actions are counted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
#: Above and below, pixels: what is clicked in the panels lies between, so that no bar covers it.
MARGINS = (90, 120)
#: How far a notch of the wheel moves the panels, pixels.
NOTCH = 60


class GaveUp(Exception):
    """What was waited for has not come."""


class Person:
    """Hands and eyes at a window that is open on a screen.

    Parameters
    ----------
    display : str
        The screen.
    folder : Path
        For what the watcher writes.
    words : sequence of str
        Of the command ``accelsurf``; with no image in them the start page is what opens.
    truth : Path, optional
        What the person knows of the object; not shown to the window.
    label : str, optional
        Ids in it, with commas between them.
    size : (int, int), optional
        Of the window, pixels of the screen.
    scale : float, optional
        Of the screen: Qt's factor.

    Attributes
    ----------
    actions : int
        Keys, clicks, drags and turns of the wheel so far.
    """

    def __init__(
        self,
        display: str,
        folder: Path,
        words: Sequence[str],
        truth: Path | None = None,
        label: str = "1",
        size: tuple[int, int] = (1280, 720),
        scale: float = 1.0,
    ) -> None:
        self.env = {
            **os.environ,
            "DISPLAY": display,
            "QT_QPA_PLATFORM": "xcb",
            "QT_SCALE_FACTOR": f"{scale:g}",
        }
        self.env["XDG_STATE_HOME"] = str(
            folder.absolute()
        )  # the list of recent images of who runs this stays as it is
        self._scale = scale
        self._file = folder / "window.json"
        self.actions = 0
        self._height = size[1] / scale
        self.began = time.monotonic()
        self._log = open(folder / "window.log", "w+")
        command = [sys.executable, "-m", "benchmarks.viewer_tasks.window_watch", str(self._file)]
        command += [str(truth or "-"), label, *words]
        self.process = subprocess.Popen(
            command, env=self.env, cwd=ROOT, stdout=self._log, stderr=self._log, text=True
        )
        self.until(
            lambda now: now["drawn"] is not None or (now["is_start_page"] and now["widgets"]), 300
        )
        self._focus("^accelsurf")
        sides = [str(side) for side in size]
        self._do(
            "search",
            "--onlyvisible",
            "--name",
            "accelsurf",
            "windowsize",
            *sides,
            "windowmove",
            "0",
            "0",
        )
        # A busy machine takes seconds for it; what is clicked before lies elsewhere afterwards.
        wanted = [round(side / scale) for side in size]
        self.until(lambda now: now.get("size") == wanted, 120)
        self.opened_s = time.monotonic() - self.began

    # -- hands --------------------------------------------------------------------------------------------

    def open_recent(self) -> None:
        """Click on the first of the recent images, and wait until it is drawn."""
        x, y = self._at_rest("Recent images")
        self.click((x, y - self.now()["heights"]["Recent images"] / 2 + 20))
        self.until(lambda now: not now["is_start_page"], 120)
        self.until(lambda now: now["drawn"] is not None or now.get("state", {}).get("ready"), 300)
        self.opened_s = time.monotonic() - self.began

    def choose(self, name: str, word: str) -> None:
        """Choose a word of a list."""
        self.click_widget(name)
        self.until(lambda now: word in now["items"], 20)
        self.click(self.now()["items"][word])

    def key(self, *names: str) -> None:
        """Press keys, one after the other."""
        self.actions += len(names)
        self._do("key", *names)

    def type(self, text: str) -> None:
        """Type a text: one action."""
        self.actions += 1
        self._do("type", text)

    def click(self, place: Sequence[float], button: int = 1) -> None:
        """Click at a place of the screen."""
        self.actions += 1
        x, y = self._pixel(place)
        self._do("mousemove", x, y, "sleep", "0.05", "click", str(button))

    def click_widget(self, name: str) -> None:
        """Click on what is called so; the panels are scrolled by the wheel until it is in sight."""
        place = self._at_rest(name)
        low, high = MARGINS[0], self._height - MARGINS[1]
        if place[0] > self.now()["widgets"]["panels"][0] - 150:
            turns = 0
            while not low < place[1] < high and turns < 8:
                panels = self.now()["widgets"]["panels"]
                # The wheel over the panels scrolls them and changes no list and no number in them.
                beyond = place[1] - high if place[1] >= high else low - place[1]
                self.scroll(panels, 5 if place[1] >= high else 4, 1 + int(beyond // NOTCH))
                before = place
                place = self._at_rest(name)
                turns = turns + 1
                if place == before:  # it lies beside what the wheel moves
                    self.actions -= 1
                    break
        self.click(place)

    def scroll(self, place: Sequence[float], button: int, notches: int) -> None:
        """Turn the wheel: up is 4, down 5."""
        self.actions += 1
        x, y = self._pixel(place)
        self._do(
            "mousemove",
            x,
            y,
            "sleep",
            "0.05",
            "click",
            "--repeat",
            str(notches),
            "--delay",
            "20",
            str(button),
        )

    def _at_rest(self, name: str) -> Any:
        """Where something is, once two states of the window that were written one after the other agree."""
        before = None
        place = None
        asked = time.time()
        while place is None or place != before:
            before = place
            seen = self.until(
                lambda now, asked=asked: name in now["widgets"] and now["time"] > asked, 60
            )
            place, asked = seen["widgets"][name], time.time() + 0.2
        return place

    def _focus(self, title: str) -> None:
        # What a window manager does, which this screen has not.
        self._do("search", "--sync", "--onlyvisible", "--name", title, "windowfocus", "--sync")

    def drag(
        self,
        places: Sequence[Sequence[float]],
        button: int = 1,
        stop: Callable[[], bool] | None = None,
    ) -> None:
        """Press at the first place, move over the others until ``stop`` says so, let go."""
        self.actions += 1
        x, y = self._pixel(places[0])
        self._do("mousemove", x, y, "sleep", "0.1", "mousedown", str(button), "sleep", "0.1")
        for place in places[1:]:
            x, y = self._pixel(place)
            self._do("mousemove", x, y, "sleep", "0.12")
            if stop is not None and stop():
                break
        self._do("mouseup", str(button))

    def _pixel(self, place: Sequence[float]) -> tuple[str, str]:
        return str(round(place[0] * self._scale)), str(round(place[1] * self._scale))

    def _do(self, *words: str) -> None:
        subprocess.run(
            ["xdotool", *words], env=self.env, check=True, timeout=60, capture_output=True
        )

    # -- eyes ---------------------------------------------------------------------------------------------

    def now(self) -> dict[str, Any]:
        """What the window shows."""
        return dict(json.loads(self._file.read_text()))

    def pixel(self, tile: str, world: Sequence[float]) -> np.ndarray:
        """Where a world point is drawn in a slice."""
        shown = self.now()["tiles"][tile]
        return np.asarray(
            np.array(shown["origin"]) + np.array(shown["matrix"]) @ np.asarray(world, float)
        )

    def until(
        self, condition: Callable[[dict[str, Any]], bool], seconds: float = 120.0
    ) -> dict[str, Any]:
        """Wait until something is seen; returns what is seen then.

        Raises
        ------
        GaveUp
            When it does not come, or the window has gone.
        """
        end, now = time.monotonic() + seconds, {}
        while time.monotonic() < end:
            if self._file.exists():
                now = self.now()
                if condition(now):
                    return now
            if self.process.poll() is not None:
                self._log.seek(0)
                raise GaveUp(f"the window has gone: {self._log.read()[-2000:]}")
            time.sleep(0.03)
        raise GaveUp(
            f"never seen: {json.dumps({k: v for k, v in now.items() if k != 'widgets'})[:2000]}"
        )

    def judge(self, seconds: float = 300.0) -> dict[str, Any]:
        """Wait until nothing moves any more, and look where the surface is wrong."""
        before = self.until(
            lambda now: not now["playing"] and "correcting" not in now["message"], seconds
        )
        number = before["verdict"].get("number", 0)
        self._file.with_suffix(".judge").touch()
        return dict(
            self.until(lambda now: now["verdict"].get("number", 0) > number, seconds)["verdict"]
        )

    def picture(self, path: Path) -> None:
        """A picture of the whole screen."""
        code = (
            "import sys; from PySide6.QtWidgets import QApplication; app = QApplication([]); "
            "app.primaryScreen().grabWindow(0).save(sys.argv[1])"
        )
        env = {**self.env, "QT_SCALE_FACTOR": "1"}
        subprocess.run([sys.executable, "-c", code, str(path)], env=env, check=True, timeout=60)

    def close(self) -> None:
        """Close the window by its key.

        Raises
        ------
        GaveUp
            When the command does not end well.
        """
        self._do("key", "ctrl+q")
        try:
            code = self.process.wait(60)
        finally:
            self.process.kill()
        self._log.seek(0)
        log = self._log.read()
        self._log.close()
        if code or "Traceback" in log:
            raise GaveUp(f"the window ended with {code}: {log[-2000:]}")
