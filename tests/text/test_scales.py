"""A place that is read off the scales of a picture and typed as the picture says is the voxel that was seen."""

import itertools

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.cli.look import typed_place
from accelsurf.grid.boxes import corner_of
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import (
    IN_PLANE,
    DisplayOrientation,
    index_of_scales,
    part_of,
    scales_of,
)
from accelsurf.image.grey_window import GreyWindow
from accelsurf.image.volume import Volume
from accelsurf.output.pictures.canvas import Box, Canvas
from accelsurf.output.pictures.slice_views import SliceView, displayed, whole_ranges
from accelsurf.output.pictures.slices import ShownImage, open_slice, typed_note
from accelsurf.run.region_of_interest import cropped, region_of_interest
from accelsurf.text.clicks import read_clicks, voxel_named
from accelsurf.text.coordinates import UNITS_MM, place_text
from accelsurf.text.object_clicks import read_object_clicks
from accelsurf.text.objects import read_balls
from accelsurf.text.starts import ball_of, parse_start, psi_of_starts, read_starts

CASES = 60


def drawn_geometry(seed):
    """A grid with axes permuted and flipped, turned by 0 to 45 degrees, uneven voxels, of mm or um, at times flat."""
    rng = np.random.default_rng(seed)
    permuted = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    angle = rng.choice([0.0, 0.04, 0.07, 0.09, 0.2, 1.0, *rng.uniform(2.0, 45.0, 4)])
    axis = rng.normal(size=3)
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(np.radians(angle)) * cross
    turn += (1 - np.cos(np.radians(angle))) * cross @ cross
    shape = rng.integers(8, 40, 3) * rng.choice([1, 15], 3, p=[0.8, 0.2])
    if rng.random() < 0.3:
        shape[rng.integers(3)] = 1
    unit = str(rng.choice(["mm", "um", "nm"]))
    spacing = UNITS_MM[unit] * rng.choice([0.2, 0.237, 0.5, 0.9375, 1.0, 3.0], 3)
    origin = UNITS_MM[unit] * rng.uniform(-300, 300, 3)
    return Geometry(tuple(shape.tolist()), tuple(spacing), tuple(origin), turn @ permuted, unit)


def read_off(geometry, voxel):
    """The text that somebody types who reads a voxel (z, y, x) off the titles and ticks of the picture."""
    image = ShownImage(
        np.zeros(geometry.shape, np.uint8), geometry, GreyWindow(0.0, 1.0), unit=geometry.unit
    )
    at = {}
    for plane in range(3):
        view = SliceView(plane, round(displayed(voxel, geometry)[plane]))
        canvas = Canvas(500, 500)
        shown = open_slice(canvas, Box(50, 50, 450, 450), image, view, whole_ranges(geometry))
        name, _, words = shown.axes.get_title().split(", ")[-1].partition(" = ")
        number, unit = words.split(" ")
        assert unit == geometry.unit
        at[name] = float(number)
        for axis, drawn in zip((1, 0), shown.place(voxel), strict=True):
            across = IN_PLANE[plane][axis]
            along = (shown.axes.xaxis, shown.axes.yaxis)[1 - axis]
            told = float(along.get_major_formatter()(drawn, 0))
            label = f"{shown.up.names[across]} ({geometry.unit})"
            assert along.get_label_text() in ((label, "") if axis == 0 else (label,))
            h = geometry.spacing[shown.up.order[across]] / UNITS_MM[geometry.unit]
            assert abs(at.setdefault(shown.up.names[across], told) - told) <= 0.11 * h
    x, y, z = (at.get(name, at.get(f"{name}'")) for name in "xyz")
    ending = typed_note(geometry).rpartition("X,Y,Z")[2]
    assert DisplayOrientation.of(geometry).is_parallel == ("grid" not in ending)
    return f"{x:.9g},{y:.9g},{z:.9g}", ending


@pytest.mark.parametrize("seed", range(CASES))
def test_a_place_read_off_a_picture_is_the_voxel_that_was_seen(seed, tmp_path):
    geometry, rng = drawn_geometry(seed), np.random.default_rng(100 + seed)
    voxel = tuple(int(rng.integers(n)) for n in geometry.shape)
    body, ending = read_off(geometry, voxel)
    assert f"{ending}" in place_text(geometry.index_to_world(voxel).tolist(), geometry)
    volume = Volume(np.zeros(geometry.shape, np.uint8), geometry)
    small = 0.3 * min(geometry.spacing) / UNITS_MM[geometry.unit]
    said = place_text(geometry.index_to_world(voxel).tolist(), geometry)
    texts = [
        f"point:{body}{ending}",
        f"{body}{ending}",
        f"ball:{body},{small:.9g}{ending}",
        f"path:{body},0{ending}",
        said,
        f"point:{said}",
    ]
    if ending in ("", "grid"):  # the numbers of the scales, whatever their unit
        texts.append(f"point:{body}grid")
    for text in texts:
        (click,) = read_clicks([text], "inside", volume)
        assert corner_of(click.box) == voxel and click.mask.size == 1, text
    z, y, x = geometry.world_to_index(typed_place(f"{body}{ending}", geometry))
    assert np.rint([z, y, x]).astype(int).tolist() == list(voxel)
    centre, _ = ball_of(parse_start(f"ball:{body},{small:.9g}{ending}"), geometry)
    assert np.rint(centre).astype(int).tolist() == list(voxel)
    assert said in voxel_named(np.array(voxel), geometry)
    # Tables on the scales.
    rows = f"id,x_grid,y_grid,z_grid,r_grid\n7,{body},{small:.9g}\n"
    (tmp_path / "balls.csv").write_text(rows)
    ((place,),) = read_balls(str(tmp_path / "balls.csv"), geometry).values()
    assert np.rint(place[:3]).astype(int).tolist() == list(voxel)
    (tmp_path / "stroke.csv").write_text(f"x_grid,y_grid,z_grid\n{body}\n")
    for text in (f"stroke:{tmp_path / 'stroke.csv'}", str(tmp_path / "stroke.csv")):
        (click,) = read_clicks([text], "inside", volume)
        assert corner_of(click.box) == voxel
    (tmp_path / "clicks.csv").write_text(f"id,x_grid,y_grid,z_grid,side\n7,{body},inside\n")
    (click,) = read_object_clicks(str(tmp_path / "clicks.csv"), geometry).clicks
    assert corner_of(click.box) == voxel and click.id == 7


@pytest.mark.parametrize("seed", range(CASES))
def test_a_box_read_off_a_picture_is_the_voxels_within(seed):
    geometry, rng = drawn_geometry(seed), np.random.default_rng(200 + seed)
    ends = [sorted(rng.choice(n, 2, replace=False)) if n > 1 else [0, 0] for n in geometry.shape]
    up, mm = DisplayOrientation.of(geometry), UNITS_MM[geometry.unit]
    corners = np.array([scales_of(geometry, corner) for corner in itertools.product(*ends)]) / mm
    # A little around the centres, as by eye.
    room = 0.2 * np.array([up.spacing[axis] for axis in (2, 1, 0)]) / mm
    numbers = [*(corners.min(axis=0) - room), *(corners.max(axis=0) + room)]
    ending = typed_note(geometry).rpartition("X,Y,Z")[2]
    text = ",".join(f"{value:.9g}" for value in numbers) + ending
    expected = [(int(a), int(b) + 1) for a, b in ends]
    if "grid" in ending or not np.any(np.abs(np.abs(geometry.direction) - 0.5) < 0.4999):
        found = region_of_interest(text, geometry, "box")
        assert [(s.start, s.stop) for s in found] == expected
    psi = psi_of_starts(
        read_starts([f"box:{text}"]), Volume(np.zeros(geometry.shape, np.uint8), geometry)
    )
    inside = np.argwhere(psi < 0)
    if "grid" in ending:
        assert inside.min(axis=0).tolist() == [a for a, _ in expected]
        assert (inside.max(axis=0) + 1).tolist() == [b for _, b in expected]


@pytest.mark.parametrize("seed", range(CASES))
def test_a_part_of_a_grid_has_the_scales_of_the_whole(seed):
    """Messages of a run on a region of interest name places as the picture of the whole image shows them."""
    geometry, rng = drawn_geometry(seed), np.random.default_rng(300 + seed)
    ends = [sorted(rng.choice(n + 1, 2, replace=False)) for n in geometry.shape]
    box = tuple(slice(int(a), int(b)) for a, b in ends)
    part = cropped(cropped(geometry, box), tuple(slice(0, s.stop - s.start) for s in box))
    coarse = part_of(part, part.shape, part.origin, tuple(2.0 * h for h in part.spacing))
    first = np.array([s.start for s in box], float)
    # Scales that are said to be the world's are so to a tenth of a voxel.
    off = 0.1 if DisplayOrientation.of(geometry).is_parallel else 1e-6
    off_mm = off * max(geometry.spacing)
    for at in rng.uniform(-3, 20, (5, 3)):
        world = geometry.index_to_world(at).tolist()
        assert place_text(world, part) == place_text(world, geometry)
        scales = np.array(scales_of(geometry, at))
        assert np.allclose(scales_of(part, at - first), scales, rtol=0, atol=off_mm)
        assert np.allclose(index_of_scales(part, scales), at - first, rtol=0, atol=off)
        assert np.allclose(index_of_scales(coarse, scales), (at - first) / 2, rtol=0, atol=off)


def two_balls(direction, unit="mm"):
    """An image with a small ball, and where it is (z, y, x)."""
    mm = UNITS_MM[unit]
    geometry = Geometry(
        (20, 24, 28), (1.2 * mm, 0.9 * mm, mm), (7 * mm, -5 * mm, 3 * mm), direction
    )
    z, y, x = np.indices(geometry.shape)
    place = (13, 8, 19)
    far = sum(((a - b) * h) ** 2 for a, b, h in zip((z, y, x), place, (1.2, 0.9, 1), strict=True))
    image = 100.0 * (far < 16) + np.random.default_rng(0).normal(0, 5, geometry.shape)
    return Volume(image.astype(np.float32), geometry), place


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.slow
def test_commands_take_what_look_shows(seed, tmp_path, capsys):
    """Look, segment, its report and preview, and refine on an image turned by 3 to 45 degrees, permuted and flipped."""
    rng = np.random.default_rng(seed)
    permuted = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    angle = np.radians(rng.uniform(3, 45))
    c, s = np.cos(angle), np.sin(angle)
    volume, place = two_balls(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ permuted)
    io.write(volume, tmp_path / "scan.nii.gz")
    geometry = io.read(tmp_path / "scan.nii.gz").geometry

    def run(*words):
        return cli.execute([str(word) for word in words])

    body, ending = read_off(geometry, place)
    assert ending == "grid"
    assert run("look", tmp_path / "scan.nii.gz", "-o", tmp_path, "--at", f"{body}grid") == 0
    assert f"at       {place_text(geometry.index_to_world(place).tolist(), geometry)}" in (
        capsys.readouterr().out
    )
    words = (tmp_path / "scan.nii.gz", "-o", tmp_path / "out", "--threads", 1)
    assert run("segment", *words, "--inside", f"ball:{body},2grid") == 0
    labels = io.read(tmp_path / "out" / "scan_seg.nii.gz").array
    inside = volume.array > 50
    assert 2 * (inside & (labels > 0)).sum() > 0.9 * (inside.sum() + (labels > 0).sum())
    outside, _ = read_off(geometry, (place[0], place[1], place[2] - 3))
    assert run("refine", tmp_path / "out", "--outside", f"point:{outside}grid") in (0, 5)
    assert not io.read(tmp_path / "out" / "scan_seg.nii.gz").array[13, 8, 16]
