"""Names and colours of the objects of a run, and the files that carry them: of 3D Slicer, ITK-SNAP and BIDS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.errors import InputError, UsageError
from accelsurf.io import (
    DICOM_KEY,
    LABELS_KEY,
    InputFiles,
    bids_text,
    color_table_text,
    itk_snap_text,
    read_label_table,
    write_bytes,
)
from accelsurf.output.folder import named_files
from accelsurf.settings.labels import LabelEntry, LabelTable
from accelsurf.settings.mesh_formats import LABEL_OUTPUTS
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.image.volume import Volume
    from accelsurf.run import Result

#: Name of the one object of a run without ids.
ONE = "object"


def entries_of(result: Result, table: LabelTable) -> list[LabelEntry]:
    """Return the name and the colour of each label, in order: of the objects, and of those that a mended map has."""
    return [table[label] for label in result.label_ids]


def check_label_settings(config: RunConfig, volume: Volume, overwrite: bool = False) -> None:
    """Refuse label files that cannot be made of an image, before anything is computed.

    Raises
    ------
    UsageError
        When it needs DICOM and the image is none; InputError when a table of labels cannot be read, or a package lacks.
    """
    from accelsurf.io import dicom_library

    table_of(config)
    if config.label_group is not None:
        from accelsurf.io import check_label_group

        group = check_label_group(volume.source or Path(), config.label_group, overwrite)
        InputFiles(named_files(config)).refuse([group], "--label-group")
    for name in config.also:
        if name not in LABEL_OUTPUTS or not LABEL_OUTPUTS[name].needs_dicom:
            continue
        if DICOM_KEY not in volume.metadata:
            raise UsageError(
                f"also: {name} was given, and the image is no DICOM",
                "leave it out, or give the DICOM of the image",
            )
        dicom_library("highdicom")


def into_image(result: Result, image: Path, overwrite: bool) -> None:
    """Write the label map into the labels of its image.

    Raises
    ------
    OutputError
        When it cannot be written; the other files are complete.
    """
    from accelsurf import io
    from accelsurf.io import put_labels

    group = result.config.label_group
    assert group is not None  # it was asked for
    labels = result.labels_volume()
    kind = io.label_type(int(labels.array.max()))
    volume = labels.with_array(labels.array.astype(kind))
    volume.metadata[LABELS_KEY] = table_of(result.config).of(result.label_ids).to_json()
    put_labels(image, volume, group, overwrite)


def seg_nrrd(result: Result, table: LabelTable, path: Path) -> None:
    """Write a segmentation of 3D Slicer."""
    from accelsurf.io import write_segmentation

    write_segmentation(result.labels_volume(), entries_of(result, table), path)


def itk_snap(result: Result, table: LabelTable, path: Path) -> None:
    """Write label descriptions of ITK-SNAP."""
    write_bytes(path, itk_snap_text(entries_of(result, table)).encode())


def color_table(result: Result, table: LabelTable, path: Path) -> None:
    """Write a colour table of 3D Slicer."""
    write_bytes(path, color_table_text(entries_of(result, table)).encode())


def bids_table(result: Result, table: LabelTable, path: Path) -> None:
    """Write a table of labels as BIDS has it."""
    write_bytes(path, bids_text(entries_of(result, table)).encode())


def table_of(config: RunConfig) -> LabelTable:
    """Return names and colours of labels: from the table of the settings, else from a label map of objects; then from
    settings of single labels.

    Raises
    ------
    InputError
        When a table cannot be read.
    """
    known = LabelTable()
    if config.label_table is not None:
        known = read_label_table(config.label_table)
    elif (given := _label_map_of(config)) is not None and given.lower().endswith(
        (".seg.nrrd", ".dcm")
    ):
        try:
            known = read_label_table(Path(given))
        except InputError:
            known = LabelTable()  # a label map of that name without segments is a label map
    if not config.has_ids and 1 not in known.entries:
        known = LabelTable({**known.entries, 1: LabelEntry(1, ONE, known[1].color)})
    return known.with_settings(config.name, config.color)


def _label_map_of(config: RunConfig) -> str | None:
    """File of the label map that a run begins with."""
    given = config.objects or config.labels
    return None if given is None else given.partition("@")[0]


def given_labels(config: RunConfig) -> LabelTable:
    """Return `table_of` where settings or the file of the objects name labels, else an empty table.

    Pictures have colours of their own for objects without an entry.

    Raises
    ------
    InputError
        When a table cannot be read.

    Examples
    --------
    >>> given_labels(RunConfig(name=["liver"])).entries[1].name, given_labels(RunConfig()).entries
    ('liver', {})
    """
    return (
        table_of(config) if is_named(config) or _label_map_of(config) is not None else LabelTable()
    )


def is_named(config: RunConfig) -> bool:
    """Test if the settings name labels, so that label maps carry names."""
    return bool(config.name or config.color or config.label_table)


#: The writers by the names of `accelsurf.settings.mesh_formats.LABEL_OUTPUTS`, but for DICOM.
LABEL_WRITERS: dict[str, Callable[[Result, LabelTable, Path], None]] = {
    "seg.nrrd": seg_nrrd,
    "itk-snap": itk_snap,
    "ctbl": color_table,
    "tsv": bids_table,
}
