"""Headers that announce up to 10^18 of something: each reader refuses them in no time and next to no memory.

Valid files are made small, one size in their headers is changed at a time, and every reader is asked for the result.
All is done in one process that may have little more memory than it has after its imports.
"""

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from accelsurf.settings.file_formats import IMAGE_FORMATS

SIZES = [10**power for power in (5, 6, 8, 9, 10, 12, 15, 18)]
MAX_SECONDS, MORE_BYTES = 5.0, 1 << 30
#: Formats whose claims other tests change.
ELSEWHERE = {
    "ome.zarr",
    "png",
    "tif",
    "dcm",
    "slices",
    "hdr",
}  # the header of a pair is that of nii
KINDS = (
    "nii",
    "nii2",
    "nii.gz",
    "nii2.gz",
    "nrrd",
    "nrrd gzip",
    "nrrd 4D",
    "nhdr",
    "mha",
    "mha 4D",
    "mha packed",
    "mhd",
    "mgz",
    "mgh",
    "npy",
    "npy 4D",
    "long files",
    "state",
    "checkpoint",
    "tables",
    "label tables",
    "texts",
)


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("claims")
    done = subprocess.run(
        [sys.executable, __file__, str(folder)],
        capture_output=True,
        text=True,
        timeout=280,
        cwd=Path(__file__).parents[2],
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert not done.stderr, done.stderr[-2000:]  # no line of a library beside ours
    return json.loads(done.stdout)


def test_every_format_is_among_them():
    assert set(IMAGE_FORMATS) - ELSEWHERE <= set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_claims_are_refused_in_time(told, kind):
    cases = told[kind]
    assert len(cases) >= 10
    faults = [case for case in cases if case[1] not in ("refused", "read") or case[3] > MAX_SECONDS]
    assert not faults, faults[:5]
    refused = [case for case in cases if case[1] == "refused"]
    assert len(refused) > 0.4 * len(cases)
    assert all(
        len(message) < 1000 and "fit into memory" not in message for _, _, message, _ in refused
    )


# ------------------------------------------------------------------------------------------------- in the child


def files(folder):
    """Yield (kind, what was changed, what reads it); each file is made when it is asked for."""
    import gzip
    import struct
    import zlib

    import nibabel
    import numpy as np

    from accelsurf import io
    from accelsurf.image.volume import Volume
    from accelsurf.io import channels, label_tables

    small = Volume.from_array(np.arange(120, dtype="<i2").reshape(4, 5, 6))
    voxels = small.array.tobytes()
    count = 0

    def made(suffix, content):
        nonlocal count
        count += 1
        path = folder / f"c{count}{suffix}"
        path.write_bytes(content)
        return path

    def images(kind, suffix, name, content):
        path = made(suffix, content)
        for read in (
            io.read,
            io.read_labels,
            io.open_volume,
            io.read_sequence,
            channels.read_channels,
        ):
            yield kind, f"{name} {read.__name__}", lambda read=read: read(path)
        if suffix in (".nii", ".nii.gz", ".nrrd", ".nhdr"):
            yield kind, f"{name} label table", lambda: label_tables.read_label_table(path)

    def packed_into(content, places, sizes=SIZES):
        """The content with each number (code, offset) changed."""
        for code, at in places:
            for size in sizes:
                changed = bytearray(content)
                try:
                    struct.pack_into(code, changed, at, float(size) if code[1] == "f" else size)
                except struct.error:
                    struct.pack_into(code, changed, at, 256 ** struct.calcsize(code) // 2 - 1)
                yield f"{at}={size}", bytes(changed)

    def texts_of(text, numbers, sizes=SIZES):
        """A text header with each of its numbers, marked as <n>, changed."""
        for which in range(len(numbers)):
            for size in sizes:
                given = [size if n == which else number for n, number in enumerate(numbers)]
                out = text
                for n, number in enumerate(given):
                    out = out.replace(f"<{n}>", str(number))
                yield f"{which}={size}", out.encode()

    io.write(small, folder / "s.nii")
    first = (folder / "s.nii").read_bytes()
    second = (
        nibabel.Nifti2Image(small.array.T, np.diag([1.0, 2.0, 3.0, 1.0])).to_bytes()[:544] + voxels
    )
    places1 = [("<h", 42 + 2 * n) for n in range(7)] + [("<f", 108)]
    places2 = [("<q", 24 + 8 * n) for n in range(7)] + [("<q", 168)]
    for kind, content, places in (("nii", first, places1), ("nii2", second, places2)):
        at = 40 if kind == "nii" else 16
        for axes in (3, 4, 5, 7):
            head = bytearray(content)
            struct.pack_into("<h" if kind == "nii" else "<q", head, at, axes)
            for n in range(axes, 3, -1):
                struct.pack_into(
                    "<h" if kind == "nii" else "<q", head, at + (2 if kind == "nii" else 8) * n, 1
                )
            for name, changed in packed_into(head, places):
                yield from images(kind, ".nii", f"{axes} {name}", changed)
                if axes == 4:
                    yield from images(
                        f"{kind}.gz", ".nii.gz", f"{axes} {name}", gzip.compress(changed, 1)
                    )

    nrrd = "NRRD0004\ntype: short\ndimension: 3\nsizes: <0> <1> <2>\nendian: little\nencoding: {}\n{}\n"
    four = "NRRD0004\ntype: short\ndimension: 4\nsizes: <0> <1> <2> <3>\nendian: little\nencoding: raw\nkinds: {}\n\n"
    for name, changed in texts_of(
        nrrd.format("raw", "byte skip: <3>\nline skip: <4>\n"), (6, 5, 4, 0, 0)
    ):
        yield from images("nrrd", ".nrrd", name, changed + voxels)
    for name, changed in texts_of(nrrd.format("gzip", ""), (6, 5, 4)):
        yield from images("nrrd gzip", ".nrrd", name, changed + gzip.compress(voxels))
    for kinds in ("domain domain domain time", "list domain domain domain"):
        for name, changed in texts_of(four.format(kinds), (6, 5, 2, 2)):
            yield from images("nrrd 4D", ".nrrd", name, changed + voxels)
    (folder / "v.raw").write_bytes(voxels)
    for name, changed in texts_of(
        nrrd.format("raw", "data file: v.raw\nbyte skip: <3>\n"), (6, 5, 4, 0)
    ):
        yield from images("nhdr", ".nhdr", name, changed)

    meta = (
        "NDims = 3\nDimSize = <0> <1> <2>\nElementNumberOfChannels = <3>\nHeaderSize = <4>\nElementType = MET_SHORT\n"
        "ElementDataFile = {}\n"
    )
    for name, changed in texts_of(meta.format("LOCAL"), (6, 5, 4, 1, 0)):
        yield from images("mha", ".mha", name, changed + voxels)
    for name, changed in texts_of(meta.format("v.raw"), (6, 5, 4, 1, 0)):
        yield from images("mhd", ".mhd", name, changed)
    text = (
        "NDims = 4\nDimSize = <0> <1> <2> <3>\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    )
    for name, changed in texts_of(text, (6, 5, 2, 2)):
        yield from images("mha 4D", ".mha", name, changed + voxels)
    packed = zlib.compress(voxels)
    text = (
        "NDims = 3\nDimSize = <0> <1> <2>\nCompressedData = True\nCompressedDataSize = <3>\nElementType = MET_SHORT\n"
        "ElementDataFile = LOCAL\n"
    )
    for name, changed in texts_of(text, (6, 5, 4, len(packed))):
        yield from images("mha packed", ".mha", name, changed + packed)

    mgh = (
        struct.pack(">7ih", 1, 6, 5, 4, 1, 4, 0, 0).ljust(284, b"\0")
        + small.array.astype(">i2").tobytes()
    )
    for name, changed in packed_into(mgh, [(">i", 4 + 4 * n) for n in range(5)]):
        yield from images("mgh", ".mgh", name, changed)
        yield from images("mgz", ".mgz", name, gzip.compress(changed, 1))

    def array(shape, body=voxels, kind="<i2"):
        text = (
            str({"descr": kind, "fortran_order": False, "shape": tuple(shape)}).encode().ljust(117)
            + b"\n"
        )
        return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text + body

    for n in range(3):
        for size in SIZES:
            shape = [size if n == axis else length for axis, length in enumerate((4, 5, 6))]
            yield from images("npy", ".npy", f"{n}={size}", array(shape))
            yield from images(
                "npy 4D", ".npy", f"{n}={size}", array([*shape[:n], size, *shape[n:]])
            )

    def long(name, content, length):
        """A file with all that it announces: a hole, so that it takes no place on the disk."""
        path = folder / name
        path.write_bytes(content)
        with path.open("r+b") as file:
            file.truncate(length)
        for read in (io.read, io.open_volume, io.read_sequence, channels.read_channels):
            yield "long files", f"{name} {read.__name__}", lambda read=read: read(path)

    many = bytearray(second)
    for n, length in enumerate((1, 1, 10**9)):
        struct.pack_into("<q", many, 24 + 8 * n, length)
    yield from long("long.nii", many, 544 + 2 * 10**9)
    struct.pack_into("<q", many, 16, 4)
    for n, length in enumerate((1, 1, 1, 10**9)):
        struct.pack_into("<q", many, 24 + 8 * n, length)
    yield from long("frames.nii", many, 544 + 2 * 10**9)
    yield from long("long.npy", array((10**9, 1, 1), b""), 128 + 2 * 10**9)
    text = nrrd.format("raw", "").replace("<0> <1> <2>", "1 1 1000000000").encode()
    yield from long("long.nrrd", text, len(text) + 2 * 10**9)
    text = (
        b"NDims = 3\nDimSize = 1 1 1000000000\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    )
    yield from long("long.mha", text, len(text) + 2 * 10**9)

    yield from states(made, array)
    yield from tables(made, small)


def states(made, array):
    """Files of states whose members claim too much."""
    import io as streams
    import zipfile

    from accelsurf.interact.state_file import read_state
    from accelsurf.run.checkpoint import read_checkpoint

    def archive(content, kind):
        stream = streams.BytesIO()
        with zipfile.ZipFile(stream, "w", kind) as out:
            out.writestr("tree.npy", content)
        return stream.getvalue()

    for size in SIZES:
        for name, shape in (("long", (size,)), ("wide", (1, size))):
            for kind in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA):
                path = made(".npz", archive(array(shape, bytes(1 << 20), "|u1"), kind))
                yield "state", f"{name} {size} {kind}", lambda path=path: read_state(path)
                yield "checkpoint", f"{name} {size} {kind}", lambda path=path: read_checkpoint(path)


def tables(made, small):
    """Tables and texts with huge numbers."""
    from accelsurf.io import label_tables
    from accelsurf.settings.labels import parse_ids
    from accelsurf.settings.run_config import RunConfig
    from accelsurf.text.clicks import read_clicks
    from accelsurf.text.object_clicks import read_object_clicks
    from accelsurf.text.objects import read_objects

    for size in [*SIZES, 10**30, 10**400]:
        for place in range(5):
            row = ",".join(str(size) if n == place else "1" for n in range(5))
            balls = made(".csv", f"id,x,y,z,r\n{row}\n".encode())
            yield (
                "tables",
                f"balls {place} {size}",
                lambda path=balls: read_objects(str(path), small.geometry, 2),
            )
            sides = made(".csv", f"id,x,y,z,r,side\n{row},inside\n".encode())
            yield (
                "tables",
                f"sides {place} {size}",
                lambda path=sides: read_object_clicks(str(path), small.geometry),
            )
            points = ",".join(["1,1,1,1", row.partition(",")[2]][place > 0].split(","))
            stroke = made(".csv", f"x,y,z,r\n{points}\n".encode())
            yield (
                "tables",
                f"stroke {place} {size}",
                lambda path=stroke: read_clicks([f"stroke:{path}"], "inside", small),
            )
        for suffix, text in (
            (".csv", f"id,name\n{size},a\n"),
            (".tsv", f"index\tname\n{size}\ta\n"),
            (".ctbl", f"{size} a 1 2 3 4\n"),
            (".ctbl", f"1 a {size} 2 3 4\n"),
            (".txt", f'{size} 1 2 3 1 1 1 "a"\n'),
            (".txt", f'1 {size} 2 3 1 1 1 "a"\n'),
            (".csv", f"id,name,r,g,b\n1,a,{size},0,0\n"),
            (".seg.nrrd", f"NRRD0004\nSegment{size}_Name:=a\n\n"),
            (".seg.nrrd", f"NRRD0004\nSegment0_Name:=a\nSegment0_LabelValue:={size}\n\n"),
        ):
            path = made(suffix, text.encode())
            yield (
                "label tables",
                f"{suffix} {size}",
                lambda path=path: label_tables.read_label_table(path),
            )
        yield "texts", f"ids {size}", lambda size=size: parse_ids(f"1-{size}", "labels", "1-3")
        for key in ("max_steps", "threads", "levels", "seed", "half_width"):
            path = made(".toml", f"{key} = {size}\n".encode())
            yield "texts", f"{key} {size}", lambda path=path: RunConfig.from_toml(path)
        for text in (f"ball:1,1,1,{size}", f"path:1,1,1,{size}", f"point:{size},1,1"):
            yield "texts", f"{text[:40]}", lambda text=text: read_clicks([text], "inside", small)


def main(folder):
    import accelsurf.interact.state_file  # noqa: F401 - counts as imports
    from accelsurf.errors import AccelsurfError

    out = {kind: [] for kind in KINDS}
    cases = files(Path(folder))
    used = int(Path("/proc/self/status").read_text().split("VmSize:")[1].split()[0]) * 1024
    resource.setrlimit(resource.RLIMIT_AS, (used + MORE_BYTES,) * 2)

    def too_long(*_):
        raise TimeoutError

    signal.signal(signal.SIGALRM, too_long)
    for kind, name, read in cases:
        began = time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, MAX_SECONDS)
        try:
            read()
            found = "read", ""
        except AccelsurfError as error:
            found = "refused", error.message
        except BaseException as error:
            found = "fault", f"{type(error).__name__}: {error}"[:300]
        signal.setitimer(signal.ITIMER_REAL, 0)
        out[kind].append((name, *found, time.perf_counter() - began))
    print(json.dumps(out))


if __name__ == "__main__":
    main(sys.argv[1])
