"""The image of ``accelsurf view FILE``: read in a thread beside what is loaded, with the same errors."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.cli import view
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.viewer.core import opening
from accelsurf.viewer.core.opening import ImageToOpen
from accelsurf.viewer.scene.headless import GraphicsError
from accelsurf.viewer.window import display


@pytest.fixture
def scan(tmp_path):
    io.write(
        Volume.from_array(np.random.default_rng(0).integers(0, 99, (6, 7, 8)).astype(np.int16)),
        tmp_path / "scan.nii.gz",
    )
    return tmp_path / "scan.nii.gz"


def first_image(path, reference=None):
    return ImageToOpen(path, RunConfig(), reference, None, TrackConfig())


def test_it_is_read_while_something_else_is_done(scan, monkeypatch):
    may_read, readers, read = threading.Event(), [], opening.read_channels

    def slow(*given):
        readers.append(threading.current_thread())
        assert may_read.wait(60)
        return read(*given)

    monkeypatch.setattr(opening, "read_channels", slow)
    wait = first_image(scan).start_reading()  # comes back, though nothing has been read
    may_read.set()
    opened = wait()
    assert np.array_equal(opened.volume.array, io.read(scan).array)
    assert opened.name == "scan" and opened.source == scan and opened.channels == ()
    assert len(readers) == 1 and readers[0] is not threading.main_thread()


def test_its_reference_is_read_too(scan):
    assert first_image(scan, scan).start_reading()().reference.array.shape == (6, 7, 8)


def test_what_is_wrong_with_it_is_raised_where_it_is_waited_for(scan):
    scan.write_bytes(scan.read_bytes()[:-40])
    wait = first_image(scan).start_reading()
    with pytest.raises(InputError, match="scan.nii.gz: .*end"):
        wait()


@pytest.mark.parametrize(
    ("content", "message"), [(None, "no such file"), (b"x" * 400, "not gzip-compressed")]
)
def test_the_command_says_it_in_one_line(content, message, tmp_path, monkeypatch, capsys):
    if content is not None:
        (tmp_path / "scan.nii.gz").write_bytes(content)
    monkeypatch.setattr(view, "front_end", lambda page, begin: begin() or page)
    monkeypatch.setattr(view, "open_window", lambda *_: pytest.fail("a window was opened"))
    assert cli.execute(["view", str(tmp_path / "scan.nii.gz")]) == 3
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 2 and message in error[0] and "scan.nii.gz" in error[0]


@pytest.fixture
def on_a_screen(monkeypatch):
    """As if a screen and the window's packages were there."""
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    monkeypatch.setattr(display, "WINDOW_PACKAGES", ("json",))


def test_work_goes_on_while_another_process_tries_the_screen(on_a_screen, monkeypatch, tmp_path):
    mark = tmp_path / "mark"
    probe = f"import time, pathlib\nwhile not pathlib.Path({str(mark)!r}).exists(): time.sleep(0.01)\nprint('opened')"
    monkeypatch.setattr(display, "PROBE", probe)
    monkeypatch.setattr(display, "PROBE_SECONDS", 30)
    display.require_display(mark.touch)  # before it, the trial would wait for ever
    assert mark.exists()


def test_a_trial_that_fails_is_told_after_the_work(on_a_screen, monkeypatch):
    monkeypatch.setattr(display, "PROBE", "import sys; sys.exit('qt.qpa.xcb: no screen here')")
    done = []
    with pytest.raises(GraphicsError, match="no screen here"):
        display.require_display(lambda: done.append(1))
    assert done == [1]


def test_an_error_of_the_work_ends_the_trial(on_a_screen, monkeypatch):
    monkeypatch.setattr(display, "PROBE", "import time; time.sleep(300)")
    started, begin = [], subprocess.Popen

    def note(*given, **options):
        started.append(begin(*given, **options))
        return started[0]

    def fail():
        raise InputError("no image")

    monkeypatch.setattr(subprocess, "Popen", note)
    with pytest.raises(InputError, match="no image"):
        display.require_display(fail)
    assert started[0].poll() is not None


def test_garbage_is_looked_for_again_after_loading():
    # In a process of its own: what is frozen stays so.
    code = (
        "import gc\nfrom accelsurf.cli.view import loading\n"
        "try:\n    with loading():\n        assert not gc.isenabled()\n        import email.mime.text\n        1 / 0\n"
        "except ZeroDivisionError:\n    print(gc.isenabled(), gc.get_freeze_count() > 1000)\n"
        "gc.disable()\ngc.set_threshold(500_000)\nwith loading():\n    pass\n"
        "print(gc.isenabled(), gc.get_threshold()[0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["True", "True", "False", "50000"], done.stderr
