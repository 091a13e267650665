"""Saves the files of a run, and lists those that were saved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings.catalogue import as_typed
from accelsurf.settings.mesh_formats import MESH_FORMATS
from accelsurf.viewer.actions.tool import AllActions, Feature, Key, word
from accelsurf.viewer.core.status import SAVED_KINDS, Status

#: The format of surfaces unless another is asked for.
AUTO_MESH = next(name for name, form in MESH_FORMATS.items() if "surface" in form.auto)


class FilesFeature(Feature):
    """Saves into the folder of results.

    Attributes
    ----------
    files : dict of str to Path
        Saved files, by name.
    is_saving : bool
        Whether files are being written.
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self.files: dict[str, Path] = {}
        self.is_saving = False
        #: Format of meshes that was selected here; of the settings otherwise.
        self._mesh = ""
        #: Content of the run in the files that were saved last.
        self._stored: Any = None

    @property
    def is_unsaved(self) -> bool:
        """Test if something was done that is not in the files that were saved last."""
        session, status = self.actions.session, self.actions.session.status
        changed = {
            "new": bool(status.step or status.undoable),
            "saved": bool(status.undoable),
            "unsaved": True,
        }[session.origin]
        return status.ready and changed and _content(status) != self._stored

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"save": self._save, "mesh": self._choose_mesh}

    def keys(self) -> Mapping[str, Key]:
        return {"Ctrl+S": Key("save", (), "save labels, mesh, picture, settings")}

    def state(self, status: Status) -> dict[str, Any]:
        mesh = self._mesh or as_typed(status.settings.mesh).replace("auto", AUTO_MESH)
        meshes = [
            mesh,
            *(
                name
                for name, form in MESH_FORMATS.items()
                if "surface" in form.shapes and name != mesh
            ),
        ]
        return {
            "saved": sorted(self.files),
            "saving": self.is_saving,
            "mesh": mesh,
            "meshes": meshes,
        }

    def _choose_mesh(self, name: Any) -> None:
        self._mesh = word(name, tuple(MESH_FORMATS))

    def _save(self, *what: Any) -> None:
        actions = self.actions
        kinds = [word(kind, SAVED_KINDS) for kind in what] or list(SAVED_KINDS)
        if actions.folder is None:
            raise UsageError("save: there is no folder to save in", "name one")
        future = actions.session.save(actions.folder, kinds, actions.overwrite, self._mesh)
        content = _content(actions.session.status)
        self.is_saving = True
        future.add_done_callback(lambda _: setattr(self, "is_saving", False))
        actions.note("saving ...", 600)
        folder, is_all = actions.folder, not what
        actions.ask(
            future,
            lambda paths: self._saved(
                folder, paths, is_all, content if "labels" in kinds else None
            ),
        )

    def _saved(self, folder: Path, paths: list[Path], is_all: bool, content: Any) -> None:
        """List saved files; after all kinds, save the scene as it is drawn now."""
        self._stored = content or self._stored
        home = folder.resolve()
        # The session chooses the names; a file elsewhere would not be served all the same.
        self.files |= {path.name: path for path in paths if path.resolve().parent == home}
        self.actions.note(f"saved in {folder.absolute()}: {len(paths)} files", 20)
        if is_all:
            picture = folder / f"{self.actions.session.name}_view.png"
            self.actions.scene.screenshot(picture)
            self.actions.scene.tiles.redraw.mark_all()  # a page has not got this picture
            self.files[picture.name] = picture


def _content(status: Status) -> tuple[Any, ...]:
    """Return the part of a run that files hold."""
    return status.step, status.settings, status.edits, status.refinements
