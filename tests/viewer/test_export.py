"""Pages and notebooks: all of the scene in one file, nothing from elsewhere, drawn by a real browser."""

import base64
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import accelsurf
from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.viewer.notebook import SceneOutput
from accelsurf.viewer.scene.headless import GraphicsError
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


@pytest.fixture(scope="module")
def result():
    volume, center = viewing.ball_image(direction=viewing.TURN)
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    return accelsurf.segment(volume, start=start, max_steps=25, levels=1)


def page_of(path):
    text = path.read_text()
    return text, json.loads(
        re.search(r'<script id="scene" type="application/json">(.*?)</script>', text).group(1)
    )


def array(text, kind):
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, 3)


def test_a_page_has_everything_in_it(result, tmp_path):
    truth = result.volume.with_array(result.volume.array > 0)
    assert result.plot(to=tmp_path / "a.html", reference=truth) is None
    text, scene = page_of(tmp_path / "a.html")
    assert (
        not re.search(r"(https?:)?//[a-z]+\.[a-z]", text)
        and "@import" not in text
        and "__" not in text[:3000]
    )
    assert re.findall(r'(?:src|href)="(.{5})', text) == ["data:"]
    assert re.search(r"Dice (0\.9|1\.0)", text)
    box, surface, reference = scene["meshes"]
    middle = result.geometry.center_world()
    points = array(surface["points"], "<f4") + middle
    # Linear between voxels.
    assert np.allclose([points.min(axis=0), points.max(axis=0)], result.surface.bounds, atol=0.06)
    cells = array(surface["cells"], "<u4")
    assert cells.max() == len(points) - 1
    assert np.allclose(np.linalg.norm(array(surface["normals"], "i1") / 127, axis=1), 1, atol=0.02)
    assert "normals" not in box and reference["opacity"] < 1
    assert scene["letters"][2] == ["-z", "+z"]  # the image does not say that it is a patient's


def test_a_title_cannot_break_out_of_the_page(tmp_path):
    volume, _ = viewing.ball_image()
    scene = Scene(volume, title="</script><script>alert(1)</script>__SCENE__")
    from accelsurf.viewer.export import write_html

    write_html(scene, tmp_path / "a.html")
    scene.close()
    text, document = page_of(tmp_path / "a.html")
    assert "<script>alert" not in text and len(document["meshes"]) == 1


def test_colours_are_in_the_page(tmp_path):
    from accelsurf.viewer.export import write_html

    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1)
    scene = Scene(volume)
    scene.color_by("speed")
    scene.update(frames[3], (history,))
    write_html(scene, tmp_path / "a.html")
    scene.close()
    _, document = page_of(tmp_path / "a.html")
    colors = array(document["meshes"][1]["colors"], "u1")
    assert (
        len(colors) == len(array(document["meshes"][1]["points"], "<f4"))
        and len(np.unique(colors, axis=0)) >= 2
    )


@pytest.mark.program
def test_a_browser_draws_the_page(result, tmp_path):
    chromium = viewing.needs_chromium()
    result.plot(to=tmp_path / "a.html")
    out = tmp_path / "a.png"
    flags = ["--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--window-size=1280,720"]
    flags += [
        f"--user-data-dir={tmp_path / 'profile'}",
        "--virtual-time-budget=4000",
        f"--screenshot={out}",
    ]
    command = [chromium, *viewing.CHROMIUM_FLAGS, *flags, f"file://{tmp_path / 'a.html'}"]
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    with Image.open(out) as opened:
        picture = np.asarray(opened.convert("RGB")).astype(int)
    left = picture[:, : picture.shape[1] // 2]
    orange = (left[..., 0] > 90) & (left[..., 0] > left[..., 2] + 60)
    assert orange.mean() > 0.02, "no surface was drawn"


def test_notebooks_get_a_page_and_a_picture(result, monkeypatch):
    monkeypatch.setattr("accelsurf.viewer.notebook.in_notebook", lambda: True)
    shown = result.plot(size=(640, 360))
    assert isinstance(shown, SceneOutput)
    bundle = shown._repr_mimebundle_()
    assert base64.b64decode(bundle["image/png"])[:4] == b"\x89PNG"
    assert bundle["text/html"].startswith("<iframe srcdoc=") and "&lt;script" in bundle["text/html"]
    image = accelsurf.Volume.from_array(np.random.default_rng(0).random((20, 30)))
    assert set(accelsurf.show(image)._repr_mimebundle_()) == {"image/png"}


def test_pictures_and_what_cannot_be_shown(result, tmp_path):
    result.plot(to=tmp_path / "a.png", theme="dark", planes=True, size=(640, 360))
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (640, 360)
    accelsurf.show(result.volume, to=tmp_path / "b.png")
    for given, message in (
        (dict(to="a.jpg"), "a.jpg: .jpg was given"),
        (dict(theme="pink"), "theme: pink"),
    ):
        with pytest.raises(UsageError, match=message):
            result.plot(**({"to": tmp_path / "c.png"} | given))
    with pytest.raises(InputError, match="brain.nii: there is no such file"):
        accelsurf.show("brain.nii")
    with pytest.raises(InputError, match="a dict was given, expected a path"):
        accelsurf.show({})
    other, _ = viewing.ball_image((8, 9, 10))
    with pytest.raises(InputError, match="not on the image's grid"):
        result.plot(to=tmp_path / "c.png", reference=other)
    with pytest.raises(OutputError):
        result.plot(to=tmp_path / "nowhere" / "c.html")
    flat = accelsurf.Volume.from_array(np.eye(24))
    with pytest.raises(UsageError, match="one slice was given"):
        accelsurf.show(flat, to=tmp_path / "c.html")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_a_window_needs_a_screen(result, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if sys.platform.startswith("linux"):
        with pytest.raises(GraphicsError, match="no screen was found") as caught:
            result.plot()
        assert "to='a.png'" in caught.value.hint


@pytest.mark.slow
@pytest.mark.program
def test_segmenting_does_not_load_the_viewer():
    code = (
        "import sys, numpy as np, accelsurf; z = np.zeros((16, 16, 16)); z[4:12, 4:12, 4:12] = 1;"
        "accelsurf.segment(z, start='ball:8,8,8,3', max_steps=3);"
        "print(any(name.partition('.')[0] in ('pyvista', 'vtkmodules', 'trame') for name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=True
    )
    assert done.stdout.strip() == "False"
