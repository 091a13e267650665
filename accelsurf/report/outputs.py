"""The files of a run: which there are, by the kind of image it gets (a volume a mesh, an image of one slice contours),
and how they are written, each whole or not at all.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from accelsurf.errors import OutputError, UsageError
from accelsurf.io.files import write_bytes
from accelsurf.io.headers import is_anatomical
from accelsurf.report import document, preview
from accelsurf.settings.run_config import LabelFormat, RunConfig

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry
    from accelsurf.segmentation.api import Result
    from accelsurf.segmentation.several import ObjectsResult

CONTOUR_FORMATS = ("vtp", "csv")
SURFACE_FORMATS = ("ply", "stl", "obj", "vtp")


def label_format(config: RunConfig, source_suffix: str) -> str:
    """Return the format of the label map: as told, else the input's, else nii.gz.

    Parameters
    ----------
    config : RunConfig
    source_suffix : str
        Of the input, as ".nii"; may be empty.

    Examples
    --------
    >>> label_format(RunConfig(), ".tiff"), label_format(RunConfig(format="png"), ".nii")
    ('tif', 'png')
    """
    follow = source_suffix.removeprefix(".").replace("tiff", "tif")
    return config.format or (follow if follow in get_args(LabelFormat) else "nii.gz")


def names(config: RunConfig, labels: str, is_2d: bool | None) -> dict[str, str]:
    """Return the last part of every output's name by its kind, but for the report.

    Parameters
    ----------
    config : RunConfig
    labels : str
        From `label_format`.
    is_2d : bool or None
        Whether the image has one slice; None when that is not known yet: then all that there may be.

    Examples
    --------
    >>> [name for kind, name in names(RunConfig(), "png", True).items() if kind.startswith("contour")]
    ['contour.vtp', 'contour.csv']
    """
    resolved_settings = {"labels": f"seg.{labels}"}
    if is_2d is not True:
        kinds = ["ply"] if config.mesh == "auto" else [kind for kind in config.mesh if kind in SURFACE_FORMATS]
        resolved_settings |= {f"surface-{kind}": f"surface.{kind}" for kind in kinds}
    if is_2d is not False:
        wanted = CONTOUR_FORMATS if config.mesh == "auto" else config.mesh
        resolved_settings |= {f"contour-{kind}": f"contour.{kind}" for kind in CONTOUR_FORMATS if kind in wanted}
    if config.save_sdf:
        resolved_settings["sdf"] = f"sdf.{'tif' if labels == 'png' else labels}"  # a PNG holds no distances
    return resolved_settings | {"trace": "trace.csv", "preview": "preview.png"}


def check(config: RunConfig, labels: str, geometry: Geometry) -> None:
    """Refuse formats that cannot hold what comes of an image on this grid.

    Raises
    ------
    UsageError
        With those that can.
    """
    flat = geometry.slice_axis is not None
    possible = CONTOUR_FORMATS if flat else SURFACE_FORMATS
    sort = "an image of one slice, whose contours are written" if flat else "a volume, whose surface is written"
    for kind in () if config.mesh == "auto" else config.mesh:
        if kind not in possible:
            raise UsageError(
                f"mesh: {kind} was given for {sort}, expected {', '.join(possible)}",
                f"--mesh auto is {'vtp,csv for one slice' if flat else 'ply for a volume'}",
            )
    if labels == "png" and geometry.shape[0] > 1:
        raise UsageError(
            f"format: png was given for {geometry.shape[0]} slices along z, expected one",
            "use --format tif for a stack, or a volume format",
        )


def refuse_existing(paths: dict[str, Path], overwrite: bool) -> None:
    """Refuse to start when an output exists already, or the folder cannot take one; make the folder.

    A report of a run that failed does not count as existing: it holds no result.

    Raises
    ------
    OutputError
        When an output exists and may not be replaced, or nothing can be written there.
    """
    there = [path for path in paths.values() if os.path.lexists(path)]
    kept = [path for path in there if not (path == paths.get("report") and tells_of_failure(path))]
    if kept and not overwrite:
        more = f" and {len(kept) - 1} more" if len(kept) > 1 else ""
        raise OutputError(f"{kept[0]}{more}: exists already", "choose another folder with -o, or add --overwrite")
    folders = [path for path in there if path.is_dir()]
    if folders:
        raise OutputError(f"{folders[0]}: is a folder, a file is to be written there", "choose another folder with -o")
    for folder in {path.parent for path in paths.values()}:
        make_writable(folder)


def tells_of_failure(path: Path) -> bool:
    """Whether a file is the report of a run that failed."""
    try:
        return bool(json.loads(path.read_text(encoding="utf-8"))["status"] == "failed")
    except (OSError, ValueError, KeyError, TypeError):
        return False


def make_writable(folder: Path) -> None:
    """Make a folder, and see that a file can be written there.

    Raises
    ------
    OutputError
        When it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{folder}: cannot be written to ({reason})", "choose another folder with -o") from None


def write_result(
    result: Result,
    folder: Path,
    names: Mapping[str, str],
    picture: preview.Scene,
    seconds: dict[str, float] | None = None,
) -> Iterator[tuple[str, Path]]:
    """Write the files of a result, yielding kind and path of each that is there.

    A result without a surface has a trace and a picture only.

    Parameters
    ----------
    result : Result
    folder : Path
        Where they go; there already.
    names : mapping of str to str
        Name of the file by kind, as from `names`; kinds that are not there are not written.
    picture : preview.Scene
        For ``preview``.
    seconds : dict, optional
        The durations of ``mesh`` and ``write`` are added.

    Raises
    ------
    OutputError
        When a file cannot be written; those before it are whole.
    """
    from accelsurf import io

    seconds = {} if seconds is None else seconds
    empty, config = result.stop.reason in ("vanished", "filled"), result.config
    began = time.perf_counter()
    mesh: Any = None
    if not empty and any(kind.startswith(("surface-", "contour-")) for kind in names):
        mesh = result.contours if result.geometry.slice_axis is not None else result.surface
    seconds["mesh"] = seconds.get("mesh", 0.0) + time.perf_counter() - began
    writers: dict[str, Callable[[Path], Any]] = {}
    for kind in names:
        if kind == "labels" and not empty:
            writers[kind] = lambda path: io.write_labels(result.labels_volume(), path)
        elif kind.startswith(("surface-", "contour-")) and mesh is not None:
            writers[kind] = lambda path: mesh.write(path, config.mesh_space)
        elif kind == "sdf" and not empty:
            writers[kind] = lambda path: io.write(result.labels_volume().with_array(result.psi), path)
        elif kind == "trace":
            writers[kind] = lambda path: write_bytes(path, document.trace_csv(result.history).encode())
        elif kind == "preview":
            writers[kind] = lambda path: write_bytes(path, preview.preview_png(picture))
    for kind, writer in writers.items():
        began = time.perf_counter()
        writer(folder / names[kind])
        seconds["write"] = seconds.get("write", 0.0) + time.perf_counter() - began
        yield kind.partition("-")[0], folder / names[kind]


def told(name: str, result: Result | ObjectsResult) -> str:
    """Return the heading of a picture: how the run ended."""
    return f"{name}: {result.config.flow} flow, {result.stop.steps} steps, {result.stop.reason}"


def scene(result: Result | ObjectsResult, title: str, reference: Any = None) -> preview.Scene:
    """Return what a picture of a result shows.

    Parameters
    ----------
    result : Result or ObjectsResult
    title : str
        Its heading.
    reference : ndarray, optional
        Labels to draw as a second contour.
    """
    flat = result.geometry.slice_axis is not None
    return preview.Scene(
        image=result.image,
        psi=result.psi,
        geometry=result.geometry,
        history=result.history,
        surface=None if flat or result.stop.reason in ("vanished", "filled") else result.surface,
        start=result.start,
        title=title,
        anatomical=is_anatomical(result.volume.metadata),
        reference=reference,
        labels=result.labels if hasattr(result, "objects") else None,
    )
