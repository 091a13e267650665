"""Pictures show what they should."""

import dataclasses
import io
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import matplotlib.axis
import numpy as np
import pytest
from matplotlib import image as mpl_image
from matplotlib.text import Text

from accelsurf.grid.clicks import Click
from accelsurf.grid.geometry import Geometry
from accelsurf.image.grey_window import GreyWindow, window_of
from accelsurf.output.pictures import canvas, preview
from accelsurf.output.pictures.preview_content import ObjectShape, PreviewContent, marks_of
from accelsurf.output.pictures.slice_views import (
    click_views,
    main_views,
    shown_ranges,
    uncertain_views,
    whole_ranges,
)
from accelsurf.settings.wording import volume_text
from tests.support.records import step_record
from tests.support.shapes import ball_on_grid

pytestmark = pytest.mark.pictures


def content(psi, geometry, **changes):
    rows = [step_record(i, restarted=i == 3) for i in range(8)]
    values = dict(
        image=(psi < 0).astype(np.float32),
        psi=psi,
        geometry=geometry,
        history=rows,
    )
    return PreviewContent(**{**values, "title": "a ball", **changes})


def pixels(png):
    return mpl_image.imread(io.BytesIO(png))[..., :3]


def share_of(picture, color):
    wanted = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return float((np.abs(picture - wanted).max(axis=2) < 0.02).mean())


def test_preview_shows_contour_and_energies():
    picture = pixels(preview.preview_png(content(*ball_on_grid())))
    height = len(picture)
    assert share_of(picture[: height // 2], canvas.ORANGE) > 1e-3  # contours, in the upper half
    assert share_of(picture[height // 2 :], canvas.BLUE) > 1e-4  # energy
    assert share_of(picture[height // 2 :], canvas.VERMILION) > 1e-4  # kinetic energy


def test_further_clicks_fill_the_places_below_before_the_picture_grows():
    psi, geometry = wide()
    heights = []
    for count in range(5):
        clicks = [click("outside", (4 + 2 * k, 6, 6)) for k in range(count)]
        made = content(psi, geometry, history=[], clicks=marks_of(clicks, geometry.spacing))
        heights.append(len(pixels(preview.preview_png(made))))
    assert heights[0] == heights[1] == heights[2] < heights[3] == heights[4]


def test_preview_is_the_same_twice_and_keeps_no_pyplot_state():
    made = content(*ball_on_grid())
    before = dict(matplotlib.rcParams)
    assert preview.preview_png(made) == preview.preview_png(made)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("reason", ["vanished", "filled"])
def test_preview_of_an_empty_result(reason):
    psi, geometry = ball_on_grid()
    level = np.full_like(psi, 3.0 if reason == "vanished" else -3.0)
    picture = pixels(preview.preview_png(content(level, geometry)))
    assert share_of(picture, canvas.ORANGE) == 0.0


def test_preview_of_one_slice_and_of_a_gradient_flow():
    psi, geometry = ball_on_grid(shape=(1, 16, 20))
    rows = [step_record(i, kinetic=0.0) for i in range(3)]
    picture = pixels(preview.preview_png(content(psi, geometry, history=rows)))
    assert share_of(picture, canvas.ORANGE) > 1e-4
    assert share_of(picture, canvas.VERMILION) == 0.0


def test_preview_without_a_single_step_and_of_a_constant_slice():
    psi, geometry = ball_on_grid()
    picture = pixels(
        preview.preview_png(content(psi, geometry, history=[], image=np.zeros_like(psi)))
    )
    assert share_of(picture[: len(picture) // 2], canvas.ORANGE) > 1e-3  # the contours
    assert (
        share_of(picture[len(picture) // 2 :], canvas.BLUE) < 1e-3
    )  # no curve of the energy, only its axis' label


def test_content_can_be_changed_for_another_picture():
    made = content(*ball_on_grid())
    assert dataclasses.replace(made, title="other").title == "other"


# ------------------------------------------------------------------------------------ what lets a person judge


def wide(shape=(20, 60, 64), radius=6, middle=(10, 20, 40)):
    """A small ball in a large grid, away from its middle."""
    geometry = Geometry(shape, (2.0, 1.0, 1.0), (-3.0, 4.0, 5.0))
    axes = [(np.arange(n) - m) * h for n, m, h in zip(shape, middle, geometry.spacing, strict=True)]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return (np.sqrt(x**2 + y**2 + z**2) - radius).astype(np.float32), geometry


def click(side, place, id=1, radius=1):
    box = tuple(slice(at - radius, at + radius + 1) for at in place)
    return Click(side, box, np.ones((2 * radius + 1,) * 3, bool), id)


def test_slices_are_cropped_to_the_object_its_clicks_and_a_margin():
    psi, geometry = wide()
    made = content(psi, geometry)
    (z, y, x), n = shown_ranges(made), geometry.shape
    # The ball has radius 6 mm: 3 slices of 2 mm up and down, 6 voxels to the sides, and a margin around.
    assert y[0] < 14 and y[1] > 27 and y[1] - y[0] < 30 and x[1] - x[0] < 30 and z[1] - z[0] < n[0]
    far = dataclasses.replace(
        made, clicks=marks_of([click("outside", (10, 50, 40))], geometry.spacing)
    )
    assert shown_ranges(far)[1][1] >= 52
    assert shown_ranges(content(np.full_like(psi, 3.0), geometry)) == whole_ranges(geometry)


def test_slices_go_through_the_first_inside_click_else_through_the_largest_section():
    psi, geometry = wide()
    assert [view.index for view in main_views(content(psi, geometry))] == [10, 20, 40]
    clicks = marks_of([click("outside", (4, 4, 4)), click("inside", (9, 18, 41))], geometry.spacing)
    clicked = content(psi, geometry, clicks=clicks)
    assert [view.index for view in main_views(clicked)] == [9, 18, 41]
    assert [(view.index, view.why) for view in click_views(clicked)] == [(4, "click 1, outside")]
    flipped = dataclasses.replace(geometry, direction=np.diag([-1.0, 1.0, -1.0]))
    turned = [view.index for view in main_views(content(psi, flipped, clicks=clicks))]
    assert turned == [19 - 9, 18, 63 - 41]


def test_clicks_are_drawn_in_their_colours_and_late_growth_has_its_slice():
    psi, geometry = wide()
    plain = pixels(preview.preview_png(content(psi, geometry, history=[])))
    marks = marks_of(
        [click("inside", (10, 20, 40)), click("outside", (10, 30, 40))], geometry.spacing
    )
    clicked = pixels(preview.preview_png(content(psi, geometry, history=[], clicks=marks)))
    for color in (canvas.GREEN, canvas.VERMILION):
        assert share_of(plain, color) == 0 and share_of(clicked, color) > 2e-5
    late = pixels(
        preview.preview_png(content(psi, geometry, history=[], late_growth=(12.0, 24.0, 40.0)))
    )
    assert share_of(late[len(late) // 2 :], canvas.ORANGE) > 1e-4  # a fourth slice, below
    assert share_of(late, canvas.YELLOW) > share_of(plain, canvas.YELLOW) + 2e-5


@pytest.fixture
def figures(monkeypatch):
    """Figures as they are drawn."""
    drawn, pixels_of = [], canvas.Canvas.pixels

    def pixels(self):
        drawn.append(self.figure)
        return pixels_of(self)

    monkeypatch.setattr(canvas.Canvas, "pixels", pixels)
    return drawn


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def test_around_the_object_30_percent_are_shown():
    psi, geometry = wide(
        (60, 90, 96), 12, (30, 40, 50)
    )  # 12 slices of 2 mm, 24 voxels to the sides
    ranges = shown_ranges(content(psi, geometry))
    box = [np.flatnonzero((psi < 0).any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    for (low, high), own, least in zip(ranges, box, (3, 6, 6), strict=True):
        room = max(round(0.3 * (own[-1] + 1 - own[0])), least)
        assert (low, high) == (own[0] - room, own[-1] + 1 + room)


def test_slices_are_the_largest_panels_and_have_two_ticks_at_least(figures):
    """Also of flat and of narrow images, by their shorter side; the energies are a strip."""
    for of in (
        ((20, 60, 64), 6, (10, 20, 40)),
        ((6, 90, 96), 40, (3, 45, 48)),
        ((40, 9, 80), 9, (20, 4, 40)),
    ):
        psi, geometry = wide(*of)
        preview.preview_png(content(psi, geometry))
        axes = {each.get_title(): each for each in figures[-1].axes if each.get_title()}
        side = {title: min(each.bbox.width, each.bbox.height) for title, each in axes.items()}
        slices = [title for title in axes if "Slice, " in title]
        assert len(slices) in (3, 4) and max(side, key=side.get) in slices
        for each in (axes[title] for title in slices):
            for axis, ends in ((each.xaxis, each.get_xlim()), (each.yaxis, each.get_ylim())):
                shown = [
                    tick for tick in axis.get_major_locator()() if min(ends) <= tick <= max(ends)
                ]
                assert len(shown) >= 2


def test_ticks_are_laid_out_only_where_there_is_a_scale_and_never_for_a_title(figures, monkeypatch):
    asked = []
    monkeypatch.setattr(
        matplotlib.axis.Axis, "get_tightbbox", lambda *args, **options: asked.append(args)
    )
    preview.preview_png(content(*ball_on_grid()))
    assert not asked
    shown = {
        axes.get_title(): [axis.get_visible() for axis in (axes.xaxis, axes.yaxis)]
        for axes in figures[0].axes
    }
    assert shown.pop("") == [False, True]  # the second scale of the energies
    assert shown.pop("Energy and kinetic energy") == [True, True]
    assert len(shown) >= 3
    assert all(shown[title] == [True, True] for title in shown)


def test_scales_are_in_the_unit_of_the_file(figures):
    psi, geometry = wide()
    small = Geometry(geometry.shape, tuple(1e-3 * step for step in geometry.spacing))
    preview.preview_png(content(1e-3 * psi, small, unit="um", history=[]))
    titles = [axes.get_title() for axes in figures[-1].axes]
    assert "Slice, z = 20 um" in titles and not any(" mm" in title for title in titles)
    (axial,) = (axes for axes in figures[-1].axes if axes.get_title() == "Slice, z = 20 um")
    assert axial.get_xlabel() == "x (um)" and {"40"} <= {
        tick.get_text() for tick in axial.get_xticklabels()
    }


def test_where_to_click_next_is_drawn_with_a_slice_of_its_own_where_no_other_shows_it(figures):
    psi, geometry = wide()
    captions = {}
    for place in ((10, 20, 46), (13, 22, 42)):
        made = content(psi, geometry, history=[], next_clicks=[place])
        views = uncertain_views(made)
        assert [(view.index, view.why) for view in views] == (
            [] if place[0] == 10 else [(13, "most doubtful place")]
        )
        picture = pixels(preview.preview_png(made))
        assert share_of(picture, canvas.YELLOW) > 2e-5
        captions[place] = texts_of(figures[-1]).count("click next?")
    # In the slices that go through it; the first lies in two main ones, and the third is below.
    assert captions == {(10, 20, 46): 3, (13, 22, 42): 1}
    late = content(
        psi, geometry, history=[], next_clicks=[(13, 22, 42)], late_growth=(12.0, 24.0, 40.0)
    )
    assert [view.why for view in uncertain_views(late)] == ["latest growth", "most doubtful place"]
    preview.preview_png(late)
    assert (
        sum(
            text.endswith((": latest growth", ": most doubtful place"))
            for text in texts_of(figures[-1])
        )
        == 2
    )
    preview.preview_png(content(psi, geometry))
    assert "click next?" not in texts_of(figures[-1])


def test_an_id_is_written_away_from_the_mark_of_the_click(figures):
    psi, geometry = wide()
    whole = (slice(0, 20), slice(0, 60), slice(0, 64))
    for place in ((10, 20, 40), (10, 22, 38)):
        marks = marks_of([click("inside", place, id=70)], geometry.spacing)
        preview.preview_png(
            content(psi, geometry, history=[], objects=[ObjectShape(70, whole, psi)], clicks=marks)
        )
        slices = [
            axes for axes in figures[-1].axes if any(text.get_text() == "70" for text in axes.texts)
        ]
        assert len(slices) == 4
        for axes in (axes for axes in slices if not axes.get_title().startswith("half-way")):
            (name,) = (text for text in axes.texts if text.get_text() == "70")
            (mark, *_) = (line for line in axes.lines if line.get_marker() == "+")
            box = name.get_window_extent()
            middle = np.array([box.x0 + box.x1, box.y0 + box.y1]) / 2
            assert np.hypot(*(middle - axes.transData.transform(mark.get_xydata()[0]))) > 18


def test_what_does_not_cut_a_slice_is_not_drawn_in_it(figures):
    """Nor is an id written into a section that is too small for it; the grid runs against the axes of a patient."""
    psi, geometry = wide()
    geometry = Geometry(psi.shape, geometry.spacing, geometry.origin, np.diag([-1.0, -1.0, 1.0]))
    whole = (slice(0, 20), slice(0, 60), slice(0, 64))
    thin = np.ones_like(psi)
    thin[np.unravel_index(psi.argmin(), psi.shape)] = -1e-3
    corner = (slice(0, 1), slice(0, 1), slice(0, 1))
    objects = [
        ObjectShape(3, whole, psi),
        ObjectShape(70, corner, -np.ones((1, 1, 1))),
        ObjectShape(80, whole, thin),
    ]
    ends = np.zeros(psi.shape, bool)
    ends[0, 0, 0] = ends[-1, -1, -1] = True
    marks = marks_of([click("inside", (10, 20, 40), id=3)], geometry.spacing)
    marks = (*marks, marks[0]._replace(id=80, box=whole, mask=ends))
    preview.preview_png(content(psi, geometry, history=[], objects=objects, clicks=marks))
    said = texts_of(figures[-1])
    assert "3" in said and "70" not in said and "80" not in said


def test_energies_of_corrections_are_not_drawn_and_it_is_said(figures):
    preview.preview_png(content(*ball_on_grid(), steps_left_out=12))
    assert any("step (without the 12 of corrections)" == text for text in texts_of(figures[-1]))
    preview.preview_png(content(*ball_on_grid()))
    assert not any("corrections" in text for text in texts_of(figures[-1]))


def test_objects_have_their_own_colours():
    psi, geometry = wide()
    boxes = (slice(0, 20), slice(0, 60), slice(0, 64))
    other = np.roll(psi, 18, axis=1)
    several = [ObjectShape(3, boxes, psi), ObjectShape(70, boxes, other)]
    both = content(np.minimum(psi, other), geometry, objects=several, history=[])
    picture = pixels(preview.preview_png(both))
    for color in canvas.OBJECT_COLORS[:2]:
        assert share_of(picture[: len(picture) // 2], color) > 2e-4


def test_window_is_that_of_the_object_and_its_surroundings():
    rng = np.random.default_rng(0)
    image = rng.normal(60, 15, (20, 40, 40)).astype(np.float32)
    image[:, :8] = -1000  # air
    image[:, 30:33] = 1500  # bone
    inside = np.zeros(image.shape, bool)
    inside[5:15, 12:25, 10:30] = True
    image[inside] = rng.normal(110, 15, int(inside.sum()))
    window = window_of(image, inside)
    assert -150 < window.low < 60 and 150 < window.high < 350
    # Ribs that touch it at few places are white, and it is not.
    image[:, 30:33] = 60
    image[9:11, 25:28, 10:14] = 400
    shown = window_of(image, inside).grey(np.array([110.0, 140.0, 400.0]))
    assert shown[0] < 160 and shown[1] < 220 and shown[2] == 255
    assert window_of(image) == GreyWindow(-160.0, 240.0)  # a CT without an object: soft tissue
    brain = np.zeros((20, 40, 40))
    brain[4:16, 8:32, 8:32] = rng.normal(90, 10, (12, 24, 24))
    assert window_of(brain).low == 0 and 100 < window_of(brain).high < 125
    assert window_of(np.full((3, 4, 5), 7.0)) == GreyWindow(7.0, 8.0)
    grey = GreyWindow(0.0, 10.0).grey(np.array([-5.0, 5.0, 20.0, np.nan]))
    assert grey.tolist() == [0, 127, 255, 0]


def test_the_plotting_library_is_loaded_by_the_first_picture_and_never_pyplot():
    code = (
        "import sys, numpy as np; from accelsurf.grid.geometry import Geometry\n"
        "from accelsurf.output.pictures import preview\n"
        "from accelsurf.output.pictures.preview_content import PreviewContent\n"
        "assert 'matplotlib' not in sys.modules\n"
        "psi = np.ones((5, 6, 7), np.float32); psi[2, 2:4, 2:4] = -1\n"
        "made = PreviewContent(psi, psi, Geometry(psi.shape, (1.0, 1.0, 1.0)), [], 'a')\n"
        "assert preview.preview_png(made)[1:4] == b'PNG'; sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0


@pytest.mark.parametrize(
    ("ends", "texts"),
    [
        ((-774.5, -700.0), {"-760", "-740", "-720", "-700"}),
        ((0.0, 0.3), {"0.0", "0.1", "0.2", "0.3"}),
    ],
)
def test_ticks_are_round_and_few(ends, texts):
    axes = canvas.Canvas(400, 400).axes(canvas.Box(50, 50, 350, 350), ends, (0, 1))
    canvas.write_scales(axes, "mm", "mm")
    axes.figure.canvas.draw()
    low, high = ends
    shown = {
        text.get_text()
        for text in axes.get_xticklabels()
        if low <= text.get_position()[0] <= high + 1e-9
    }
    assert {text.replace("\u2212", "-") for text in shown} == texts


def test_the_same_bytes_whatever_a_users_settings_of_matplotlib():
    made = content(*ball_on_grid())
    usual = preview.preview_png(made)
    style = {
        "font.size": 30,
        "lines.linewidth": 9,
        "axes.grid": True,
        "font.family": "serif",
        "xtick.direction": "in",
    }
    with matplotlib.rc_context(style):
        assert preview.preview_png(made) == usual


def test_pictures_in_threads_have_the_same_bytes():
    made = content(*ball_on_grid())
    usual = preview.preview_png(made)
    with ThreadPoolExecutor(3) as pool:
        assert set(pool.map(preview.preview_png, [made] * 3)) == {usual}


def test_long_titles_are_shortened_and_volumes_have_the_unit_of_their_size():
    assert volume_text(0.0) == "0 mm3" and volume_text(2.5e7) == "25 l"
    short = canvas.fitting("x" * 300, 14, 120)
    assert canvas.text_width(short, 14) <= 120 and "..." in short


def test_scale_bars_are_in_the_unit_of_the_file(figures):
    for unit, factor in (("mm", 1), ("um", 1000)):
        preview.preview_png(content(*ball_on_grid(), unit=unit))
        bars = [words for words in texts_of(figures[-1]) if re.fullmatch(r"[\d.e+]+ [um]m", words)]
        assert len(bars) >= 2 and all(words.endswith(f" {unit}") for words in bars)
        assert all(1 <= float(words.split()[0]) / factor <= 20 for words in bars)
