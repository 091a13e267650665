"""Small inputs that claim, repeat or pack too much: refused by name, with little memory and in little time.

All are built and read in one process, whose address space is limited, and which says for each what it took.
"""

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.program

NAMES = (
    "gzip of 2 GB",
    "nrrd of 2 GB",
    "png of 128 MB",
    "tiff of shared tags",
    "tiff of shared strips",
    "OME text",
    "energy of digits",
    "energy of blanks",
    "start of digits",
    "deep TOML",
    "deep report",
    "image as objects",
    "large triangles",
    "packed checkpoint",
    "large table",
    "many terms",
    "many edits",
    "long numbers in TOML",
    "packed TIFF that claims much",
    "text that claims much",
    "many balls",
    "long path",
    "wide path",
)
#: Memory beyond that of the program itself, which is what it imports.
MAX_SECONDS, MAX_RSS_MB = 5.0, 700


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bombs")
    done = subprocess.run(
        [sys.executable, __file__, str(folder)],
        capture_output=True,
        text=True,
        timeout=200,
        cwd=Path(__file__).parents[2],
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", NAMES)
def test_each_is_refused_in_time(told, name):
    kind, message, seconds, rss_mb = told[name]
    assert kind in ("InputError", "UsageError"), message
    assert seconds < MAX_SECONDS and rss_mb < MAX_RSS_MB, (seconds, rss_mb, message)
    assert len(message) < 1000 and "memory" not in message, message


# ------------------------------------------------------------------------------------------------- in the child


def bombs(folder):
    """Name -> what reads the input, which is made when it is called for."""
    import gzip
    import io as streams
    import struct
    import zlib

    import numpy as np

    from accelsurf import io, segment, segment_objects
    from accelsurf.image.volume import Volume
    from accelsurf.io import meshes
    from accelsurf.io.formats import png, tiff_file
    from accelsurf.io.states import from_bytes
    from accelsurf.settings.energy_expression import EnergyText
    from accelsurf.settings.run_config import RunConfig
    from accelsurf.text.clicks import read_clicks
    from accelsurf.text.objects import read_objects
    from accelsurf.text.starts import parse_start
    from accelsurf.viewer.movie_file import run_of_folder

    small = Volume.from_array(np.arange(120, dtype=np.int16).reshape(4, 5, 6))

    def made(name, content):
        (folder / name).write_bytes(content)
        return folder / name

    def nifti():
        io.write(small, folder / "s.nii")
        zeros = gzip.compress(bytes(1 << 26), 1) * 32
        return io.read(made("a.nii.gz", gzip.compress((folder / "s.nii").read_bytes(), 1) + zeros))

    def nrrd(encoding, body, sizes="6 5 4"):
        head = f"NRRD0004\ntype: short\ndimension: 3\nsizes: {sizes}\nendian: little\nencoding: {encoding}\n\n"
        return io.read(made("a.nrrd", head.encode() + body))

    def picture():
        plain = png.png_bytes(small.array[:1].astype(np.uint8), (1.0, 1.0, 1.0))
        body = b"IDAT" + zlib.compress(bytes(1 << 27), 1)
        at = plain.index(b"IDAT") - 4
        length = struct.unpack(">I", plain[at : at + 4])[0]
        chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
        return io.read(made("a.png", plain[:at] + chunk + plain[at + 12 + length :]))

    def shared_tags(tags):
        """Pages whose entries point to the same 4 MB."""
        entries = [
            (256, 3, 1, 6),
            (257, 3, 1, 5),
            (258, 3, 1, 8),
            (259, 3, 1, 8),
            (262, 3, 1, 1),
            *tags,
        ]
        count, at, out = (
            1 << 20,
            8 + (4 << 20),
            [struct.pack("<2sHI", b"II", 42, 8 + (4 << 20)), bytes(range(4)) * (1 << 20)],
        )
        for page in range(400):
            at += 2 + 12 * len(entries) + 4
            out.append(struct.pack("<H", len(entries)))
            out += [struct.pack("<HHII", *entry) for entry in entries]
            out.append(struct.pack("<I", at if page < 399 else 0))
        assert count
        return io.read(made("a.tif", b"".join(out)))

    def shared_strips():
        content = bytearray(tiff_file.tiff_bytes(np.zeros((1, 64, 64), np.uint8), (1.0, 1.0, 1.0)))
        body = zlib.compress(bytes(1 << 22), 1)
        strips = 20_000
        offsets, lengths = len(content), len(content) + 4 * strips
        data = lengths + 4 * strips
        for place in range(len(content) - 12):
            tag = struct.unpack_from("<HHI", content, place)
            if tag == (273, 4, 1):
                struct.pack_into("<II", content, place + 4, strips, offsets)
            if tag == (279, 4, 1):
                struct.pack_into("<II", content, place + 4, strips, lengths)
        content += struct.pack("<I", data) * strips + struct.pack("<I", len(body)) * strips + body
        return io.read(made("a.tif", bytes(content)))

    def described(text):
        values = tiff_file.tiff_bytes(small.array.astype(np.uint16), (1.0, 1.0, 1.0))
        at, old = values.index(b"ImageJ"), values.index(struct.pack("<HH", 270, 2))
        content = bytearray(values) + text.encode()
        struct.pack_into("<II", content, old + 4, len(text), len(values))
        assert at
        io.read(made("a.tif", bytes(content)))
        # The text holds nothing that matters: what counts is that it was passed over in no time.
        return EnergyText("")

    def claims(compression):
        content = bytearray(tiff_file.tiff_bytes(np.zeros((1, 64, 64), np.uint8), (1.0, 1.0, 1.0)))
        for place in range(len(content) - 12):
            tag, kind, count = struct.unpack_from("<HHI", content, place)
            if (tag, kind, count) in ((256, 4, 1), (257, 4, 1), (278, 4, 1)):
                struct.pack_into("<I", content, place + 8, 20_000)
            if (tag, kind, count) == (259, 3, 1):
                struct.pack_into("<I", content, place + 8, compression)
        return io.read(made("a.tif", bytes(content)))

    def deep_report():
        made("a_report.json", b"[" * 1_000_000)
        return run_of_folder(folder)

    def triangles():
        points = np.array([[0, 0, 0], [500, 0, 0], [0, 500, 0], [0, 0, 500]], float)
        faces = np.tile([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], (20_000, 1))
        return meshes.voxels_inside(points, faces, (512, 512, 512))

    def checkpoint():
        stream = streams.BytesIO()
        np.savez_compressed(stream, tree=np.zeros(1 << 28, np.uint8))
        return from_bytes(stream.getvalue(), {})

    def many_balls():
        rows = "".join("1,0,0,0,100\n" for _ in range(100_000))
        made("a.csv", f"id,x,y,z,r\n{rows}".encode())
        image = Volume.from_array(np.zeros((64, 64, 64), np.float32))
        return read_objects(str(folder / "a.csv"), image.geometry, 2)

    noise = np.random.default_rng(0).integers(0, 256, (48, 48, 48)).astype(np.uint8)
    wide = Volume.from_array(np.zeros((80, 90, 100), np.uint8))
    toml = folder / "a.toml"
    return {
        "gzip of 2 GB": nifti,
        "nrrd of 2 GB": lambda: nrrd("gzip", gzip.compress(bytes(1 << 26), 1) * 32),
        "png of 128 MB": picture,
        "tiff of shared tags": lambda: shared_tags([(273, 4, 1 << 20, 8), (279, 4, 1 << 20, 8)]),
        "tiff of shared strips": shared_strips,
        "OME text": lambda: described("<OME <Pixels " + "a" * 2_000_000 + ">"),
        "energy of digits": lambda: EnergyText("1" * 100_000 + "x*chan-vese"),
        "energy of blanks": lambda: RunConfig(energy="chan-vese" + " " * 100_000 + "x"),
        "start of digits": lambda: parse_start("label:a@" + "1" * 10_000),
        "deep TOML": lambda: (
            made("a.toml", b"energy = " + b"[" * 200_000),
            RunConfig.from_toml(toml),
        ),
        "long numbers in TOML": lambda: (
            made("a.toml", b"seed = " + b"9" * 200_000),
            RunConfig.from_toml(toml),
        ),
        "deep report": deep_report,
        "image as objects": lambda: segment_objects(noise.astype(np.float32), noise),
        "large triangles": triangles,
        "packed checkpoint": checkpoint,
        "large table": lambda: read_objects(
            str(made("b.csv", b"id,x,y,z,r\n" + b"1,1,1,1,1\n" * 500_000)), small.geometry, 2
        ),
        "many terms": lambda: segment(noise, energy=" + ".join(["local-region"] * 500)),
        "many edits": lambda: RunConfig(edit=[{"step": n, "cfl": 0.4} for n in range(20_000)]),
        "packed TIFF that claims much": lambda: claims(32773),
        "text that claims much": lambda: nrrd("ascii", b"1 2 3", "600 500 400"),
        "many balls": many_balls,
        "long path": lambda: segment(noise, inside="path:" + "1,2,3,4;" * 1_000_000),
        "wide path": lambda: read_clicks(
            ["path:" + ";".join(["1,2,3,1e9"] * 10_000)], "inside", wide
        ),
    }


def peak_mb():
    """Largest memory of this process; `ru_maxrss` has that of the process it was forked from, too."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(folder):
    from accelsurf.errors import AccelsurfError

    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    out, known = {}, bombs(Path(folder))
    own = peak_mb()
    for name, read in known.items():
        began = time.perf_counter()
        try:
            found = "read", repr(read())[:200]
        except AccelsurfError as error:
            found = type(error).__name__, error.message
        except BaseException as error:
            found = "fault", f"{type(error).__name__}: {error}"[:500]
        out[name] = (*found, time.perf_counter() - began, peak_mb() - own)
    print(json.dumps(out))


if __name__ == "__main__":
    main(sys.argv[1])
