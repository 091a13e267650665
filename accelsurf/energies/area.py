"""Area of the surface: U = alpha A, f = alpha H."""

from __future__ import annotations

import numpy as np


class AreaTerm:
    """The area term that energies contain: U = alpha A, f = alpha H (H > 0 on a sphere, which therefore shrinks).

    Parameters
    ----------
    alpha : float
        Weight, in units of the energy per mm2.
    """

    def __init__(self, alpha: float = 0.0) -> None:
        self.alpha = float(alpha)

    def value(self, area: np.ndarray) -> float:
        """Energy of the surface areas (mm2) of the band cells."""
        return self.alpha * float(area.sum()) if self.alpha else 0.0

    def add_force(self, force: np.ndarray, curvature: np.ndarray) -> None:
        """Add alpha H to ``force`` in place."""
        if self.alpha:
            force += np.float32(self.alpha) * curvature
