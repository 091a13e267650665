"""The folders in which the images that are opened one after the other are saved."""

from __future__ import annotations

from pathlib import Path


class ResultFolders:
    """Folders for results: the first image is saved in the folder itself, each further one in a folder of its own.

    Parameters
    ----------
    folder : Path or None
        None where the user is asked for one.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._count = folder, 0

    def of_next(self, name: str) -> Path | None:
        """Return the folder for the image that is opened next, by its name; it is made when something is saved.

        Examples
        --------
        >>> folders = ResultFolders(Path("out"))
        >>> [folders.of_next("scan").as_posix() for _ in range(3)]
        ['out', 'out/scan-2', 'out/scan-3']
        """
        self._count += 1
        if self._folder is None or self._count == 1:
            return self._folder
        return self._folder / f"{name}-{self._count}"
