"""What may be written of the objects beside the label map: one entry each, the values of ``--also``.

A format of images writes the label map once more. The others carry names and colours, or outlines.
"""

from __future__ import annotations

from dataclasses import dataclass

from accelsurf.settings.file_formats import Function, label_formats
from accelsurf.settings.registry import Registry


@dataclass(frozen=True)
class LabelOutput:
    """A file of the objects.

    Attributes
    ----------
    name : str
        As it is given to ``--also``.
    help : str
        What it is, in a few words.
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
        "seg.nrrd", "segmentation of 3D Slicer", "segmentation.seg.nrrd", "accelsurf.report.label_files:seg_nrrd"
    ),
    LabelOutput("itk-snap", "label descriptions of ITK-SNAP", "labels.txt", "accelsurf.report.label_files:itk_snap"),
    LabelOutput("ctbl", "colour table of 3D Slicer", "labels.ctbl", "accelsurf.report.label_files:color_table"),
    LabelOutput("tsv", "table of labels as in BIDS", "dseg.tsv", "accelsurf.report.label_files:bids_table"),
    LabelOutput(
        "dicom-seg", "DICOM segmentation, of an image in DICOM", "segmentation.dcm",
        "accelsurf.report.dicom_seg:write_segmentation", needs_dicom=True,
    ),
    LabelOutput(
        "dicom-labelmap", "the same as a label map, which is smaller; few programs read it", "labelmap.dcm",
        "accelsurf.report.dicom_seg:write_labelmap", needs_dicom=True,
    ),
    LabelOutput(
        "rtstruct", "DICOM structure set, of an image in DICOM", "rtstruct.dcm",
        "accelsurf.report.dicom_seg:write_structure_set", needs_dicom=True,
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
    """The same with what each is, as the help says it."""
    own = (f"{name} ({entry.help})" for name, entry in LABEL_OUTPUTS.items())
    return ", ".join([*own, "or a format of label maps"])


def ending_of(name: str) -> str:
    """The end of the name of a file.

    Examples
    --------
    >>> ending_of("seg.nrrd"), ending_of("nii.gz")
    ('segmentation.seg.nrrd', 'seg.nii.gz')
    """
    return LABEL_OUTPUTS[name].ending if name in LABEL_OUTPUTS else f"seg.{name}"
