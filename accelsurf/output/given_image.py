"""The image of a finished run as it was given, from its report: every later command opens it by this one value.

An image is given by a path (a file, a folder, a pattern of names) and options of reading: which series, level, channel
or time point, the size of a voxel. The volume read again must be the same.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume, voxels_sha256
from accelsurf.io import is_pattern, read_channels, sha256, written_at
from accelsurf.settings.older import modern
from accelsurf.settings.reading import AS_IT_IS, ReadOptions
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

_ANEW = "give the image and --config NAME_run.toml instead"


@dataclass(frozen=True)
class GivenImage:
    """The image of a run, as it was given.

    Attributes
    ----------
    path : Path
        A file, a folder, or a pattern of the names of slices.
    reading : ReadOptions
        How it was read.
    voxels : str or None
        SHA-256 of the values read, from `accelsurf.image.volume.voxels_sha256`; None where it was read in parts.
    files : str or None
        SHA-256 of its file or files, by which reports without ``voxels`` know it.
    geometry : Geometry or None
        Its grid.
    written : list of int or None
        Of an image that was read in parts, from `accelsurf.io.files.written_at`.
    """

    path: Path
    reading: ReadOptions = AS_IT_IS
    voxels: str | None = None
    files: str | None = None
    geometry: Geometry | None = field(default=None, compare=False)
    written: list[int] | None = field(default=None, compare=False)

    @classmethod
    def of_report(cls, report: Mapping[str, Any], where: Path) -> GivenImage:
        """Return the image that a report names.

        Parameters
        ----------
        report : mapping
            Its content; it may be anybody's.
        where : Path
            The report, for messages.

        Raises
        ------
        InputError
            When it names none.
        """
        entry = report.get("input")
        if not isinstance(entry, dict) or not isinstance(entry.get("path"), str):
            raise InputError(f"{where}: names no image and settings to go on with", _ANEW)
        config = settings_of(report, where)
        run = config.run if isinstance(config, TrackConfig) else config
        return cls.of_entry(entry, Path(entry["path"]), run.reading)

    @classmethod
    def of_entry(cls, entry: Any, path: Path, reading: ReadOptions) -> GivenImage:
        """Return the image that the entry of a report describes; only path and reading without an entry."""
        known: dict[str, Any] = entry if isinstance(entry, dict) else {}
        voxels, files = _text(known.get("voxels_sha256")), _text(known.get("sha256"))
        written = known.get("written")
        of_parts = written if isinstance(written, list) else None
        return cls(path, reading, voxels, files, _geometry(known), of_parts)

    def found(self, moved: Path | None, hint: str) -> GivenImage:
        """Return the image where it is now.

        Parameters
        ----------
        moved : Path or None
            Where it was moved to; None: where the run found it.
        hint : str
            Advice when it is not there.

        Raises
        ------
        InputError
            When nothing is there.
        """
        path = self.path if moved is None else moved
        if not is_there(path):
            raise InputError(f"{path}: the image of the run is not there", hint)
        return replace(self, path=path)

    def read(self, hint: str) -> list[Volume]:
        """Read its channels.

        Parameters
        ----------
        hint : str
            Advice when it is another image.

        Raises
        ------
        InputError
            As `accelsurf.io.channels.read_channels`, and when another volume is read than the run had; the message
            names the difference.
        """
        volumes = read_channels(self.path, self.reading)
        self.check(volumes, hint)
        return volumes

    def check(self, volumes: Sequence[Volume], hint: str) -> None:
        """Refuse another image than that of the run; one that was read in parts is not checked.

        Raises
        ------
        InputError
            With the difference.
        """
        differs = "" if self.geometry is None else self.geometry.difference(volumes[0].geometry)
        if not differs and self.voxels is None:
            self.check_files(hint)
        elif not differs and voxels_sha256(volumes) != self.voxels:
            differs = "the values of its voxels differ"
        self._refuse(differs, hint)

    def check_files(self, hint: str) -> None:
        """Refuse files with other bytes than the run's; where these are not known nothing is checked.

        Raises
        ------
        InputError
            When they differ.
        """
        is_same = self.files is None or sha256(self.path) == self.files
        self._refuse("" if is_same else "the bytes of its files differ", hint)

    @property
    def is_same(self) -> bool:
        """True if the files have the bytes that they had, or the volume read is the same; unknown is False.

        Of an image that was read in parts, if its files were not written since.

        Raises
        ------
        InputError
            When it cannot be read.
        """
        if self.files is not None and sha256(self.path) == self.files:
            return True
        if self.voxels is None:
            return self.written is not None and written_at(self.path) == self.written
        volumes = read_channels(self.path, self.reading)
        is_placed = self.geometry is None or self.geometry.matches(volumes[0].geometry)
        return is_placed and voxels_sha256(volumes) == self.voxels

    def _refuse(self, differs: str, hint: str) -> None:
        if differs:
            raise InputError(
                f"{self.path}: is another image than that of the run, or was changed since: {differs}",
                hint,
            )


def settings_of(report: Mapping[str, Any], where: Path) -> RunConfig | TrackConfig:
    """Return the settings of the run or the tracking that a report is of.

    Raises
    ------
    InputError
        When it has none with which that can be repeated.
    UsageError
        When one of them has a value that is no longer valid.
    """
    settings = report.get("config")
    if not isinstance(settings, dict):
        raise InputError(f"{where}: not the report of a run that can be repeated", _ANEW)
    if str(settings.get("energy", "")).startswith("custom: "):
        raise InputError(
            f"{where}: the energy was one of your own ({settings['energy']})", "go on in Python"
        )
    if report.get("kind") != "tracking":
        return RunConfig(**modern(settings))
    run = settings.get("run")
    if not isinstance(run, dict):
        raise InputError(f"{where}: not the report of a tracking that can be repeated", _ANEW)
    return TrackConfig(**{**settings, "run": RunConfig(**modern(run))})


def is_there(path: Path) -> bool:
    """Test if a path names a file or a folder, or a pattern that a file fits; False for impossible names.

    Examples
    --------
    >>> is_there(Path("absent.nii")), is_there(Path("a" * 300)), is_there(Path("a" * 300 + "*"))
    (False, False, False)
    """
    if os.path.exists(path):  # False where the system refuses the name
        return True
    is_searched = is_pattern(path) and os.path.isdir(path.parent)
    return is_searched and any(path.parent.glob(path.name))


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _geometry(entry: Mapping[str, Any]) -> Geometry | None:
    """The grid of the image, where the report has it."""
    try:
        size, spacing, origin = (tuple(entry[key]) for key in ("size", "spacing", "origin"))
        return Geometry(size[::-1], spacing[::-1], origin, entry["direction"])
    except (KeyError, TypeError, ValueError, GeometryError):
        return None
