"""What is said about a start before step 1, and when nothing is."""

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.api.segment import segment
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

SHAPE = (40, 40, 48)
START = "ball:20,20,20,5vox"


def scan(outlier=False):
    """A ball of radius 12 and value 100 on 0, with noise; perhaps with a stone in it."""
    z, y, x = np.indices(SHAPE) - np.array([20, 20, 20])[:, None, None, None]
    image = (z**2 + y**2 + x**2 < 12**2) * 100.0 + np.random.default_rng(1).normal(0, 5, SHAPE)
    if outlier:
        image[20:22, 20:22, 20:23] = 900.0
    return image.astype(np.float32)


def lines(image=None, start=START, **options):
    found = segment(
        scan() if image is None else image, start=start, max_steps=1, levels=1, threads=1, **options
    )
    return found.warnings


@pytest.mark.parametrize(
    "options", [{}, {"energy": "threshold:50,"}, {"energy": "threshold:learned,learned"}]
)
def test_a_good_start_is_passed_in_silence(options):
    assert lines(**options, smoothness=0.5) == []


def test_a_start_beyond_the_bounds_is_told_to_shrink():
    (line,) = lines(energy="threshold:226,")
    assert line.startswith("start: its median grey value 1")
    assert "the bound 226: it will shrink to nothing; try --energy" in line


def test_a_window_that_takes_in_the_surroundings_is_told():
    (line,) = lines(energy="threshold:-50,150")
    assert "lie within the bounds too" in line and "it will leak; try --inside ball:" in line
    assert line.endswith(", in place of --start and --energy")
    x, y, z, r = (float(v) for v in line.split("ball:")[1].split(", in place")[0].split(","))
    assert np.linalg.norm(np.array([x, y, z]) - 20) < 2 < r  # the start


def test_an_area_weight_that_is_too_large_for_the_start_is_told():
    (line,) = lines(energy="threshold:50,", smoothness=8.0)
    assert line.startswith("area: the start has a radius of about ") and "try --smoothness" in line
    less = float(line.split("--smoothness ")[1])
    assert lines(energy="threshold:50,", smoothness=less) == []


def test_the_area_weight_is_checked_as_if_the_clicks_were_not_there():
    """The surface cannot leave the click, so nothing acts into it: what is left in the end is the bare click."""
    options = {"inside": "ball:20,20,20,2vox", "energy": "threshold:50,", "levels": 1, "threads": 1}
    result = segment(scan(), smoothness=6.0, **options)
    (line,) = of_area(result)
    assert line.startswith("area: the start has a radius of about ") and result.labels.sum() < 100
    less = float(line.split("--smoothness ")[1])
    better = segment(scan(), smoothness=less, **options)
    assert not of_area(better) and better.labels.sum() > 5000
    assert not of_area(
        segment(scan(), smoothness=2.0, **{**options, "inside": "ball:20,20,20,9vox"}, max_steps=1)
    )


def of_area(result):
    return [line for line in result.warnings if line.startswith("area: ")]


def test_outliers_in_the_start_are_told_and_learned_around():
    (line,) = lines(scan(outlier=True), energy="threshold:learned,learned")
    assert (
        line.startswith("start: ")
        and "other grey values than the rest" in line
        and "median-based" in line
    )
    x, y, z = (float(v) for v in line.split("near ")[1].split(";")[0].split(","))
    assert all(abs(v - 20.5) < 3 for v in (x, y, z))
    x, y, z, radius = (float(v) for v in line.split("try --start ball:")[1].split(","))
    stone = np.argwhere(scan(outlier=True) > 500)[:, ::-1]
    assert np.linalg.norm(stone - np.array([x, y, z]), axis=1).min() > radius > 0.5
    found = lines(
        scan(outlier=True), f"ball:{x},{y},{z},{radius}", energy="threshold:learned,learned"
    )
    assert not [line for line in found if "other grey values" in line]
    assert lines(scan(outlier=True), energy="threshold:50,") == []  # nothing is learned


def in_air(noise):
    """Two cubes of 100 in air that is black or has noise."""
    image = np.random.default_rng(2).normal(0, noise, SHAPE) if noise else np.zeros(SHAPE)
    image[10:18, 10:18, 8:16] += 100.0
    image[20:30, 20:30, 26:36] += 100.0
    return image.astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 6.0])
@pytest.mark.parametrize("click", ["ball:6,32,30,3vox", "point:6,32,30"])
def test_a_click_in_the_air_is_told_before_the_run(noise, click):
    (line,) = (
        line for line in lines(in_air(noise), "clicks", inside=click) if line.startswith("click: ")
    )
    assert "looks like background" in line and "; try --inside" in line


def test_a_click_in_an_object_is_no_click_in_the_background():
    large = np.full(SHAPE, 100.0) + np.random.default_rng(2).normal(0, 5, SHAPE)
    large[:2], large[:, :2], large[:, :, -2:] = (
        0.0,
        0.0,
        0.0,
    )  # the object is 86 % of the image, up to its faces
    black, noisy = in_air(0.0), in_air(6.0)
    for image, click in (
        (black, "ball:12,14,14,3vox"),
        (noisy, "point:30,25,25"),
        (large, "ball:20,20,20,8vox"),
    ):
        assert not [
            line for line in lines(image, "clicks", inside=click) if line.startswith("click: ")
        ]


def test_a_size_that_the_image_does_not_have_is_told():
    (line,) = lines(start="clicks", inside="ball:20,20,20,3vox", size="250ml")
    assert line == "size: 250 ml is more than the whole image (76.8 ml); try it without --size"


def test_a_few_outliers_do_not_change_what_is_learned():
    plain, stone = (
        segment(image, start=START, energy="threshold:learned,learned", max_steps=1, levels=1)
        for image in (scan(), scan(outlier=True))
    )
    for key in ("LO", "HI"):
        assert stone.terms[0][key] == pytest.approx(plain.terms[0][key], abs=4)


def test_several_objects_are_named(tmp_path):
    labels = np.zeros(SHAPE, int)
    labels[18:22, 18:22, 18:22], labels[2:5, 2:5, 40:44] = 3, 9
    from accelsurf.api.segment import segment_objects

    found = segment_objects(scan(), labels, energy="threshold:60,", max_steps=1)
    assert [line.split(":")[0] for line in found.warnings] == ["object 9"]


def test_the_command_says_it_before_the_run_and_once(tmp_path, capsys):
    io.write(Volume(scan(), Geometry(SHAPE, (1.0, 1.0, 1.0))), tmp_path / "scan.nii.gz")
    words = [
        "segment",
        str(tmp_path / "scan.nii.gz"),
        "--start",
        START,
        "--energy",
        "threshold:226,",
        "--quiet",
    ]
    cli.execute([*words, "-o", str(tmp_path / "out"), "--progress", "json"])
    message = capsys.readouterr().err
    assert message.count("it will shrink to nothing") == 1
    assert message.index("it will shrink to nothing") < message.index('"event": "step"')
    assert "it will shrink to nothing" in (tmp_path / "out" / "scan_report.json").read_text()
