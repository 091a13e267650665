"""The kernels through the calls that the package is made of, so that a rewrite of them can be compared with what was.

    scripts/benchmark kernels --benchmark-save before
    scripts/benchmark kernels --benchmark-compare 0001

One thread, a ball of radius 40 in 128^3 (some 120 000 band cells), smooth and with a ragged surface as noise leaves it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.energies import ChanVese
from accelsurf.flows.diffusion import diffuse, largest_diffusion
from accelsurf.levelset import LevelSet
from benchmarks.peers.work import ball, bumpy, evolution

SIDE, RADIUS = 128, 40.0


def smooth_psi() -> np.ndarray:
    """Distance of a ball."""
    return ball(SIDE, RADIUS)


def ragged_psi() -> np.ndarray:
    """A ball whose surface noise has torn, a voxel or two deep."""
    noise = ndimage.gaussian_filter(np.random.default_rng(6).normal(0.0, 1.0, (SIDE,) * 3), 1.0)
    return smooth_psi() + (2.0 / noise.std() * noise).astype(np.float32)


SHAPES: dict[str, Callable[[], np.ndarray]] = {"smooth": smooth_psi, "ragged": ragged_psi}


class Case:
    """A surface, its image, and what the kernels are given."""

    def __init__(self, psi: np.ndarray) -> None:
        self.psi = psi
        self.image = (psi < -2.0).astype(np.float32)
        self.image += np.random.default_rng(7).normal(0.0, 0.3, psi.shape).astype(np.float32)
        self.surface = self.fresh()
        self.front = self.surface.front()
        self.field = bumpy(self.surface)
        self.fraction, self.area = self.surface.fraction_and_area()
        self.curvature = self.surface.curvature(self.front)
        self.energy = ChanVese(self.image, 0.0, epsilon=1.5)
        self.energy.start(self.surface)
        self.energy.value(self.surface, self.fraction, self.area)

    def fresh(self) -> LevelSet:
        """The surface again, for a kernel that changes it."""
        return LevelSet(self.psi, (1.0, 1.0, 1.0), 3.0)

    def moved(self) -> tuple[LevelSet, list[np.ndarray]]:
        """A surface that has moved, with two fields to extend."""
        surface = self.fresh()
        field = bumpy(surface)
        surface.advance(field, 0.5)
        return surface, [field, field * field]


@pytest.fixture(scope="module", params=list(SHAPES))
def case(request: pytest.FixtureRequest) -> Iterator[Case]:
    yield Case(SHAPES[request.param]())


def test_construct(benchmark: Any, case: Case) -> None:
    surface = benchmark.pedantic(case.fresh, rounds=5, warmup_rounds=1)
    benchmark.extra_info["band_cells"] = surface.size


def test_redistance_with_two_fields(benchmark: Any, case: Case) -> None:
    change = benchmark.pedantic(
        lambda surface, fields: surface.redistance(fields),
        setup=lambda: (case.moved(), {}),
        rounds=7,
        warmup_rounds=1,
    )
    assert len(change.fields) == 2


def test_advance(benchmark: Any, case: Case) -> None:
    # Of no length, so that the surface stays where it is: the work is the same.
    benchmark(case.surface.advance, case.field, 0.0)


def test_fraction_and_area(benchmark: Any, case: Case) -> None:
    benchmark(case.surface.fraction_and_area)


def test_curvature(benchmark: Any, case: Case) -> None:
    benchmark(case.surface.curvature, case.front)


def test_extend_outwards(benchmark: Any, case: Case) -> None:
    benchmark(case.surface.extend_outwards, case.field.copy(), case.front)


def test_diffuse(benchmark: Any, case: Case) -> None:
    benchmark(diffuse, case.surface, case.front, case.field.copy(), largest_diffusion(case.surface))


def test_chan_vese_value(benchmark: Any, case: Case) -> None:
    benchmark(case.energy.value, case.surface, case.fraction, case.area)


def test_chan_vese_force(benchmark: Any, case: Case) -> None:
    benchmark(case.energy.force, case.surface, case.front, case.curvature)


def test_whole_step(benchmark: Any, case: Case) -> None:
    made = iter(evolution(case.psi, case.image, 10_000))
    row = benchmark.pedantic(lambda: next(made).record, rounds=12, warmup_rounds=2)
    benchmark.extra_info["band_cells"] = row.band_cells
