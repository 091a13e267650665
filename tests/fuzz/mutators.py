"""Mutations of valid inputs: of bytes, of fields, of lines; each follows from the input and a random generator."""

import io
import json
import re
import struct
import warnings
import zipfile

from tests.fuzz import headers

NUMBERS = (
    *(
        "0",
        "-1",
        "1",
        "2",
        "255",
        "65536",
        "2147483647",
        "2147483648",
        "4294967295",
        "4294967296",
        "-2147483648",
    ),
    *(
        "9223372036854775807",
        "18446744073709551616",
        "1e308",
        "-1e308",
        "1e-308",
        "1e400",
        "nan",
        "inf",
        "-inf",
    ),
    *(
        "1e-42",
        "3.4e38",
        "1e39",
        "0.0",
        "-0.0",
        "1e15",
        "1e-15",
        "1,5",
        "0x10",
        "1_000",
        "9" * 400,
        "9" * 5000,
    ),
    *(
        "1.000,5",
        "1e3",
        "1E+2",
        "1d3",
        "1e",
        ".5",
        "5.",
        "+-1",
        "1e9",
        "1e12",
        "\u0663",
        "\u00bd",
        "\u22121",
        "1 2",
    ),
)
#: Powers of ten and of two, and what lies beside them, for fields of whole numbers.
WHOLE = (
    *(
        0,
        1,
        2,
        3,
        7,
        100,
        10**4,
        10**6,
        10**8,
        10**9,
        10**12,
        10**15,
        10**18,
        2**15,
        2**16,
        2**31 - 1,
        2**31,
    ),
    *(
        2**32 - 1,
        2**32,
        2**53,
        2**62,
        2**63 - 1,
        2**63,
        2**64 - 1,
        -1,
        -2,
        -(2**15),
        -(2**31),
        -(2**63),
    ),
)
REAL = (
    *(
        float("nan"),
        float("inf"),
        float("-inf"),
        0.0,
        -0.0,
        -1.0,
        1e-42,
        1e-30,
        1e-9,
        0.5,
        1.5,
        10.0,
        1e3,
        1e6,
        1e9,
    ),
    *(1e15, 1e30, 3e38, 2.0**31, 2.0**63),
)
#: Put in the place of a value of JSON.
VALUES = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        2,
        3,
        4,
        8,
        10**9,
        2**31,
        2**63,
        2**64,
        10**30,
        0.5,
        -0.5,
        1e308,
        1e-308,
        5,
        6,
    ),
    *(
        float("nan"),
        float("inf"),
        "",
        "x",
        "0",
        "1e9",
        "\u65e5",
        "a" * 3000,
        "../..",
        [],
        [1],
        [1, 2, 3],
        {},
        {"a": 1},
    ),
)
WORDS = (
    *(
        "",
        " ",
        "\t",
        "\0",
        "\n",
        "\r",
        "%s",
        "%d",
        "{0}",
        "../../etc/passwd",
        "/dev/zero",
        "/dev/null",
        "@",
        ":",
        "@ras",
    ),
    *(
        "\u65e5\u672c\u8a9e",
        "\u00b2",
        "\uff11\uff12",
        "\ud800",
        "\U0001f600",
        "'",
        '"',
        "\\",
        "#",
        "=",
        "true",
        "[]",
    ),
    *(
        "a" * 5000,
        " " * 5000,
        "[" * 3000,
        "{" * 3000,
        "1" * 5000 + "x",
        "(((",
        "*",
        "+",
        " + ",
        "-",
        ",,,,",
        "vox",
    ),
)
BYTES = (0, 1, 2, 0x7F, 0x80, 0xFE, 0xFF)


def mutated(content: bytes, kind: str, rng, others) -> bytes:
    """One to three mutations; ``kind`` is text, json, mixed (a text header before bytes), zip or binary."""
    if kind == "zip" and rng.random() < 0.7:
        return _member(content, rng, others)
    for _ in range(int(rng.integers(1, 4))):
        if kind == "json":
            content = (
                _of_json(content, rng)
                if rng.random() < 0.7
                else _of_text(content, kind, rng, others)
            )
        elif kind == "text" or (kind == "mixed" and rng.random() < 0.75):
            content = _of_text(content, kind, rng, others)
        else:
            content = _of_bytes(content, rng, others)
    return content


def _of_bytes(content: bytes, rng, others) -> bytes:
    if not content:
        return bytes(rng.integers(0, 256, 8, dtype="u1"))
    out, n = bytearray(content), len(content)
    # Headers are at the beginning of most formats.
    at = int(rng.integers(min(n, 600))) if rng.random() < 0.7 else int(rng.integers(n))
    if rng.random() < 0.3 and (found := headers.fields(content)):
        return changed_field(out, found[int(rng.integers(len(found)))], rng)
    match int(rng.integers(13)):
        case 0:
            for _ in range(int(rng.integers(1, 9))):
                out[int(rng.integers(n))] ^= 1 << int(rng.integers(8))
        case 1:
            out[at] = BYTES[int(rng.integers(len(BYTES)))]
        case 2:
            return content[: int(rng.integers(n))]
        case 10:  # a few bytes short, or half
            return content[: max(n - (1, 1, 2, 7, n // 4, n // 2)[int(rng.integers(6))], 0)]
        case 11:  # two blocks change places
            size = int(rng.integers(1, max(min(n // 2, 512), 1) + 1))
            first, second = sorted(int(v) for v in rng.integers(0, max(n - size, 0) + 1, 2))
            if first + size <= second:
                out[first : first + size], out[second : second + size] = (
                    content[second : second + size],
                    content[first : first + size],
                )
        case 12:  # two inputs joined
            other = others[int(rng.integers(len(others)))]
            return content[:at] + other[at:] if rng.random() < 0.7 else content + other
        case 3:
            return content + bytes(rng.integers(0, 256, int(rng.integers(1, 200)), dtype="u1"))
        case 4:  # a field of 2, 4 or 8 bytes, in either order
            number = WHOLE[int(rng.integers(len(WHOLE)))]
            size = (2, 4, 8)[int(rng.integers(3))]
            order = "little" if rng.random() < 0.5 else "big"
            at -= at % 2
            out[at : at + size] = (number % (1 << (8 * size))).to_bytes(size, order)
        case 5:
            number = REAL[int(rng.integers(len(REAL)))]
            at -= at % 4
            out[at : at + 4] = struct.pack("<f" if rng.random() < 0.7 else ">f", number)
        case 6:
            end = at + int(rng.integers(1, 64))
            return content[:at] + content[end:]
        case 7:
            end = at + int(rng.integers(1, 64))
            return content[:at] + content[at:end] * int(rng.integers(2, 40)) + content[end:]
        case 8:
            other = others[int(rng.integers(len(others)))]
            cut = int(rng.integers(len(other) + 1))
            return content[:at] + other[cut : cut + int(rng.integers(1, 400))] + content[at:]
        case _:  # a small change of a small number: sizes, counts, types
            out[at] = (out[at] + int(rng.integers(-3, 4))) % 256
    return bytes(out)


def changed_field(out: bytearray, field: tuple[int, str], rng) -> bytes:
    """A field of a header gets another number, as large as it holds."""
    at, kind = field
    if kind[-1] in "fd":
        number = REAL[int(rng.integers(len(REAL)))]
        number = (
            min(max(number, -3e38), 3e38)
            if kind[-1] == "f" and abs(number) < float("inf")
            else number
        )
        struct.pack_into(kind, out, at, number)
    else:
        bits = 8 * struct.calcsize(kind)
        before = struct.unpack_from(kind, out, at)[0]
        change = (
            WHOLE[int(rng.integers(len(WHOLE)))]
            if rng.random() < 0.6
            else before + int(rng.integers(-3, 4))
        )
        change %= 1 << bits
        struct.pack_into(
            kind,
            out,
            at,
            change - (1 << bits) if kind[-1].islower() and change >> (bits - 1) else change,
        )
    return bytes(out)


def _member(content: bytes, rng, others) -> bytes:
    """A member of an archive is mutated, with a right checksum; or left out, or there twice."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [(item, archive.read(item)) for item in archive.infolist()]
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, OSError, EOFError):
        return _of_bytes(content, rng, others)
    at = int(rng.integers(len(members)))
    item, inner = members[at]
    chance = rng.random()
    if chance < 0.05:
        members.pop(at)
    elif chance < 0.1:
        members.append(members[at])
    else:
        text = item.filename.endswith((".model", ".xml", ".rels", ".json", ".txt"))
        members[at] = (
            item,
            mutated(inner, "text" if text else "mixed", rng, [each for _, each in members]),
        )
    packed = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(packed, "w") as archive:
        warnings.simplefilter("ignore")  # a name twice is what is wanted
        for item, inner in members:
            archive.writestr(zipfile.ZipInfo(item.filename), inner, item.compress_type)
    return packed.getvalue()


def _of_json(content: bytes, rng) -> bytes:
    """A value becomes another, of another type, goes, or its key is there twice."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return content
    places = list(_places(document))
    if not places:
        return content
    holder, key = places[int(rng.integers(len(places)))]
    value = VALUES[int(rng.integers(len(VALUES)))]
    match int(rng.integers(6)):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            again = json.dumps(document).replace(
                json.dumps(key) + ":",
                f"{json.dumps(key)}: {json.dumps(value)},\n{json.dumps(key)}:",
                1,
            )
            return again.encode()
        case 2 if isinstance(holder, list):
            holder.insert(key, value)
        case 3 if isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
            holder[key] = (holder[key] + 1, -holder[key], holder[key] * 1000, str(holder[key]))[
                int(rng.integers(4))
            ]
        case _:
            holder[key] = value
    return json.dumps(document, indent=1).encode()


def _places(value):
    """Each list or dictionary of a document with each of its keys."""
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from _places(value[key])


def _of_text(content: bytes, kind: str, rng, others) -> bytes:
    head, mark, rest = _split(content) if kind == "mixed" else (content, b"", b"")
    text = head.decode("utf-8", "surrogateescape")
    match int(rng.integers(9)):
        case 0 | 1 | 2:  # a number becomes another
            found = list(re.finditer(r"[-+]?\d[\d.eE+-]*", text))
            if found:
                one = found[int(rng.integers(len(found)))]
                text = (
                    text[: one.start()]
                    + NUMBERS[int(rng.integers(len(NUMBERS)))]
                    + text[one.end() :]
                )
        case 3:  # a word goes in
            at = int(rng.integers(len(text) + 1))
            text = text[:at] + WORDS[int(rng.integers(len(WORDS)))] + text[at:]
        case 4:  # a word becomes another
            found = list(re.finditer(r"[\w./-]+", text))
            if found:
                one = found[int(rng.integers(len(found)))]
                text = (
                    text[: one.start()] + WORDS[int(rng.integers(len(WORDS)))] + text[one.end() :]
                )
        case 5 | 6:  # lines twice, away, in another order
            lines = text.splitlines(keepends=True)
            if lines:
                at, to = int(rng.integers(len(lines))), int(rng.integers(len(lines) + 1))
                line = lines[at] if rng.random() < 0.5 else lines.pop(at)
                lines.insert(to, line)
                text = "".join(lines[: len(lines) - int(rng.random() < 0.3)])
        case 7:
            at = int(rng.integers(len(text) + 1))
            text = text[:at] + text[at + int(rng.integers(1, 12)) :]
        case _:
            other = others[int(rng.integers(len(others)))].decode("utf-8", "replace")
            cut, at = int(rng.integers(len(other) + 1)), int(rng.integers(len(text) + 1))
            text = text[:at] + other[cut : cut + int(rng.integers(1, 60))] + text[at:]
    return text.encode("utf-8", "replace" if "\ud800" in text else "surrogateescape") + mark + rest


def _split(content: bytes) -> tuple[bytes, bytes, bytes]:
    """A text header, its end and what follows."""
    for mark in (b"\n\n", b"ElementDataFile = LOCAL\n", b"end_header\n", b"<AppendedData"):
        if mark in content:
            return content.partition(mark)
    return content, b"", b""
