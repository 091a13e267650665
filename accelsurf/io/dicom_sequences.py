"""A DICOM series at several times, or a loop in one file, as a sequence."""

from __future__ import annotations

from pathlib import Path

from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.io.dicom.cine import TIME_PHASES, frames_in_time, is_cine
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.slices import ordered
from accelsurf.io.dicom.volumes import Contents, DicomVolume
from accelsurf.io.formats import dicom
from accelsurf.io.sequence_sources import FileSequence
from accelsurf.settings.reading import ReadOptions


class DicomFrames(FileSequence):
    """The times of a series: slices at the same places, as of a beating heart; or pictures of a loop."""

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        super().__init__(path, options, memory_bytes)
        self._files, contents, file = dicom.found_in(path)
        frames = _frames_of(contents, options, file)
        series = frames[0].uids[1]
        dicom.refuse_lost(contents, series, options)
        self._parts, times = frames_in_time(frames, self._files.root)
        first = self._header(0)
        self.place(first.geometry, times, [*dicom.notes_on_left_out(contents, series, file), *first.notes])

    def _header(self, number: int) -> dicom.DicomHeader:
        """Slices of a frame in their order, on a grid."""
        slices = ordered(DicomVolume(self._parts[number]), self._files.root, self._options.spacing)
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
            f"{len(cines)} series at several times are in it", "say which by --series; accelsurf info FOLDER lists them"
        )
    asked = dicom.volume_of(contents, options, file)
    alike = [volume for volume in contents.volumes if volume.uid == asked.uid and _contrast(volume) == _contrast(asked)]
    return [frame for volume in alike for frame in volume.frames]


def _contrast(volume: DicomVolume) -> dict[str, str]:
    """Elements, other than time, that tell a volume apart."""
    return {name: value for name, value in volume.phase.items() if name not in TIME_PHASES}
