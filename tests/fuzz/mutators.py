"""Mutations of valid inputs: of bytes, of fields, of lines; each follows from the input and a random generator."""

import re
import struct

NUMBERS = (
    *("0", "-1", "1", "2", "255", "65536", "2147483647", "2147483648", "4294967295", "4294967296", "-2147483648"),
    *("9223372036854775807", "18446744073709551616", "1e308", "-1e308", "1e-308", "1e400", "nan", "inf", "-inf"),
    *("1e-42", "3.4e38", "1e39", "0.0", "-0.0", "1e15", "1e-15", "1,5", "0x10", "1_000", "9" * 400, "9" * 5000),
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
    *("\u65e5\u672c\u8a9e", "\u00b2", "\uff11\uff12", "\ud800", "\U0001f600", "'", '"', "\\", "#", "=", "true", "[]"),
    *("a" * 5000, " " * 5000, "[" * 3000, "{" * 3000, "1" * 5000 + "x", "(((", "*", "+", " + ", "-", ",,,,", "vox"),
)
BYTES = (0, 1, 2, 0x7F, 0x80, 0xFE, 0xFF)


def mutated(content: bytes, kind: str, rng, others) -> bytes:
    """One to three mutations; ``kind`` is text, mixed (a text header before bytes) or binary."""
    for _ in range(int(rng.integers(1, 4))):
        if kind == "text" or (kind == "mixed" and rng.random() < 0.75):
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
    match int(rng.integers(10)):
        case 0:
            for _ in range(int(rng.integers(1, 9))):
                out[int(rng.integers(n))] ^= 1 << int(rng.integers(8))
        case 1:
            out[at] = BYTES[int(rng.integers(len(BYTES)))]
        case 2:
            return content[: int(rng.integers(n))]
        case 3:
            return content + bytes(rng.integers(0, 256, int(rng.integers(1, 200)), dtype="u1"))
        case 4:  # a field of 2, 4 or 8 bytes, in either order
            number = int(NUMBERS[int(rng.integers(11))])
            size = (2, 4, 8)[int(rng.integers(3))]
            order = "little" if rng.random() < 0.5 else "big"
            at -= at % 2
            out[at : at + size] = (number % (1 << (8 * size))).to_bytes(size, order)
        case 5:
            number = (float("nan"), float("inf"), 3e38, -1.0, 0.0, 1e-42, 1e-30, 1e30)[int(rng.integers(8))]
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


def _of_text(content: bytes, kind: str, rng, others) -> bytes:
    head, mark, rest = _split(content) if kind == "mixed" else (content, b"", b"")
    text = head.decode("utf-8", "surrogateescape")
    match int(rng.integers(9)):
        case 0 | 1 | 2:  # a number becomes another
            found = list(re.finditer(r"[-+]?\d[\d.eE+-]*", text))
            if found:
                one = found[int(rng.integers(len(found)))]
                text = text[: one.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + text[one.end() :]
        case 3:  # a word goes in
            at = int(rng.integers(len(text) + 1))
            text = text[:at] + WORDS[int(rng.integers(len(WORDS)))] + text[at:]
        case 4:  # a word becomes another
            found = list(re.finditer(r"[\w./-]+", text))
            if found:
                one = found[int(rng.integers(len(found)))]
                text = text[: one.start()] + WORDS[int(rng.integers(len(WORDS)))] + text[one.end() :]
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
