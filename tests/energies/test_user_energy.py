"""Energies that users write: the guide's example as it is printed there, the helpers, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from accelsurf.api.segment import evolve, segment
from accelsurf.energies import (
    ChanVese,
    ImageEnergy,
    MomentTracker,
    RegionField,
    normals_at_front,
    points_at_front,
    sample_at_front,
    slope_at_front,
)
from accelsurf.errors import InputError, UsageError
from accelsurf.levelset import LevelSet
from accelsurf.measure.metrics import dice
from accelsurf.settings.run_config import RunConfig

GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "own-energy.md"
MARK = "<!-- run by tests/energies/test_user_energy.py -->"


def example():
    """The names that the guide's example leaves, after it was run as printed."""
    code = re.search(
        re.escape(MARK) + r"\n```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL
    )
    assert code is not None, "the page has lost its example, or the mark above it"
    names = {}
    exec(compile(code[1], "the example in docs/how-to/own-energy.md", "exec"), names)
    return names


def blob(shape=(28, 30, 32)):
    z, y, x = (np.indices(shape).T - (np.array(shape) - 1) / 2).T
    return np.exp(-(z**2 + y**2 + x**2) / (2 * 6.0**2))


START = {"start": "ball:17,14,13,5vox"}


def cubed(n=64):
    z, y, x = np.indices((n, n, n)) - n / 2 + 0.5
    return 1.0 * (z**2 + y**2 + x**2 < (n / 4) ** 2)


# ---------------------------------------------------------------------------------------------- the guide's example


def test_the_example_of_the_guide_finds_what_its_equation_says(capsys):
    """exp(-r^2/128) = mu (V/V0 - 1), V the volume of the ball of radius r: the isophote that balances both wishes."""
    result = example()["result"]

    def force(r):
        return -np.exp(-(r**2) / 128) + 10.0 * (4 / 3 * np.pi * r**3 / 4000.0 - 1)

    true = brentq(force, 5, 15)
    assert result.stop.reason == "converged"
    radii = np.linalg.norm(result.surface.vertices - 19.5, axis=1)
    assert np.abs(radii - true).max() < 0.2 and abs(radii.mean() - true) < 0.02
    assert result.volume_mm3 == pytest.approx(4 / 3 * np.pi * true**3, rel=0.002)
    # What is printed is what the comment in the guide promises.
    name, volume = capsys.readouterr().out.rsplit(maxsplit=1)
    promised = re.search(r"# (custom: \w+), and (\d+) mm3", GUIDE.read_text(encoding="utf-8"))
    assert name == promised[1] and float(volume) == pytest.approx(int(promised[2]), abs=2)


def test_the_force_of_the_example_is_the_derivative_of_its_value():
    known = example()["KnownVolume"]
    image = blob()
    radius = np.sqrt(-72 * np.log(image))
    surfaces = [LevelSet(radius - r, (1, 1, 1), 4.0) for r in (8.8, 9.0, 9.2)]
    energy = known(image, 2000.0, alpha=0.4)
    values = []
    for surface in surfaces:
        energy.start(surface)
        values.append(energy.value(surface, *surface.fraction_and_area()))
    middle, front = surfaces[1], surfaces[1].front()
    fraction, area = middle.fraction_and_area()
    energy.start(middle)
    energy.value(middle, fraction, area)
    work = 0.4 * np.dot(energy.force(middle, front, middle.curvature(front)), area)
    assert values[2] - values[0] == pytest.approx(work, rel=0.01)


# ----------------------------------------------------------------------------------------------------- in segment()


def two_means(image, spacing):
    return ChanVese(image, 0.05, epsilon=1.5)


def noisy_ball():
    z, y, x = np.indices((30, 30, 30)) - 14.5
    truth = z**2 + y**2 + x**2 < 9**2
    return truth * 50.0 + np.random.default_rng(2).normal(0, 10, truth.shape), truth


def test_an_object_and_a_maker_run_as_the_named_energy_does():
    image, truth = noisy_ball()
    words = {"start": "ball:17,14,13,5vox", "presmooth": 0.7}
    named = segment(image, energy="chan-vese:area=0", smoothness=0.05, **words)
    made = segment(image, energy=two_means, start="ball:17,14,13,5vox", presmooth=0.7)
    given = segment(
        image, energy=two_means(named.image, None), start="ball:17,14,13,5vox", presmooth=0.7
    )
    for run in (made, given):
        np.testing.assert_array_equal(run.psi, named.psi)
        assert [r.potential for r in run.history] == [r.potential for r in named.history]
    assert dice(named.labels, truth) > 0.97
    steps = list(evolve(image, energy=two_means, start="ball:17,14,13,5vox", presmooth=0.7))
    assert [s.record.potential for s in steps] == [r.potential for r in made.history]


def test_a_class_is_made_with_the_scaled_image_and_the_spacing():
    seen = []

    class Bright(RegionField):
        def __init__(self, image, spacing):
            seen.append((image, spacing))
            super().__init__(0.5 - image)

    image, truth = noisy_ball()
    result = segment(
        image, spacing=(1.0, 0.9, 1.1), energy=Bright, start="ball:18,13,13,5", max_steps=400
    )
    ((scaled, spacing),) = seen
    assert spacing == (1.0, 0.9, 1.1) and scaled.dtype == np.float32
    assert [float(v) for v in np.percentile(scaled, (0.5, 99.5))] == pytest.approx([0, 1], abs=1e-5)
    assert dice(result.labels, truth) > 0.95


def test_the_same_object_may_run_twice():
    energy = two_means(noisy_ball()[0], None)
    one, two = (
        segment(noisy_ball()[0], energy=energy, start="ball:17,14,13,5vox") for _ in range(2)
    )
    np.testing.assert_array_equal(one.psi, two.psi)


def test_the_report_says_whose_energy_it_was():
    image, _ = noisy_ball()
    own = segment(image, energy=two_means, max_steps=2, **START)
    assert (
        own.energy
        == own.report["energy"]["name"]
        == own.report["config"]["energy"]
        == "custom: ChanVese"
    )
    with pytest.raises(
        UsageError, match="custom: ChanVese was given, expected chan-vese, .* in place of 'custom'"
    ):
        RunConfig(**own.report["config"])  # no settings make this run again
    named = segment(image, energy="chan-vese", max_steps=2, **START)
    assert (
        named.energy
        == named.report["energy"]["name"]
        == named.report["config"]["energy"]
        == "chan-vese"
    )
    assert RunConfig(**named.report["config"]) == named.config


@pytest.mark.parametrize(
    ("key", "setting"),
    [("smoothness", 0.1), ("balance", 2), ("epsilon", 0), ("edge_scale", 1), ("balloon", -1)],
)
def test_settings_that_it_would_not_see_are_refused(key, setting):
    with pytest.raises(UsageError, match=f"^{key}: .* one of your own"):
        segment(noisy_ball()[0], energy=two_means, **{key: setting}, **START)


# ----------------------------------------------------------------------------------------------------- what is refused


class Fine:
    """U = area, without any base."""

    alpha = 1.0

    def start(self, surface):
        pass

    def follow(self, surface, change):
        pass

    def value(self, surface, fraction, area):
        return area.sum()

    def force(self, surface, front, curvature):
        return curvature


def test_a_class_without_a_base_is_enough():
    """The area alone: a cube becomes round and smaller."""
    result = segment(
        noisy_ball()[0], energy=Fine(), start="box:6,6,6,22,22,22vox", flow="gradient", max_steps=60
    )
    assert result.energy == "custom: Fine"
    assert result.area_mm2 < 0.8 * 6 * 17**2
    roundness = 36 * np.pi * result.volume_mm3**2 / result.area_mm2**3
    assert roundness > 0.97  # 0.52 for a cube


@pytest.mark.parametrize("method", ["start", "follow", "value", "force"])
def test_an_object_that_lacks_a_method(method):
    lacking = type("Lacking", (Fine,), {method: None})()
    with pytest.raises(
        UsageError, match=f"a Lacking was given, which has no {method}\\b"
    ) as caught:
        segment(noisy_ball()[0], energy=lacking, **START)
    assert "accelsurf.energies.Energy" in caught.value.hint


@pytest.mark.parametrize("energy", [5, np.zeros(3), object()])
def test_what_is_no_energy_at_all(energy):
    with pytest.raises(UsageError, match="which has no start, follow, value, force"):
        segment(noisy_ball()[0], energy=energy, **START)


@pytest.mark.parametrize("alpha", [None, -1.0, float("nan"), float("inf"), "1", True, np.ones(2)])
def test_alpha_must_be_a_number(alpha):
    energy = Fine()
    energy.alpha = alpha
    with pytest.raises(UsageError, match="alpha of Fine is .*, expected a number at least 0"):
        segment(noisy_ball()[0], energy=energy, **START)


def test_a_name_that_is_none():
    with pytest.raises(UsageError, match="energy: edges was given"):
        segment(noisy_ball()[0], energy="edges", **START)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda f: f[:-1], r"an array of float32 of shape \(\d+,\), expected .* of shape \(\d+,\)"),
        (lambda f: f[:, None], "expected an array of numbers of shape"),
        (lambda f: list(f), "a list, expected"),
        (lambda f: None, "a NoneType, expected"),
        (lambda f: f > 0, "array of bool"),
        (lambda f: f * 1j, "array of complex"),
        (
            lambda f: np.where(np.arange(f.size) % 7 == 0, np.nan, f),
            "not finite, the first nan at index x=",
        ),
        (lambda f: f.astype(float) + 1e300, r"not finite, the first 1e\+300 at index x="),
    ],
)
def test_a_force_that_is_none(wrong, words):
    class Wrong(Fine):
        def force(self, surface, front, curvature):
            return wrong(curvature)

    with pytest.raises(InputError, match="Wrong.force returned .*" + words) as caught:
        segment(noisy_ball()[0], energy=Wrong(), **START)
    assert "\n" not in str(caught.value) and caught.value.hint


def test_off_the_front_anything_goes():
    class Careless(Fine):
        def force(self, surface, front, curvature):
            return np.where(front, curvature, np.nan)

    options = {"start": "ball:15,15,15,9vox", "max_steps": 5}
    one, other = (
        segment(noisy_ball()[0], energy=energy, **options) for energy in (Careless(), Fine())
    )
    np.testing.assert_array_equal(one.psi, other.psi)


@pytest.mark.parametrize("value", [None, "12", np.ones(2), 1j])
def test_a_value_that_is_none(value):
    class Wrong(Fine):
        def value(self, surface, fraction, area):
            return value

    with pytest.raises(InputError, match="Wrong.value returned .*, expected one number"):
        segment(noisy_ball()[0], energy=Wrong(), **START)


def test_a_value_that_is_infinite_ends_the_run():
    class Infinite(Fine):
        def value(self, surface, fraction, area):
            return np.inf

    assert segment(noisy_ball()[0], energy=Infinite(), **START).stop.reason == "diverged"


def test_an_image_on_another_grid():
    with pytest.raises(
        InputError, match=r"shape \(4, 4, 4\) was given to an energy, expected \(30, 30, 30\)"
    ):
        segment(noisy_ball()[0], energy=RegionField(np.zeros((4, 4, 4))), **START)
    turned = np.zeros((30, 28, 32))
    surface = LevelSet(sphere(shape=(28, 30, 32))[0], (1.0, 1.2, 0.9))
    with pytest.raises(InputError, match="shape"):
        sample_at_front(turned, surface, surface.front())
    with pytest.raises(InputError, match="shape"):
        MomentTracker(turned).start(surface)


def test_an_image_energy_must_say_value_and_force():
    class Half(ImageEnergy):
        def value(self, surface, fraction, area):
            return 0.0

    with pytest.raises(TypeError, match="force"):
        Half(np.zeros((4, 4, 4)))


# ------------------------------------------------------------------------------------------------------- the helpers


def sphere(radius=9.3, spacing=(1.0, 1.2, 0.9), shape=(28, 26, 32)):
    """Distance from a sphere in the middle of the grid, its middle (mm from voxel 0, 0, 0), coordinates (3, ...)."""
    h = np.reshape(spacing, (3, 1, 1, 1))
    points = np.indices(shape) * h
    middle = (np.array(shape) - 1) * spacing / 2
    return np.linalg.norm(points - middle.reshape(3, 1, 1, 1), axis=0) - radius, middle, points


def test_places_normals_and_slopes_on_a_sphere():
    radius, spacing = 9.3, (1.0, 1.2, 0.9)
    distance, middle, points = sphere(radius, spacing)
    surface = LevelSet(distance, spacing)
    front = surface.front()
    at = points_at_front(surface, front)
    n = (at - middle) / radius
    np.testing.assert_allclose(np.linalg.norm(n[front], axis=1), 1, atol=0.003)
    normals = normals_at_front(surface, front)
    np.testing.assert_allclose(normals[front], n[front], atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(normals[front], axis=1), 1, atol=1e-5)
    z, y, x = points
    image = z * x + 0.3 * y**2
    value, slope = slope_at_front(image, surface, front)
    az, ay, ax = at[front].T
    np.testing.assert_allclose(value[front], az * ax + 0.3 * ay**2, atol=1e-3)
    true = ax * n[front, 0] + 0.6 * ay * n[front, 1] + az * n[front, 2]
    np.testing.assert_allclose(slope[front], true, atol=0.5)  # of up to 25: the normals' error
    np.testing.assert_array_equal(value, sample_at_front(image, surface, front))
    for array in (at, normals, value, slope):
        assert not array[~front].any()


def test_a_single_slice_has_normals_in_its_plane():
    y, x = np.indices((30, 32)) - 15.0
    surface = LevelSet((np.hypot(y, x) - 9)[None], (5.0, 1.0, 1.0))
    front = surface.front()
    normals = normals_at_front(surface, front)
    assert not normals[:, 0].any() and not points_at_front(surface, front)[:, 0].any()
    np.testing.assert_allclose(np.linalg.norm(normals[front], axis=1), 1, atol=1e-5)


# ------------------------------------------------------------------------------------------------------------- levels


def test_an_energy_that_is_made_is_made_again_on_each_level():
    seen = []

    def maker(image, spacing):
        seen.append((image.shape, spacing))
        return ChanVese(image)

    image = cubed()
    result = segment(image, start="ball:36,30,30,9", energy=maker, levels=2)
    assert seen == [((32, 32, 32), (2.0, 2.0, 2.0)), ((64, 64, 64), (1.0, 1.0, 1.0))]
    assert result.energy == "custom: ChanVese" and dice(result.labels, image) > 0.99


def test_an_energy_of_your_own_has_one_level_unless_more_are_asked_for():
    image = cubed()
    for energy in (ChanVese(image), lambda image, spacing: ChanVese(image)):
        result = segment(image, start="ball:36,30,30,9", energy=energy, max_steps=2)
        assert [p.level.number for p in result.levels] == [0]
    with pytest.raises(UsageError, match="levels: 2 was given, expected 1"):
        segment(image, start="ball:36,30,30,9", energy=ChanVese(image), levels=2)
