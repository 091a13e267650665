"""The scene: what it draws lies where it should, in mm, on oblique, left-handed, anisotropic and coarse grids."""

import dataclasses
import re

import numpy as np
import pytest
import pyvista as pv
from PIL import Image

from accelsurf import Volume
from accelsurf.errors import InputError, UsageError
from accelsurf.io.headers import DICOM_KEY, UNIT_KEY
from accelsurf.measure.surface_mesh import extract_surface
from accelsurf.output.pictures import canvas
from accelsurf.viewer.page.page import style_sheet
from accelsurf.viewer.scene import colors, shapes
from tests.support import viewing

DIRECTIONS = {
    "straight": np.eye(3),
    "left-handed, oblique": viewing.TURN,
    "axes swapped": np.eye(3)[[2, 0, 1]],
}


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


# -- shapes: no plotter -------------------------------------------------------------------------------------


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", DIRECTIONS)
@pytest.mark.parametrize("levels", [1, 2])
def test_the_surface_lies_in_the_world(name, levels):
    volume, center = viewing.ball_image((48, 52, 56), direction=DIRECTIONS[name], radius=16.0)
    frames, _ = viewing.run_frames(volume, center, levels=levels, max_steps=60)
    assert {frame.level for frame in frames} == set(range(levels))
    for frame in frames[-1], frames[2]:
        mesh = shapes.isosurface(frame.surfaces[0], volume.geometry)
        radii = np.linalg.norm(mesh.points - center, axis=1)
        assert radii.std() < 0.35, (frame.level, radii.std())
        outward = (mesh.points - center) / radii[:, None]
        normals = np.asarray(mesh.point_data.active_normals)
        assert np.median((normals * outward).sum(axis=1)) > 0.97
    radii = np.linalg.norm(
        shapes.isosurface(frames[-1].surfaces[0], volume.geometry).points - center, axis=1
    )
    assert abs(radii.mean() - 16.0) < 0.5


def test_the_surface_is_that_of_the_mesh_that_is_saved():
    volume, center = viewing.ball_image(direction=viewing.TURN)
    frames, _ = viewing.run_frames(volume, center, levels=1)
    psi = np.full(volume.geometry.shape, 9.0, np.float32)
    (surface,) = frames[-1].surfaces
    psi[tuple(slice(o, o + n) for o, n in zip(surface.offset, surface.psi.shape, strict=True))] = (
        surface.psi
    )
    saved = extract_surface(psi, volume.geometry)
    mesh = shapes.isosurface(surface, volume.geometry)
    # What is shown is linear between voxels; the mesh lies so that it has the volume, h^2/(6 r) further out at most.
    assert np.allclose(mesh.bounds[::2], saved.bounds[0], atol=0.06)
    assert np.allclose(mesh.bounds[1::2], saved.bounds[1], atol=0.06)
    assert mesh.area == pytest.approx(saved.area, rel=0.01)


def test_an_object_cut_by_the_border_is_closed():
    z, y, x = np.indices((12, 14, 16)).astype(np.float32)
    mesh = shapes.closed_surface(np.sqrt((z - 1) ** 2 + (y - 7) ** 2 + (x - 8) ** 2) - 5)
    assert mesh.n_open_edges == 0 and mesh.volume > 0
    assert mesh.bounds[4] == pytest.approx(-0.5, abs=0.01)


def test_colours_on_the_surface_are_the_quantity():
    volume, center = viewing.ball_image()
    frames, _ = viewing.run_frames(volume, center, levels=1)
    mesh = shapes.isosurface(frames[3].surfaces[0], volume.geometry, "speed")
    cells, values = frames[3].surfaces[0].quantities["speed"]
    near = np.abs(np.asarray(mesh["speed"]))
    assert near.max() > 0 and near.max() <= np.abs(values).max() * 1.0001
    assert (
        "density"
        not in shapes.isosurface(frames[3].surfaces[0], volume.geometry, "density").point_data
    )


def test_contours_lie_on_the_circle():
    y, x = np.indices((30, 40)).astype(np.float32)
    lines = shapes.contour(np.sqrt((y - 12) ** 2 + (x - 20) ** 2) - 8)
    assert np.allclose(np.linalg.norm(lines.reshape(-1, 2) - (12, 20), axis=1), 8, atol=0.05)
    assert len(shapes.contour(np.ones((5, 5), np.float32))) == 0


def test_color_ranges_are_round_and_hold_the_values():
    assert colors.color_range(np.zeros(3, np.float32), True) == (-1.0, 1.0)
    assert colors.color_range(np.array([np.nan, 7.0], np.float32), False) == (0.0, 10.0)


# -- the scene ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DIRECTIONS)
def test_slices_cut_where_the_cursor_is(scene_of, name):
    """A single bright voxel is seen where its world position is, in each slice, whatever the grid's directions."""
    volume, _ = viewing.ball_image(direction=DIRECTIONS[name])
    voxel = (5, 30, 12)
    array = np.zeros(volume.array.shape, np.float32)
    array[voxel] = 1.0
    scene = scene_of(Volume(array, volume.geometry), size=(800, 450))
    world = volume.geometry.index_to_world(voxel)
    scene.cursor = world
    assert np.allclose(scene.cursor, world)
    picture = scene.screenshot()
    height, width = picture.shape[:2]
    for tile in scene.slice_tiles.values():
        right, up = tile.to_tile(np.array(voxel, float))
        left, bottom, far, top = tile.renderer.GetViewport()
        mm = 2 * tile.renderer.camera.parallel_scale / ((top - bottom) * height)
        x = (left + far) / 2 * width + (right - tile.renderer.camera.focal_point[0]) / mm
        y = (bottom + top) / 2 * height + (up - tile.renderer.camera.focal_point[1]) / mm
        assert picture[height - 1 - round(y), round(x)].max() > 100
        picked = scene.pick(x, y)
        assert np.linalg.norm(picked.world - world) < 1.0
    scene.cursor = volume.geometry.index_to_world((12, 12, 30))
    assert (scene.screenshot() != picture).any()


def test_slices_hang_as_radiologists_hang_them(scene_of):
    """The patient's left (+x) is at the right, front (-y) at the top of an axial slice, head (+z) of the others."""
    volume, _ = viewing.ball_image(direction=np.diag([-1.0, -1.0, -1.0]))
    tiles = scene_of(volume).slice_tiles
    origin = volume.geometry.center_world()
    for name, vector, wanted in (
        ("axial", (1, 0, 0), (1, 0)),
        ("axial", (0, -1, 0), (0, 1)),
        ("coronal", (1, 0, 0), (1, 0)),
        ("coronal", (0, 0, 1), (0, 1)),
        ("sagittal", (0, 1, 0), (1, 0)),
        ("sagittal", (0, 0, 1), (0, 1)),
    ):
        ends = [volume.geometry.world_to_index(origin + k * np.array(vector)) for k in (0.0, 1.0)]
        assert np.allclose(tiles[name].to_tile(ends[1]) - tiles[name].to_tile(ends[0]), wanted), (
            name,
            vector,
        )


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_pictures_show_the_run(scene_of, theme):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center)
    scene = scene_of(
        volume, theme=theme, reference=volume.with_array(volume.array > 0), size=(960, 540)
    )
    empty = scene.screenshot()
    assert empty.shape == (540, 960, 3)
    seen = [empty]
    for number in (0, 3, len(frames) - 1):
        scene.update(frames[number], (history[: number + 1],))
        seen.append(scene.screenshot())
        assert all((seen[-1] != other).any() for other in seen[:-1])
    assert scene.dice > 0.97
    assert abs(int(np.median(seen[-1])) - (20 if theme == "dark" else 255)) < 30
    # The same frame gives the same picture.
    assert np.array_equal(seen[-1], scene.screenshot())
    for name in ("speed", "force"):
        scene.color_by(name)
        colored = scene.screenshot()
        assert (colored != seen[-1]).mean() > 0.002
        seen.append(colored)
    assert (seen[-1] != seen[-2]).any()
    scene.color_by("density")  # this flow has none: plain, and no scale of colours
    assert np.array_equal(scene.screenshot(), seen[4 - 1])


def test_dice_of_coarse_frames_is_near(scene_of):
    volume, center = viewing.ball_image((48, 52, 56), radius=16.0)
    frames, _ = viewing.run_frames(volume, center, levels=2, max_steps=60)
    truth = volume.with_array(volume.array > 0)
    scene = scene_of(volume, reference=truth)
    coarse = [frame for frame in frames if frame.level == 1][-1]
    scene.update(coarse)
    assert scene.dice > 0.93
    scene.update(frames[-1])
    labels = np.zeros(volume.array.shape, bool)
    (surface,) = frames[-1].surfaces
    labels[
        tuple(slice(o, o + n) for o, n in zip(surface.offset, surface.psi.shape, strict=True))
    ] = surface.psi < 0
    common = (labels & (truth.array > 0)).sum()
    assert scene.dice == pytest.approx(2 * common / (labels.sum() + truth.array.sum()), abs=1e-12)


def test_switches_change_the_picture(scene_of):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center)
    scene = scene_of(volume, size=(640, 360))
    scene.update(frames[-1], (history,))
    plain = scene.screenshot()
    scene.show_planes(True)
    assert (scene.screenshot() != plain).mean() > 0.002
    scene.show_planes(False)
    assert np.array_equal(scene.screenshot(), plain)
    scene.mark_ball(center, 9.0)
    assert (scene.screenshot() != plain).any()
    scene.mark_ball(None)
    assert np.array_equal(scene.screenshot(), plain)
    scene.tiles.orbit(30.0)
    turned = scene.screenshot()
    assert (turned != plain).any()
    scene.tiles.orbit(-30.0)
    assert (scene.screenshot() != plain).mean() < 0.002  # but for rounding
    scene.paint("light")
    assert np.median(scene.screenshot()) == 255


def test_picking_the_surface_gives_a_point_on_it(scene_of):
    volume, center = viewing.ball_image()
    frames, _ = viewing.run_frames(volume, center)
    scene = scene_of(volume, size=(800, 450))
    scene.update(frames[-1])
    scene.render()
    scene.space.renderer.SetWorldPoint(*center, 1.0)
    scene.space.renderer.WorldToDisplay()
    x, y, _ = scene.space.renderer.GetDisplayPoint()
    picked = scene.pick(x, y)
    assert picked.tile == "space" and abs(np.linalg.norm(picked.world - center) - 11) < 0.6
    assert scene.pick(2, 440).world is None  # beside it
    assert scene.pick(790, 10).tile == "energies"


def test_a_stepped_slice_is_the_next_one(scene_of):
    volume, _ = viewing.ball_image(direction=viewing.TURN)
    scene = scene_of(volume)
    for name, tile in scene.slice_tiles.items():
        before = tile.index
        scene.step_slice(name, 2)
        assert abs(tile.index - before) == 2
        scene.step_slice(name, -1000)
        assert tile.index in (0, volume.array.shape[tile.stack.axis] - 1)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_slice_is_a_scene_too(scene_of, axis):
    shape = [40, 44, 48]
    shape[axis] = 1
    where = np.indices(shape) - (np.array(shape).reshape(3, 1, 1, 1) - 1) / 2
    image = (np.linalg.norm(where, axis=0) < 12).astype(np.float32)
    volume = Volume.from_array(image, (1.0, 1.0, 1.0))
    frames, history = viewing.run_frames(volume, volume.geometry.center_world(), levels=1)
    scene = scene_of(volume, size=(800, 450), reference=volume)
    assert scene.space is None and len(scene.slice_tiles) == 1
    empty = scene.screenshot()
    scene.update(frames[-1], (history,))
    assert (scene.screenshot() != empty).mean() > 0.01
    assert scene.dice > 0.97
    scene.show_planes(True)
    scene.color_by("speed")
    assert scene.pick(200, 225).world is not None


def test_no_surface_and_no_history_are_drawn(scene_of):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, smoothness=60, max_steps=150, levels=1)
    assert not frames[-1].has_surface
    scene = scene_of(volume)
    scene.update(frames[0], (history[:1],))
    there = scene.screenshot()
    scene.update(frames[-1], (history,))
    assert (scene.screenshot() != there).any()


def test_bad_input_is_an_error(scene_of):
    volume, _ = viewing.ball_image()
    with pytest.raises(UsageError, match="theme: pink"):
        scene_of(volume, theme="pink")
    other, _ = viewing.ball_image(spacing=(1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="not on the image's grid"):
        scene_of(volume, reference=other)
    scene = scene_of(volume)
    with pytest.raises(UsageError, match="color: rainbow"):
        scene.color_by("rainbow")
    for bad in (np.nan, np.inf):
        with pytest.raises(UsageError, match="cursor"):
            scene.cursor = (0, 0, bad)
    scene.cursor = (1e12, -1e12, 0)  # clipped to the image
    assert np.isfinite(scene.cursor).all()


def test_screenshots_are_files_too(scene_of, tmp_path):
    from matplotlib import image

    volume, _ = viewing.ball_image()
    scene = scene_of(volume, size=(400, 300))
    picture = scene.screenshot(tmp_path / "a.png")
    assert np.array_equal(
        (image.imread(tmp_path / "a.png") * 255).round().astype(np.uint8)[..., :3], picture
    )
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize("name", DIRECTIONS)
def test_triangles_face_the_way_of_their_normals(name):
    volume, center = viewing.ball_image(direction=DIRECTIONS[name])
    frames, _ = viewing.run_frames(volume, center, levels=1, max_steps=3)
    (surface,) = frames[-1].surfaces
    for mesh in (
        shapes.isosurface(surface, volume.geometry),
        shapes.label_surface(volume.array > 0, volume.geometry),
    ):
        a, b, c = (
            np.asarray(mesh.points)[corner]
            for corner in np.asarray(mesh.faces).reshape(-1, 4)[:, 1:].T
        )
        outward = (np.cross(b - a, c - a) * (a - center)).sum(axis=1)
        assert (outward > 0).mean() > 0.999


def test_the_reference_has_a_colour_of_its_own_in_every_picture():
    assert (colors.SURFACE, colors.REFERENCE) == (
        canvas.SURFACE_COLOR,
        canvas.REFERENCE_COLOR,
    )
    assert (
        colors.REFERENCE not in canvas.OBJECT_COLORS and canvas.OBJECT_COLORS[0] == colors.SURFACE
    )


def luminance(code):
    rgb = np.array(pv.Color(code).int_rgb) / 255
    return float(
        np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        @ [0.2126, 0.7152, 0.0722]
    )


def contrast(one, other):
    """As of the Web Content Accessibility Guidelines: 4.5 for text."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", colors.THEMES)
def test_curves_of_one_object_have_neither_colour_of_a_surface(scene_of, theme):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1)
    scene = scene_of(volume, theme=theme, size=(960, 540))
    scene.update(frames[-1], [history])
    chart = scene.screenshot()[270:, 720:].astype(int)
    for code in (colors.SURFACE, colors.REFERENCE, canvas.BLUE, canvas.VERMILION):
        assert not (np.abs(chart - pv.Color(code).int_rgb).max(axis=2) < 12).any(), code
    look = colors.theme_named(theme)
    assert (np.abs(chart - pv.Color(look.ink).int_rgb).max(axis=2) < 12).sum() > 200
    assert contrast(look.ink, look.background) > 4.5


def test_the_page_has_the_accent_of_the_window_and_of_the_surface():
    """Never the reference's colour; what is written can be read in both themes."""
    sheet = style_sheet()
    given = re.findall(r"^[.]page([.]light)? {([^}]*)}?", sheet, re.MULTILINE)
    themes = {"dark": {}, "light": {}}
    for light, text in given:
        for name in themes if not light else ("light",):
            themes[name] |= dict(re.findall(r"--(\w+): (#\w{6});", text))
    for theme, known in themes.items():
        assert known["main"] == colors.SURFACE and contrast(known["on"], known["main"]) > 4.5
        for ground in (known["ground"], known["panel"]):
            assert (
                min(contrast(known[name], ground) for name in ("edge", "alarm", "ink", "soft"))
                > 4.5
            )
        assert known["alarm"] == colors.ALARM[theme] != known["edge"]
    others = (colors.REFERENCE, *canvas.OBJECT_COLORS[1:4])
    assert not [code for code in others if code.lower() in sheet.lower()]


# -- what is written and drawn over it ----------------------------------------------------------------------


def test_the_chart_says_what_will_be_there_and_has_room_for_its_ticks(scene_of):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1)
    far = [record._replace(potential=record.potential * 1e3 - 9e6) for record in history]
    scene = scene_of(volume, size=(640, 360), theme="light")
    assert "first step" in written(scene)
    scene.update(frames[-1], [far])
    scene.screenshot()
    assert "first step" not in written(scene)
    few = ticks(scene)
    scene.tiles.resize(1920, 1080)
    scene.screenshot()
    many = ticks(scene)
    assert all(2 <= len(texts) <= 4 for texts in few) and sum(map(len, many)) > sum(map(len, few))
    # Blanks at both ends: what VTK would cut off, or draw twice, is none of the number.
    assert all(text == f" {text.strip()} " for texts in many for text in texts)


def written(scene):
    """All text actors that are seen, in one string."""
    return " ".join(
        prop.GetInput()
        for renderer in scene.plotter.renderers
        for prop in renderer.GetViewProps()
        if prop.IsA("vtkTextActor") and prop.GetVisibility() and prop.GetInput()
    )


def ticks(scene):
    """Texts at the axes of the charts."""
    axes = [axis for chart in scene.chart.charts for axis in (chart.x_axis, chart.y_axis)]
    return [
        [labels.GetValue(i) for i in range(labels.GetNumberOfValues())]
        for labels in map(tick_labels, axes)
    ]


def tick_labels(axis):
    return axis.GetTickLabels()


def test_lengths_are_in_the_unit_of_the_file(scene_of):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1)
    small = Volume(volume.array, volume.geometry, {UNIT_KEY: "um"})
    scene = scene_of(small, size=(1280, 720))
    scene.update(frames[-1], [history])
    scene.screenshot()
    said = written(scene)
    assert "Slice  z = 27 000 um" in said and "um3" in said and "10000 um" in said
    assert "mm" not in said and " ml" not in said
    scene = scene_of(volume, size=(1280, 720))
    scene.update(frames[-1], [history])
    scene.screenshot()
    said = written(scene)
    assert " mm3\n= " in said and " ml" in said and "10 mm" in said and " um" not in said


@pytest.mark.parametrize("ratio", [1.0, 1.5, 2.0, 3.0])
def test_text_and_lines_scale_once_with_the_screen(scene_of, ratio):
    """A window that is so many times finer shows the same picture, finer; whatever resolution Qt has set."""
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1)
    pictures = []
    for own in (1.0, ratio):
        scene = scene_of(volume, size=(round(640 * own), round(360 * own)))
        scene.tiles.pixel_ratio = own
        scene.plotter.render_window.SetDPI(round(72 * own))  # as Qt does
        scene.update(frames[-1], [history])
        pictures.append(scene.screenshot().astype(float))
    small = np.asarray(
        Image.fromarray(pictures[1].astype(np.uint8)).resize((640, 360), Image.Resampling.BOX)
    )
    ink = [
        float((np.abs(one - one[0, 0]).max(axis=2) > 60).mean())
        for one in (pictures[0], small.astype(float))
    ]
    assert ink[1] == pytest.approx(ink[0], rel=0.04)
    assert np.abs(small - pictures[0]).mean() < 5.0


def line_widths(scene):
    """Widths of all lines that are seen, in the order in which they are drawn."""
    found = []
    for renderer in scene.plotter.render_window.GetRenderers():
        for prop in renderer.GetViewProps():
            mesh = (
                prop.GetMapper().GetInput()
                if hasattr(prop, "GetMapper") and prop.GetVisibility()
                else None
            )
            if prop.IsA("vtkAnnotatedCubeActor"):
                found.append(prop.GetTextEdgesProperty().GetLineWidth())
            elif mesh is not None and mesh.GetNumberOfLines():
                found.append(prop.GetProperty().GetLineWidth())
    return found


@pytest.mark.parametrize("ratio", [1.0, 1.5, 2.0, 3.0])
def test_the_lines_of_ways_and_cube_scale_with_the_screen(scene_of, ratio):
    """Whatever draws lines is as wide on a fine screen as on a usual one."""
    volume, center = viewing.ball_image()
    frame = viewing.run_frames(volume, center, levels=1)[0][-1]
    way = center + np.array([[-8.0, 0.0, 0.0], [0.0, 6.0, 0.0], [9.0, 0.0, 3.0]])
    widths = []
    for own in (1.0, ratio):
        scene = scene_of(volume, size=(round(640 * own), round(360 * own)))
        scene.tiles.pixel_ratio = own
        scene.update(dataclasses.replace(frame, paths=(way,)))
        scene.render()
        widths.append(np.array(line_widths(scene)))
    assert len(widths[0]) >= 10 and widths[1] == pytest.approx(ratio * widths[0])


@pytest.mark.parametrize("size", [(640, 360), (1280, 720)])
def test_letters_beside_a_thin_slab_do_not_overlap(scene_of, size):
    volume = Volume.from_array(
        np.zeros((2, 200, 200), np.float32), (1.0, 1.0, 1.0), direction=np.eye(3)
    )
    volume.metadata[DICOM_KEY] = "1.2.3"  # its axes are a patient's
    scene = scene_of(volume, size=size)
    assert scene.anatomical
    for name in ("coronal", "sagittal"):
        boxes = []
        scene.screenshot()
        for prop in scene.slice_tiles[name].renderer.GetViewProps():
            if prop.IsA("vtkTextActor") and prop.GetInput() in ("S", "I"):
                box, renderer = [0.0] * 4, scene.slice_tiles[name].renderer
                prop.GetBoundingBox(renderer, box)
                _, up = prop.GetPositionCoordinate().GetComputedViewportValue(renderer)
                boxes.append((up + box[2], up + box[3]))
        (low, high) = sorted(boxes)
        assert low[1] < high[0], (name, boxes)


@pytest.mark.parametrize("layout", ["one", "four", "single"])
def test_lines_of_the_legend_do_not_overlap(scene_of, layout):
    volume, center = viewing.ball_image()
    truth = volume.with_array((volume.array > 0).astype(np.uint8))
    frames, history = viewing.run_frames(volume, center, levels=1)
    scene = scene_of(volume, reference=truth, size=(960, 540))
    scene.tiles.lay_out(layout, "space")
    scene.update(frames[-1], [history])
    scene.screenshot()
    spans = []
    for prop in scene.space.renderer.GetViewProps():
        if prop.IsA("vtkTextActor") and prop.GetInput() in scene.legend:
            box = [0.0] * 4
            prop.GetBoundingBox(scene.space.renderer, box)
            _, up = prop.GetPositionCoordinate().GetComputedViewportValue(scene.space.renderer)
            spans.append((up + box[2], up + box[3]))
    (low, high) = sorted(spans)
    assert low[1] <= high[0]
