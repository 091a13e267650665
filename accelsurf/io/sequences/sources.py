"""Sources of the frames of sequences: time points of a file, slices of a volume, files of a folder, DICOM series.

A DICOM series is a sequence if it has slices at several times, or is a loop in one file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.channels import read_volumes, values_read
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.slices import ordered
from accelsurf.io.dicom.volumes import TIME_PHASES, Contents, DicomVolume, frames_in_time, is_cine
from accelsurf.io.files import naming
from accelsurf.io.format_functions import functions_of
from accelsurf.io.formats import dicom
from accelsurf.io.formats.slices import (
    changing_numbers,
    fitting_names,
    in_order,
    shown_gaps,
)
from accelsurf.io.headers import FRAME_KEY, TIMES_KEY, WARNING_KEY, FrameTimes
from accelsurf.io.lazy_volume import LazyVolume, open_volume
from accelsurf.io.memory import available_memory, check_memory
from accelsurf.settings import budgets
from accelsurf.settings.file_formats import ImageFormat
from accelsurf.settings.reading import ReadOptions


class FileSequence(ImageSequence):
    """A sequence in files, each frame read when it is asked for.

    Parameters
    ----------
    path : Path
        The given path.
    options : ReadOptions
        How it is read.
    memory_bytes : int or None
        Memory to plan with; None for the available memory when a frame is read.
    """

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        self.path, self.source = path, str(path)
        self._options, self._memory_bytes = options, memory_bytes

    def place(self, geometry: Geometry, times: FrameTimes, notes: Sequence[str] = ()) -> None:
        """Say where and when the frames are."""
        self.geometry = geometry
        self.times = times.values
        self.time_unit = times.unit
        self.notes = tuple(note for note in notes if note)

    def set_step(self, seconds: float) -> None:
        """Place frames ``seconds`` apart; where files are missing between them, a multiple of that."""
        places = self.times if self.time_unit == "frame" else range(len(self.times))
        self.times, self.time_unit = tuple(place * seconds for place in places), "s"

    @property
    def memory(self) -> int:
        """Bytes to plan with."""
        return available_memory() if self._memory_bytes is None else self._memory_bytes

    def _channels(self, number: int) -> list[Volume]:
        with naming(self.path):
            found = self.read(number)
        out = []
        for volume in found:
            if difference := self.geometry.difference(volume.geometry):
                raise InputError(
                    f"{self.path}: frame {number} lies on another grid than frame 0: {difference}"
                )
            said = {
                key: text
                for key, text in volume.metadata.items()
                if key not in (TIMES_KEY, FRAME_KEY)
            }
            out.append(Volume(volume.array, self.geometry, said, volume.source))
        return out

    def read(self, number: int) -> list[Volume]:
        """Read the channels of a frame that exists."""
        raise NotImplementedError


class FileFrames(FileSequence):
    """The time points of one file whose format reads one of them like the other."""

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        super().__init__(path, options, memory_bytes)
        self.form, self.header = headers.parse_header(path, options)
        count = int(getattr(self.header, "time_points", 1))
        times = getattr(self.header, "frame_times", None) or FrameTimes.regular(count, None)
        self.place(self.header.geometry, times, getattr(self.header, "notes", ()))

    @property
    def frame_values(self) -> int:
        """Number of values of a frame, all channels together."""
        return values_read(self.header, replace(self._options, time_index=0))

    def read(self, number: int) -> list[Volume]:
        """Read the channels of a frame."""
        return read_volumes(self.path, self.form, with_time(self.header, number), self.memory)


class SliceFrames(FileSequence):
    """The slices of a volume as frames of one slice."""

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        super().__init__(path, options, memory_bytes)
        form, header = headers.parse_header(path, options)
        if getattr(header, "time_points", 1) > 1:
            raise InputError(
                f"{header.time_points} time points are in it: its slices are no frames",
                "leave out --frames-from-slices (frames_from_slices=True)",
            )
        self._volume = self._opened(form, header)
        nz, ny, nx = self._volume.shape
        whole = self._volume.geometry
        geometry = replace(whole, shape=(1, ny, nx))
        self.place(
            geometry, FrameTimes.regular(nz, None), [self._volume.metadata.get(WARNING_KEY, "")]
        )

    def _opened(self, form: ImageFormat, header: Any) -> LazyVolume:
        """The volume, box by box; one that is packed as a whole is read."""
        if functions_of(form).open is not None:
            asked = self._options
            return open_volume(
                self.path,
                level=asked.level,
                channel_index=asked.channel_index,
                spacing=asked.spacing,
            )
        return LazyVolume.of_array(functions_of(form).read(self.path, header, self.memory))

    def read(self, number: int) -> list[Volume]:
        """Read a slice."""
        _, rows, columns = whole_box(self._volume.shape)
        box = (slice(number, number + 1), rows, columns)
        check_memory(self.geometry.size, self._volume.dtype.itemsize, self.memory)
        said = {key: text for key, text in self._volume.metadata.items() if key != WARNING_KEY}
        return [Volume(self._volume.voxels.read(box), self.geometry, said, self.path)]


class FrameFolder(FileSequence):
    """A file for each frame, in a folder or by a pattern; times are the numbers in their names."""

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        super().__init__(path, options, memory_bytes)
        self.files = frame_files(path)
        geometry = None
        for number, file in enumerate(self.files):
            with naming(file):
                _, header = self._parsed(file)
                if getattr(header, "time_points", 1) > 1:
                    raise InputError(
                        f"{header.time_points} time points are in it, a frame expected",
                        "give the file alone",
                    )
                here = header.geometry
            geometry = geometry or here
            if difference := geometry.difference(here):
                raise InputError(
                    f"{file.name}: frame {number} lies on another grid than {self.files[0].name}: {difference}",
                    "resample the frames to one grid, or give a pattern of those that belong together",
                )
        assert geometry is not None
        times, note = times_of_names([file.name for file in self.files])
        self.place(geometry, times, [note])

    @property
    def frame_values(self) -> int:
        """Number of values of a frame, all channels together."""
        first = self.files[0]
        return values_read(self._parsed(first)[1], self._asked(first))

    def _asked(self, file: Path) -> ReadOptions:
        return self._options.restricted_to(headers.options_of(file))

    def _parsed(self, file: Path) -> tuple[ImageFormat, Any]:
        return headers.parse_header(file, self._asked(file))

    def read(self, number: int) -> list[Volume]:
        """Read a file."""
        file = self.files[number]
        with naming(file):
            return read_volumes(file, *self._parsed(file), self.memory)


def with_time(header: Any, number: int) -> Any:
    """A header, with a time point asked for; as it is where it has one only."""
    name = "asked" if hasattr(header, "asked") else "options"
    if getattr(header, "time_points", 1) == 1:
        return header
    return replace(header, **{name: replace(getattr(header, name), time_index=number)})


def holds_frames(path: Path) -> bool:
    """Test if a path is a folder with a file for each frame, or a pattern of the files' names."""
    if headers.is_pattern(path):
        return True
    if not path.is_dir() or headers.is_stored(path):
        return False
    try:
        return headers.format_of(path).name == "slices"
    except InputError:  # no image by itself: a folder of volumes, perhaps
        return any(headers.split_name(entry)[1] for entry in path.iterdir())


def frame_files(path: Path) -> list[Path]:
    """The files of a folder or a pattern, in the order of the numbers in their names.

    Raises
    ------
    InputError
        When there are none, too many, or of several kinds.
    """
    folder, names = fitting_names(path, stores=True)
    kinds = {headers.split_name(name)[1] for name in names} - {""}
    names = [name for name in names if headers.split_name(name)[1]]
    budgets.SLICES.check(len(names))
    if not names:
        raise InputError("no image fits", "check the folder and the pattern")
    if len(kinds) > 1:
        raise InputError(
            f"files of several kinds are there: {', '.join(sorted(kinds))}, one expected",
            "give a pattern, as 'FOLDER/*.tif'",
        )
    return [folder / name for name in in_order(names)]


def times_of_names(names: Sequence[str]) -> tuple[FrameTimes, str]:
    """The times of frames by the numbers in the names of their files, and a note on them.

    The first is at 0. Numbers are divided by their largest common step.

    Examples
    --------
    >>> times_of_names(["t2.tif", "t3.tif", "t5.tif"])[0].values, times_of_names(["a.tif", "b.tif"])[0].values
    ((0.0, 1.0, 3.0), (0.0, 1.0))
    """
    plain = FrameTimes.regular(len(names), None)
    columns = changing_numbers([headers.split_name(name)[0] for name in names])
    if not columns:
        return plain, ""
    if len(columns) != 1 or len(set(columns[0])) < len(names):
        return (
            plain,
            "several numbers in the names of the files change: the frames are counted in their order",
        )
    found = columns[0]
    step = math.gcd(*(b - a for a, b in zip(found, found[1:], strict=False)))
    values = tuple(float((n - found[0]) // step) for n in found)
    known = set(found)
    gaps = (
        [n for n in range(found[0], found[-1], step) if n not in known] if values[-1] < 1e6 else []
    )
    if not gaps:
        return FrameTimes(values), ""
    note = f"frames are missing: no file has the number {shown_gaps(gaps)}; the times have the gap"
    return FrameTimes(values), note


class DicomFrames(FileSequence):
    """The times of a series: slices at the same places, as of a beating heart; or pictures of a loop."""

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        super().__init__(path, options, memory_bytes)
        found = dicom.found_in(path)
        self._root = found.files.root
        frames = _frames_of(found.contents, options, found.file)
        series = frames[0].uids.series
        dicom.refuse_lost(found.contents, series)
        self._parts, times = frames_in_time(frames, self._root)
        first = self._header(0)
        left_out = dicom.notes_on_left_out(found.contents, series, found.file)
        self.place(first.geometry, times, [*left_out, *first.notes])

    def _header(self, number: int) -> dicom.DicomHeader:
        """Slices of a frame in their order, on a grid."""
        slices = ordered(DicomVolume(self._parts[number]), self._root, self._options.spacing)
        return dicom.on_grid(slices, self._options, [])

    def read(self, number: int) -> list[Volume]:
        """Read the slices of a frame."""
        return [dicom.read_dicom(self.path, self._header(number), self.memory)]


def _frames_of(contents: Contents, options: ReadOptions, file: Path | None) -> list[Frame]:
    """The slices of the series that is meant."""
    series: dict[str, list[Frame]] = {}
    for volume in contents.volumes:
        series.setdefault(volume.uid, []).extend(volume.frames)
    cines = [uid for uid, frames in series.items() if is_cine(frames)]
    if file is not None:
        cines = [uid for uid in cines if any(frame.path == file for frame in series[uid])]
    if options.series is None and len(cines) == 1:
        return series[cines[0]]
    if options.series is not None and options.series in series:
        return series[options.series]
    if options.series is None and len(cines) > 1:
        raise InputError(
            f"{len(cines)} series at several times are in it",
            "say which by --series; accelsurf info FOLDER lists them",
        )
    asked = dicom.volume_of(contents, options, file)
    alike = [
        volume
        for volume in contents.volumes
        if volume.uid == asked.uid and _contrast(volume) == _contrast(asked)
    ]
    return [frame for volume in alike for frame in volume.frames]


def _contrast(volume: DicomVolume) -> dict[str, str]:
    """Elements, other than time, that tell a volume apart."""
    return {name: value for name, value in volume.phase.items() if name not in TIME_PHASES}
