"""Where formats have numbers in their headers: sizes, types, places of the data."""

import struct

_NIFTI_1 = [(0, "i"), *((at, "h") for at in range(40, 56, 2)), (70, "h"), (72, "h")]
_NIFTI_1 += [*((at, "f") for at in range(76, 124, 4)), (123, "B"), (252, "h"), (254, "h")]
_NIFTI_1 += [(at, "f") for at in range(256, 328, 4)]
_NIFTI_2 = [(0, "i"), (12, "h"), (14, "h"), *((at, "q") for at in range(16, 80, 8))]
_NIFTI_2 += [
    *((at, "d") for at in range(104, 168, 8)),
    (168, "q"),
    (176, "d"),
    (184, "d"),
    (344, "i"),
    (348, "i"),
]
_NIFTI_2 += [*((at, "d") for at in range(352, 496, 8)), (500, "i")]
_MGH = [*((at, "i") for at in range(0, 28, 4)), (28, "h"), *((at, "f") for at in range(30, 90, 4))]
_STL = [(80, "I"), *((at, "f") for at in range(84, 134, 4))]


def fields(content: bytes) -> list[tuple[int, str]]:
    """Place and kind (as of `struct`) of each number of a header; empty where the format is not known here."""
    found, n = [], len(content)
    if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        found = _of_tiff(content)
    elif n > 348 and struct.unpack_from("<i", content)[0] in (348, 540):
        found = [
            (at, "<" + kind) for at, kind in (_NIFTI_1 if content[:2] == b"\x5c\x01" else _NIFTI_2)
        ]
    elif n > 284 and content[:4] == b"\0\0\0\1":
        found = [(at, ">" + kind) for at, kind in _MGH]
    elif content[128:132] == b"DICM":
        found = _of_dicom(content)
    elif n > 84 and n == 84 + 50 * struct.unpack_from("<I", content, 80)[0]:
        found = [(at, "<" + kind) for at, kind in _STL]
    return [(at, kind) for at, kind in found if at + struct.calcsize(kind) <= n]


def _of_tiff(content: bytes) -> list[tuple[int, str]]:
    """Tag, type, count and value of each entry of the first directories."""
    order = "<" if content[:1] == b"I" else ">"
    big = content[2:4] in (b"+\0", b"\0+")
    size, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    found = [(8 if big else 4, order + size)]
    for _ in range(8):
        try:
            at = struct.unpack_from(found[-1][1], content, found[-1][0])[0]
            entries = struct.unpack_from(order + count, content, at)[0]
        except struct.error:
            break
        if not at or entries > 100:
            break
        found.append((at, order + count))
        at += struct.calcsize(count)
        for place in range(at, at + entries * entry, entry):
            found += [(place, order + "H"), (place + 2, order + "H"), (place + 4, order + size)]
            found += [(place + 4 + struct.calcsize(size), order + kind) for kind in ("H", size)]
        found.append((at + entries * entry, order + size))
    return found


def _of_dicom(content: bytes) -> list[tuple[int, str]]:
    """Lengths of elements of explicit kinds, and 16-bit values, one after the other until one is not understood."""
    found, at = [], 132
    while at + 12 <= len(content):
        kind = content[at + 4 : at + 6]
        if kind in (b"OB", b"OW", b"SQ", b"UN", b"UT", b"OF", b"OD"):
            found.append((at + 8, "<I"))
            length, at = struct.unpack_from("<I", content, at + 8)[0], at + 12
        elif kind.isalpha() and kind.isupper():
            found.append((at + 6, "<H"))
            length, at = struct.unpack_from("<H", content, at + 6)[0], at + 8
            if kind == b"US":
                found += [(at, "<H")] * 4  # rows, columns, bits: rather these than lengths
        else:
            break
        at += 0 if length == 0xFFFFFFFF else length
    return found
