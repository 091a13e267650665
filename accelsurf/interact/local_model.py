"""Model of an object's clicks while it is corrected: the voxels that a click relabels. Each click costs its own box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from accelsurf.clicks import ClickModel
from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import Box, box_at, connected_to, counted_from, enclosing, on_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.interact.corrected_surface import CorrectedSurface
from accelsurf.interact.region import around_clicks, automatic_near
from accelsurf.run import ImageContext

#: Spacing, in smallest spacings, from which a slice is as thick as two voxels.
_THICK_SLICES = 2.0


class ModelChange(NamedTuple):
    """The change by a click: the ``mask`` on a ``box`` of the grid where the object has changed; and before."""

    box: Box
    mask: Mask
    before: ClickModel


class LocalModel:
    """The model of an object, click by click.

    Parameters
    ----------
    state : ClickModel
    spacing : (hz, hy, hx)
        mm.
    make : callable
        Makes the model of clicks from one of the first of them.
    """

    def __init__(
        self, state: ClickModel, spacing: Spacing, make: Callable[[Clicks, ClickModel], ClickModel]
    ) -> None:
        self.state = state
        self.spacing = spacing
        self._make = make

    def field_on(self, box: Box) -> Singles:
        """F on a box of the grid: the surface grows where it is below 0."""
        return self.state.field_on(box)

    def mean_curvature(self) -> float:
        """Mean curvature of the model's object, 1/mm; 0 of a partition."""
        return self.state.mean_curvature(self.spacing)

    def add(self, click: Click) -> ModelChange:
        """Update the model by one more click.

        It is the model of all clicks. Where the click takes voxels from earlier ones, all else that these have said
        stays as it was.

        Parameters
        ----------
        click : Click
            On the grid of the model, as its object sees it.
        """
        before, clicks = self.state, self.state.clicks.with_later([click])
        first = Clicks(clicks.clicks[:-1], clicks.shape)
        self.state = self._make(clicks, replace(before, clicks=first))
        box = enclosing(self.state.box, before.box)
        return ModelChange(box, self.state.inside_on(box) != before.inside_on(box), before)

    def undo(self, change: ModelChange) -> None:
        """Take back the last change."""
        self.state = change.before


def basin_of(
    click: Click, change: ModelChange, model: LocalModel, surface: CorrectedSurface
) -> Click:
    """Return the basin of a click, as a click: its voxels, and those that the model relabels to its side.

    Of those, the voxels that the model relabels because of the click: also a part that an outside click cuts off,
    where F is as it was, but which is connected to no inside click any more. Far from the click only pieces thicker
    than a voxel: any click moves the model's boundary by parts of a voxel everywhere, and the surface need not be run
    again for that. And voxels around the click, connected to it, where the surface has left the model's boundary: the
    click says that this was wrong.

    Parameters
    ----------
    click : Click
    change : ModelChange
        That it made.
    model : LocalModel
        After the click.
    surface : CorrectedSurface
    """
    spacing = model.spacing
    near = automatic_near(
        surface.psi, [click._replace(box=counted_from(click.box, surface.corner))], spacing
    )
    around = around_clicks([click], near, 0.0, model.state.clicks.shape, spacing, 0.0)
    box = enclosing(around.box, change.box)
    on_side = model.state.inside_on(box) == (click.side == "inside")
    changed, near_it = (
        on_side & on_box(change.mask, change.box, box, False),
        on_box(around.mask, around.box, box, False),
    )
    changed = connected_to(changed, changed & (near_it | _thicker_than_a_voxel(changed, spacing)))
    on_side &= near_it
    on_side &= (on_box(surface.psi, box_at(surface.corner, surface.psi.shape), box, 1.0) < 0) != (
        click.side == "inside"
    )
    clicked = click.mask_on(box)
    return click._replace(box=box, mask=changed | connected_to(on_side | clicked, clicked))


def _thicker_than_a_voxel(mask: Mask, spacing: Spacing) -> Mask:
    """The first voxels of the blocks in a mask of two voxels along each axis; of one along axes that are as coarse."""
    out = mask.copy()
    fine = [h < _THICK_SLICES * min(spacing) for h in spacing]
    for axis in (i for i, n in enumerate(mask.shape) if n > 1 and fine[i]):
        here: list[slice] = [slice(None)] * 3
        here[axis] = slice(None, -1)
        last, following = list(here), list(here)
        last[axis], following[axis] = slice(-1, None), slice(1, None)
        pairs = out[tuple(here)] & out[tuple(following)]
        out[tuple(here)], out[tuple(last)] = pairs, False
    return out


def local_model(context: ImageContext, state: ClickModel) -> LocalModel:
    """The model of an object of a finished run, from its ``state`` on."""
    return LocalModel(
        state,
        context.spacing,
        lambda clicks, before: context.with_clicks(clicks).click_model(before),
    )
