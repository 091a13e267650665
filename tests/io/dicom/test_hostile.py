"""Small files whose headers announce much: refused, or read, in little time and memory, and without a line of others.

All are read in one process, whose address space is limited, and which says for each what it took.
"""

import io as streams
import json
import resource
import struct
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

pytestmark = pytest.mark.program

NAMES = (
    "a billion frames",
    "frames without bytes",
    "65536 frames of a pixel",
    "large sides",
    "large sides, packed",
    "large sides and frames, packed",
    "groups of an announced length",
    "groups without an end",
    "groups of no frame",
    "deep groups without an end",
    "deep groups",
    "a long element",
    "a long sequence",
    "long pixels",
    "deflated zeros",
    "no bits",
    "many bits",
    "many samples",
    "many bits stored",
    "far away",
    "no size",
    "commas in numbers",
    "a scale of 0",
    "packed nonsense",
    "packed as JPEG",
    "packed as JPEG-LS",
    "packed as RLE",
    "plain pixels called JPEG 2000",
    "packed pixels called plain",
    "many pieces",
    "many steps of time",
)
READ = ("deep groups",)
MAX_SECONDS, MAX_RSS_MB = 5.0, 700


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "tests.io.dicom.test_hostile",
            str(tmp_path_factory.mktemp("hostile")),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=Path(__file__).parents[3],
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", NAMES)
def test_each_costs_little(told, name):
    kind, message, seconds, rss_mb = told[name]
    assert kind in (("read",) if name in READ else ("InputError", "GeometryError")), message
    assert seconds < MAX_SECONDS and rss_mb < MAX_RSS_MB, (seconds, rss_mb, message)
    assert len(message) < 500 and "\n" not in message, message


# ------------------------------------------------------------------------------------------------- in the child


def cases():
    """Name -> content of a file."""
    import pydicom
    from pydicom.encaps import encapsulate

    from tests.support.dicom_series import Series

    def stored(**changes):
        dataset = Series().stacked(1).dataset(0)
        syntax = changes.pop("syntax", None)
        for name, value in changes.items():
            setattr(dataset, name, value)
        if syntax is not None:
            dataset.file_meta.TransferSyntaxUID = syntax
            if syntax.is_encapsulated:
                dataset.PixelData = encapsulate(
                    changes.get("pieces", [b"\xff\x4f\xff\x51" + bytes(50) + b"\xff\xd9"])
                )
                dataset["PixelData"].is_undefined_length = True
        stream = streams.BytesIO()
        dataset.save_as(stream, enforce_file_format=True)
        return stream.getvalue()

    def element(group, number, vr, length, value=b""):
        form = "<HH2sHL" if vr in (b"OB", b"OW", b"SQ") else "<HH2sH"
        return (
            struct.pack(form, group, number, vr, *((0, length) if form[-1] == "L" else (length,)))
            + value
        )

    def groups(length, value=b""):
        return element(0x5200, 0x9230, b"SQ", length, value)

    whole = stored()
    pixels = whole.rindex(b"\xe0\x7f\x10\x00OW")
    head, tail = whole[:pixels], whole[pixels:]
    item, endless = b"\xfe\xff\x00\xe0", 0xFFFF_FFFF
    deep = b""
    for _ in range(2000):
        deep = groups(len(deep) + 8, item + struct.pack("<L", len(deep)) + deep)
    uid = pydicom.uid
    plain_called_packed = whole.replace(
        uid.ExplicitVRLittleEndian.encode() + b"\0", b"1.2.840.10008.1.2.5\0"
    )
    packed_called_plain = stored(syntax=uid.RLELossless).replace(
        b"1.2.840.10008.1.2.5\0", uid.ExplicitVRLittleEndian.encode() + b"\0"
    )
    return {
        "a billion frames": stored(NumberOfFrames=10**9),
        "frames without bytes": stored(NumberOfFrames=60_000),
        "65536 frames of a pixel": stored(
            NumberOfFrames=65536, Rows=1, Columns=1, PixelData=bytes(1 << 17)
        ),
        "large sides": stored(Rows=65535, Columns=65535),
        "large sides, packed": stored(Rows=65535, Columns=65535, syntax=uid.JPEG2000Lossless),
        "large sides and frames, packed": stored(
            Rows=65535,
            Columns=65535,
            NumberOfFrames=60_000,
            syntax=uid.JPEGLSLossless,
            pieces=[b"\xff\xd9"] * 60_000,
        ),
        "groups of an announced length": head
        + groups(0xFFFF_FFF0, item + b"\xf0\xff\xff\xff")
        + tail,
        "groups without an end": head + groups(endless) + tail,
        "groups of no frame": head + groups(80_000, (item + bytes(4)) * 10_000) + tail,
        "deep groups without an end": head
        + (groups(endless) + item + b"\xff\xff\xff\xff") * 5000
        + tail,
        "deep groups": head + deep.replace(b"\x00\x52", b"\x00\x54") + tail,
        "a long element": head + element(0x0029, 0x1010, b"OB", 0xFFFF_FFFE) + tail,
        "a long sequence": head + element(0x0028, 0x3000, b"SQ", 0xFFFF_FFFE) + tail,
        "long pixels": head + element(0x7FE0, 0x0010, b"OW", 0xFFFF_FFFE) + tail[12:],
        "deflated zeros": stored(
            syntax=uid.DeflatedExplicitVRLittleEndian,
            Rows=16384,
            Columns=16384,
            PixelData=bytes(1 << 29),
        ),
        "no bits": stored(BitsStored=0, BitsAllocated=0).replace(
            b"\x28\x00\x00\x01US\x02\x00\x00\x00", b"\x28\x00\x00\x01US\x02\x00\x07\x00"
        ),
        "many bits": stored(BitsAllocated=65535),
        "many samples": stored(SamplesPerPixel=65535),
        "many bits stored": stored(BitsStored=60000),
        "far away": stored(ImagePositionPatient=[1e300, 1e300, 1e300]),
        "no size": stored(PixelSpacing=[1e-300, 1e300]),
        "commas in numbers": whole.replace(b"0.5\\0.75", b"0,5\\0,75"),
        "a scale of 0": stored(RescaleSlope=0),
        "packed nonsense": stored(syntax=uid.JPEG2000Lossless),
        "packed as JPEG": stored(syntax=uid.JPEGBaseline8Bit, BitsAllocated=8),
        "packed as JPEG-LS": stored(syntax=uid.JPEGLSLossless),
        "packed as RLE": stored(syntax=uid.RLELossless),
        "plain pixels called JPEG 2000": plain_called_packed,
        "packed pixels called plain": packed_called_plain,
        "many pieces": stored(
            syntax=uid.JPEG2000Lossless, NumberOfFrames=3, pieces=[b"\xff\xd9"] * 300_000
        ),
        "many steps of time": stored(
            NumberOfFrames=60_000,
            Rows=1,
            Columns=1,
            PixelData=bytes(120_000),
            FrameTimeVector=[1.0] * 60_000,
        ),
    }


def peak_mb():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024


def main(folder):
    from accelsurf import io
    from accelsurf.errors import AccelsurfError
    from tests.support.dicom_series import Series

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cases()
    paths = Series().stacked(2).write(folder / "plain")
    io.read(paths[0])  # so that what is imported counts for none of them
    for name, content in found.items():
        (folder / f"{name}.dcm").parent.mkdir(exist_ok=True)
        (folder / name).mkdir()
        (folder / name / "a.dcm").write_bytes(content)
    del found, content
    Path("/proc/self/clear_refs").write_text("5")
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    before, out = peak_mb(), {}
    for name in NAMES:
        began = time.process_time()
        try:
            volume = io.read(folder / name / "a.dcm")
            told = "read", repr(volume)
        except AccelsurfError as error:
            told = type(error).__name__, error.message
        except BaseException as error:
            told = "fault", f"{type(error).__name__}: {error}"[:400]
        out[name] = (*told, time.process_time() - began, peak_mb() - before)
    print(json.dumps(out))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
