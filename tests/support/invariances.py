"""The same problem told in other words: mirrored, axes in another order, other lengths, inside out, shifted, turned."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tests.support.follow import WIDTH, lattice
from tests.support.follow_curve import Frame, Run, Setup, about, psi_at, set_up, turned
from tests.support.lagrangian import Law, solve
from tests.support.lagrangian_cases import BODY, EGG, OBLIQUE, lopsided, uneven

#: A problem told in other words, its law, and how its psi is told in the first words again.
Variant = tuple[Setup, Law, Callable[[np.ndarray], np.ndarray]]


def told_otherwise(setup: Setup, law: Law) -> Iterator[tuple[str, Variant]]:
    """Every variant of a setup on the same voxels, with its name."""
    for axis in range(3):
        yield (
            f"mirrored along {'zyx'[axis]}",
            (mirrored(setup, axis), law, lambda psi, a=axis: np.flip(psi, a)),
        )
    for axes in list(itertools.permutations(range(3)))[1:]:
        back = tuple(np.argsort(axes))
        yield (
            "axes in the order " + "".join("zyx"[a] for a in axes),
            (permuted(setup, axes), law, lambda psi, b=back: psi.transpose(b)),
        )
    for factor in (2.0, 1e-3):
        # beta_t = w f/rho + ...: f is a length here, and alpha a length squared.
        scaled = Setup(
            setup.psi * factor, setup.field * factor, tuple(h * factor for h in setup.spacing)
        )
        other = replace(law, alpha=law.alpha * factor**2)
        yield f"lengths x {factor:g}", (scaled, other, lambda psi, f=factor: psi / f)
    yield "inside out", (Setup(-setup.psi, -setup.field, setup.spacing), law, lambda psi: -psi)


def mirrored(setup: Setup, axis: int) -> Setup:
    """The setup turned round along an axis."""
    return Setup(np.flip(setup.psi, axis).copy(), np.flip(setup.field, axis).copy(), setup.spacing)


def permuted(setup: Setup, axes: tuple[int, ...]) -> Setup:
    """The setup with its axes in another order."""
    spacing = tuple(setup.spacing[a] for a in axes)
    return Setup(setup.psi.transpose(axes).copy(), setup.field.transpose(axes).copy(), spacing)


def psi_after(setup: Setup, law: Law, t_end: float) -> np.ndarray:
    """psi (nz, ny, nx), mm, of a setup at ``t_end``, in equal steps that do not depend on the unit of length."""
    run = Run(setup, law)
    run.until(t_end, 0.5 * WIDTH / (max(setup.psi.shape) - 1))
    return np.array(run.surface.psi)


def differences(
    setup: Setup, law: Law, t_end: float, names: Sequence[str] = ()
) -> dict[str, float]:
    """Largest difference of psi, in voxels, within a voxel of the surface, of every variant (or ``names``) at t_end."""
    h, first, found = min(setup.spacing), psi_after(setup, law, t_end), {}
    near = np.abs(first) < h
    for name, (other, other_law, back) in told_otherwise(setup, law):
        if not names or name in names:
            found[name] = (
                float(np.abs(back(psi_after(other, other_law, t_end)) - first)[near].max()) / h
            )
    return found


def body(n: int) -> Setup:
    """The uneven body about its oblique axis, on ``n`` voxels along an axis."""
    return set_up(BODY, uneven, lattice(n), OBLIQUE)


def spread(
    frames: list[Frame], law: Law, n: int, t_end: float, revolved: bool
) -> tuple[float, float]:
    """How the surface depends on where the grid lies: mean and largest spread, in voxels, over ``frames``.

    psi is compared at the points of the reference, all points of the plane curve or of the body.
    """
    start, force = (BODY, uneven) if revolved else (EGG, lopsided)
    on, curve = lattice(n, flat=not revolved), solve(start, force, law, (t_end,))[0]
    h, found = WIDTH / (n - 1), []
    for frame in frames:
        run = Run(set_up(start, force, on, frame), law)
        run.until(t_end, 0.5 * h)
        found.append(psi_at(run.surface, on, frame, curve) / h)
    off = np.abs(np.array(found) - np.mean(found, axis=0))
    return float(off.mean()), float(off.max())


def shifts(n: int, count: int = 6) -> list[Frame]:
    """The oblique axis, or the tilted plane, shifted by parts of a voxel."""
    rng = np.random.default_rng(3)
    return [
        replace(turned(0.4), shift=tuple(rng.uniform(-0.5, 0.5, 3) * WIDTH / (n - 1)))
        for _ in range(count)
    ]


def rotations(revolved: bool, count: int = 6) -> list[Frame]:
    """The plane turned by any angle; the axis of revolution in any direction."""
    rng = np.random.default_rng(4)
    if revolved:
        return [about(rng.normal(size=3)) for _ in range(count)]
    return [turned(angle) for angle in np.linspace(0.0, np.pi / 2, count, endpoint=False)]
