"""The folder of a run's files: their names, rules of replacement, and the commit of all at once.

`OutputFolder.plan` names the files, `OutputFolder.stage` refuses files that may not be replaced and gives a hidden
folder to write in, `OutputFolder.commit` puts all in place, the report last. Only files of these names are replaced,
and of the others only those are removed that a report lists with the user's own seal. Inputs are never replaced.
Nothing of a run is loaded here: a command knows its files, and can refuse, before anything is computed.
"""

from __future__ import annotations

import os
import re
import tempfile
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from accelsurf.errors import AccelsurfError, AccelsurfWarning, InputError, OutputError, UsageError
from accelsurf.io import (
    FileSet,
    InputFiles,
    image_name,
    is_pattern,
    is_stored,
    is_unfinished,
    open_set,
    parse_header,
    refuse_links,
    split_name,
)
from accelsurf.output import layouts
from accelsurf.output.reports import FAILED, Report, has_guests, is_output, report_name
from accelsurf.settings.file_formats import DEFAULT_IMAGE_FORMAT, IMAGE_FORMATS, image_format
from accelsurf.settings.mesh_formats import Shape, automatic_mesh_formats, ending_of, mesh_formats
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.text.coordinates import file_in

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry

#: Of a file's name, on the usual file systems.
MAX_NAME_BYTES = 255
#: Settings that are places.
PLACES = ("start", "foreground", "background", "inside", "outside")
#: Settings that name a file.
_FILES = ("mask", "objects", "labels", "label_table")
#: Endings of headers whose voxels may lie in another file.
_DETACHED = (".mhd", ".mha", ".nhdr", ".hdr", ".img", ".hdr.gz", ".img.gz")
#: Kinds of outputs of which each object has its own.
EACH = ("surface", "contour")


@dataclass(frozen=True)
class OutputFolder:
    """Folder and names of the files of a run.

    Attributes
    ----------
    path : Path
        The folder.
    name : str
        First part of every file's name.
    source : Path or None
        The image; its ending is that of the label map.
    overwrite : bool
        True if existing outputs may be replaced, and an unfinished set be made anew.
    resume : bool
        True if the run goes on from the checkpoint of an earlier one.
    has_checkpoint : bool
        True if it may have one: a correction has none.
    further : tuple of Path or None
        Files that the command reads beside the image and the files that its settings name.
    """

    path: Path
    name: str
    source: Path | None = None
    overwrite: bool = False
    resume: bool = False
    has_checkpoint: bool = True
    further: tuple[Path | None, ...] = ()

    @classmethod
    def for_image(
        cls, source: Path, path: Path, overwrite: bool = False, *further: Path | None
    ) -> Self:
        """Return the folder of outputs that have the name of an image; ``further`` files are read, too."""
        return cls(path, image_name(source), source, overwrite, further=further)

    # ------------------------------------------------------------------------------------------------------ names

    @property
    def image(self) -> Path:
        """The image, of a run that has one."""
        assert self.source is not None
        return self.source

    @property
    def report(self) -> Path:
        """Path of the report."""
        return self.path / report_name(self.name)

    @property
    def checkpoint(self) -> Path:
        """Path of the state of the run while it goes on."""
        return self.path / f"{self.name}_checkpoint.npz"

    def label_format(self, config: RunConfig) -> str:
        """Return the format of the label map: the one of the settings, else the input's, else nii.gz.

        Examples
        --------
        >>> OutputFolder(Path("out"), "a", Path("a.tiff")).label_format(RunConfig())
        'tif'
        """
        followed = image_format("" if self.source is None else split_name(self.source)[1])
        if config.layout == "bids" and (followed is None or not followed.name.startswith("nii")):
            followed = None  # BIDS has label maps in NIfTI
        if followed is None or not followed.is_written:
            return config.format or DEFAULT_IMAGE_FORMAT
        return config.format or followed.name

    def names(self, config: RunConfig, is_2d: bool | None = None) -> dict[str, str]:
        """Return the name of every output by its kind, without the report; of all objects that of a single one.

        Parameters
        ----------
        config : RunConfig
        is_2d : bool or None
            True if the image has one slice; None as long as that is not known: then all possible files.

        Examples
        --------
        >>> found = OutputFolder(Path("out"), "a", Path("a.png")).names(RunConfig(), True)
        >>> [name for kind, name in found.items() if kind.startswith("contour")]
        ['a_contour.vtp', 'a_contour.csv']
        """
        labels = self.label_format(config)
        files = {"labels": f"seg.{labels}"}
        if is_2d is not True:
            files |= _mesh_names(config, "surface")
        if is_2d is not False:
            files |= _mesh_names(config, "contour")
        if config.save_sdf:
            files["sdf"] = f"sdf.{IMAGE_FORMATS[labels].distances or labels}"
        if config.has_ids:
            files["objects"] = "objects.csv"
        if keeps_state(config):
            files |= {"state": "state.npz", "config": "run.toml"}
        files |= {f"also-{name}": ending_of(name) for name in config.also if name != labels}
        if labels in ("nii", "nii.gz") and (config.name or config.color or config.label_table):
            files["also-itk-snap"] = ending_of("itk-snap")  # which ITK-SNAP reads beside a NIfTI
        files |= {"trace": "trace.csv", "preview": "preview.png"}
        files |= {"statistics": "statistics.csv", "statistics-json": "statistics.json"}
        names = {kind: f"{self.name}_{last}" for kind, last in files.items()}
        if config.layout == "plain":
            return names
        return layouts.renamed(config, self.image, self.name, names)

    def plan(self, config: RunConfig, is_2d: bool | None = None) -> dict[str, Path]:
        """Return every output by kind, the report last; of several objects the meshes that exist already.

        Parameters as of `names`.
        """
        names = self.names(config, is_2d)
        planned = {
            kind: self.path / name
            for kind, name in names.items()
            if not (config.has_ids and kind.startswith(EACH))
        }
        if config.has_ids:
            planned |= {path.name: path for path in self._meshes_there(names)}
        return planned | {"report": self.report}

    def _meshes_there(self, names: Mapping[str, str]) -> list[Path]:
        """Files in the folder that are named as the surface or contour of an object, of any id."""
        parts = [names[kind].rpartition(".") for kind in names if kind.startswith(EACH)]
        known = re.compile(
            "|".join(rf"{re.escape(stem)}_[1-9][0-9]*\.{suffix}" for stem, _, suffix in parts)
        )
        files = self.path.iterdir() if self.path.is_dir() else ()
        return sorted(path for path in files if known.fullmatch(path.name))

    def laid_out(self, config: RunConfig) -> Self:
        """Return the folder in the layout of the settings.

        Raises
        ------
        UsageError
            When the image cannot be in that layout.
        """
        layouts.check_layout(config, self.image, self.path, self.name)
        return replace(self, path=layouts.layout_folder(config, self.image, self.path))

    def inputs(self, config: RunConfig | TrackConfig | None) -> list[Path]:
        """Return all files that the command reads: none of them may be replaced."""
        return inputs_of(self.source, config, *self.further)

    # ----------------------------------------------------------------------------------------------- existing files

    def refuse_left(self, *states: Path) -> None:
        """Refuse to lose the state of a run that was stopped, in one of ``states``.

        Raises
        ------
        OutputError
            When one of them is there, and the run neither goes on from it nor replaces it.
        """
        left = next((path for path in states if path.exists()), None)
        if left is not None and not (self.resume or self.overwrite):
            raise OutputError(
                f"{left}: is the state of a run that was stopped",
                "add --resume to go on from it, or --overwrite to begin anew",
            )

    def resumed(self, planned: Iterable[Path]) -> Self:
        """Return the folder to go on in: ``planned`` files of a run that was killed or failed may be replaced."""
        report, known = Report(self.report), set[str]()
        if report.document is not None and report.document["status"] != "ok":
            known = {self.report.name, *report.own()}
        is_free = is_unfinished(self.path, self.name) or all(
            path.name in known for path in planned if os.path.lexists(path)
        )
        return replace(self, resume=True, overwrite=self.overwrite or is_free)

    def holds_result(self, planned: Iterable[Path] = ()) -> bool:
        """Test if the folder has files that a failed run must not replace: any but files of an earlier failure.

        Parameters
        ----------
        planned : iterable of Path, optional
            Files that may be written beside the report.
        """
        report = Report(self.report)
        replaced = {self.report.name, *report.own()} if report.is_failure else set()
        there = [path for path in {*planned, self.report} if os.path.lexists(path)]
        return any(path.name not in replaced for path in there)

    def beside_result(self, planned: Iterable[Path]) -> Self:
        """Return the place of a failed run's files: this one, or where a result stands, beside it under other names."""
        return replace(self, name=self.name + FAILED) if self.holds_result(planned) else self

    # -------------------------------------------------------------------------------------------------- writing

    @contextmanager
    def stage(
        self,
        planned: Mapping[str, Path] | None = None,
        inputs: Sequence[Path] = (),
    ) -> Iterator[FileSet]:
        """Make the folder, and give a hidden one to write in; see `accelsurf.io.file_set.open_set`.

        Parameters
        ----------
        planned : mapping of str to Path, optional
            All that may be written, by kind, as of `refuse_existing`.
        inputs : sequence of Path, optional
            Files that are read: none of them is replaced or removed.

        Raises
        ------
        OutputError
            When an output exists and may not be replaced, nothing can be written there, another run is writing files of
            this name, or they are unfinished and may not be replaced.
        """
        make_writable(self.path)
        with ExitStack() as stack:
            try:
                files = stack.enter_context(
                    open_set(self.path, self.name, inputs=inputs, mend=self.overwrite)
                )
            except OSError as error:
                reason = error.strerror or str(error)
                raise OutputError(
                    f"{self.path}: cannot be written to ({reason})", "choose another folder with -o"
                ) from None
            if planned is not None:
                refuse_existing(planned, self.overwrite, inputs)
            yield files

    def commit(self, files: FileSet, failed: bool = False, gone: Sequence[str] = ()) -> None:
        """Put staged files in place, the report last; outdated files of an earlier run are removed.

        Parameters
        ----------
        files : FileSet
        failed : bool
            True if the run failed.
        gone : sequence of str, optional
            Further files that are removed.

        Raises
        ------
        OutputError
            When a file exists that may not be replaced: another program may have put it there while the run went on.
        """
        written = [path.name for path in files.staging.iterdir()]
        if not (failed or self.overwrite):
            refuse_existing(
                {
                    "report" if name == self.report.name else name: self.path / name
                    for name in written
                },
                False,
            )
        last = self.report.name if self.report.name in written else None
        earlier = [Report(folder / self.report.name, self.path) for folder in files.earlier]
        outdated = self.outdated(written, failed, earlier)
        files.commit(last, [*outdated, *gone], mends=not failed)

    def outdated(
        self, written: Collection[str], failed: bool, earlier: Iterable[Report] = ()
    ) -> list[str]:
        """Return the names of the files that go when a new run's files come; a warning names those that stay.

        These are the files of the report there, and of the ``earlier`` ones that a killed run has left; of a run that
        did not fail also the files of a failed one before it. Without ``overwrite`` only reports go, and files that are
        named as of a failed run.
        """
        failures = self.path / report_name(self.name + FAILED)
        reports = [Report(self.report), *earlier]
        if not failed and (beside := Report(failures)).is_failure:
            reports.append(beside)
        gone, stays = [], []
        for report in reports:
            if report.document is not None:
                files = report.unchanged(written)
                gone += [*(file.name for file in files if file.is_own), report.path.name]
                stays += [file.name for file in files if not file.is_own]
        if not self.overwrite:
            begins = f"{self.name.removesuffix(FAILED)}{FAILED}_", self.report.name
            gone, stays = (
                [name for name in names if name.startswith(begins)] for names in (gone, stays)
            )
        if stays := [name for name in stays if name not in gone]:
            named = ", ".join(str(self.path / name) for name in stays[:3])
            warnings.warn(
                f"{named}{' and more' if len(stays) > 3 else ''}: the earlier report lists it, but no run of yours on "
                "this machine wrote it, so it stays; remove it if it is not needed",
                AccelsurfWarning,
                stacklevel=2,
            )
        return [name for name in gone if name not in written]


def _mesh_names(config: RunConfig, shape: Shape) -> dict[str, str]:
    """Last parts of the names of surfaces or contours, by kind."""
    wanted = automatic_mesh_formats(shape) if config.mesh == "auto" else config.mesh
    return {f"{shape}-{kind}": f"{shape}.{kind}" for kind in wanted if kind in mesh_formats(shape)}


def keeps_state(config: RunConfig) -> bool:
    """Test if the state of a run is written, from which it can be corrected, and the settings that repeat it.

    Examples
    --------
    >>> keeps_state(RunConfig()), keeps_state(RunConfig(inside="point:1,2,3")), keeps_state(RunConfig(keep_state="yes"))
    (False, True, True)
    """
    if config.keep_state != "auto":
        return config.keep_state == "yes"
    given = config.inside or config.outside or config.refine or config.labels
    return bool(given) or _is_table_of_clicks(config.objects)


def _is_table_of_clicks(objects: str | None) -> bool:
    """Test if the objects begin as clicks; if a table cannot be read, the run reports the error."""
    if objects is None or not objects.lower().endswith(".csv"):
        return False
    from accelsurf.text.object_clicks import has_sides

    try:
        return has_sides(objects)
    except InputError:
        return False


def check_outputs(config: RunConfig, labels: str, geometry: Geometry) -> None:
    """Refuse formats that cannot hold the results on this grid.

    Raises
    ------
    UsageError
        With those that can.
    """
    is_2d = geometry.slice_axis is not None
    shape: Shape = "contour" if is_2d else "surface"
    possible = mesh_formats(shape)
    image = (
        "an image of one slice, whose contours are written"
        if is_2d
        else "a volume, whose surface is written"
    )
    for kind in () if config.mesh == "auto" else config.mesh:
        if kind not in possible:
            raise UsageError(
                f"mesh: {kind} was given for {image}, expected {', '.join(possible)}",
                f"--mesh auto is {','.join(automatic_mesh_formats(shape))} for {'one slice' if is_2d else 'a volume'}",
            )
    for key in ("mesh_smooth", "mesh_faces", "mesh_error"):
        if is_2d and getattr(config, key):
            raise UsageError(
                f"{key}: it was given for {image}", "leave it out: contours are written as they are"
            )
    if IMAGE_FORMATS[labels].only_2d and geometry.shape[0] > 1:
        raise UsageError(
            f"format: {labels} was given for {geometry.shape[0]} slices along z, expected one",
            "use --format tif for a stack, or a volume format",
        )


def name_of(name: str, object_id: int) -> str:
    """Return the name of a file for the object ``object_id``.

    Examples
    --------
    >>> name_of("scan_surface.ply", 7)
    'scan_surface_7.ply'
    """
    stem, _, suffix = name.rpartition(".")
    return f"{stem}_{object_id}.{suffix}"


def refuse_existing(
    paths: Mapping[str, Path], overwrite: bool, inputs: Sequence[Path] = ()
) -> None:
    """Refuse to start when an output exists already, or the folder cannot take one; make the folder.

    The report of a failed run does not count as existing: it has no result.

    Parameters
    ----------
    paths : mapping of str to Path
        All files that may be written, by kind; files that a standing ``report`` lists may be removed.
    overwrite : bool
    inputs : sequence of Path, optional
        Files that are read: none of them is replaced or removed.

    Raises
    ------
    OutputError
        When an output exists and may not be replaced, or is an input; or nothing can be written there.
    """
    longest = max(
        (path.name for path in paths.values()), key=lambda name: len(os.fsencode(name)), default=""
    )
    if len(os.fsencode(longest)) > MAX_NAME_BYTES:
        raise OutputError(
            f"{longest}: the name of an output would have {len(os.fsencode(longest))} bytes, at most {MAX_NAME_BYTES} "
            "expected",
            "rename the image, or link to it by a shorter name",
        )
    existing = [path for path in paths.values() if os.path.lexists(path)]
    read = InputFiles(inputs)
    read.refuse(existing)
    report = paths.get("report")
    if report is not None:
        read.refuse(outdated_inputs(report, read))
    results = [path for path in existing if not (path == report and Report(path).is_failure)]
    if results and not overwrite:
        more = f" and {len(results) - 1} more" if len(results) > 1 else ""
        is_alone = report is not None and not report.exists()
        why = ", without a report: a run may have been killed before it was complete"
        raise OutputError(
            f"{results[0]}{more}: exists already{why if is_alone else ''}",
            "choose another folder with -o, or add --overwrite",
        )
    for path in existing:
        if not is_output(path):
            refuse_folder(path)
        if has_guests(path):
            raise OutputError(
                f"{path}: label maps were added to it, which would go with it",
                "choose another folder with -o, or copy its folder labels elsewhere",
            )
    for folder in {path.parent for path in paths.values()}:
        make_writable(folder)


def outdated_inputs(report: Path, inputs: InputFiles) -> list[Path]:
    """Return the inputs among the files that go with an earlier result; only their checksums are computed."""
    found = Report(report)
    others = {file.name for file in found.listed if inputs.at(report.parent / file.name) is None}
    if others == {file.name for file in found.listed}:
        return []
    return [report.parent / name for name in found.own(others)]


def refuse_folder(path: Path) -> None:
    """Refuse a folder in the place of a file.

    Raises
    ------
    OutputError
        With it.
    """
    if path.is_dir():
        raise OutputError(
            f"{path}: is a folder, a file is to be written there", "choose another folder with -o"
        )


def make_writable(folder: Path) -> None:
    """Make a folder, and check that a file can be written there.

    Raises
    ------
    OutputError
        When it cannot, or the folder is a link.
    """
    try:
        os.fspath(folder).encode()
    except UnicodeEncodeError:
        message = f"{folder}: the name of the folder is not valid UTF-8"
        raise OutputError(message, "choose another folder with -o, or rename this one") from None
    refuse_links(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = (
            "it is a file" if isinstance(error, FileExistsError) else error.strerror or str(error)
        )
        raise OutputError(
            f"{folder}: cannot be written to ({reason})", "choose another folder with -o"
        ) from None


@contextmanager
def naming_final(files: FileSet) -> Iterator[None]:
    """Name in errors the files as they would be called, not their staging files.

    Raises
    ------
    OutputError
        Instead of one that names a staging file, and of Python's error for a full disk.
    """
    try:
        yield
    except OutputError as error:
        message, hint = (
            text.replace(str(files.staging), str(files.folder))
            for text in (error.message, error.hint)
        )
        raise OutputError(message, hint) from error
    except OSError as error:
        name = Path(error.filename).name if isinstance(error.filename, str) else ""
        raise OutputError(
            f"{files.folder / name}: cannot be written ({error.strerror or error})",
            f"may {files.folder} be written to, is there space on the disk, is a file of it open in another program?",
        ) from error


def named_files(given: RunConfig | TrackConfig) -> list[Path]:
    """Return the files, beside the image, that the settings of a run or a tracking name and that are there."""
    config, corrections = (
        (given.run, given.correct) if isinstance(given, TrackConfig) else (given, ())
    )
    texts = [text for text in (*(getattr(config, key) for key in _FILES), *config.channel) if text]
    wheres = [text for key in PLACES for text in getattr(config, key)]
    for correction in (*config.refine, *corrections):
        wheres += [*correction.inside, *correction.outside]
    texts += [file_in(text) for text in wheres if file_in(text)]
    found = {}
    for text in texts:
        for name in (text, text.rpartition("@")[0]):  # FILE@IDS; a name may have an @ itself
            if name and is_stored(Path(name)):
                found[name] = Path(name)
                break
    return list(found.values())


def inputs_of(
    image: Path | None, config: RunConfig | TrackConfig | None, *further: Path | None
) -> list[Path]:
    """Return all files that a run reads: image, files of its settings, ``further`` files, and data files of headers.

    Parameters
    ----------
    image : Path, optional
    config : RunConfig or TrackConfig, optional
    *further : Path or None
        Files that the command reads beside: a reference, a configuration.
    """
    given = () if config is None else named_files(config)
    named = [path for path in (image, *given, *further) if path is not None]
    return [*named, *(data for path in named for data in _data_of(path))]


def _data_of(path: Path) -> Iterator[Path]:
    """Files with the voxels of an image, where they are others than its own; of a folder or a pattern its files."""
    if is_pattern(path):
        yield from path.parent.glob(path.name)
    elif os.path.isdir(path):
        yield from path.iterdir()
    elif path.name.lower().endswith(_DETACHED):
        try:
            _, header = parse_header(path)
        except AccelsurfError:  # it is refused when it is read
            return
        yield header.data
        yield from getattr(header, "parts", ())  # of an image in several files
