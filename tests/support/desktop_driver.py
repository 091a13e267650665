"""Opens the window for tests/viewer/test_desktop.py, and writes to a file, every 60 ms, where its parts are and what it
shows. All that happens to the window comes from outside, as mouse and key events of the screen.

Usage: desktop_driver.py IMAGE STATE_FILE [OPTION=VALUE ...]
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from PySide6.QtCore import QPoint, QTimer
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QLineEdit,
    QListWidget,
    QPushButton,
    QScrollArea,
    QTableWidget,
    QWidget,
)

from accelsurf import io
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.window.desktop import Window, application
from accelsurf.viewer.window.settings_panel import SettingRow


def main() -> None:
    source, state_file = Path(sys.argv[1]), Path(sys.argv[2])
    options = dict(word.split("=", 1) for word in sys.argv[3:])
    folder, theme = options.pop("result", None), options.pop("theme", "dark")
    reference = options.pop("reference", None)
    app = application()
    session = Session(io.read(source), RunConfig(**options), name="scan", source=source)
    session.ready.result(300)
    window = Window(
        session,
        io.read_labels(reference) if reference else None,
        Path(folder) if folder else None,
        theme,
    )
    window.show()
    staged = state_file.with_suffix(".draft")
    #: When each status was first seen by the window, for how fast keys are answered.
    answered: list[tuple[float, bool, int]] = []

    def watch() -> None:
        status = session.status
        if not answered or answered[-1][1] != status.playing:
            answered.append((time.time(), status.playing, status.step))

    def write() -> None:
        staged.write_text(
            json.dumps({**places(window), **shown(session, window), "answered": answered[-50:]})
        )
        os.replace(staged, state_file)

    timers = []
    for work, pause in ((watch, 2), (write, 60)):
        timer = QTimer(window, interval=pause)
        timer.timeout.connect(work)
        timer.start()
        timers.append(timer)
    app.exec()
    assert not session.is_alive
    print("closed")


def places(window: Window) -> dict[str, Any]:
    """Where buttons, sliders and tiles are on the screen, pixels."""
    side, canvas, bar = window.side, window.canvas, window.bar
    tools, settings = side.panels["ToolsPanel"], side.panels["SettingsPanel"]
    objects, slices = side.panels["ObjectsPanel"], side.panels["SlicesPanel"]
    corner = canvas.mapToGlobal(QPoint(0, 0))
    tiles = {}
    for name, tile in {"space": window.scene.space, **window.scene.slice_tiles}.items():
        if tile is not None and tile.renderer.GetViewport()[2] > 0:
            left, bottom, right, top = tile.renderer.GetViewport()
            tiles[name] = [
                corner.x() + round(canvas.width() * 0.5 * (left + right)),
                corner.y() + round(canvas.height() * (1 - 0.5 * (bottom + top))),
            ]
    return {
        "buttons": {
            name: middle(getattr(bar, name)) for name in ("restart", "back", "play", "forward")
        }
        | {
            "undo": middle(side.changes.undo),
            "save": middle(side.changes.save),
            "timeline": ends(bar.timeline),
        }
        | {name: middle(button) for name, button in tools.tools.items()}
        | {"opacity": ends(objects.opacity)}
        | {
            f"object_{name}": middle(getattr(objects, name))
            for name in ("add", "merge", "remove", "nearest")
        }
        | {
            "grey values": middle(slices.window_word),
            "layout": middle(slices.layout_),
            "level": middle(slices.level),
        }
        | {"straight": middle(slices.straight)}
        | {f"change {row}": row_of(side.panels["HistoryPanel"].list, row) for row in range(3)}
        | {"next uncertain": middle(side.panels["ResultPanel"].next)}
        | {f"object {row}": cell_of(objects.table, row, 2) for row in range(3)}
        | {f"color {row}": cell_of(objects.table, row, 1) for row in range(3)}
        | {f"seen {row}": cell_of(objects.table, row, 0) for row in range(3)}
        | {
            name: ends(row.amount.slider)
            for name, row in settings.rows.items()
            if row.amount is not None
        },
        "tiles": tiles,
        "dialog": dialog(),
        "hidden_width": hidden_width(side),
        "rows": {
            key: [row.label.text(), middle(line_of(row))] for key, row in settings.rows.items()
        },
        "energy_error": settings.rows["energy"].error.text() if settings.rows else "",
    }


def hidden_width(side: QWidget) -> int:
    """Pixels by which the panels are wider than what is seen of them."""
    (area,) = side.findChildren(QScrollArea)
    return area.widget().width() - area.viewport().width()


def dialog() -> dict[str, Any]:
    """Title of the dialog that is open, its field for a colour's code and its buttons; empty where none is."""
    shown = QApplication.activeModalWidget()
    if not isinstance(shown, QDialog):
        return {}
    buttons = {
        one.text().replace("&", ""): middle(one)
        for one in shown.findChildren(QPushButton)
        if one.isVisible()
    }
    codes = [
        middle(one)
        for one in shown.findChildren(QLineEdit)
        if one.isVisible() and one.text().startswith("#")
    ]
    return {"title": shown.windowTitle(), "code": codes, **buttons}


def line_of(row: SettingRow) -> QWidget:
    """What one types in, or chooses with."""
    return row.amount.box if row.amount is not None else row.box or row.line or row.choice


def shown(session: Session, window: Window) -> dict[str, Any]:
    """What the session and the window say."""
    status, frame, state = session.status, window.scene.frame, window.user_actions.state()
    return {
        "step": status.step,
        "playing": status.playing,
        "checkpoints": status.checkpoints,
        "message": window.message.text().replace("\N{ZERO WIDTH SPACE}", ""),
        "edits": [edit.model_dump() for edit in status.edits],
        "refinements": [correction.model_dump() for correction in status.refinements],
        "start": status.settings.start,
        "settings": status.settings.model_dump(mode="json"),
        "stop": status.stop and status.stop.reason,
        "drawn": None if frame is None else [frame.step, frame.volume_mm3],
        "color": state["color"],
        "theme": state["theme"],
        "help": window.help.isVisible(),
        "state": state,
        "pixels": [window.scene.tiles.pixel_ratio, window.canvas.render_window.GetDPI()]
        if window.isVisible()
        else [],
        "clipboard": QApplication.clipboard().text(),
        "play": window.bar.play.text(),
        "title": window.windowTitle(),
        "cursor": window.scene.cursor.tolist(),
    }


def row_of(rows: QListWidget, number: int) -> list[int] | None:
    item = rows.item(number)
    if item is None:
        return None
    place = rows.viewport().mapToGlobal(rows.visualItemRect(item).center())
    return [place.x(), place.y()]


def cell_of(table: QTableWidget, row: int, column: int) -> list[int]:
    rect = table.visualRect(table.model().index(row, column))
    place = table.viewport().mapToGlobal(rect.center())
    return [place.x(), place.y()]


def middle(widget: QWidget) -> list[int]:
    place = widget.mapToGlobal(QPoint(widget.width() // 2, widget.height() // 2))
    return [place.x(), place.y()]


def ends(slider: QWidget) -> list[int]:
    place = slider.mapToGlobal(QPoint(0, slider.height() // 2))
    return [place.x(), place.y(), slider.width()]


if __name__ == "__main__":
    main()
