"""What libtiff and libpng print: never a line beside accelsurf's, and a reason to refuse; lines of others stay."""

import os
import struct
import subprocess
import sys
import threading

import numpy as np
import pytest
import tifffile
from PIL import Image

from accelsurf import io
from accelsurf.errors import InputError

STACK = (np.arange(4 * 40 * 50).reshape(4, 40, 50) % 3001).astype(np.uint16)


def lzw(path):
    pages = [Image.fromarray(page) for page in STACK]
    pages[0].save(path, compression="tiff_lzw", save_all=True, append_images=pages[1:])
    return path


def damaged(path, seed):
    """A file of LZW whose voxels are damaged: libtiff prints about most of them."""
    content = bytearray(lzw(path).read_bytes())
    rng = np.random.default_rng(seed)
    strips = [page.tag_v2[273][0] for page in pages_of(path)]
    at = int(rng.choice(strips)) + int(rng.integers(0, 200))
    content[at : at + 40] = rng.bytes(40)
    path.write_bytes(content)
    return path


def pages_of(path):
    with Image.open(path) as image:
        for number in range(image.n_frames):
            image.seek(number)
            yield image


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_stream_is_refused_with_the_line_of_the_library(tmp_path, seed, capfd):
    path = damaged(tmp_path / "a.tif", seed)
    reasons = []
    for read in (
        io.read,
        lambda path: io.open_volume(path).read((slice(0, 4), slice(0, 40), slice(0, 50))),
    ):
        try:
            read(path)
        except InputError as error:
            reasons.append(error.message)
    assert capfd.readouterr() == ("", "")
    # Every code is a valid one by chance in few of them: nothing tells those values from others.
    assert not reasons or "damaged" in reasons[0], reasons


def test_most_damages_are_noticed(tmp_path):
    noticed = 0
    for seed in range(40):
        try:
            io.read(damaged(tmp_path / "a.tif", seed))
        except InputError as error:
            noticed += "LZW" in error.message
    assert noticed > 10


def test_lines_of_other_threads_arrive_and_readers_do_not_disturb_each_other(tmp_path, capfd):
    """A line may stand in the middle of one of a library."""
    good = lzw(tmp_path / "good.tif")
    bad = [damaged(tmp_path / f"bad{seed}.tif", seed) for seed in range(12)]
    before, faults, done = os.fstat(2).st_ino, [], threading.Event()
    lines = [f"step {number}: the energy is {number / 7}" for number in range(400)]

    def print_lines():
        for line in lines:
            os.write(2, f"{line}\n".encode())
            done.wait(1e-3)

    def read_all():
        for path in bad:
            try:
                io.read(path)
            except InputError:
                pass
            if not np.array_equal(io.read(good).array, STACK):
                faults.append(path)

    threads = [
        threading.Thread(target=work) for work in (print_lines, read_all, read_all, read_all)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults and os.fstat(2).st_ino == before
    found = capfd.readouterr().err
    assert sum(line in found for line in lines) > 0.9 * len(lines)


@pytest.mark.parametrize(
    "options", [{"compression": "lzma"}, {"compression": "zlib", "tile": (16, 16)}]
)
def test_what_tifffile_logs_stays_with_it(tmp_path, capfd, caplog, options):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, STACK, photometric="minisblack", rowsperstrip=None, **options)
    # A private tag whose value lies beyond the end: tifffile logs a line, and it counts for nothing.
    content = path.read_bytes()
    at = content.index(struct.pack("<HHI", 305, 2, 12))
    path.write_bytes(content[: at + 8] + struct.pack("<I", 2**31) + content[at + 12 :])
    with caplog.at_level("DEBUG"):
        np.testing.assert_array_equal(io.read(path).array, STACK)
    assert caplog.records == [] and capfd.readouterr() == ("", "")
    with tifffile.TiffFile(path) as file:
        file.pages[0].tags.get(305)
    assert caplog.records, "its own users hear it"


def test_closed_standard_error_is_no_place_for_a_file(tmp_path):
    """A file that is opened gets the lowest number that is free: that of standard error, where it is closed."""
    bad = next(
        path
        for path in (damaged(tmp_path / f"{seed}.tif", seed) for seed in range(30))
        if is_refused(path)
    )
    code = (
        "import os, sys; os.close(2); from accelsurf import io\n"
        "try: io.read(sys.argv[1])\n"
        "except Exception as error: print(type(error).__name__)\n"
        "print(io.read(sys.argv[2]).array.shape)"
    )
    lzw(tmp_path / "good.tif")
    command = [sys.executable, "-c", code, str(bad), str(tmp_path / "good.tif")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout.split("\n")[:2] == ["InputError", "(4, 40, 50)"]


def is_refused(path):
    try:
        io.read(path)
    except InputError:
        return True
    return False
