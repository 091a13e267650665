"""Small meshes that claim, repeat or pack too much: refused by name, or read, with little memory and in little time.

All are read in one process, whose address space is limited, and which says for each what it took.
"""

import json
import resource
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.program

MAX_SECONDS, MAX_MB = 5.0, 1000
CORNERS = np.array([[10.0, 20, 30], [11, 20, 30], [10, 22, 30], [10, 20, 33]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
VERTICES = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
LISTS = "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES)
BIG = (10**9, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64)


# ------------------------------------------------------------------------------------------------------- the files


def plys():
    def header(form, vertices=4, faces=4, vertex="", face="", more=""):
        return (
            f"ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
            f"{vertex}element face {faces}\nproperty list uchar int vertex_indices\n{face}{more}end_header\n"
        ).encode()

    rows = b"".join(struct.pack("<B3i", 3, *face) for face in FACES.tolist())
    body = CORNERS.astype("<f4").tobytes() + rows
    for count in (*BIG, -1, -(10**9)):
        yield f"ply vertices {count}", "ply", header("binary_little_endian", vertices=count) + body
        yield f"ply faces {count}", "ply", header("binary_little_endian", faces=count) + body
        yield (
            f"ply text vertices {count}",
            "ply",
            header("ascii", vertices=count) + (VERTICES + LISTS).encode(),
        )
        yield (
            f"ply text faces {count}",
            "ply",
            header("ascii", faces=count) + (VERTICES + LISTS).encode(),
        )
        more = f"element edge {count}\nproperty int vertex1\nproperty int vertex2\n"
        yield (
            f"ply edges {count}",
            "ply",
            header("ascii", more=more) + (VERTICES + LISTS + "0 1\n" * 9).encode(),
        )
        more = f"element extra {count}\n"
        yield f"ply nothing {count}", "ply", header("binary_little_endian", more=more) + body
        counted = header("binary_little_endian").replace(b"list uchar int", b"list uint int")
        long = struct.pack("<I3i", count % 2**32, 0, 1, 2)
        yield f"ply list of {count}", "ply", counted + CORNERS.astype("<f4").tobytes() + long * 4
        text = VERTICES + LISTS.replace("3 ", f"{count} ", 1)
        yield f"ply text list of {count}", "ply", header("ascii") + text.encode()
        text = VERTICES + LISTS.replace("2", str(count))
        yield f"ply point {count}", "ply", header("ascii") + text.encode()
    yield (
        "ply many properties",
        "ply",
        header("ascii", vertex="".join(f"property float p{n}\n" for n in range(50_000))),
    )
    yield (
        "ply many elements",
        "ply",
        header("ascii", more="".join(f"element e{n} 999999999\n" for n in range(50_000))),
    )
    empty = "element e 99999999999\nproperty list uchar int a\n"
    yield "ply empty lists", "ply", header("binary_little_endian", more=empty) + body + bytes(1000)
    yield (
        "ply texture",
        "ply",
        header("ascii", more="comment TextureFile /etc/passwd\n") + (VERTICES + LISTS).encode(),
    )
    yield "ply long line", "ply", header("ascii") + b"1 " * 1_000_000
    yield "ply no end", "ply", b"ply\nformat ascii 1.0\ncomment " + b"a" * 1_000_000


def stls():
    from accelsurf.io.formats import surface_files

    good = surface_files.stl_bytes(CORNERS, FACES, "LPS")
    for count in BIG[:3]:
        yield f"stl {count}", "stl", good[:80] + struct.pack("<I", count) + good[84:]
        yield f"stl zeros {count}", "stl", bytes(80) + struct.pack("<I", count)
    yield "stl solids", "stl", b"solid a\nendsolid a\n" * 50_000
    yield "stl no end", "stl", b"solid " * 200_000
    yield "stl ends", "stl", b"endsolid " * 200_000
    yield "stl vertices", "stl", b"solid a\n" + b"vertex " * 300_000 + b"\nendsolid"
    yield "stl spaces", "stl", b"solid " + b"SPACE" * 200_000 + b"\nendsolid"
    yield "stl equals", "stl", b"solid " + b"SPACE=" * 200_000 + b"\nendsolid"
    yield "stl blanks", "stl", b"solid SPACE" + b" " * 1_000_000 + b"\nendsolid"
    yield "stl blank lines", "stl", b"\n" * 1_000_000
    yield (
        "stl huge numbers",
        "stl",
        b"solid a\nvertex 1e308 1e308 1e999\n" + b"vertex 1 2 3\n" * 2 + b"endsolid a\n",
    )


def objs():
    vertices = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
    faces = [" ".join(str(n + 1) for n in face) for face in FACES]
    lines = "".join(f"f {face}\n" for face in faces)
    for number in (*BIG, -5, -(10**9), 0, -(2**63)):
        for name, face in (
            ("", f"f 1 2 {number}\n"),
            (" texture", f"f 1/{number} 2/1 3/1\n"),
            (" normal", f"f 1//{number} 2//1 3//1\n"),
            (" all", f"f {number}/{number}/{number} 2/1/1 3/1/1\n"),
            (" mixed", f"f 1 2 3 {number}\nf 1 2 3\n"),
        ):
            text = f"{vertices}vt 0 0\nvn 0 0 1\n{lines if not name else ''}{face}"
            yield f"obj{name} {number}", "obj", text.encode()
    yield "obj materials", "obj", (vertices + "mtllib /etc/passwd\nusemtl a\n" + lines).encode()
    for kind in ("usemtl", "o", "g"):
        names = "".join(f"{kind} m{n}\nf 1 2 3\n" for n in range(20_000))
        yield f"obj many {kind}", "obj", (vertices * 5000 + names).encode()
    yield "obj long face", "obj", (vertices + "f " + "1 2 3 " * 200_000 + "\n").encode()
    yield "obj remarks", "obj", (vertices + "#" * 1_000_000 + "\n" + "# SPACE\n" * 50_000).encode()
    yield "obj lines joined", "obj", ("v 0 0 \\\n" * 100_000).encode()


def files():
    for made in (plys, stls, objs):
        yield from made()


# ------------------------------------------------------------------------------------------------------- the tests


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    words = [sys.executable, __file__, str(folder)]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=500, cwd=Path(__file__).parents[2]
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    return dict(json.loads(line) for line in done.stdout.splitlines())


def test_each_is_refused_or_read_in_time(told):
    faults = {
        name: (kind, message, hint, seconds, megabytes)
        for name, (kind, message, hint, seconds, megabytes) in told.items()
        if kind not in ("InputError", "read")
        or seconds > MAX_SECONDS
        or megabytes > MAX_MB
        or (
            kind != "read"
            and (not hint or "\n" in message or len(message) > 1000 or "memory" in message)
        )
    }
    assert len(told) > 100 and not faults, json.dumps(faults, indent=1)


@pytest.mark.parametrize("word", ["stl 4294967295"])
def test_these_are_refused(told, word):
    found = {name: kind for name, (kind, *_) in told.items() if word in name}
    assert found and set(found.values()) == {"InputError"}, found


@pytest.mark.parametrize("name", ["obj materials"])
def test_these_are_read(told, name):
    assert told[name][0] == "read", told[name]


def test_nothing_outside_is_opened(told):
    assert not {name: said[:2] for name, said in told.items() if "opened" in said[1]}


def read_all(folder):
    import resource as limits

    from accelsurf.errors import AccelsurfError
    from accelsurf.io import meshes

    opened = []
    sys.addaudithook(
        lambda event, words: (
            opened.append(words[0]) if event in ("open", "socket.connect") else None
        )
    )
    for suffix in ("ply", "stl", "obj"):  # what is imported is not of a file
        (folder / f"a.{suffix}").write_bytes(b"")
        try:
            meshes.read_mesh(folder / f"a.{suffix}")
        except AccelsurfError:
            pass
    for name, suffix, content in files():
        path = folder / f"a.{suffix}"
        path.write_bytes(content)
        del content
        # The largest memory since now.
        Path("/proc/self/clear_refs").write_text("5")
        before = peak_mb()
        limits.setrlimit(limits.RLIMIT_AS, (3 << 30, -1))
        opened.clear()
        began = time.process_time()  # a busy machine does not count
        try:
            found = "read", str(len(meshes.read_mesh(path)[1])), ""
        except AccelsurfError as error:
            found = type(error).__name__, error.message, error.hint
        except BaseException as error:
            found = "fault", f"{type(error).__name__}: {error}"[:500], ""
        seconds = time.process_time() - began
        others = {str(file) for file in opened} - {str(path), "/proc/meminfo"}
        if others := [file for file in others if not file.endswith((".py", ".pyc", ".so"))]:
            found = "opened", f"opened {others[:3]}", ""
        yield name, (*found, seconds, peak_mb() - before)


def peak_mb():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024


if __name__ == "__main__":
    assert resource
    for told_name, of_it in read_all(Path(sys.argv[1])):
        print(json.dumps([told_name, of_it]), flush=True)
