"""DICOM Segmentations of a run: binary, one bit a voxel, or as a label map."""

from __future__ import annotations

from pathlib import Path

from accelsurf import __version__
from accelsurf.io.dicom.segmentation import Algorithm, segmentation_bytes
from accelsurf.io.files import write_bytes
from accelsurf.report.dicom_source import objects_of, seed_of, source_of
from accelsurf.segmentation.result import Result
from accelsurf.settings.labels import LabelTable


def write(result: Result, table: LabelTable, path: Path) -> None:
    """Write the objects as the segments of a binary DICOM Segmentation.

    Parameters
    ----------
    result : Result
        Of an image that was read from DICOM.
    table : LabelTable
        Names and colours of the segments.
    path : Path
        The file; an existing one is replaced.

    Raises
    ------
    UsageError
        When the image was not read from DICOM, no object is left, or a package is missing.
    InputError
        When the slices cannot be read any more, or have no identifiers.
    OutputError
        When the file cannot be written.
    """
    _write(result, table, path, as_labelmap=False)


def write_labelmap(result: Result, table: LabelTable, path: Path) -> None:
    """Write the objects as a DICOM Label Map Segmentation, compressed; parameters and errors as of `write`."""
    _write(result, table, path, as_labelmap=True)


def _write(result: Result, table: LabelTable, path: Path, as_labelmap: bool) -> None:
    source = source_of(result)
    parameters = {"energy": result.config.energy, "flow": result.config.flow}
    seed = seed_of("labelmap" if as_labelmap else "segmentation", result, table, source)
    content = segmentation_bytes(
        result.labels, result.geometry, source, [table[one.id] for one in objects_of(result)],
        Algorithm(__version__, parameters), seed, as_labelmap,
    )
    write_bytes(path, content)
