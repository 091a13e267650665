"""What is worked on: balls as signed distances, noisy cubes, the brain scan; and how close a ball's radius came."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.energies import ChanVese
from accelsurf.evolution.convergence import Restart
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, Flow
from accelsurf.levelset import LevelSet, Workers
from benchmarks.peers.measure import MissingError

BRAIN, BRAIN_REFERENCE = "mri_brain256.nii.gz", "mri_brain256_ref.nii.gz"
SOURCES = "public niivue demo images, see docs/explanation/real-scans.md"


def ball(side: int, radius: float, centre: tuple[float, float, float] | None = None) -> np.ndarray:
    """Signed distance (float32, voxels) of a ball in a cube of ``side`` voxels; in the middle, or at (z, y, x)."""
    middle = 0.5 * (side - 1)
    z, y, x = np.ogrid[:side, :side, :side]
    c = centre or (middle, middle, middle)
    squares = ((z - c[0]) ** 2).astype(np.float32) + ((y - c[1]) ** 2).astype(np.float32)
    squares = squares + ((x - c[2]) ** 2).astype(np.float32)
    return np.sqrt(squares, out=squares) - np.float32(radius)


def noisy_cube(side: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, str, np.ndarray]:
    """A cube of half the side in white noise of the contrast: image, truth, off-centre start as text, and as distance.

    The start is a ball of radius side/12, (9, -6, 3)/96 of the side off the middle in x, y and z.
    """
    truth = np.zeros((side,) * 3, bool)
    truth[(slice(side // 4, 3 * side // 4),) * 3] = True
    noise = np.random.default_rng(seed).normal(0.0, 1.0, truth.shape)
    image = (truth + noise).astype(np.float32)
    middle, part = 0.5 * (side - 1), side / 96
    x = middle + 9 * part
    y = middle - 6 * part
    z = middle + 3 * part
    radius = 8 * part
    return image, truth, f"ball:{x:g},{y:g},{z:g},{radius:g}vox", ball(side, radius, (z, y, x))


def scan(folder: Path | None, name: str) -> Path:
    """A scan's file.

    Raises
    ------
    MissingError
        When there is no folder, or not this scan in it.
    """
    if folder is None:
        raise MissingError(
            f"no folder with scans: --volumes DIR or ACCELSURF_VOLUMES, with {name} ({SOURCES})"
        )
    if not (folder / name).is_file():
        raise MissingError(f"{name} is not in the folder of scans ({SOURCES})")
    return folder / name


def radius_error(psi: np.ndarray, radius: float) -> dict[str, float]:
    """How far a level set is from a ball in the middle: radius by the volume of its mesh, and its vertices' distances.

    Read from the zero level by marching cubes, the same for every program.
    """
    from skimage.measure import marching_cubes

    points, faces, _, _ = marching_cubes(np.array(psi, np.float32), 0.0)
    points = points - 0.5 * (np.array(psi.shape) - 1)
    a, b, c = (points[faces[:, i]].astype(np.float64) for i in range(3))
    volume = abs(float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum())) / 6.0
    by_volume = (0.75 * volume / np.pi) ** (1 / 3)
    far = np.sqrt((points.astype(np.float64) ** 2).sum(axis=1)) - radius
    return {
        "radius": by_volume,
        "volume_error": abs(by_volume - radius),
        "rms_error": float(np.sqrt((far**2).mean())),
    }


def bumpy(surface: LevelSet) -> np.ndarray:
    """A smooth field on the band: what a flow would extend."""
    z, y, x = np.unravel_index(surface.band.cells, surface.shape)
    return (1.0 + 0.3 * np.sin(0.11 * z) * np.cos(0.13 * y) + 0.2 * np.sin(0.09 * x)).astype(
        np.float32
    )


def perturbed(
    psi: np.ndarray, half_width: float, motion: float = 0.5, workers: Workers | None = None
) -> LevelSet:
    """A surface moved by about ``motion`` voxels and not yet redistanced."""
    surface = LevelSet(psi, (1.0, 1.0, 1.0), half_width, workers)
    surface.advance(bumpy(surface), motion)
    return surface


def evolution(
    psi: np.ndarray,
    image: np.ndarray,
    steps: int,
    flow: Flow | None = None,
    workers: Workers | None = None,
) -> Evolution:
    """Constant density on Chan-Vese with the settings of `accelsurf segment`, at 1 mm."""
    surface = LevelSet(psi, (1.0, 1.0, 1.0), 3.0, workers)
    energy = ChanVese(image, 0.0, epsilon=1.5)
    return Evolution(
        surface, energy, SolverSetup(flow or ConstantDensity(), restart=Restart()), steps
    )


def run_evolution(made: Evolution) -> list[Any]:
    """Run it; the rows of its steps that moved."""
    for _ in made:
        pass
    return [row for row in made.history if row.dt > 0]
