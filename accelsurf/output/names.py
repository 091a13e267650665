"""Files that a run writes for its image, and their names: meshes of a volume, contours of an image of one slice.

Nothing of a run is loaded here: a command knows its files, and can refuse, before anything is computed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.errors import InputError, UsageError
from accelsurf.evolution.rests import MAX_PLATEAUS
from accelsurf.settings.file_formats import DEFAULT_IMAGE_FORMAT, IMAGE_FORMATS, image_format
from accelsurf.settings.mesh_formats import Shape, automatic_mesh_formats, ending_of, mesh_formats
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry

#: Kinds of outputs of which each object has its own.
EACH = ("surface", "contour")


def label_format(config: RunConfig, source_suffix: str) -> str:
    """Return the format of the label map: the one of the settings, else the input's, else nii.gz.

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
    followed = image_format(source_suffix)
    if config.layout == "bids" and (followed is None or not followed.name.startswith("nii")):
        followed = None  # BIDS has label maps in NIfTI
    return config.format or (
        DEFAULT_IMAGE_FORMAT if followed is None or followed.write is None else followed.name
    )


def names(config: RunConfig, labels: str, is_2d: bool | None) -> dict[str, str]:
    """Return the last part of every output's name by its kind, without the report.

    Parameters
    ----------
    config : RunConfig
    labels : str
        From `label_format`.
    is_2d : bool or None
        Whether the image has one slice; None when that is not known yet: then all possible files.

    Examples
    --------
    >>> [name for kind, name in names(RunConfig(), "png", True).items() if kind.startswith("contour")]
    ['contour.vtp', 'contour.csv']
    """
    files = {"labels": f"seg.{labels}"}
    if is_2d is not True:
        wanted = automatic_mesh_formats("surface") if config.mesh == "auto" else config.mesh
        files |= {
            f"surface-{kind}": f"surface.{kind}"
            for kind in wanted
            if kind in mesh_formats("surface")
        }
    if is_2d is not False:
        wanted = automatic_mesh_formats("contour") if config.mesh == "auto" else config.mesh
        files |= {
            f"contour-{kind}": f"contour.{kind}"
            for kind in mesh_formats("contour")
            if kind in wanted
        }
    if config.save_sdf:
        files["sdf"] = f"sdf.{IMAGE_FORMATS[labels].distances or labels}"
    if config.has_ids:
        files["objects"] = "objects.csv"
    if keeps_state(config):
        files |= {"state": "state.npz", "config": "run.toml"}
    files |= {f"also-{name}": ending_of(name) for name in config.also if name != labels}
    if labels in ("nii", "nii.gz") and (config.name or config.color or config.label_table):
        files["also-itk-snap"] = ending_of("itk-snap")  # which ITK-SNAP reads beside a NIfTI
    files |= {
        f"rest{number}": f"rest{number}_seg.{labels}" for number in range(1, MAX_PLATEAUS + 1)
    }
    files |= {"trace": "trace.csv", "preview": "preview.png"}
    return files | {"statistics": "statistics.csv", "statistics-json": "statistics.json"}


def keeps_state(config: RunConfig) -> bool:
    """Test if the state of a run is written, from which it can be refined, and the settings that repeat it.

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
    from accelsurf.clicks.tables import has_sides  # loads what a run needs

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


def existing(folder: Path, names: Mapping[str, str]) -> list[Path]:
    """Return the files in a folder that are named as the surface or contour of an object, of any id.

    Parameters
    ----------
    folder : Path
    names : mapping of str to str
        Name of the file by kind, as of a run of one object.
    """
    parts = [names[kind].rpartition(".") for kind in names if kind.startswith(EACH)]
    known = re.compile(
        "|".join(rf"{re.escape(stem)}_[1-9][0-9]*\.{suffix}" for stem, _, suffix in parts)
    )
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in files if known.fullmatch(path.name))
