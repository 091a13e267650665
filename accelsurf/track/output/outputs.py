"""The files of a tracking: frames are taken one at a time, in any order, and all files appear at once at the end.

The folder of the Cell Tracking Challenge follows its "Naming and file content conventions": ``res_track.txt`` has a
line "L B E P" for each track (label, first and last frame, parent or 0), and a 16-bit TIFF of each frame has the label
of each track from B to E. So an object that is not seen for some frames becomes several tracks, each the parent of the
next, as its "Annotation procedure" says ("link its track to its predecessor using a parent link"). A track has one
parent at most: of several that merged, the one of the lowest id.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from types import TracebackType

import numpy as np

from accelsurf import io
from accelsurf.errors import AccelsurfError, OutputError, exit_code_of
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.io import FileSet, refuse_links, write_bytes
from accelsurf.measure import Contours, Surface, extract_contours, extract_surface
from accelsurf.output import OutputFolder, describe_staged, naming_final
from accelsurf.run import cropped
from accelsurf.track.output import document as track_document
from accelsurf.track.output import geff_file, slices, surfaces
from accelsurf.track.output.document import TrackRun
from accelsurf.track.output.files import TrackFiles, is_of_frame, labels_name, mesh_name
from accelsurf.track.output.frames import FrameStore, TrackSet, frame_digits, remove_store
from accelsurf.track.records import FrameResult, Lineage, TrackedObject
from accelsurf.track.scores import Stretch, stretches

#: The largest label of 16 bits.
MAX_LABEL = 65535


class TrackOutputs:
    """Files of a tracking in one folder: all new, or all as they were.

    ``add`` each frame, in any order; then ``finish`` with the lineage, or ``abort``. As a context manager it aborts at
    the end of the block, unless it was finished. A frame lies on the disk as soon as it was added, nothing of it stays
    in memory.

    Parameters
    ----------
    folder : Path
        Where the files go; made if it is not there.
    name : str
        First part of their names.
    sequence : ImageSequence
        The tracked one: grid and times of the frames, and at the end the images that pictures show.
    files : TrackFiles
        Which files.
    run : TrackRun, optional
        Command and settings, for the report.
    overwrite : bool
        Whether files of the same names are replaced.
    store : Path, optional
        A folder for the frames that survives a run that is killed or interrupted; it is removed when the files are
        complete. By default they lie in a hidden folder, which goes with the run.
    resume : bool
        Whether frames that an earlier run has left in ``store`` count; else they are removed.

    Raises
    ------
    OutputError
        When a file exists already, nothing can be written there, or another run is writing files of this name.
    UsageError
        When a format cannot hold the results.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        sequence: ImageSequence,
        files: TrackFiles | None = None,
        *,
        run: TrackRun | None = None,
        overwrite: bool = False,
        store: Path | None = None,
        resume: bool = True,
    ) -> None:
        self.name, self.sequence, self.files = name, sequence, files or TrackFiles()
        self.files.check(sequence.geometry)
        for kind in self.files.also:
            if kind in TRACK_CHECKS:
                TRACK_CHECKS[kind]()
        self._run, self._place = run or TrackRun(), OutputFolder(folder, name, overwrite=overwrite)
        with ExitStack() as stack:
            self._set = stack.enter_context(
                self._place.stage(self.files.paths(folder, name), self._run.inputs)
            )
            self._own_store = store is not None
            self._store = FrameStore(
                self._set.staging.parent / "frames" if store is None else store, resume
            )
            self._stack = stack.pop_all()

    def __enter__(self) -> TrackOutputs:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.abort(error)

    def frames(self) -> list[int]:
        """The numbers of the frames that are there, rising: of a resumed run also the earlier one's."""
        return self._store.numbers()

    def add(self, result: FrameResult) -> None:
        """Take a frame; one of the same number is replaced.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        with naming_final(self._set):
            self._write_meshes(result)
            self._store.put(result)  # last: a frame that is there has its meshes

    def finish(
        self,
        lineage: Lineage,
        *,
        status: track_document.Status = "ok",
        exit_code: int = 0,
        warnings: Sequence[str] = (),
    ) -> list[dict[str, str]]:
        """Write all files and put them in place, the report last.

        Parameters
        ----------
        lineage : Lineage
        status : {"ok", "interrupted"}
            "interrupted" where frames lack because the user has ended the run.
        exit_code : int
            Exit code of the command.
        warnings : sequence of str

        Returns
        -------
        list of dict
            ``path``, ``kind`` and ``sha256`` of each file, without the report.

        Raises
        ------
        OutputError
            When a file cannot be written; then all are as they were.
        """
        with naming_final(self._set):
            rows = tuple(self._store.frame_row(number) for number in self.frames())
            tracks = TrackSet(self.name, self.sequence, rows, lineage, self._store)
            kinds = self._write_all(tracks)
            entries = describe_staged(self._set, kinds)
            document = track_document.build(
                tracks,
                status=status,
                exit_code=exit_code,
                run=self._run,
                warnings=warnings,
                outputs=entries,
            )
            report = self._set.staging / self._place.report.name
            write_bytes(report, track_document.report_json(document).encode())
            self._place.commit(self._set)
        if self._own_store and status == "ok":
            with suppress(OutputError):  # somebody has put a file there
                remove_store(self._store.folder)
        self._stack.close()
        return entries

    def abort(self, error: BaseException | None = None) -> None:
        """Leave the files as they were; after `finish` it does nothing.

        Frames in a ``store`` of their own stay for a run that resumes.

        Parameters
        ----------
        error : BaseException, optional
            Why the run failed. An `AccelsurfError` gets a report, beside a result that stands there.
        """
        try:
            if not self._set.committed:
                self._set.discard()
                if isinstance(error, AccelsurfError):
                    with suppress(AccelsurfError, OSError):  # the first error matters more
                        _write_failure(
                            self._set, self.name, self.files, error, self.sequence, self._run
                        )
        finally:
            self._stack.close()

    # ----------------------------------------------------------------------------------------------------- frames

    def _write_meshes(self, result: FrameResult) -> None:
        """Write the meshes of a frame to the frames' folder; objects that it does not show have none."""
        folder, number = self._mesh_folder, f"{result.frame:0{self._digits}d}"
        for old in folder.glob(f"*_t{number}.*"):
            if is_of_frame(old.name, self.name):
                old.unlink()
        for kind in self.files.mesh:
            for tracked in result.objects:
                if tracked.seen and tracked.surface.has_inside:
                    shape = "surface" if self.sequence.geometry.slice_axis is None else "contour"
                    path = folder / mesh_name(self.name, shape, tracked.id, number, kind)
                    self._mesh_of(tracked).write(path, self.files.mesh_space)

    def _mesh_of(self, tracked: TrackedObject) -> Surface | Contours:
        """The mesh that moves with the momentum, else that of the surface."""
        geometry = cropped(self.sequence.geometry, tracked.surface.box)
        if geometry.slice_axis is not None:
            return extract_contours(tracked.surface.psi, geometry)
        if tracked.mesh is not None:
            return Surface(tracked.mesh.vertices, tracked.mesh.faces.astype("int32"))
        return extract_surface(tracked.surface.psi, geometry)

    @property
    def _mesh_folder(self) -> Path:
        folder = self._store.folder / "meshes"
        refuse_links(folder, "remove the link, or choose another folder with -o")
        folder.mkdir(exist_ok=True)
        return folder

    @property
    def _digits(self) -> int:
        return frame_digits(len(self.sequence))

    # -------------------------------------------------------------------------------------------------------- end

    def _write_all(self, tracks: TrackSet) -> dict[str, str]:
        """Write the staging files of all outputs but the report; kind by name."""
        names, kinds = self.files.names(self.name), {}
        for path in sorted(self._mesh_folder.iterdir()):
            if not is_of_frame(path.name, self.name) or path.is_symlink() or not path.is_file():
                continue  # somebody has put it there
            shutil.copyfile(path, self._set.staging / path.name)
            kinds[path.name] = "surface" if self.sequence.geometry.slice_axis is None else "contour"
        if self.files.per_frame:
            kinds |= dict.fromkeys(self._write_frames(tracks), "labels")
        else:
            self._write_sequence(tracks, self._set.staging / names["labels"])
            kinds[names["labels"]] = "labels"
        texts = {
            "tracks": track_document.tracks_csv(tracks),
            "curves": track_document.curves_csv(tracks),
        }
        for kind, text in (texts | ({"config": self._run.toml} if self._run.toml else {})).items():
            write_bytes(self._set.staging / names[kind], text.encode())
            kinds[names[kind]] = kind
        pictures = {
            "preview": slices.film_strip_png(tracks),
            "curves-picture": slices.curves_png(tracks),
        }
        for kind, picture in pictures.items():
            write_bytes(self._set.staging / names[kind], picture)
            kinds[names[kind]] = kind
        for kind in self.files.also:
            TRACK_WRITERS[kind](tracks, self._set.staging / names[kind])
            kinds[names[kind]] = kind
        return kinds

    def _write_frames(self, tracks: TrackSet) -> list[str]:
        """Write a label map for each frame that was reached, all of one type, with the ids as they are; their names."""
        names = []
        for row in tracks.rows:
            volume = Volume(tracks.labels(row.frame), tracks.geometry)
            names.append(labels_name(self.name, f"{row.frame:0{self._digits}d}", self.files.labels))
            io.write(volume, self._set.staging / names[-1])
        return names

    def _write_sequence(self, tracks: TrackSet, path: Path) -> None:
        """Write the label maps of all frames as one file with time."""
        sequence, kind = self.sequence, tracks.label_type
        with io.SequenceWriter(
            path, sequence.geometry, sequence.times, sequence.time_unit, kind
        ) as writer:
            for number in range(len(sequence)):
                writer.write(number, tracks.labels(number))


def write_failure(
    folder: Path,
    name: str,
    files: TrackFiles,
    error: BaseException,
    source: Path,
    run: TrackRun,
) -> None:
    """Write the report of a tracking that could not begin, beside a result that stands there.

    Parameters
    ----------
    folder : Path
    name : str
        First part of the names of the files.
    files : TrackFiles
        Which ones a result would have had.
    error : BaseException
        Why there is none.
    source : Path
        The sequence that was to be tracked.
    run : TrackRun

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    with (
        OutputFolder(folder, name, overwrite=True).stage(inputs=run.inputs) as staged,
        naming_final(staged),
    ):
        _write_failure(staged, name, files, error, source, run)


def _write_failure(
    staged: FileSet,
    name: str,
    files: TrackFiles,
    error: BaseException,
    images: ImageSequence | Path,
    run: TrackRun,
) -> None:
    """Write a report without a result, under another name where a result stands."""
    place = OutputFolder(staged.folder, name)
    target = place.beside_result(files.paths(staged.folder, name).values())
    if target is not place and target.holds_result():
        return  # the result of a sequence that has this name
    document = track_document.build(
        None, images=images, status="failed", exit_code=exit_code_of(error), run=run, error=error
    )
    write_bytes(staged.staging / target.report.name, track_document.report_json(document).encode())
    target.commit(staged, failed=True)


def write_challenge(tracks: TrackSet, folder: Path) -> None:
    """Write the folder of the Cell Tracking Challenge: ``res_track.txt`` and ``maskTTT.tif``.

    Raises
    ------
    OutputError
        When a file cannot be written, or labels do not fit.
    """
    lineage = tracks.lineage
    found = stretches(
        tracks.frames_shown(), {track.id: lineage.parents(track.id) for track in lineage.tracks}
    )
    largest = max((stretch.label for stretch in found), default=0)
    if largest > MAX_LABEL:
        raise OutputError(
            f"{folder.name}: a track has the label {largest}, the Cell Tracking Challenge has 1 to {MAX_LABEL}",
            "leave --also ctc out",
        )
    folder.mkdir()
    digits = frame_digits(len(tracks.sequence))
    for number in range(len(tracks.sequence)):
        label_of = np.zeros(max((stretch.id for stretch in found), default=0) + 1, np.uint16)
        for stretch in found:
            if stretch.first <= number <= stretch.last:
                label_of[stretch.id] = stretch.label
        io.write(
            Volume(label_of[tracks.labels(number)], tracks.geometry),
            folder / f"mask{number:0{digits}d}.tif",
        )
    write_bytes(folder / "res_track.txt", track_lines(found).encode())


def track_lines(found: Iterable[Stretch]) -> str:
    """The text of ``res_track.txt``.

    Examples
    --------
    >>> track_lines([Stretch(1, 1, 0, 4), Stretch(2, 2, 5, 9, (1, 7))]).splitlines()
    ['1 0 4 0', '2 5 9 1']
    """
    return "".join(
        f"{track.label} {track.first} {track.last} {(*track.parents, 0)[0]}\n" for track in found
    )


#: The writers by the names of `accelsurf.settings.track_fields.TRACK_FORMATS`: of the tracks and a path.
TRACK_WRITERS: dict[str, Callable[[TrackSet, Path], None]] = {
    "ctc": write_challenge,
    "geff": geff_file.write_geff,
    "surfaces": surfaces.write_surfaces,
    "mp4": slices.write_track_movie,
    "gif": slices.write_track_movie,
    "webp": slices.write_track_movie,
}
#: Checks before anything is computed of those that need a further library.
TRACK_CHECKS: dict[str, Callable[[], None]] = {
    "geff": geff_file.check_geff,
    "mp4": partial(slices.check_movie, ".mp4"),
    "webp": partial(slices.check_movie, ".webp"),
}
