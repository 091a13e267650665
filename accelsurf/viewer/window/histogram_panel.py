"""The panel of the histogram: the image, what is in the object, the bounds of the energy; and the force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.scene.colors import MARK, SURFACE
from accelsurf.viewer.window.section_panel import Section, framed, show_switch

HEIGHT = 86
#: Pixels from a bound within which it is taken.
REACH = 7.0


class HistogramView(QWidget):
    """Draws the histogram; `moved` has the place of a term, LO or HI, and the value that a bound was dragged to."""

    moved = Signal(int, str, float)

    def __init__(self) -> None:
        super().__init__()
        self.setMinimumHeight(HEIGHT)
        self.setMouseTracking(True)
        self.setAccessibleName("histogram")
        self._histogram: Mapping[str, Any] = {"low": 0.0, "high": 1.0, "image": [], "object": []}
        self._bounds: list[dict[str, Any]] = []
        self._taken: dict[str, Any] | None = None

    def sizeHint(self) -> QSize:
        """Return a size as wide as the panel."""
        return QSize(260, HEIGHT)

    def show_state(self, histogram: Mapping[str, Any], bounds: list[dict[str, Any]]) -> None:
        """Show other values, except for a bound that is being dragged."""
        if (histogram, bounds) != (self._histogram, self._bounds):
            self._histogram, self._bounds = histogram, bounds
            self.update()

    def place_of(self, value: float) -> float:
        """Pixel of a value, from the left; values beyond the ends are at the ends."""
        low, high = self._histogram["low"], self._histogram["high"]
        return float(min(max((value - low) / (high - low), 0.0), 1.0)) * (self.width() - 1)

    def value_at(self, x: float) -> float:
        """Value of a pixel."""
        low, high = self._histogram["low"], self._histogram["high"]
        return float(low + (high - low) * min(max(x / max(self.width() - 1, 1), 0.0), 1.0))

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the bars, the object's over the image's, and the bounds."""
        painter = QPainter(self)
        floor = self.height() - 14
        for key, color in (("image", self.palette().mid().color()), ("object", QColor(SURFACE))):
            self._draw_bars(painter, self._histogram[key], color, floor)
        for bound in self._bounds:
            value = self._taken["value"] if self._is_taken(bound) and self._taken else bound["value"]
            x = self.place_of(value)
            painter.setPen(QPen(QColor(MARK), 2, Qt.PenStyle.SolidLine if bound["given"] else Qt.PenStyle.DashLine))
            painter.drawLine(QPointF(x, 0), QPointF(x, floor))
            side = Qt.AlignmentFlag.AlignLeft if x < 0.6 * self.width() else Qt.AlignmentFlag.AlignRight
            place = QRectF(x + 4, 0, 90, 14) if side == Qt.AlignmentFlag.AlignLeft else QRectF(x - 94, 0, 90, 14)
            painter.setPen(self.palette().text().color())
            painter.drawText(place, side, f"{value:.4g}")
        ends = QRectF(0, floor, self.width(), 14)
        painter.setPen(self.palette().text().color())
        painter.drawText(ends, Qt.AlignmentFlag.AlignLeft, f"{self._histogram['low']:.4g}")
        painter.drawText(ends, Qt.AlignmentFlag.AlignRight, f"{self._histogram['high']:.4g}")

    def _draw_bars(self, painter: QPainter, heights: list[float], color: QColor, floor: int) -> None:
        color.setAlpha(190)
        wide = self.width() / max(len(heights), 1)
        for place, height in enumerate(heights):
            painter.fillRect(QRectF(place * wide, floor * (1 - height), wide, floor * height), color)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Take the bound that is nearest."""
        x = event.position().x()
        near = [bound for bound in self._bounds if abs(self.place_of(bound["value"]) - x) <= REACH]
        self._taken = dict(min(near, key=lambda bound: abs(self.place_of(bound["value"]) - x))) if near else None

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Draw the bound where it is dragged; show which can be."""
        x = event.position().x()
        is_near = any(abs(self.place_of(bound["value"]) - x) <= REACH for bound in self._bounds)
        self.setCursor(Qt.CursorShape.SplitHCursor if is_near or self._taken else Qt.CursorShape.ArrowCursor)
        self.setToolTip(f"{self.value_at(x):.4g}")
        if self._taken is not None:
            self._taken["value"] = self.value_at(x)
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """Move the bound."""
        taken, self._taken = self._taken, None
        if taken is not None:
            self.moved.emit(taken["term"], taken["key"], taken["value"])

    def _is_taken(self, bound: dict[str, Any]) -> bool:
        taken = self._taken
        return taken is not None and (taken["term"], taken["key"]) == (bound["term"], bound["key"])


class HistogramPanel(Section):
    """The histogram, and a switch for the force over the slices."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Histogram", actions)
        whole = framed(QVBoxLayout(self.body), 5)
        self.view = HistogramView()
        self.view.moved.connect(lambda *moved: self.ask("bound", *moved))
        tip = "Over the slices: where the energy makes a surface grow, and shrink (F)"
        self.force = self.switch("Show force", "force", tip)
        self.note = QLabel("")
        self.note.setWordWrap(True)
        for part in (self.view, self.force, self.note):
            whole.addWidget(part)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the histogram, and whether the force is."""
        self.view.show_state(state["histogram"], state["bounds"])
        show_switch(self.force, state["force"])
        self.note.setText(state["force_note"])
        self.note.setVisible(bool(state["force_note"]))
