"""The formats of images: one entry each, with its capabilities, reader and writer.

The entries determine the formats of `accelsurf.io`, the values and the help of ``--format``, the
help of the commands, ``accelsurf info`` and the reference page. Functions are named as ``"module:function"`` and
imported when a file is read or written, so this module stays light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from accelsurf.settings.registry import Registry

Function = str | Callable[..., Any]
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
    parse : str or callable
        Of a Path, and where the format has ``options`` of `accelsurf.settings.reading.ReadOptions`, returns the
        content of the header, of any type; raises InputError or GeometryError.
    read : str or callable
        Of a Path, that header and the memory in bytes, returns a Volume; raises as `accelsurf.io.read` does.
    write : str or callable, optional
        Of a Volume, whose values have one of the ``types``, and a Path, which it makes. Further files may lie beside
        it; all are in a folder of their own until they are complete. None: it is read only.
    options : tuple of str
        Names of the options of reading that it has. An option that it has not is refused.
    read_channels : str or callable, optional
        As ``read``, returns a list of a Volume for each channel; None: the format has one channel.
    write_labels : str or callable, optional
        As ``write``, of a label map; None: the same.
    read_labels : str or callable, optional
        As ``read``, with ranges of the labels that are wanted: of a format whose labels may overlap; None: the same.
    open : str or callable, optional
        Of a Path, that header and an `accelsurf.io.lazy_volume.Opening`, returns a LazyVolume, which is read box by
        box; None: the format is packed as a whole.
    store : str or callable, optional
        Of a Path, a Geometry, a type of values, metadata and a path to the image or None, returns the writer of
        label maps box by box (``write``, ``read``, ``finish``); None: it cannot be.
    sequence : str or callable, optional
        Of a Path, ReadOptions and the memory in bytes or None, returns the
        `accelsurf.io.sequences.sources.FileSequence` that is in it; None: one time point is read like the other.
    write_frames : str or callable, optional
        Of a Path, which it makes, and an `accelsurf.io.sequences.writing.FrameStack`: writes a sequence with its times;
        None: it cannot hold one.
    has_levels : bool
        Whether a file may hold several levels, channels and time points.
    folder_marks : tuple of str
        Files of which an image of this format has one, where it is a folder; empty: it is a file.
    is_folder : str or callable, optional
        Of the Path of a folder without these marks, whether its files are an image of this format.
    is_file : str or callable, optional
        Of the Path of a file whose name has no known ending, whether it is of this format.
    listing : str or callable, optional
        Of a Path, a dictionary for each volume that it holds, for a person to choose from.
    is_anatomical : str or callable, optional
        Of the metadata of a Volume that was read, whether its header said that the world's axes are a patient's; also
        asked of volumes that were read from other formats. None: it never does.
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
    parse: Function
    read: Function
    write: Function | None = None
    options: tuple[str, ...] = ()
    read_channels: Function | None = None
    is_anatomical: Function | None = None
    write_labels: Function | None = None
    read_labels: Function | None = None
    open: Function | None = None
    store: Function | None = None
    sequence: Function | None = None
    write_frames: Function | None = None
    has_levels: bool = False
    folder_marks: tuple[str, ...] = ()
    is_folder: Function | None = None
    is_file: Function | None = None
    listing: Function | None = None
    types: tuple[str, ...] = ()
    only_2d: bool = False
    keeps: GridFidelity = "all"
    white_labels: bool = False
    distances: str | None = None


_FORMATS = "accelsurf.io.formats"
_SEQUENCES = "accelsurf.io.sequences"
#: Options of formats that may hold several channels and time points.
_PARTS = ("channel_index", "time_index", "channels_from_time")

#: Shared by formats that are read alike.
_NIFTI: dict[str, Any] = {
    "read": f"{_FORMATS}.raw_header:read_raw",
    "write_frames": "accelsurf.io.sequences.nifti_frames:write_frames",
    "options": _PARTS,
    "sequence": f"{_SEQUENCES}.packed:PackedFrames",
    "read_channels": f"{_FORMATS}.raw_header:read_raw_channels",
    "is_anatomical": f"{_FORMATS}.nifti_grid:is_nifti_anatomical",
}
_RAW: dict[str, Any] = {
    "read": f"{_FORMATS}.raw_header:read_raw",
    "options": _PARTS,
    "sequence": f"{_SEQUENCES}.packed:PackedFrames",
    "read_channels": f"{_FORMATS}.raw_header:read_raw_channels",
    "open": f"{_FORMATS}.raw_header:open_raw",
}
_NRRD: dict[str, Any] = {
    "parse": f"{_FORMATS}.nrrd:parse_nrrd",
    "is_anatomical": f"{_FORMATS}.nrrd:is_nrrd_anatomical",
    **_RAW,
}
_METAIMAGE: dict[str, Any] = {
    "parse": f"{_FORMATS}.metaimage:parse_metaimage",
    "write": f"{_FORMATS}.metaimage:write_metaimage",
    **_RAW,
}

IMAGE_FORMATS: Registry[ImageFormat] = Registry(
    "image format",
    ImageFormat(
        "nii.gz",
        "NIfTI-1 or NIfTI-2, compressed; written as NIfTI-1",
        (".nii.gz",),
        parse=f"{_FORMATS}.nifti:read_header",
        write=f"{_FORMATS}.nifti_volumes:write_nifti",
        **_NIFTI,
    ),
    ImageFormat(
        "nii",
        "NIfTI-1 or NIfTI-2; written as NIfTI-1",
        (".nii",),
        parse=f"{_FORMATS}.nifti:read_header",
        write=f"{_FORMATS}.nifti_volumes:write_nifti",
        open=f"{_FORMATS}.raw_header:open_raw",
        store=f"{_FORMATS}.nifti_volumes:store_nifti",
        **_NIFTI,
    ),
    ImageFormat(
        "hdr",
        "NIfTI in two files, .hdr and .img, each also packed; read only",
        (".hdr", ".hdr.gz"),
        parse=f"{_FORMATS}.nifti:read_pair_header",
        is_file=f"{_FORMATS}.nifti:is_of_pair",
        **{key: value for key, value in _NIFTI.items() if key != "write_frames"},
    ),
    ImageFormat(
        "nrrd",
        "NRRD; written compressed",
        (".nrrd",),
        write=f"{_FORMATS}.nrrd:write_nrrd",
        **_NRRD,
    ),
    ImageFormat("nhdr", "NRRD, a header that names its data file; read only", (".nhdr",), **_NRRD),
    ImageFormat("mha", "MetaImage in one file; written compressed", (".mha",), **_METAIMAGE),
    ImageFormat(
        "mhd", "MetaImage, a header and a data file; written compressed", (".mhd",), **_METAIMAGE
    ),
    ImageFormat(
        "ome.zarr",
        "OME-Zarr 0.4 or 0.5, a folder of chunks and coarser levels; written as 0.5",
        (".ome.zarr", ".zarr"),
        f"{_FORMATS}.ome_zarr:parse_ome_zarr",
        f"{_FORMATS}.ome_zarr:read_ome_zarr",
        f"{_FORMATS}.ome_zarr:write_ome_zarr",
        ("level", *_PARTS),
        write_frames=f"{_SEQUENCES}.ome_zarr_frames:write_ome_zarr_frames",
        is_anatomical=f"{_FORMATS}.ome_metadata:is_ome_anatomical",
        read_channels=f"{_FORMATS}.ome_zarr:read_ome_zarr_channels",
        write_labels=f"{_FORMATS}.ome_zarr:write_labels",
        open=f"{_FORMATS}.ome_zarr:open_ome_zarr",
        store=f"{_FORMATS}.ome_zarr:store_ome_zarr",
        has_levels=True,
        folder_marks=("zarr.json", ".zattrs", ".zgroup", ".zarray"),
    ),
    ImageFormat(
        "png",
        "PNG, grey or colour; written grey",
        (".png",),
        f"{_FORMATS}.png:parse_png",
        f"{_FORMATS}.png:read_png",
        f"{_FORMATS}.png:write_png",
        ("spacing",),
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
        f"{_FORMATS}.tiff:parse_tiff",
        f"{_FORMATS}.tiff:read_tiff",
        f"{_FORMATS}.tiff_file:write_tiff",
        ("level", *_PARTS, "spacing"),
        write_frames=f"{_SEQUENCES}.tiff_frames:write_tiff_frames",
        read_channels=f"{_FORMATS}.tiff:read_tiff_channels",
        open=f"{_FORMATS}.tiff:open_tiff",
        has_levels=True,
        types=_TIFF_TYPES,
        keeps="spacing",
        white_labels=True,
    ),
    ImageFormat(
        "dcm",
        "DICOM, a folder of slices or one of its files; a segmentation as a label map; read only",
        (".dcm", ".ima"),
        f"{_FORMATS}.dicom:parse_dicom",
        f"{_FORMATS}.dicom:read_dicom",
        options=("series", "spacing"),
        read_labels=f"{_FORMATS}.dicom:read_labels",
        sequence=f"{_SEQUENCES}.sources:DicomFrames",
        is_anatomical=f"{_FORMATS}.dicom:is_dicom_anatomical",
        is_folder=f"{_FORMATS}.dicom:holds_dicom",
        is_file=f"{_FORMATS}.dicom:is_dicom",
        listing=f"{_FORMATS}.dicom:listing",
    ),
    ImageFormat(
        "mgz",
        "MGH and MGZ of FreeSurfer; read only",
        (".mgz", ".mgh"),
        f"{_FORMATS}.mgh:parse_mgh",
        f"{_FORMATS}.raw_header:read_raw",
        is_anatomical=f"{_FORMATS}.mgh:is_mgh_anatomical",
    ),
    ImageFormat(
        "slices",
        "a folder of slices in TIFF or PNG, or a pattern of such files",
        (),
        f"{_FORMATS}.slices:parse_slices",
        f"{_FORMATS}.slices:read_slices",
        None,
        ("spacing",),
        open=f"{_FORMATS}.slices:open_slices",
        is_folder=f"{_FORMATS}.slices:is_slices",
    ),
    ImageFormat(
        "npy",
        "an array of numpy, (z, y, x) or (t, z, y, x), without its grid",
        (".npy",),
        f"{_FORMATS}.numpy_arrays:parse_npy",
        f"{_FORMATS}.raw_header:read_raw",
        f"{_FORMATS}.numpy_arrays:write_npy",
        ("spacing", "time_index"),
        open=f"{_FORMATS}.raw_header:open_raw",
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
        suffix
        for form in IMAGE_FORMATS.values()
        if form.write is not None
        for suffix in form.suffixes
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
    return tuple(name for name, form in IMAGE_FORMATS.items() if form.write is not None)


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
