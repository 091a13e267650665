"""Sums over a whole object and a whole image, from which those beyond a box follow at the cost of the box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Summing, sums_by_plane
from accelsurf.grid.boxes import Box


class RegionTotals:
    """Sums of an image over an object and over the whole, by channel and kind.

    They are made once from the whole image, on demand; after that a change of the object in a box changes them by the
    voxels of the box. Rounding of these changes is part of the state, so that a run that goes on has the same bytes.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels.
    psi : ndarray (nz, ny, nx)
        The object, negative inside; the caller changes it, with `change`.
    totals : mapping of str to ndarray (2, m), optional
        The totals of a saved state, by their names.
    """

    def __init__(
        self,
        images: Sequence[NDArray[np.float32]],
        psi: NDArray[np.float32],
        totals: Mapping[str, NDArray[np.float64]] | None = None,
    ) -> None:
        self._images, self._psi = images, psi
        self.totals = dict(totals or {})
        self._summing: dict[str, Summing] = {}

    def beyond(
        self, box: Box, channel: int, kind: str, summing: Summing
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sums over the object beyond a box, and over all voxels beyond it.

        Parameters
        ----------
        box : tuple of slice
        channel : int
        kind : str
            Name of the sums.
        summing : callable
            Makes them of values.
        """
        name = f"{kind} {channel}"
        self._summing[name] = summing
        if name not in self.totals:
            image, inside = self._images[channel], self._psi < 0
            self.totals[name] = np.stack(
                [sums_by_plane(image, summing, inside), sums_by_plane(image, summing)]
            )
        image, inside = self._images[channel][box], self._psi[box] < 0
        total = self.totals[name]
        return total[0] - summing(image[inside]), total[1] - summing(image.ravel())

    def change(self, box: Box, before: NDArray[np.bool_], after: NDArray[np.bool_]) -> None:
        """Follow a change of the object's voxels in a box.

        Parameters
        ----------
        box : tuple of slice
        before, after : ndarray of bool
            The object's voxels there.
        """
        for name, total in list(self.totals.items()):
            image = self._images[int(name.rpartition(" ")[2])][box]
            summing = self._summing.get(name)
            if summing is None:
                del self.totals[name]  # of a saved state, and not used since: made anew when needed
                continue
            changed = summing(image[after & ~before]) - summing(image[before & ~after])
            self.totals[name] = np.stack([total[0] + changed, total[1]])
