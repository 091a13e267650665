"""The image itself in 3D: translucent, bright parts denser, cut away in front of the surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkCommonDataModel import vtkPlane

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.grey_window import GreyWindow

#: Most voxels along an axis that are drawn; more take too long.
MAX_ALONG = 160


class VolumePicture:
    """The image in 3D, made when it is shown first.

    Parameters
    ----------
    plotter : pyvista.Plotter
    renderer : pyvista.Renderer
        The plotter's first, in which it is drawn.
    geometry : Geometry
    image : ndarray (nz, ny, nx)
    """

    def __init__(self, plotter: pv.Plotter, renderer: pv.Renderer, geometry: Geometry, image: NDArray[Any]) -> None:
        self._plotter, self._renderer = plotter, renderer
        self._geometry, self._image = geometry, image
        self._volume: pv.Volume | None = None
        self._cut = vtkPlane()

    @property
    def is_shown(self) -> bool:
        """Whether it is drawn."""
        return self._volume is not None and bool(self._volume.GetVisibility())

    def show(self, on: bool, window: GreyWindow) -> None:
        """Draw it, or not."""
        if on and self._volume is None:
            self._volume = self._make(window)
        if self._volume is not None:
            self._volume.SetVisibility(on)

    def use_image(self, image: NDArray[Any], window: GreyWindow) -> None:
        """Draw another image (nz, ny, nx) on the same grid."""
        self._image = image
        self.use_window(window)

    def use_window(self, window: GreyWindow) -> None:
        """Draw other values black and white."""
        if self._volume is not None:
            shown = self.is_shown
            self._renderer.remove_actor(self._volume, reset_camera=False, render=False)
            self._volume = self._make(window) if shown else None

    def cut_away(self, meshes: Sequence[pv.PolyData]) -> None:
        """Leave out what is nearer than the middle of the surfaces, so that it does not hide them."""
        if not self.is_shown:
            return
        bounds = np.array([mesh.bounds for mesh in meshes if mesh.n_points])
        camera = self._renderer.camera
        if len(bounds):
            middle = 0.5 * (bounds[:, ::2].min(axis=0) + bounds[:, 1::2].max(axis=0))
        else:  # no surface: all of it
            middle = np.array(camera.position)
        self._cut.SetOrigin(*middle)
        self._cut.SetNormal(*camera.direction)

    def _make(self, window: GreyWindow) -> pv.Volume:
        stride = [max(1, -(-n // MAX_ALONG)) for n in self._image.shape]
        grey = window.grey(self._image[tuple(slice(None, None, s) for s in stride)])
        steps = [h * s for h, s in zip(self._geometry.spacing, stride, strict=True)]
        image = pv.ImageData(dimensions=grey.shape[::-1], spacing=steps[::-1])
        image.point_data["grey"] = grey.ravel()
        self._plotter.subplot(0, 0)
        # Nothing below a fifth of the range: noise in the air would hide everything.
        opacity = np.concatenate([np.zeros(51), np.linspace(0.0, 110.0, 205)]).astype(np.uint8)
        volume = self._plotter.add_volume(
            image, scalars="grey", cmap="gray", clim=(0, 255), opacity=opacity, shade=False,
            opacity_unit_distance=4.0 * max(steps), show_scalar_bar=False, reset_camera=False, render=False,
        )
        turn = np.eye(4)
        turn[:3, :3], turn[:3, 3] = self._geometry.direction, self._geometry.origin
        volume.user_matrix = turn
        volume.mapper.AddClippingPlane(self._cut)
        return volume
