"""Small TIFF and PNG files and folders of slices that announce far too much: refused at once, with little memory.

All are read in one process whose address space may grow by 1 GiB, as if the machine had any memory.
"""

import json
import resource
import struct
import subprocess
import sys
import time
import zlib
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.program

MAX_SECONDS, MAX_GROWTH = 5.0, 1 << 30  # of processor time: other processes do not count
HUGE = 10**9


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("claims")
    command, root = [sys.executable, __file__, str(folder)], Path(__file__).parents[3]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, cwd=root)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    return json.loads(done.stdout)


# ------------------------------------------------------------------------------------------------------ inputs

#: Tag, type and values of the entries of a page of 16 x 12 bytes; the others are those of the strip.
TAGS = [
    (254, 4, [0]),
    (256, 4, [16]),
    (257, 4, [12]),
    (258, 3, [8]),
    (259, 3, [1]),
    (262, 3, [1]),
    (270, 2, b"a\0"),
    (274, 3, [1]),
    (277, 3, [1]),
    (278, 4, [12]),
    (282, 5, [2, 1]),
    (283, 5, [2, 1]),
    (284, 3, [1]),
    (296, 3, [1]),
    (317, 3, [1]),
    (338, 3, [0]),
    (339, 3, [1]),
    (330, 4, [8]),
    (320, 3, [0] * 768),
]
CODES = {1: "B", 2: "s", 3: "H", 4: "I", 5: "I", 16: "Q"}


def tiff(order="<", big=False, changes=None, text=b"", pages=1, following=None, body=bytes(192)):
    """A TIFF whose entries are changed: by tag, (type, number, value)."""
    word, entry = ("Q", 20) if big else ("I", 12)
    # Tags that a plain page has not are there where they are changed.
    changes, shown = changes or {}, [tag for tag in TAGS if tag[0] not in (254, 317, 320, 330, 338)]
    shown += [tag for tag in TAGS if tag[0] in changes and tag not in shown]
    if text:
        shown = [tag for tag in shown if tag[0] != 270] + [(270, 2, text + b"\0")]
    out = bytearray(
        struct.pack(
            order + "2sHHHQ" if big else order + "2sHI",
            *(
                (b"II" if order == "<" else b"MM", 43, 8, 0, 16)
                if big
                else (b"II" if order == "<" else b"MM", 42, 8)
            ),
        )
    )
    counted = [*shown, (273, 4, [0]), (279, 4, [len(body)])]
    for page in range(pages):
        length = (8 if big else 2) + entry * len(counted) + (8 if big else 4)
        here, beyond, far = len(out), len(out) + length, b""
        rows = []
        for tag, kind, values in sorted(counted):
            raw = (
                values if kind == 2 else struct.pack(f"{order}{len(values)}{CODES[kind]}", *values)
            )
            count = len(values) // (2 if kind == 5 else 1)
            if tag == 273:
                raw = None
            elif len(raw) > (8 if big else 4):
                raw, far = struct.pack(order + word, beyond + len(far)), far + raw
            rows.append((tag, kind, count, raw))
        at = beyond + len(far)
        out += struct.pack(order + ("Q" if big else "H"), len(rows))
        for tag, kind, count, raw in rows:
            raw = struct.pack(order + "I", at) if raw is None else raw
            kind, count, value = changes.get(tag, (kind, count, None))
            raw = raw if value is None else struct.pack(order + word, value)
            out += struct.pack(order + "HH" + word, tag, kind, count) + raw.ljust(
                8 if big else 4, b"\0"
            )
        following_page = at + len(body) if page < pages - 1 else 0
        out += (
            struct.pack(order + word, following_page if following is None else following(here))
            + far
            + body
        )
    return bytes(out)


TIFFS = {
    "little": {},
    "big-endian": {"order": ">"},
    "BigTIFF": {"big": True},
    "pages": {"pages": 14},
    "ImageJ": {"text": b"ImageJ=1.53\nimages=1\nunit=um\nspacing=2\n"},
}


def damages():
    """Changes of entries that announce much: name -> by tag, type, number and value."""
    out = {}
    for tag, kind, _ in [*TAGS, (273, 4, [0]), (279, 4, [0])]:
        if tag != 320:
            out[f"{HUGE} values of tag {tag}"] = {tag: (kind, HUGE, None)}
        for other in (1, 3, 4, 5, 12, 16):
            out[f"tag {tag} of type {other}, twice {HUGE}"] = {tag: (other, 2 * HUGE, 16)}
    out |= {
        "width": {256: (4, 1, HUGE)},
        "rows and columns": {256: (4, 1, 2**32 - 1), 257: (4, 1, 2**32 - 1)},
        "height in strips of a row": {257: (4, 1, HUGE), 278: (4, 1, 1)},
        "rows of a strip": {278: (4, 1, 0)},
        "samples": {277: (4, 1, HUGE)},
        "samples as a fraction": {277: (5, 1, 8)},
        "many samples": {277: (4, 1, 65535)},
        "packed": {256: (4, 1, 40_000), 257: (4, 1, 40_000), 278: (4, 1, 40_000), 259: (4, 1, 8)},
        "packed by LZW": {
            256: (4, 1, 40_000),
            257: (4, 1, 40_000),
            278: (4, 1, 40_000),
            259: (4, 1, 5),
        },
        "levels in a circle": {330: (4, 1, 8)},
    }
    return out


def tiny_directories(_):
    """A directory without an entry at every place, each with the next."""
    return b"II*\0\x08\0\0\0" + b"".join(
        struct.pack("<HI", 0, 8 + 6 * (n + 1)) for n in range(1_000_000)
    )


def directories_upon_one_another(_):
    """Each has 4096 entries, which are those of the next but one."""
    out = bytearray(struct.pack("<2sHI", b"II", 42, 8) + bytes(4_000_000))
    for at in range(8, 3_000_000, 64):
        struct.pack_into("<H", out, at, 4000)
        struct.pack_into("<I", out, at + 2 + 12 * 4000, at + 64)
    return bytes(out)


STACKS = {
    "TIFF: tiny directories": tiny_directories,
    "TIFF: directories upon one another": directories_upon_one_another,
    "TIFF: a circle": lambda _: tiff(following=lambda here: here),
    "TIFF: one far away": lambda _: tiff(following=lambda _: 2**32 - 2),
}
XML = (
    '<?xml version="1.0"?>{head}<OME><Image><Pixels DimensionOrder="XYZCT" Type="uint8" SizeX="16" SizeY="12" '
    "{sizes}>{data}</Pixels></Image></OME>"
)
SIZES = 'SizeZ="1" SizeC="1" SizeT="1"'
MANY = '<TiffData IFD="0" FirstZ="{0}"><UUID FileName="{0}.tif">{0}</UUID></TiffData>'
BOMB = (
    "<!DOCTYPE a [<!ENTITY a0 'aaaaaaaaaa'>"
    + "".join(f"<!ENTITY a{n + 1} '{f'&a{n};' * 10}'>" for n in range(12))
    + "]>"
)


def ome(sizes=SIZES, data="<TiffData/>", head=""):
    return XML.format(sizes=sizes, data=data, head=head)


TEXTS = {
    **{
        f"ImageJ: {line}": "ImageJ=1.53\n" + line
        for line in (
            f"images={HUGE}",
            f"images={2**40}",
            "images=4000000",
            f"slices={HUGE}",
            f"images=1\nframes={HUGE}",
            f"images={HUGE}\nchannels={HUGE}",
            f"images={HUGE}\nframes=1000\nslices=1000000",
            f"images={'9' * 4000}",
            f"images={'9' * 100_000}",
            f"spacing={'9' * 1_000_000}x",
        )
    },
    **{
        f"OME: {axis}": ome(
            f'{SIZES} Size{axis}1="{HUGE}"'.replace(f'Size{axis}="1"', "").replace("1=", "=")
        )
        for axis in "ZCT"
    },
    "OME: all pages that are allowed": ome(
        'SizeZ="4194304" SizeC="1" SizeT="1"', '<TiffData PlaneCount="4194304"/>'
    ),
    "OME: pages": ome(data=f'<TiffData PlaneCount="{HUGE}"/>'),
    "OME: entities": ome(head=BOMB, data="&a12;"),
    "OME: files": ome(
        'SizeZ="60000" SizeC="1" SizeT="1"', "".join(MANY.format(n) for n in range(60_000))
    ),
    "OME: depth": ome(data="<a>" * 1_000_000),
    "OME: attributes": ome(data="<a " + " ".join(f'b{n}="1"' for n in range(200_000)) + "/>"),
    "OME: a number": ome(f'SizeZ="{"9" * 1_000_000}" SizeC="1" SizeT="1"'),
    "tifffile: axes": '{"shape": [' + "1000000000, " * 3 + '12, 16], "axes": "TCZYX"}',
    "tifffile: depth": '{"shape": [' + "[" * 60_000 + '"axes"',
}


def png(*parts, width=16, height=12, depth=8, colour=0, rows=None):
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    rows = bytes(17 * 12) if rows is None else rows
    every = ((b"IHDR", head), *parts, (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in every
    )


@cache
def packed_zeros():
    return zlib.compress(bytes(1 << 28), 9)


PNGS = {
    "PNG: columns and rows": lambda: png(width=2**31 - 1, height=2**31 - 1),
    "PNG: beyond 31 bits": lambda: png(width=2**32 - 1, height=2**32 - 1, depth=16),
    "PNG: rows": lambda: png(height=HUGE),
    "PNG: a colour": lambda: png(width=HUGE, depth=16, colour=6),
    "PNG: unpacked beyond its end": lambda: png(rows=bytes(1 << 28)),
    "PNG: a part of 2 GB": lambda: png().replace(
        b"\0\0\0\0IEND", struct.pack(">I", 2**31 - 1) + b"teXt"
    ),
    "PNG: packed text": lambda: png((b"zTXt", b"a\0\0" + packed_zeros())),
    "PNG: packed text in UTF-8": lambda: png((b"iTXt", b"a\0\1\0\0\0" + packed_zeros())),
    "PNG: packed profile": lambda: png((b"iCCP", b"a\0\0" + packed_zeros())),
    "PNG: a part that counts": lambda: png((b"CgBI", b"abcd")),
}
#: They are read: what is packed in them is not unpacked.
HARMLESS = {
    "PNG: wrong profile": lambda: png((b"iCCP", b"a\0\0abc")),
    "PNG: significant bits": lambda: png((b"sBIT", b"\5")),
    "PNG: a palette of a grey image": lambda: png((b"PLTE", b"abc")),
    "PNG: more after its end": lambda: png() + struct.pack(">I", 2**32 - 1) + b"abcd" * 9,
    "PNG: parts": lambda: png(*[(b"teXt", b"")] * 100_000),
}


def many_slices(folder):
    """More files than a folder of slices may have."""
    (folder / "slices").mkdir()
    for number in range((1 << 16) + 1):
        (folder / "slices" / f"{number}.tif").touch()
    return folder / "slices" / "*.tif"


FOLDERS = {"slices: too many": many_slices}


# ------------------------------------------------------------------------------------------------------- tests


@pytest.mark.parametrize("kind", [*TIFFS, "TIFF", "ImageJ", "OME", "tifffile", "PNG", "slices"])
def test_each_is_refused_at_once_or_read_as_it_is(told, kind):
    """Read where what announces much says nothing about voxels: a palette beside grey values, a circle of levels."""
    shape = "(14, 12, 16)" if kind == "pages" else "(1, 12, 16)"
    mine = {
        name: found
        for name, found in told.items()
        if name.startswith(f"{kind}:") and name not in HARMLESS
    }
    assert mine
    refused = sum(readings[0][0] != "read" for readings in mine.values())
    assert (
        refused >= 0.8 * len(mine) or kind == "tifffile"
    )  # its axes are heeded where they fit the pages
    for name, readings in mine.items():
        for error, message, hint, seconds in readings:
            if error == "read":
                assert message in (shape, "(1, 1, 1)"), name
                continue
            assert error in ("InputError", "UsageError") and hint, (name, error, message)
            assert seconds < MAX_SECONDS, (name, seconds, message)
            assert len(message) < 1000 and "fit into memory" not in message, (name, message)


@pytest.mark.parametrize("name", HARMLESS)
def test_parts_that_say_nothing_about_pixels_are_not_unpacked(told, name):
    for kind, message, _, seconds in told[name]:
        assert kind == "read" and message == "(1, 12, 16)", message
        assert seconds < MAX_SECONDS


# ------------------------------------------------------------------------------------------------- in the child


def inputs(folder):
    """Name and path of each, written when it is asked for."""
    for kind, options in TIFFS.items():
        for name, changes in damages().items():
            (folder / "a.tif").write_bytes(tiff(changes=changes, **options))
            yield f"{kind}: {name}", folder / "a.tif"
    for name, made in STACKS.items():
        (folder / "a.tif").write_bytes(made(None))
        yield name, folder / "a.tif"
    for name, text in TEXTS.items():
        (folder / "a.tif").write_bytes(tiff(text=text.encode()))
        yield name, folder / "a.tif"
    for name, made in (PNGS | HARMLESS).items():
        (folder / "a.png").write_bytes(made())
        yield name, folder / "a.png"
    for name, made in FOLDERS.items():
        yield name, made(folder)


def main(folder):
    from accelsurf import io
    from accelsurf.errors import AccelsurfError

    (folder / "plain.tif").write_bytes(tiff())
    (folder / "plain.png").write_bytes(png())
    for path in (
        folder / "plain.tif",
        folder / "plain.png",
    ):  # what is imported for it does not count
        assert io.read(path).array.shape == (1, 12, 16)
    grown = (
        int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MAX_GROWTH
    )
    resource.setrlimit(resource.RLIMIT_AS, (grown, grown))
    out = {}
    for name, path in inputs(folder):
        out[name] = []
        readers = [lambda path: io.read(path, memory_bytes=1 << 62)]
        if path.suffix == ".tif":
            readers.append(lambda path: io.open_volume(path).read((slice(0, 1),) * 3))
        for read in readers:
            began = time.process_time()
            try:
                found = "read", str(getattr(read(path), "shape", "") or read(path).array.shape), ""
            except AccelsurfError as error:
                found = type(error).__name__, error.message, error.hint
            except BaseException as error:
                found = "fault", f"{type(error).__name__}: {error}"[:500], ""
            out[name].append((*found, time.process_time() - began))
    print(json.dumps(out))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
