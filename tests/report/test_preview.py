"""Pictures show what they should."""

import dataclasses
import io

import matplotlib
import numpy as np
import pytest
from matplotlib import image as mpl_image

from accelsurf.analysis.surface_mesh import extract
from accelsurf.report import canvas, preview
from accelsurf.report.preview_content import PreviewContent
from tests.support.records import step_record
from tests.support.shapes import ball_on_grid


def content(psi, geometry, **changes):
    rows = [step_record(i, restarted=i == 3) for i in range(8)]
    surface = extract(psi, geometry) if (psi < 0).any() else None
    values = dict(image=(psi < 0).astype(np.float32), psi=psi, geometry=geometry, history=rows, surface=surface)
    return PreviewContent(**{**values, "title": "a ball", **changes})


def pixels(png):
    return mpl_image.imread(io.BytesIO(png))[..., :3]


def share_of(picture, color):
    wanted = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return float((np.abs(picture - wanted).max(axis=2) < 0.02).mean())


def test_preview_shows_contour_energies_and_surface():
    picture = pixels(preview.preview_png(content(*ball_on_grid())))
    height, width = picture.shape[:2]
    assert share_of(picture[: height // 2], canvas.ORANGE) > 1e-3  # contours, in the upper half
    assert share_of(picture[height // 2 :], canvas.BLUE) > 1e-4  # energy
    assert share_of(picture[height // 2 :], canvas.VERMILION) > 1e-4  # kinetic energy
    corner = picture[height // 2 :, 2 * width // 3 :]
    blue = (corner[..., 2] > corner[..., 0] + 0.2).mean()
    assert blue > 0.1  # the surface


def test_preview_is_the_same_twice_and_keeps_no_pyplot_state():
    made = content(*ball_on_grid())
    before = dict(matplotlib.rcParams)
    assert preview.preview_png(made) == preview.preview_png(made)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("reason", ["vanished", "filled"])
def test_preview_of_an_empty_result(reason):
    psi, geometry = ball_on_grid()
    level = np.full_like(psi, 3.0 if reason == "vanished" else -3.0)
    picture = pixels(preview.preview_png(content(level, geometry, surface=None)))
    assert share_of(picture, canvas.ORANGE) == 0.0


def test_preview_of_one_slice_and_of_a_gradient_flow():
    psi, geometry = ball_on_grid(shape=(1, 16, 20))
    rows = [step_record(i, kinetic=0.0) for i in range(3)]
    picture = pixels(preview.preview_png(content(psi, geometry, history=rows)))
    assert share_of(picture, canvas.ORANGE) > 1e-4
    assert share_of(picture, canvas.VERMILION) == 0.0


def test_preview_without_a_single_step_and_of_a_constant_slice():
    psi, geometry = ball_on_grid()
    picture = pixels(preview.preview_png(content(psi, geometry, history=[], image=np.zeros_like(psi))))
    assert share_of(picture[: len(picture) // 2], canvas.ORANGE) > 1e-3  # the contours
    assert share_of(picture[len(picture) // 2 :], canvas.BLUE) < 1e-3  # no curve of the energy, only its axis' label


def test_comparison_has_a_column_for_each_run_and_the_reference():
    psi, geometry = ball_on_grid()
    first = content(psi, geometry, reference=(psi < 1).astype(np.uint8))
    png = preview.comparison_png({"gradient": first, "constant-density": content(psi + 1, geometry)}, "two flows")
    picture = pixels(png)
    middle = picture.shape[1] // 2
    assert share_of(picture[:, :middle], canvas.SKY) > share_of(picture[:, middle:], canvas.SKY)
    assert share_of(picture[:, middle:], canvas.ORANGE) > 1e-4


def test_content_can_be_changed_for_another_picture():
    made = content(*ball_on_grid())
    assert dataclasses.replace(made, title="other").title == "other"
