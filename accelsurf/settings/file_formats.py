"""The formats of images: one entry each, with its capabilities.

The entries determine the formats of `accelsurf.io`, the values and the help of ``--format``, the
help of the commands, ``accelsurf info`` and the reference page. The functions that read and write a format are in
`accelsurf.io.format_table`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from accelsurf.settings.registry import by_name

#: Parts of the grid that a file keeps: all of it, the spacing, or the size of a pixel.
GridFidelity = Literal["all", "spacing", "pixel", "none"]
#: Types of values that a TIFF can hold here.
_TIFF_TYPES = ("uint8", "uint16", "uint32", "int8", "int16", "int32", "float32")


@dataclass(frozen=True)
class ImageFormat:
    """All that is said about a format of images.

    Attributes
    ----------
    name : str
        As it is given to ``--format``; also the ending of label maps that are written.
    help : str
        Description in a few words.
    suffixes : tuple of str
        Endings of its files, in lower case, with the dot; of a folder with any name none. No
        ending of one format ends with that of another.
    is_written : bool
        False: it is read only.
    options : tuple of str
        Names of the options of reading that it has. An option that it has not is refused.
    has_levels : bool
        Whether a file may hold several levels, channels and time points.
    folder_marks : tuple of str
        Files of which an image of this format has one, where it is a folder; empty: it is a file.
    types : tuple of str
        The numpy types of values that it holds; empty: all of integers and floats of 4 and 8 bytes.
    only_2d : bool
        Whether it holds one slice only.
    keeps : {"all", "spacing", "pixel", "none"}
        Parts of the grid that are read back: all of it, the spacing, the size of a pixel, or no length; the rest is the
        world's origin, the world's axes, and lengths of 1 mm.
    white_labels : bool
        Whether a label map of 0 and 1 is written as 0 and 255, which is black and white in every viewer.
    distances : str or None
        The format that signed distances are written in beside label maps in this one; None: the same.
    """

    name: str
    help: str
    suffixes: tuple[str, ...]
    is_written: bool = False
    options: tuple[str, ...] = ()
    has_levels: bool = False
    folder_marks: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    only_2d: bool = False
    keeps: GridFidelity = "all"
    white_labels: bool = False
    distances: str | None = None


#: Options of formats that may hold several channels and time points.
_PARTS = ("channel_index", "time_index", "channels_from_time")

IMAGE_FORMATS: dict[str, ImageFormat] = by_name(
    ImageFormat(
        "nii.gz",
        "NIfTI-1 or NIfTI-2, compressed; written as NIfTI-1",
        (".nii.gz",),
        is_written=True,
        options=_PARTS,
    ),
    ImageFormat(
        "nii",
        "NIfTI-1 or NIfTI-2; written as NIfTI-1",
        (".nii",),
        is_written=True,
        options=_PARTS,
    ),
    ImageFormat(
        "hdr",
        "NIfTI in two files, .hdr and .img, each also packed; read only",
        (".hdr", ".hdr.gz"),
        options=_PARTS,
    ),
    ImageFormat("nrrd", "NRRD; written compressed", (".nrrd",), is_written=True, options=_PARTS),
    ImageFormat(
        "nhdr", "NRRD, a header that names its data file; read only", (".nhdr",), options=_PARTS
    ),
    ImageFormat(
        "mha",
        "MetaImage in one file; written compressed",
        (".mha",),
        is_written=True,
        options=_PARTS,
    ),
    ImageFormat(
        "mhd",
        "MetaImage, a header and a data file; written compressed",
        (".mhd",),
        is_written=True,
        options=_PARTS,
    ),
    ImageFormat(
        "ome.zarr",
        "OME-Zarr 0.4 or 0.5, a folder of chunks and coarser levels; written as 0.5",
        (".ome.zarr", ".zarr"),
        is_written=True,
        options=("level", *_PARTS),
        has_levels=True,
        folder_marks=("zarr.json", ".zattrs", ".zgroup", ".zarray"),
    ),
    ImageFormat(
        "png",
        "PNG, grey or colour; written grey",
        (".png",),
        is_written=True,
        options=("spacing",),
        types=("uint8", "uint16"),
        only_2d=True,
        keeps="pixel",
        white_labels=True,
        distances="tif",
    ),
    ImageFormat(
        "tif",
        "TIFF, OME-TIFF, ImageJ hyperstacks, BigTIFF; written grey and compressed, a page for each slice",
        (".tif", ".tiff"),
        is_written=True,
        options=("level", *_PARTS, "spacing"),
        has_levels=True,
        types=_TIFF_TYPES,
        keeps="spacing",
        white_labels=True,
    ),
    ImageFormat(
        "dcm",
        "DICOM, a folder of slices or one of its files; a segmentation as a label map; read only",
        (".dcm", ".ima"),
        options=("series", "spacing"),
    ),
    ImageFormat("mgz", "MGH and MGZ of FreeSurfer; read only", (".mgz", ".mgh")),
    ImageFormat(
        "slices",
        "a folder of slices in TIFF or PNG, or a pattern of such files",
        (),
        options=("spacing",),
    ),
    ImageFormat(
        "npy",
        "an array of numpy, (z, y, x) or (t, z, y, x), without its grid",
        (".npy",),
        is_written=True,
        options=("spacing", "time_index"),
        keeps="none",
    ),
)
#: The format of a label map where neither the settings nor the input give one.
DEFAULT_IMAGE_FORMAT = "nii.gz"


def image_suffixes() -> tuple[str, ...]:
    """Endings of the images that can be read.

    Examples
    --------
    >>> image_suffixes()[:3]
    ('.nii.gz', '.nii', '.hdr')
    """
    return tuple(suffix for form in IMAGE_FORMATS.values() for suffix in form.suffixes)


def written_suffixes() -> tuple[str, ...]:
    """Endings of the images that can be written.

    Examples
    --------
    >>> ".dcm" in image_suffixes(), ".dcm" in written_suffixes()
    (True, False)
    """
    return tuple(
        suffix for form in IMAGE_FORMATS.values() if form.is_written for suffix in form.suffixes
    )


def image_format(suffix: str) -> ImageFormat | None:
    """The format whose files have an ending; None where there is none.

    Examples
    --------
    >>> image_format(".tiff").name
    'tif'
    """
    return next((form for form in IMAGE_FORMATS.values() if suffix in form.suffixes), None)


def input_help() -> str:
    """The endings of images, as the help of a command says them.

    Examples
    --------
    >>> input_help()
    '.nii.gz, .nii, .hdr, .nrrd, .nhdr, .mha, .mhd, .ome.zarr, .png, .tif, .dcm, .mgz or .npy'
    """
    # .tiff is known where .tif is.
    *others, last = (form.suffixes[0] for form in IMAGE_FORMATS.values() if form.suffixes)
    return f"{', '.join(others)} or {last}"


def label_formats() -> tuple[str, ...]:
    """Names of the formats that label maps are written in."""
    return tuple(name for name, form in IMAGE_FORMATS.items() if form.is_written)


def label_help() -> str:
    """The formats of label maps, as the help of ``--format`` says them.

    Examples
    --------
    >>> label_help()
    'nii.gz, nii, nrrd, mha, mhd, ome.zarr, tif, npy, or for one slice png'
    """
    volumes = [name for name in label_formats() if not IMAGE_FORMATS[name].only_2d]
    slices = [name for name in label_formats() if IMAGE_FORMATS[name].only_2d]
    return f"{', '.join(volumes)}, or for one slice {', '.join(slices)}"
