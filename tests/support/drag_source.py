"""A small window, at the lower right of the screen, from which files can be dragged: drag_source.py FILE ..."""

import sys

from PySide6.QtCore import QMimeData, Qt, QUrl
from PySide6.QtGui import QDrag, QMouseEvent
from PySide6.QtWidgets import QApplication, QLabel


class Source(QLabel):
    """Starts a drag when it is pressed."""

    def mousePressEvent(self, event: QMouseEvent) -> None:
        drag, data = QDrag(self), QMimeData()
        data.setUrls([QUrl.fromLocalFile(name) for name in sys.argv[1:]])
        drag.setMimeData(data)
        done = drag.exec(Qt.DropAction.CopyAction)
        print(f"dropped {done.name}", flush=True)  # the window still asks for what was dropped


if __name__ == "__main__":
    app = QApplication(sys.argv[:1])
    label = Source("drag me")
    label.setWindowTitle("drag source")
    label.setGeometry(1200, 640, 70, 60)
    label.show()
    print("shown", flush=True)
    app.exec()
