"""No file may grow beyond a size, as on a full disk: the write fails, by name, and the old file stays."""

import os
import sys
from dataclasses import replace

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import OutputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.format_functions import FORMAT_FUNCTIONS
from accelsurf.measure.surface_mesh import Surface

resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")


def volume(suffix):
    """Voxels that do not compress."""
    shape = (1, 60, 50) if suffix == ".png" else (10, 30, 20)
    values = np.random.default_rng(1).integers(0, 255, shape, np.uint8)
    return Volume(values, Geometry(shape, (1.0, 1.0, 1.0)))


def error_with_limit(limit, work):
    """The message of the OutputError of some work when no file may grow beyond a limit; empty when it is done."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        text = "died"
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            work()
            text = ""
        except OutputError as error:
            text = str(error)
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        finally:
            os.write(writer, text.encode())
            os._exit(0)
    os.waitpid(child, 0)
    os.close(writer)
    with os.fdopen(reader) as told:
        return told.read()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".tif", ".png"])
def test_an_image_that_was_cut_short_does_not_replace_the_old_one(suffix, tmp_path, capfd):
    path, new = tmp_path / f"labels{suffix}", volume(suffix)
    io.write(new, path)
    sizes = {name.name: name.stat().st_size for name in tmp_path.iterdir()}
    io.write(new.with_array(np.zeros_like(new.array)), path)
    before = {name.name: name.read_bytes() for name in tmp_path.iterdir()}
    for limit in (50, 400, max(sizes.values()) // 2, max(sizes.values()) - 1):
        message = error_with_limit(limit, lambda: io.write(new, path))
        assert message.startswith(str(path)) or message.startswith(path.name), message
        assert "cannot be written" in message
        assert capfd.readouterr().err == ""  # libraries say nothing of their own
        assert {name.name: name.read_bytes() for name in tmp_path.iterdir()} == before
    assert error_with_limit(1 << 16, lambda: io.write(new, path)) == ""
    assert np.array_equal(io.read(path).array, new.array)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".vtp"])
def test_a_mesh_that_was_cut_short_does_not_replace_the_old_one(suffix, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(b"old")
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    mesh = Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    assert "cannot be written" in error_with_limit(60, lambda: mesh.write(path))
    assert path.read_bytes() == b"old" and [name.name for name in tmp_path.iterdir()] == [path.name]


def test_a_staging_file_that_differs_is_refused_without_an_error_of_the_system(
    tmp_path, monkeypatch
):
    path = tmp_path / "labels.nii"
    new = volume(".nii")
    real = FORMAT_FUNCTIONS["nii"]()

    def write(volume, staged):
        real.write(volume, staged)
        with staged.open("r+b") as file:
            file.seek(400)
            file.write(b"?" if volume.array.ravel()[48] != ord("?") else b"!")

    monkeypatch.setitem(FORMAT_FUNCTIONS, "nii", lambda: replace(real, write=write))
    with pytest.raises(OutputError, match="other voxels are read than were written"):
        io.write(new, path)
    assert list(tmp_path.iterdir()) == []
