"""Formats of meshes, contours and further files of the objects: one entry each, with its reader and writer.

From an entry follow the values and the help of ``--mesh`` and ``--also``, ``accelsurf info`` and the reference page.
Functions are named as in `accelsurf.settings.file_formats`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from accelsurf.settings.file_formats import Function, label_formats
from accelsurf.settings.registry import Registry

_FORMATS = "accelsurf.io.formats"
#: Content of a mesh file: the surface in a volume, or the contours in an image of one slice.
Shape = Literal["surface", "contour"]
_SURFACE = f"{_FORMATS}.surface_files"
_CONTOUR = "accelsurf.measure.contours"


@dataclass(frozen=True)
class MeshFormat:
    """All that is said about a format of surfaces and contours.

    Attributes
    ----------
    name : str
        As it is given to ``--mesh``; also the ending of its files.
    help : str
        Description in a few words.
    surface : str or callable, optional
        Of the vertices (n, 3) in mm, the triangles (m, 3), "LPS" or "RAS" and a LabelEntry or None, returns the bytes
        of a file, without a label as without name and colour; None: the format holds no surfaces.
    contour : str or callable, optional
        Of a tuple of loops (n, 3) in mm and "LPS" or "RAS", returns the same.
    auto : tuple of str
        Of which of the two ``--mesh auto`` writes it.
    read : str or callable, optional
        Of the bytes of a file, returns points (n, 3), triangles (m, 3), and the file's description of itself,
        in which SPACE=RAS is looked for, if it can say that; anything that it raises is reported as a damaged file.
        None: starts cannot be read from it.
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
        """Return the function that writes a surface or contours; None where the format does not hold them."""
        return self.surface if shape == "surface" else self.contour


MESH_FORMATS: Registry[MeshFormat] = Registry(
    "mesh format",
    MeshFormat(
        "ply",
        "PLY, binary",
        f"{_SURFACE}:ply_bytes",
        auto=("surface",),
        read=f"{_SURFACE}:read_ply",
    ),
    MeshFormat("stl", "STL, binary", f"{_SURFACE}:stl_bytes", read=f"{_SURFACE}:read_stl"),
    MeshFormat("obj", "Wavefront OBJ", f"{_SURFACE}:obj_bytes", read=f"{_SURFACE}:read_obj"),
    MeshFormat(
        "vtp",
        "VTK PolyData, triangles or lines",
        f"{_SURFACE}:vtp_bytes",
        f"{_CONTOUR}:vtp_bytes",
        auto=("contour",),
    ),
    MeshFormat("glb", "glTF 2.0 in one file", f"{_FORMATS}.glb:glb_bytes"),
    MeshFormat("csv", "a table of points", contour=f"{_CONTOUR}:csv_bytes", auto=("contour",)),
)


def mesh_formats(shape: Shape) -> tuple[str, ...]:
    """Names of the formats that hold surfaces, or contours.

    Examples
    --------
    >>> mesh_formats("surface"), mesh_formats("contour")
    (('ply', 'stl', 'obj', 'vtp', 'glb'), ('vtp', 'csv'))
    """
    return tuple(name for name, form in MESH_FORMATS.items() if form.writer(shape) is not None)


def automatic_mesh_formats(shape: Shape) -> tuple[str, ...]:
    """Names of the formats that ``--mesh auto`` writes."""
    return tuple(name for name, form in MESH_FORMATS.items() if shape in form.auto)


def mesh_help() -> str:
    """The formats of surfaces and contours, as the help of ``--mesh`` says them."""
    surface, contour = mesh_formats("surface"), mesh_formats("contour")
    of_volume, of_slice = automatic_mesh_formats("surface"), automatic_mesh_formats("contour")
    return (
        f"of the surface: {', '.join(surface)}; of the contours of an image of one slice: {', '.join(contour)}. "
        f"auto is {','.join(of_volume)}, or for one slice {','.join(of_slice)}."
    )


@dataclass(frozen=True)
class LabelOutput:
    """A file of the objects.

    Attributes
    ----------
    name : str
        As it is given to ``--also``.
    help : str
        Description in a few words.
    ending : str
        Of the file's name, after the name of the image.
    write : str or callable
        Of a Result, a `accelsurf.settings.labels.LabelTable` and a Path, writes the file.
    needs_dicom : bool
        Whether the image must be DICOM.
    """

    name: str
    help: str
    ending: str
    write: Function
    needs_dicom: bool = False


LABEL_OUTPUTS: Registry[LabelOutput] = Registry(
    "label output",
    LabelOutput(
        "seg.nrrd",
        "segmentation of 3D Slicer",
        "segmentation.seg.nrrd",
        "accelsurf.output.label_files:seg_nrrd",
    ),
    LabelOutput(
        "itk-snap",
        "label descriptions of ITK-SNAP",
        "labels.txt",
        "accelsurf.output.label_files:itk_snap",
    ),
    LabelOutput(
        "ctbl",
        "colour table of 3D Slicer",
        "labels.ctbl",
        "accelsurf.output.label_files:color_table",
    ),
    LabelOutput(
        "tsv", "table of labels as in BIDS", "dseg.tsv", "accelsurf.output.label_files:bids_table"
    ),
    LabelOutput(
        "dicom-seg",
        "DICOM segmentation, of an image in DICOM",
        "segmentation.dcm",
        "accelsurf.output.dicom:write_segmentation",
        needs_dicom=True,
    ),
    LabelOutput(
        "dicom-labelmap",
        "the same as a label map, which is smaller; few programs read it",
        "labelmap.dcm",
        "accelsurf.output.dicom:write_labelmap",
        needs_dicom=True,
    ),
    LabelOutput(
        "rtstruct",
        "DICOM structure set, of an image in DICOM",
        "rtstruct.dcm",
        "accelsurf.output.dicom:write_structure_set",
        needs_dicom=True,
    ),
)


def also_names() -> tuple[str, ...]:
    """The values of ``--also``.

    Examples
    --------
    >>> also_names()[:2]
    ('seg.nrrd', 'itk-snap')
    """
    return (*LABEL_OUTPUTS, *(name for name in label_formats() if name not in LABEL_OUTPUTS))


def also_help() -> str:
    """Return the same names with their descriptions, for the help."""
    texts = (f"{name} ({entry.help})" for name, entry in LABEL_OUTPUTS.items())
    return ", ".join([*texts, "or a format of label maps"])


def ending_of(name: str) -> str:
    """The end of the name of a file.

    Examples
    --------
    >>> ending_of("seg.nrrd"), ending_of("nii.gz")
    ('segmentation.seg.nrrd', 'seg.nii.gz')
    """
    return LABEL_OUTPUTS[name].ending if name in LABEL_OUTPUTS else f"seg.{name}"
