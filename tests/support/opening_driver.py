"""Opens the window of accelsurf for tests/viewer/test_opening_window.py, and writes to a file, every 60 ms, what it
shows and where. All that happens to it comes from outside, as mouse and key events of the screen.

Usage: opening_driver.py STATE_FILE RECENT_FILE [OPTION=VALUE ...]
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from PySide6.QtCore import QPoint, QTimer
from PySide6.QtWidgets import QAbstractButton, QDialogButtonBox, QListView, QMessageBox, QWidget

from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.opening import Opening, ViewerSettings
from accelsurf.viewer.core.recent_files import RecentFiles
from accelsurf.viewer.window.desktop import application
from accelsurf.viewer.window.main_window import MainWindow


def main() -> None:
    state_file, recent = Path(sys.argv[1]), RecentFiles(Path(sys.argv[2]))
    options: dict[str, Any] = dict(word.split("=", 1) for word in sys.argv[3:])
    folder = options.pop("result", None)
    app = application()
    window = MainWindow(
        Opening(RunConfig(**options), recent),
        ViewerSettings(None if folder is None else Path(folder)),
    )
    window.show()
    staged = state_file.with_suffix(".draft")
    #: The longest time between two turns of the window's loop, seconds.
    turns = [time.monotonic(), 0.0]

    def turn() -> None:
        now = time.monotonic()
        turns[:] = now, max(turns[1], now - turns[0])

    def write() -> None:
        staged.write_text(
            json.dumps(said(window) | {"places": places(window), "longest_turn": turns[1]})
        )
        os.replace(staged, state_file)

    timers = []
    for work, pause in ((turn, 5), (write, 60)):
        timer = QTimer(window, interval=pause)
        timer.timeout.connect(work)
        timer.start()
        timers.append(timer)
    app.exec()
    print("closed")


def said(window: MainWindow) -> dict[str, Any]:
    """What the window says."""
    inner, dialog = window.inner, window.dialog
    now: dict[str, Any] = {"title": window.windowTitle(), "opening": window.opening.state()}
    if window.start_page is not None:
        now["message"] = window.start_page.message.text()
    if inner is not None:
        status, frame = inner.session.status, inner.scene.frame
        now |= {
            "name": inner.session.name,
            "shape": inner.scene.geometry.shape,
            "step": status.step,
            "ready": status.ready,
            "drawn": frame is not None and frame.has_surface,
            "dice": inner.scene.dice,
            "message": inner.message.text(),
            "settings": status.settings.model_dump(mode="json"),
            "alive": inner.session.is_alive,
            "folder": str(inner.user_actions.folder),
        }
    now["dialog"] = (
        dialog.text()
        if isinstance(dialog, QMessageBox)
        else type(dialog).__name__
        if dialog
        else ""
    )
    return now


def places(window: MainWindow) -> dict[str, list[int]]:
    """Where things to click are on the screen, pixels."""
    found = {"middle": middle(window)}
    page, dialog = window.start_page, window.dialog
    if page is not None:
        found |= {"open_file": middle(page.open_file), "open_folder": middle(page.open_folder)}
        found |= {
            f"{name}-{n}": at
            for name in ("recent", "phantoms")
            for n, at in rows(getattr(page, name))
        }
    if isinstance(dialog, QMessageBox):
        found |= {f"answer-{one.property('name')}": middle(one) for one in dialog.buttons()}
    elif dialog is not None:
        found |= {f"choice-{n}": at for n, at in rows(dialog.findChild(QListView))}
        buttons = dialog.findChild(QDialogButtonBox).findChildren(QAbstractButton)
        found |= {one.text().replace("&", "").lower(): middle(one) for one in buttons}
    return found


def rows(made: QListView) -> list[tuple[int, list[int]]]:
    """Where the rows of a list are."""
    model = made.model()
    shown = [(n, made.visualRect(model.index(n, 0)).center()) for n in range(model.rowCount())]
    points = [(n, made.viewport().mapToGlobal(place)) for n, place in shown]
    return [(n, [point.x(), point.y()]) for n, point in points]


def middle(widget: QWidget) -> list[int]:
    place = widget.mapToGlobal(QPoint(widget.width() // 2, widget.height() // 2))
    return [place.x(), place.y()]


if __name__ == "__main__":
    main()
