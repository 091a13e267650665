"""Formats of meshes, contours and further files of the objects: one entry each.

From an entry follow the values and the help of ``--mesh`` and ``--also``, ``accelsurf info`` and the reference page.
The functions that read and write them are in `accelsurf.io.meshes`, `accelsurf.measure.surface_mesh`,
`accelsurf.measure.contours` and `accelsurf.output.outputs`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from accelsurf.settings.file_formats import label_formats
from accelsurf.settings.registry import by_name

#: Content of a mesh file: the surface in a volume, or the contours in an image of one slice.
Shape = Literal["surface", "contour"]


@dataclass(frozen=True)
class MeshFormat:
    """All that is said about a format of surfaces and contours.

    Attributes
    ----------
    name : str
        As it is given to ``--mesh``; also the ending of its files.
    help : str
        Description in a few words.
    shapes : tuple of str
        Which of the two, surface and contour, it holds.
    auto : tuple of str
        Of which of the two ``--mesh auto`` writes it.
    """

    name: str
    help: str
    shapes: tuple[Shape, ...] = ("surface",)
    auto: tuple[Shape, ...] = ()

    @property
    def suffix(self) -> str:
        """The ending of its files."""
        return f".{self.name}"


MESH_FORMATS: dict[str, MeshFormat] = by_name(
    MeshFormat("ply", "PLY, binary", auto=("surface",)),
    MeshFormat("stl", "STL, binary"),
    MeshFormat("obj", "Wavefront OBJ"),
    MeshFormat(
        "vtp", "VTK PolyData, triangles or lines", ("surface", "contour"), auto=("contour",)
    ),
    MeshFormat("glb", "glTF 2.0 in one file"),
    MeshFormat("csv", "a table of points", ("contour",), auto=("contour",)),
)


def mesh_formats(shape: Shape) -> tuple[str, ...]:
    """Names of the formats that hold surfaces, or contours.

    Examples
    --------
    >>> mesh_formats("surface"), mesh_formats("contour")
    (('ply', 'stl', 'obj', 'vtp', 'glb'), ('vtp', 'csv'))
    """
    return tuple(name for name, form in MESH_FORMATS.items() if shape in form.shapes)


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
    needs_dicom : bool
        Whether the image must be DICOM.
    """

    name: str
    help: str
    ending: str
    needs_dicom: bool = False


LABEL_OUTPUTS: dict[str, LabelOutput] = by_name(
    LabelOutput(
        "seg.nrrd",
        "segmentation of 3D Slicer",
        "segmentation.seg.nrrd",
    ),
    LabelOutput(
        "itk-snap",
        "label descriptions of ITK-SNAP",
        "labels.txt",
    ),
    LabelOutput(
        "ctbl",
        "colour table of 3D Slicer",
        "labels.ctbl",
    ),
    LabelOutput("tsv", "table of labels as in BIDS", "dseg.tsv"),
    LabelOutput(
        "dicom-seg",
        "DICOM segmentation, of an image in DICOM",
        "segmentation.dcm",
        needs_dicom=True,
    ),
    LabelOutput(
        "dicom-labelmap",
        "the same as a label map, which is smaller; few programs read it",
        "labelmap.dcm",
        needs_dicom=True,
    ),
    LabelOutput(
        "rtstruct",
        "DICOM structure set, of an image in DICOM",
        "rtstruct.dcm",
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
