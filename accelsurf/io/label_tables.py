"""Tables of labels: names and colours in files of ITK-SNAP, 3D Slicer and BIDS, in CSV, and within label maps.

A line that is not understood is an error with its number; nothing is guessed.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import unescape

from accelsurf.errors import InputError, UsageError
from accelsurf.io.cells import table_text, text_of_cell
from accelsurf.io.files import library_named, naming
from accelsurf.io.format_functions import functions_of
from accelsurf.io.headers import split_name
from accelsurf.settings.file_formats import image_format
from accelsurf.settings.labels import (
    MAX_NAME,
    Color,
    LabelEntry,
    LabelTable,
    colored,
    default_color,
)
from accelsurf.settings.wording import shown

#: Bytes of a table: beyond that it is none.
_MAX_BYTES = 1 << 22
_MAX_ID = 2**32 - 1
_WHOLE = re.compile(r"[0-9]{1,10}")
_ITK_SNAP = re.compile(
    r'\s*([0-9]{1,10})\s+([0-9]{1,10})\s+([0-9]{1,10})\s+([0-9]{1,10})\s+([0-9.eE+-]+)\s+([01])\s+([01])\s+"(.*)"\s*'
)
_CARET = 30
_CARET_LABEL = re.compile(r"<Label ([^>]{1,400})>(.{0,400}?)</Label>", re.DOTALL)
_ATTRIBUTE = re.compile(r'(\w+)="([^"]*)"')
_SEGMENT = re.compile(r"Segment([0-9]{1,10})_(Name|Color|LabelValue)\s*:?=\s*(.*)")
_ID_COLUMNS = ("index", "id", "label", "labelvalue")
_NAME_COLUMNS = ("name", "label_name")
_HEAD = "################################################\n# ITK-SnAP Label Description File\n"


def read_label_table(path: str | os.PathLike[str]) -> LabelTable:
    r"""Read names and colours of labels.

    Parameters
    ----------
    path : path-like
        Label descriptions of ITK-SNAP (.txt, .label), a colour table of 3D Slicer (.ctbl), a table with columns index
        or id, name, and color or r, g, b (.tsv as of BIDS, .csv), the header of a .seg.nrrd, or the label table in that
        of a .nii or .nii.gz, or the segments of a DICOM segmentation (.dcm).

    Raises
    ------
    InputError
        When the file is missing, or a line of it is not understood.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "labels.csv")
    ...     _ = file.write_text("id,name,color\n4,left kidney,#0080ff\n")
    ...     read_label_table(file)[4]
    LabelEntry(id=4, name='left kidney', color=(0, 128, 255))
    """
    path = Path(path)
    with naming(path):
        if split_name(path)[1].startswith(".nii") and path.is_file():
            return LabelTable({entry.id: entry for entry in _of_nifti(path)})
        if (
            path.is_file()
            and (form := image_format(split_name(path)[1])) is not None
            and (listing := functions_of(form).listing) is not None
        ):
            return _of_segments(listing(path))
        if not path.is_file():
            raise InputError("there is no such file", "check the path of the label table")
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
        if _reader(path) is _of_seg_nrrd:
            content = content.partition(b"\n\n")[0]
        if len(content) > _MAX_BYTES:
            raise InputError(
                f"a file of more than {_MAX_BYTES} bytes given, a table expected",
                "is it another file?",
            )
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise InputError(
                "this is no text in UTF-8, a table of labels expected", "save it as UTF-8"
            ) from None
        return LabelTable({entry.id: entry for entry in _reader(path)(text)})


def _reader(path: Path) -> Callable[[str], Iterable[LabelEntry]]:
    name = path.name.lower()
    if name.endswith((".nrrd", ".nhdr")):
        return _of_seg_nrrd
    if name.endswith(".ctbl"):
        return _of_color_table
    if name.endswith((".csv", ".tsv")):
        return lambda text: _of_columns(text, "\t" if name.endswith(".tsv") else ",")
    if name.endswith((".txt", ".label")):
        return _of_itk_snap
    known = ".txt, .label, .ctbl, .tsv, .csv, .seg.nrrd or .dcm"
    raise InputError(f"unknown kind of label table, {known} expected", "rename it")


def _entry(number: int, label: str, name: str, color: Color) -> LabelEntry:
    """An entry; the number is that of its line."""
    label, name = label.strip(), " ".join(name.split())
    if not _is_whole(label) or int(label) > _MAX_ID:
        raise InputError(
            f"line {number}: label {label[:40]!r}, a whole number expected", "correct the table"
        )
    if not name or len(name) > MAX_NAME or not name.isprintable():
        raise InputError(
            f"line {number}: a name of 1 to {MAX_NAME} letters expected", "correct the table"
        )
    if not all(0 <= part <= 255 for part in color):
        message = f"line {number}: colour {shown(str(color))}, numbers of 0 to 255 expected"
        raise InputError(message, "correct the table")
    return LabelEntry(int(label), name, color)


def _is_whole(text: str) -> bool:
    """Test if a text is a whole number without a sign, of a length that can be meant."""
    return _WHOLE.fullmatch(text) is not None


def _lines(text: str) -> Iterable[tuple[int, str]]:
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _of_itk_snap(text: str) -> Iterable[LabelEntry]:
    for number, line in _lines(text):
        found = _ITK_SNAP.fullmatch(line)
        if found is None:
            raise InputError(
                f'line {number}: IDX R G B A VIS MSH "NAME" expected', "is this a file of ITK-SNAP?"
            )
        label, red, green, blue = (found.group(n) for n in range(1, 5))
        if int(label) > 0:
            yield _entry(number, label, found.group(8), (int(red), int(green), int(blue)))


def _of_color_table(text: str) -> Iterable[LabelEntry]:
    for number, line in _lines(text):
        parts = line.split()
        if len(parts) != 6 or not all(map(_is_whole, (parts[0], *parts[2:]))):
            raise InputError(
                f"line {number}: ID NAME R G B A expected", "is this a colour table of 3D Slicer?"
            )
        if int(parts[0]) > 0:
            red, green, blue = map(int, parts[2:5])
            yield _entry(number, parts[0], parts[1].replace("_", " "), (red, green, blue))


def _of_columns(text: str, delimiter: str) -> Iterable[LabelEntry]:
    with library_named("the table is damaged", "save it as CSV again"):
        first, *rows = [*csv.reader(io.StringIO(text), delimiter=delimiter)] or [[]]
    head = [cell.strip().lower() for cell in first]
    label = next((name for name in _ID_COLUMNS if name in head), None)
    name = next((name for name in _NAME_COLUMNS if name in head), None)
    if label is None or name is None:
        raise InputError(
            f"columns {', '.join(head)[:80]} given, index (or id) and name expected",
            "add a first line",
        )
    for number, row in enumerate(rows, 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(head):
            raise InputError(
                f"line {number}: {len(row)} cells, {len(head)} expected", "correct the table"
            )
        cells = dict(zip(head, row, strict=True))
        if cells[label].strip() == "0":
            continue
        yield _entry(
            number, cells[label], text_of_cell(cells[name]), _color_of(number, cells, cells[label])
        )


def _color_of(number: int, cells: dict[str, str], label: str) -> Color:
    text = cells.get("color", "").strip()
    if text and text.lower() != "n/a":
        try:
            return colored(text)[1]
        except UsageError:
            raise InputError(
                f"line {number}: colour {text[:40]}, #rrggbb expected", "correct the table"
            ) from None
    parts = [cells.get(name, "").strip() for name in ("r", "g", "b")]
    if all(map(_is_whole, parts)):
        red, green, blue = map(int, parts)
        return red, green, blue
    if any(parts):
        raise InputError(
            f"line {number}: r, g, b {', '.join(parts)[:40]}, whole numbers expected",
            "correct the table",
        )
    return default_color(int(label) if _is_whole(label.strip()) else 1)


def _of_seg_nrrd(text: str) -> Iterable[LabelEntry]:
    found: dict[str, dict[str, str]] = {}
    for line in text.splitlines():
        match = _SEGMENT.match(line)
        if match is not None:
            found.setdefault(match.group(1), {})[match.group(2)] = match.group(3).strip()
    if not found:
        raise InputError(
            "no Segment0_Name is in the header of this NRRD", "give a .seg.nrrd of 3D Slicer"
        )
    for number, keys in sorted(found.items(), key=lambda item: int(item[0])):
        label = keys.get("LabelValue", str(int(number) + 1))
        try:
            red, green, blue = (round(255 * float(part)) for part in keys["Color"].split())
        except (KeyError, ValueError, OverflowError):
            red, green, blue = default_color(int(label) if _is_whole(label) else 1)
        yield _entry(int(number), label, keys.get("Name", f"Segment {number}"), (red, green, blue))


def _of_segments(volumes: list[dict[str, Any]]) -> LabelTable:
    """The segments of a DICOM segmentation."""
    found = next((entry["segments"] for entry in volumes if entry["segments"]), None)
    if found is None:
        raise InputError(
            "a DICOM series given, a segmentation expected", "give a file with names, or a table"
        )
    return LabelTable(
        {row["id"]: LabelEntry(row["id"], row["name"], colored(row["color"])[1]) for row in found}
    )


def _of_nifti(path: Path) -> Iterable[LabelEntry]:
    """The label table that Connectome Workbench and accelsurf put into the header."""
    from accelsurf.io.formats.nifti import extensions_of

    text = next((content for code, content in extensions_of(path) if code == _CARET), None)
    if text is None:
        raise InputError(
            "no label table is in the header of this NIfTI", "give one with names, or a table"
        )
    for number, match in enumerate(_CARET_LABEL.finditer(text), 1):
        keys = dict(_ATTRIBUTE.findall(match.group(1)))
        if keys.get("Key") == "0":
            continue
        try:
            red, green, blue = (round(255 * float(keys[part])) for part in ("Red", "Green", "Blue"))
        except (KeyError, ValueError, OverflowError):
            raise InputError(
                f"label {number} of the header has no colour", "save it again"
            ) from None
        name = match.group(2).removeprefix("<![CDATA[").removesuffix("]]>")
        yield _entry(number, keys.get("Key", ""), unescape(name), (red, green, blue))


def itk_snap_text(entries: Iterable[LabelEntry]) -> str:
    """Label descriptions of ITK-SNAP.

    Examples
    --------
    >>> print(itk_snap_text([LabelEntry(1, "liver", (200, 60, 60))]).splitlines()[-1])
        1   200   60   60        1  1  1    "liver"
    """
    rows = [
        (0, (0, 0, 0), 0, "Clear Label"),
        *((entry.id, entry.color, 1, entry.name) for entry in entries),
    ]
    lines = [
        f'{label:5d} {color[0]:5d} {color[1]:4d} {color[2]:4d} {seen:8d} {seen:2d} {seen:2d}    "{_quoted(name)}"'
        for label, color, seen, name in rows
    ]
    return _HEAD + "# IDX   -R-  -G-  -B-  -A--  VIS MSH  LABEL\n" + "\n".join(lines) + "\n"


def _quoted(name: str) -> str:
    return name.replace('"', "'")


def color_table_text(entries: Iterable[LabelEntry]) -> str:
    """A colour table of 3D Slicer; spaces in names are underscores.

    Examples
    --------
    >>> print(color_table_text([LabelEntry(2, "left kidney", (1, 2, 3))]).splitlines()[-1])
    2 left_kidney 1 2 3 255
    """
    rows = [
        f"{entry.id} {entry.name.replace(' ', '_')} {' '.join(map(str, entry.color))} 255"
        for entry in entries
    ]
    return (
        "\n".join(["# Color table file", "# label name R G B A", "0 background 0 0 0 0", *rows])
        + "\n"
    )


def bids_text(entries: Iterable[LabelEntry]) -> str:
    """A table of labels as BIDS has it beside a discrete segmentation.

    Examples
    --------
    >>> print(bids_text([LabelEntry(1, "liver", (200, 60, 60))]).splitlines()[-1].expandtabs(1))
    1 liver #c83c3c
    """
    rows = [(entry.id, entry.name, entry.hex) for entry in entries]
    return table_text(("index", "name", "color"), rows, "\t")
