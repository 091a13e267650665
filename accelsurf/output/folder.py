"""The folder of a run's files: is it writable, what may be replaced in it, and which files are inputs of the run.

Inputs are never replaced. Errors name the files as they will be called.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from accelsurf.errors import AccelsurfError, OutputError
from accelsurf.io import headers, is_stored
from accelsurf.io.file_set import FileSet, InputFiles, open_set, refuse_links
from accelsurf.output.result_sets import (
    has_guests,
    is_failure_report,
    is_output,
    outdated,
    outdated_inputs,
    report_name,
)
from accelsurf.settings.coordinates import is_point_file
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

#: Of a file's name, on the usual file systems.
MAX_NAME_BYTES = 255
#: Settings that are places, and kinds of places that name a file: ``label:FILE``.
PLACES, FILE_KINDS = (
    ("start", "foreground", "background", "inside", "outside"),
    ("label", "mesh", "stroke"),
)
#: Settings that name a file.
_FILES = ("mask", "objects", "labels", "label_table")
#: Endings of headers whose voxels may lie in another file.
_DETACHED = (".mhd", ".mha", ".nhdr", ".hdr", ".img", ".hdr.gz", ".img.gz")


def refuse_existing(paths: dict[str, Path], overwrite: bool, inputs: Sequence[Path] = ()) -> None:
    """Refuse to start when an output exists already, or the folder cannot take one; make the folder.

    The report of a failed run does not count as existing: it has no result.

    Parameters
    ----------
    paths : dict of str to Path
        All that may be written, by kind; what a standing ``report`` lists may be removed.
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
    if (report := paths.get("report")) is not None:
        read.refuse(outdated_inputs(report, read))
    results = [
        path for path in existing if not (path == paths.get("report") and is_failure_report(path))
    ]
    if results and not overwrite:
        more = f" and {len(results) - 1} more" if len(results) > 1 else ""
        raise OutputError(
            f"{results[0]}{more}: exists already",
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


def commit(
    files: FileSet, report: str, failed: bool, overwrite: bool, gone: Sequence[str] = ()
) -> None:
    """Put the staged files of a run in place, the report last; outdated files of an earlier run are removed.

    Parameters
    ----------
    files : FileSet
    report : str
        Name of the report.
    failed : bool
        Whether the run failed.
    overwrite : bool
        Whether an earlier result may be replaced.
    gone : sequence of str, optional
        Further files that are removed.

    Raises
    ------
    OutputError
        When a file exists that may not be replaced: another program may have put it there while the run went on.
    """
    written = [path.name for path in files.staging.iterdir()]
    if not (failed or overwrite):
        refuse_existing(
            {"report" if name == report else name: files.folder / name for name in written}, False
        )
    name = report.removesuffix(report_name(""))
    files.commit(
        last=report,
        remove=[*outdated(files.folder, name, written, failed, overwrite), *gone],
        mends=not failed,
    )


@contextmanager
def opened_set(
    folder: Path, name: str, inputs: Sequence[Path] = (), mend: bool = False
) -> Iterator[FileSet]:
    """Make a folder, and prepare the files of a run in it; see `accelsurf.io.file_set.open_set`.

    Raises
    ------
    OutputError
        When nothing can be written there, another run is writing files of this name, or the set is unfinished.
    """
    make_writable(folder)
    with ExitStack() as stack:
        try:
            files = stack.enter_context(open_set(folder, name, inputs=inputs, mend=mend))
        except OSError as error:
            reason = error.strerror or str(error)
            raise OutputError(
                f"{folder}: cannot be written to ({reason})", "choose another folder with -o"
            ) from None
        yield files


@contextmanager
def naming_final(files: FileSet) -> Iterator[None]:
    """Name in errors the files as they would be called, not their staging files.

    Raises
    ------
    OutputError
        Instead of one that names a staging file, and of what a full disk makes Python raise.
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
    for correction in (*config.edit, *config.refine, *corrections):
        wheres += [*(ball for _, ball in correction.balls), *correction.inside, *correction.outside]
    texts += [text.partition(":")[2] for text in wheres if text.partition(":")[0] in FILE_KINDS]
    texts += [text for text in wheres if is_point_file(text)]
    found = {}
    for text in texts:
        for name in (text, text.rpartition("@")[0]):  # FILE@IDS; a name may have an @ itself
            if name and is_stored(Path(name)):
                found[name] = Path(name)
                break
    return list(found.values())


def inputs_of(
    image: Path, config: RunConfig | TrackConfig | None, *further: Path | None
) -> list[Path]:
    """Return all files that a run reads: image, what its settings name, ``further`` files, and data files of headers.

    Parameters
    ----------
    image : Path
    config : RunConfig or TrackConfig, optional
    *further : Path or None
        Files that the command reads beside: a reference, a configuration.
    """
    named = [
        image,
        *(() if config is None else named_files(config)),
        *(path for path in further if path is not None),
    ]
    return [*named, *(data for path in named for data in _data_of(path))]


def _data_of(path: Path) -> Iterator[Path]:
    """Files with the voxels of an image, where they are others than its own; of a folder or a pattern its files."""
    if headers.is_pattern(path):
        yield from path.parent.glob(path.name)
    elif os.path.isdir(path):
        yield from path.iterdir()
    elif path.name.lower().endswith(_DETACHED):
        try:
            _, header = headers.parse(path)
        except AccelsurfError:  # it is refused when it is read
            return
        yield header.data
        yield from getattr(header, "parts", ())  # of an image in several files
