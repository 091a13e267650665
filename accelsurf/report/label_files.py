"""Files of the objects that carry names and colours: of 3D Slicer, ITK-SNAP and BIDS.

Libraries are loaded where a file is written: commands ask here what can be written before they load any.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.errors import UsageError
from accelsurf.io.file_set import InputFiles
from accelsurf.io.files import write_bytes
from accelsurf.io.headers import DICOM_KEY, LABELS_KEY
from accelsurf.report.inputs import named_files
from accelsurf.settings.label_outputs import LABEL_OUTPUTS
from accelsurf.settings.labels import LabelEntry, LabelTable
from accelsurf.settings.registry import load
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.grid.volume import Volume
    from accelsurf.segmentation.result import Result


def entries_of(result: Result, table: LabelTable) -> list[LabelEntry]:
    """What is known of each object, in order of their ids."""
    return [table[one.id] for one in result.objects]


def check(config: RunConfig, volume: Volume, overwrite: bool = False) -> None:
    """Refuse what cannot be made of an image, before anything is computed.

    Raises
    ------
    UsageError
        When it needs DICOM and the image is none; InputError when a table of labels cannot be read, or a package lacks.
    """
    from accelsurf.io.dicom.library import library
    from accelsurf.report.label_names import table_of

    table_of(config)
    if config.label_group is not None:
        group = load("accelsurf.io.formats.ome_labels:check")(volume.source or Path(), config.label_group, overwrite)
        InputFiles(named_files(config)).refuse([group], "--label-group")
    for name in config.also:
        if name not in LABEL_OUTPUTS or not LABEL_OUTPUTS[name].needs_dicom:
            continue
        if DICOM_KEY not in volume.metadata:
            raise UsageError(
                f"also: {name} was given, and the image is no DICOM", "leave it out, or give the DICOM of the image"
            )
        library("highdicom")


def into_image(result: Result, image: Path, overwrite: bool) -> None:
    """Write the label map into the labels of its image.

    Raises
    ------
    OutputError
        When it cannot be written; the other files are complete.
    """
    from accelsurf import io
    from accelsurf.report.label_names import table_of

    labels = result.labels_volume()
    kind = io.label_type(int(labels.array.max()))
    volume = labels.with_array(labels.array.astype(kind))
    volume.metadata[LABELS_KEY] = table_of(result.config).of(one.id for one in result.objects).to_json()
    load("accelsurf.io.formats.ome_labels:put")(image, volume, result.config.label_group, overwrite)


def seg_nrrd(result: Result, table: LabelTable, path: Path) -> None:
    """Write a segmentation of 3D Slicer."""
    from accelsurf.io.formats.nrrd_metaimage import write_segmentation

    write_segmentation(result.labels_volume(), entries_of(result, table), path)


def itk_snap(result: Result, table: LabelTable, path: Path) -> None:
    """Write label descriptions of ITK-SNAP."""
    _write_text(path, result, table, "itk_snap_text")


def color_table(result: Result, table: LabelTable, path: Path) -> None:
    """Write a colour table of 3D Slicer."""
    _write_text(path, result, table, "color_table_text")


def bids_table(result: Result, table: LabelTable, path: Path) -> None:
    """Write a table of labels as BIDS has it."""
    _write_text(path, result, table, "bids_text")


def _write_text(path: Path, result: Result, table: LabelTable, maker: str) -> None:
    """Write what a function of `accelsurf.io.label_tables` makes."""
    text: str = load(f"accelsurf.io.label_tables:{maker}")(entries_of(result, table))
    write_bytes(path, text.encode())
