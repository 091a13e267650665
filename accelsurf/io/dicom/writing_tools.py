"""Identifiers and dates of DICOM objects that do not change from run to run.

pydicom and highdicom make identifiers at random and take dates from the clock. Here both follow from the content:
the same run gives the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import uuid
from typing import Any

from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.sources import dicom_library, quiet

#: Prefix of the identifiers that highdicom draws at random.
RANDOM_PREFIX = "1.2.826.0.1.3680043.10.511.3."
#: Characters that a text of a DICOM value of type LO may have, and SH.
LO = 64
SH = 16


def derived_uid(*parts: str) -> str:
    """A unique identifier that follows from texts: their SHA-256 as a UUID, in decimals after 2.25.

    Examples
    --------
    >>> derived_uid("a", "b")
    '2.25.275704271568797869363586111795216914048'
    >>> derived_uid("a", "b") == derived_uid("ab")
    False
    """
    sha = hashlib.sha256()
    for part in parts:
        content = part.encode()
        sha.update(len(content).to_bytes(8, "little") + content)
    # Version 8 of RFC 9562: a UUID whose bits were selected by its maker.
    number = int.from_bytes(sha.digest()[:16], "big")
    number = number & ~(0xF << 76) & ~(0x3 << 62) | (0x8 << 76) | (0x2 << 62)
    return f"2.25.{uuid.UUID(int=number).int}"


def short_text(text: str, length: int = LO) -> str:
    r"""A text as a DICOM value holds it: one line, no backslash (it separates values), cut at ``length`` characters.

    Examples
    --------
    >>> short_text(" left\\right\n kidney"), short_text("x" * 70) == "x" * 64
    ('left/right kidney', True)
    """
    plain = "".join(letter if letter.isprintable() else " " for letter in text.replace("\\", "/"))
    return " ".join(plain.split())[:length].strip()


def fix(dataset: Any, seed: str, date: str, time: str) -> None:
    """Replace highdicom's random identifiers, and its dates and times from the clock, anywhere in a data set.

    Parameters
    ----------
    dataset : pydicom.Dataset
        Changed in place.
    seed : str
        Text from which the identifiers are derived. The same random one becomes the same derived one everywhere.
    date, time : str
        As DICOM writes them.
    """
    known: dict[str, str] = {}

    def visit(parent: Any, element: Any) -> None:
        if element.VR == "UI" and str(element.value).startswith(RANDOM_PREFIX):
            uid = known.setdefault(str(element.value), derived_uid(seed, "random", str(len(known))))
            element.value = uid
        elif element.keyword == "ContributionDateTime" and parent.get(
            "Manufacturer", ""
        ).startswith("Highdicom"):
            element.value = date + time

    dataset.walk(visit)
    for what in ("InstanceCreation", "Content", "Series"):
        filled(dataset, **{f"{what}Date": date, f"{what}Time": time})


def filled(dataset: Any, **elements: Any) -> Any:
    """Put elements into a data set by their keywords, and return it."""
    for keyword, value in elements.items():
        setattr(dataset, keyword, value)
    return dataset


def data_set(**elements: Any) -> Any:
    """Return a data set with elements by their keywords."""
    return filled(dicom_library().Dataset(), **elements)


def reference(sop_class: str, instance: str, **elements: Any) -> Any:
    """Return an item that refers to an object."""
    return data_set(ReferencedSOPClassUID=sop_class, ReferencedSOPInstanceUID=instance, **elements)


def image_reference(frame: Frame, **elements: Any) -> Any:
    """Return an item that refers to a frame of an image."""
    of_several = {"ReferencedFrameNumber": frame.number + 1} if frame.frames > 1 else {}
    return reference(frame.labels["class"], frame.uids.instance, **of_several, **elements)


def file_bytes(dataset: Any) -> bytes:
    """The bytes of a DICOM file: preamble, file meta information, data set."""
    buffer = io.BytesIO()
    with quiet():
        dataset.save_as(buffer, enforce_file_format=True)
    return buffer.getvalue()
