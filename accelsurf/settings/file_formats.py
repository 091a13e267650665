"""The formats of images, meshes and contours: one entry each, with what it can hold and what reads and writes it.

From an entry follow what `accelsurf.io` reads and writes, the values and the help of ``--format`` and ``--mesh``, the
help of the commands, ``accelsurf info`` and the reference page. Functions are named as ``"module:function"`` and
imported when a file is read or written, so this module stays light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from accelsurf.settings.registry import Registry

Function = str | Callable[..., Any]
#: What of the grid a file keeps: all of it, the spacing, or the size of a pixel.
GridFidelity = Literal["all", "spacing", "pixel"]
#: What a mesh file describes: the surface in a volume, or the contours in an image of one slice.
Shape = Literal["surface", "contour"]
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
        What it is, in a few words.
    suffixes : tuple of str
        Endings of its files, in lower case, with the dot. No ending of one format ends with that of another.
    parse : str or callable
        Of a Path, and where the format has ``options`` of `accelsurf.settings.reading.ReadOptions`, returns what the
        header claims, of any type; raises InputError or GeometryError.
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
    open : str or callable, optional
        Of a Path, that header and an `accelsurf.io.lazy_volume.Opening`, returns a LazyVolume, which is read box by
        box; None: the format is packed as a whole.
    store : str or callable, optional
        Of a Path, a Geometry, a type of values, metadata and a path to the image or None, returns what label maps are
        written with box by box (``write``, ``read``, ``finish``, as of `accelsurf.io.LabelStore`); None: it cannot be.
    has_levels : bool
        Whether a file may hold several levels, channels and time points.
    folder_marks : tuple of str
        Files of which an image of this format has one, where it is a folder; empty: it is a file.
    is_folder : str or callable, optional
        Of the Path of a folder without such marks, whether what is in it is an image of this format.
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
    keeps : {"all", "spacing", "pixel"}
        What of the grid is read back: all of it, the spacing, or the size of a pixel; the rest is the world's origin,
        the world's axes, and slices of 1 mm.
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
    open: Function | None = None
    store: Function | None = None
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

IMAGE_FORMATS: Registry[ImageFormat] = Registry(
    "image format",
    ImageFormat(
        "nii.gz",
        "NIfTI-1 or NIfTI-2, compressed; written as NIfTI-1",
        (".nii.gz",),
        f"{_FORMATS}.nifti:read_compressed_header",
        f"{_FORMATS}.nifti_volumes:read",
        f"{_FORMATS}.nifti_volumes:write_compressed",
        read_channels=f"{_FORMATS}.nifti_volumes:read_channels",
        is_anatomical=f"{_FORMATS}.nifti_grid:is_anatomical",
    ),
    ImageFormat(
        "nii",
        "NIfTI-1 or NIfTI-2; written as NIfTI-1",
        (".nii",),
        f"{_FORMATS}.nifti:read_plain_header",
        f"{_FORMATS}.nifti_volumes:read",
        f"{_FORMATS}.nifti_volumes:write",
        read_channels=f"{_FORMATS}.nifti_volumes:read_channels",
        is_anatomical=f"{_FORMATS}.nifti_grid:is_anatomical",
        open=f"{_FORMATS}.nifti_volumes:open_lazily",
        store=f"{_FORMATS}.nifti_volumes:store",
    ),
    ImageFormat(
        "nrrd",
        "NRRD; written compressed",
        (".nrrd",),
        f"{_FORMATS}.nrrd_metaimage:parse_nrrd",
        f"{_FORMATS}.itk_volumes:read",
        f"{_FORMATS}.itk_volumes:write_nrrd",
        read_channels=f"{_FORMATS}.itk_volumes:read_channels",
        is_anatomical=f"{_FORMATS}.nrrd_metaimage:is_anatomical",
        open=f"{_FORMATS}.itk_volumes:open_lazily",
    ),
    *(
        ImageFormat(
            name,
            help,
            (f".{name}",),
            f"{_FORMATS}.nrrd_metaimage:parse_metaimage",
            f"{_FORMATS}.itk_volumes:read",
            f"{_FORMATS}.itk_volumes:write_metaimage",
            read_channels=f"{_FORMATS}.itk_volumes:read_channels",
            open=f"{_FORMATS}.itk_volumes:open_lazily",
        )
        for name, help in (
            ("mha", "MetaImage in one file; written compressed"),
            ("mhd", "MetaImage, a header and a data file; written compressed"),
        )
    ),
    ImageFormat(
        "ome.zarr",
        "OME-Zarr 0.4 or 0.5, a folder of chunks and coarser levels; written as 0.5",
        (".ome.zarr", ".zarr"),
        f"{_FORMATS}.ome_zarr:parse",
        f"{_FORMATS}.ome_zarr:read",
        f"{_FORMATS}.ome_zarr:write",
        ("level", "channel_index", "time_index"),
        read_channels=f"{_FORMATS}.ome_zarr:read_channels",
        write_labels=f"{_FORMATS}.ome_zarr:write_labels",
        open=f"{_FORMATS}.ome_zarr:open_lazily",
        store=f"{_FORMATS}.ome_zarr:store",
        has_levels=True,
        folder_marks=("zarr.json", ".zattrs", ".zgroup"),
    ),
    ImageFormat(
        "png",
        "PNG, grey or colour; written grey",
        (".png",),
        f"{_FORMATS}.png:parse",
        f"{_FORMATS}.raster:read",
        f"{_FORMATS}.png:write",
        types=("uint8", "uint16"),
        only_2d=True,
        keeps="pixel",
        white_labels=True,
        distances="tif",
    ),
    ImageFormat(
        "tif",
        "TIFF, grey or colour, a page for each slice; written grey and compressed",
        (".tif", ".tiff"),
        f"{_FORMATS}.tiff:parse",
        f"{_FORMATS}.tiff_pages:read",
        f"{_FORMATS}.tiff:write",
        open=f"{_FORMATS}.tiff_pages:open_lazily",
        types=_TIFF_TYPES,
        keeps="spacing",
        white_labels=True,
    ),
    ImageFormat(
        "dcm",
        "DICOM, a folder of slices, one of its files, or a zip archive; read only",
        (".dcm", ".ima", ".zip"),
        f"{_FORMATS}.dicom:parse",
        f"{_FORMATS}.dicom:read",
        options=("series", "resample", "spacing"),
        is_anatomical=f"{_FORMATS}.dicom:is_anatomical",
        is_folder=f"{_FORMATS}.dicom:holds_dicom",
        is_file=f"{_FORMATS}.dicom:is_dicom",
        listing=f"{_FORMATS}.dicom:listing",
    ),
)
#: The format of a label map where neither the settings nor the input give one.
DEFAULT_IMAGE_FORMAT = "nii.gz"


@dataclass(frozen=True)
class MeshFormat:
    """All that is said about a format of surfaces and contours.

    Attributes
    ----------
    name : str
        As it is given to ``--mesh``; also the ending of its files.
    help : str
        What it is, in a few words.
    surface : str or callable, optional
        Of the vertices (n, 3) in mm, the triangles (m, 3), "LPS" or "RAS" and a LabelEntry or None, returns the bytes
        of a file, without a label as without name and colour; None: the format holds no surfaces.
    contour : str or callable, optional
        Of a tuple of loops (n, 3) in mm and "LPS" or "RAS", returns the same.
    auto : tuple of str
        Of which of the two ``--mesh auto`` writes it.
    read : str or callable, optional
        Of the bytes of a file, returns points (n, 3) and triangles (m, 3); anything that it raises is reported as a
        damaged file. None: starts cannot be read from it.
    """

    name: str
    help: str
    surface: Function | None = None
    contour: Function | None = None
    auto: tuple[Shape, ...] = ()
    read: Function | None = None

    @property
    def suffix(self) -> str:
        """The ending of its files."""
        return f".{self.name}"

    def writer(self, shape: Shape) -> Function | None:
        """What makes a file of a surface or of contours; None where the format does not hold them."""
        return self.surface if shape == "surface" else self.contour


_SURFACE, _CONTOUR = f"{_FORMATS}.surface_files", "accelsurf.analysis.contours"
_TRIMESH = f"{_FORMATS}.trimesh_files"

MESH_FORMATS: Registry[MeshFormat] = Registry(
    "mesh format",
    MeshFormat("ply", "PLY, binary", f"{_SURFACE}:ply_bytes", auto=("surface",), read=f"{_TRIMESH}:read_ply"),
    MeshFormat("stl", "STL, binary", f"{_SURFACE}:stl_bytes", read=f"{_TRIMESH}:read_stl"),
    MeshFormat("obj", "Wavefront OBJ", f"{_SURFACE}:obj_bytes", read=f"{_TRIMESH}:read_obj"),
    MeshFormat(
        "vtp",
        "VTK PolyData, triangles or lines",
        f"{_SURFACE}:vtp_bytes",
        f"{_CONTOUR}:vtp_bytes",
        auto=("contour",),
        read=f"{_FORMATS}.vtp:read",
    ),
    MeshFormat("glb", "glTF 2.0 in one file", f"{_FORMATS}.glb:write", read=f"{_FORMATS}.glb:read"),
    MeshFormat("3mf", "3MF, of 3D printers", f"{_FORMATS}.three_mf:write", read=f"{_FORMATS}.three_mf:read"),
    MeshFormat("csv", "a table of points", contour=f"{_CONTOUR}:csv_bytes", auto=("contour",)),
)


def image_suffixes() -> tuple[str, ...]:
    """Endings of the images that can be read.

    Examples
    --------
    >>> image_suffixes()[:3]
    ('.nii.gz', '.nii', '.nrrd')
    """
    return tuple(suffix for form in IMAGE_FORMATS.values() for suffix in form.suffixes)


def written_suffixes() -> tuple[str, ...]:
    """Endings of the images that can be written.

    Examples
    --------
    >>> ".dcm" in image_suffixes(), ".dcm" in written_suffixes()
    (True, False)
    """
    return tuple(suffix for form in IMAGE_FORMATS.values() if form.write is not None for suffix in form.suffixes)


def image_format(suffix: str) -> ImageFormat | None:
    """The format whose files have an ending; None where there is none.

    Examples
    --------
    >>> image_format(".tiff").name
    'tif'
    """
    return next((form for form in IMAGE_FORMATS.values() if suffix in form.suffixes), None)


def mesh_formats(shape: Shape) -> tuple[str, ...]:
    """Names of the formats that hold surfaces, or contours.

    Examples
    --------
    >>> mesh_formats("surface"), mesh_formats("contour")
    (('ply', 'stl', 'obj', 'vtp', 'glb', '3mf'), ('vtp', 'csv'))
    """
    return tuple(name for name, form in MESH_FORMATS.items() if form.writer(shape) is not None)


def automatic_mesh_formats(shape: Shape) -> tuple[str, ...]:
    """Names of the formats that ``--mesh auto`` writes."""
    return tuple(name for name, form in MESH_FORMATS.items() if shape in form.auto)


def input_help() -> str:
    """The endings of images, as the help of a command says them.

    Examples
    --------
    >>> input_help()
    '.nii.gz, .nii, .nrrd, .mha, .mhd, .ome.zarr, .png, .tif or .dcm'
    """
    *others, last = (form.suffixes[0] for form in IMAGE_FORMATS.values())  # .tiff is known where .tif is
    return f"{', '.join(others)} or {last}"


def label_formats() -> tuple[str, ...]:
    """Names of the formats that label maps are written in."""
    return tuple(name for name, form in IMAGE_FORMATS.items() if form.write is not None)


def label_help() -> str:
    """The formats of label maps, as the help of ``--format`` says them.

    Examples
    --------
    >>> label_help()
    'nii.gz, nii, nrrd, mha, mhd, ome.zarr, tif, or for one slice png'
    """
    volumes = [name for name in label_formats() if not IMAGE_FORMATS[name].only_2d]
    slices = [name for name in label_formats() if IMAGE_FORMATS[name].only_2d]
    return f"{', '.join(volumes)}, or for one slice {', '.join(slices)}"


def mesh_help() -> str:
    """The formats of surfaces and contours, as the help of ``--mesh`` says them."""
    surface, contour = mesh_formats("surface"), mesh_formats("contour")
    of_volume, of_slice = automatic_mesh_formats("surface"), automatic_mesh_formats("contour")
    return (
        f"of the surface: {', '.join(surface)}; of the contours of an image of one slice: {', '.join(contour)}. "
        f"auto is {','.join(of_volume)}, or for one slice {','.join(of_slice)}."
    )
