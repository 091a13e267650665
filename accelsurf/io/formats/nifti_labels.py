"""Names and colours of a label map in an extension of a NIfTI header, in the form of Connectome Workbench.

The extension has the code 30 (CARET) and holds XML; programs that do not know it read the file as any other.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from xml.sax.saxutils import escape

from accelsurf.settings.labels import LabelTable

_CODE = 30
_HEADER, _FIRST = 348, 352
_OFFSET_PLACE = 108


def extension_of(table: LabelTable) -> bytes:
    """The extension: its size, a multiple of 16, its code, and the XML."""
    rows = "".join(
        f'<Label Key="{one.id}" Red="{one.color[0] / 255:.6g}" Green="{one.color[1] / 255:.6g}" '
        f'Blue="{one.color[2] / 255:.6g}" Alpha="1">{escape(one.name)}</Label>\n'
        for one in table
    )
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<CaretExtension>\n<VolumeInformation Index="0">\n<LabelTable>\n'
        f'<Label Key="0" Red="0" Green="0" Blue="0" Alpha="0">background</Label>\n{rows}'
        "</LabelTable>\n<VolumeType>Label</VolumeType>\n</VolumeInformation>\n</CaretExtension>\n"
    ).encode()
    size = -(-(len(text) + 8) // 16) * 16
    return struct.pack("<2i", size, _CODE) + text.ljust(size - 8, b"\0")


def put_labels(path: Path, table: LabelTable) -> None:
    """Put the extension into an uncompressed little-endian NIfTI-1 file that has none."""
    extension = extension_of(table)
    draft = path.with_name("extended.nii")
    with path.open("rb") as old, draft.open("wb") as new:
        header = bytearray(old.read(_FIRST))
        struct.pack_into("<f", header, _OFFSET_PLACE, float(_FIRST + len(extension)))
        header[_HEADER] = 1
        new.write(header)
        new.write(extension)
        while block := old.read(1 << 22):
            new.write(block)
    os.replace(draft, path)
