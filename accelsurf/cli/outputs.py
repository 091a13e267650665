"""Which files a run writes, by the kind of image it gets: a volume a mesh, an image of one slice contours."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from accelsurf.config import LabelFormat, RunConfig
from accelsurf.errors import UsageError

if TYPE_CHECKING:
    from accelsurf.geometry import Geometry

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


def names(config: RunConfig, labels: str, one_slice: bool | None) -> dict[str, str]:
    """Return the last part of every output's name by its kind, but for the report.

    Parameters
    ----------
    config : RunConfig
    labels : str
        From `label_format`.
    one_slice : bool or None
        Whether the image has one slice; None when that is not known yet: then all that there may be.

    Examples
    --------
    >>> [name for kind, name in names(RunConfig(), "png", True).items() if kind.startswith("contour")]
    ['contour.vtp', 'contour.csv']
    """
    chosen = {"labels": f"seg.{labels}"}
    if one_slice is not True:
        kinds = ["ply"] if config.mesh == "auto" else [kind for kind in config.mesh if kind in SURFACE_FORMATS]
        chosen |= {f"surface-{kind}": f"surface.{kind}" for kind in kinds}
    if one_slice is not False:
        wanted = CONTOUR_FORMATS if config.mesh == "auto" else config.mesh
        chosen |= {f"contour-{kind}": f"contour.{kind}" for kind in CONTOUR_FORMATS if kind in wanted}
    if config.save_sdf:
        chosen["sdf"] = f"sdf.{'tif' if labels == 'png' else labels}"  # a PNG holds no distances
    return chosen | {"trace": "trace.csv", "preview": "preview.png"}


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
