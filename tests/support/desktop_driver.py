"""Opens the window for tests/viewer/test_desktop.py and tells a file, again and again, where its parts are and what it
shows. All that happens to the window comes from outside, as mouse and key events of the screen.

Usage: desktop_driver.py IMAGE TOLD [OPTION=VALUE ...]
"""

import json
import os
import sys
import time
from pathlib import Path

from PySide6.QtCore import QPoint, QTimer
from PySide6.QtWidgets import QApplication, QWidget

from accelsurf import io
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.frontends.desktop import Window


def main() -> None:
    source, told = Path(sys.argv[1]), Path(sys.argv[2])
    options = dict(word.split("=", 1) for word in sys.argv[3:])
    folder, theme = options.pop("result", None), options.pop("theme", "dark")
    reference = options.pop("reference", None)
    app = QApplication(sys.argv[:1])
    app.setStyle("Fusion")
    session = Session(io.read(source), RunConfig(**options), name="scan", source=source)
    session.ready.result(300)
    window = Window(
        session, io.read_labels(reference) if reference else None, Path(folder) if folder else None, theme
    )
    window.show()
    draft = told.with_suffix(".draft")
    #: When each status was first seen by the window, for how fast keys are answered.
    answered: list[tuple[float, bool, int]] = []

    def middle(widget: QWidget) -> list[int]:
        place = widget.mapToGlobal(QPoint(widget.width() // 2, widget.height() // 2))
        return [place.x(), place.y()]

    def ends(slider: QWidget) -> list[int]:
        place = slider.mapToGlobal(QPoint(0, slider.height() // 2))
        return [place.x(), place.y(), slider.width()]

    def watch() -> None:
        status = session.status
        if not answered or answered[-1][1:] != (status.running, status.step):
            if not answered or answered[-1][1] != status.running:
                answered.append((time.time(), status.running, status.step))

    def tell() -> None:
        status, panel, canvas = session.status, window.panel, window.canvas
        corner = canvas.mapToGlobal(QPoint(0, 0))
        tiles = {}
        for name, tile in {"space": window.scene.space, **window.scene.slice_tiles}.items():
            if tile is not None:
                left, bottom, right, top = tile.renderer.GetViewport()
                tiles[name] = [
                    corner.x() + round(canvas.width() * 0.5 * (left + right)),
                    corner.y() + round(canvas.height() * (1 - 0.5 * (bottom + top))),
                ]
        frame = window.scene.frame
        draft.write_text(json.dumps({
            "buttons": {name: middle(getattr(window, name)) for name in ("restart", "back", "play", "forward")}
            | {"undo": middle(panel.undo), "save": middle(panel.save), "timeline": ends(window.timeline)}
            | {name: middle(button) for name, button in panel.tools.items()}
            | {name: ends(amount.slider) for name, amount in panel.amounts.items()},
            "tiles": tiles,
            "step": status.step, "running": status.running, "kept": status.kept, "message": window.message.text(),
            "edits": [edit.model_dump() for edit in status.edits], "start": status.settings.start,
            "settings": status.settings.model_dump(mode="json"), "stop": status.stop and status.stop.reason,
            "drawn": None if frame is None else [frame.row.step, frame.row.volume_mm3],
            "color": panel.color.currentText(), "theme": panel.theme.currentText(), "help": window.help.isVisible(),
            "play": window.play.text(), "title": window.windowTitle(), "cursor": window.scene.cursor.tolist(),
            "answered": answered[-50:],
        }))
        os.replace(draft, told)

    timers = []
    for work, pause in ((watch, 2), (tell, 60)):
        timer = QTimer(window, interval=pause)
        timer.timeout.connect(work)
        timer.start()
        timers.append(timer)
    app.exec()
    assert not session._thread.is_alive()
    print("closed")


if __name__ == "__main__":
    main()
