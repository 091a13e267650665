"""The whole pipeline against the Lagrangian reference: shapes and forces without symmetry, every point compared.

Errors are in voxels h (the finest spacing), at three times, the largest of any point of the reference from the surface
and of the surface from the reference. `benchmarks.lagrangian` has all problems on finer grids.
"""

from __future__ import annotations

import pytest

from tests.support.follow import WIDTH
from tests.support.follow_curve import Run, compare, set_up
from tests.support.lagrangian import solve
from tests.support.lagrangian_cases import DESCENT, DRAWN_OUT, PLANE, SPACE, STRETCHED, Problem
from tests.support.wrong_flows import BentWrongly

#: An error of the mean below this has no order: the area of a curve in a slice, by which the density is scaled, errs by
#: 1 to 4 parts in 10,000 without order, and the paths are up to 15 voxels long.
FLOOR = 0.003


#: Of the problems of the plane, those that differ most; the study has all.
FAST = (
    "area weight",
    "along the grid",
    "k = 1.5",
    "k = 3, lambda 2, rho 1/2",
    "constant friction",
    "flowable, area weight",
    "flowable, k = 3, lambda 2, rho 1/2",
)


def assert_converges(name: str, problem: Problem, point: float, order: float) -> list[float]:
    """On 32 and 64 voxels; returns the relative errors of the density.

    Errors are in the finest spacing. The floor is a part of the largest, which the areas are measured with.
    """
    found = problem.study((32, 64))
    mean, worst = found["mean_voxels"], found["point_voxels"]
    print(f"\n{name}: mean {mean}, worst {worst} h, order {found['order_of_mean']:.2f} (mean)")
    assert worst[-1] <= point
    assert found["order_of_mean"] >= order or mean[-1] <= FLOOR * max(problem.coarser)
    return list(found["density_relative"])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", FAST)
def test_curves_of_the_plane(name: str) -> None:
    """Measured .007 to .010 h at 64 voxels, order 1.7 to 2.1 of the mean; the density 2 to 4 % and .7 to 1.1 %."""
    coarse, fine = assert_converges(name, PLANE[name], 0.015, 1.65)
    assert fine <= 0.015 and fine <= coarse / 2.5


@pytest.mark.slow
def test_density_that_varies_fivefold() -> None:
    """A circle that fills an ellipse from one side; the dense side lags behind: measured .35 and .20 h, 10.9 and 3.5 %.

    The forces reach their full strength within 4 voxels of 64: order 1.9, but from a larger error.
    """
    problem = DRAWN_OUT
    density = solve(problem.start, problem.force, problem.law, problem.times)[-1].density
    assert density is not None and density.max() > 5.0 * density.min() > 0.0
    found = problem.study((48, 96))
    print("\ndrawn out:", found)
    assert found["point_voxels"][-1] <= 0.25 and found["density_relative"][-1] <= 0.05
    assert found["order_of_mean"] >= 1.7


@pytest.mark.parametrize("name", ["y twice as coarse", "flowable, x twice as coarse"])
def test_curves_on_a_grid_twice_as_coarse_along_one_axis(name: str) -> None:
    """Measured .045 and .021 h at 64; flowable .0052 and .0040 h of the mean, 16 and 32 voxels along x."""
    assert_converges(name, STRETCHED[name], 0.06, 1.7)


def test_the_wrong_sign_of_the_transport_term_misses_the_reference() -> None:
    """- 1/2 beta^2 H, as the paper prints it for surfaces: off by more than 20 times what is allowed."""
    problem = PLANE["no area weight"]
    on, h = problem.grid(48), WIDTH / 47
    run = Run(
        set_up(problem.start, problem.force, on, problem.frame),
        problem.law,
        BentWrongly(diffusion=0.0),
    )
    run.until(1.5, 0.5 * h)
    curve = solve(problem.start, problem.force, problem.law, (1.5,))[0]
    assert compare(run.surface, on, problem.frame, curve).point > 0.4 * h


def test_descent_of_a_curve() -> None:
    """Explicit Euler with steps of a tenth of a voxel: first order in time, .017 h."""
    misfit = DESCENT.misfit(48)
    assert misfit.point <= 0.025 and misfit.mean <= 0.012


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("name", "n", "point", "mean"),
    [
        ("oblique", 32, 0.035, 0.015),
        ("oblique, k = 3", 32, 0.04, 0.02),
        ("flowable, oblique", 32, 0.025, 0.006),
        ("oblique, 2:1:1", 48, 0.09, 0.025),
        ("flowable, oblique, 2:1:1", 32, 0.06, 0.015),
    ],
)
def test_surfaces_of_revolution_about_an_oblique_axis(
    name: str, n: int, point: float, mean: float
) -> None:
    misfit = SPACE[name].misfit(n)
    print(
        f"\n{name}, {n}: mean {misfit.mean:.4f} h, worst {misfit.point:.4f} h, density {misfit.density:.4f}"
    )
    assert misfit.point <= point and misfit.mean <= mean
    assert misfit.density <= 0.06
