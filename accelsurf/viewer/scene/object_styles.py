"""How each object is drawn: its name in the legend, its colour, how opaque it is, and whether it is drawn at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import pyvista as pv

from accelsurf.report.canvas import object_color
from accelsurf.report.label_files import given_labels
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame


class ObjectStyle(NamedTuple):
    """How an object is drawn.

    Attributes
    ----------
    name : str
    color : str
        ``#rrggbb``.
    visible : bool
    opacity : float
        From 0 to 1.
    """

    name: str
    color: str
    visible: bool = True
    opacity: float = 1.0


def unnamed(own: int) -> str:
    """What an object is called that nobody has named.

    Examples
    --------
    >>> unnamed(3)
    'object 3'
    """
    return f"object {own}"


def given_styles(config: RunConfig) -> dict[int, ObjectStyle]:
    """Return the styles of the objects that settings name or colour, by id.

    Raises
    ------
    InputError
        When a table that they name cannot be read.

    Examples
    --------
    >>> given_styles(RunConfig(name=["liver"], color=["#c83c3c"]))
    {1: ObjectStyle(name='liver', color='#c83c3c', visible=True, opacity=1.0)}
    """
    return {own: ObjectStyle(said.name, said.hex) for own, said in given_labels(config).entries.items()}


class ObjectStyles:
    """The styles of objects by id; one that has none has a colour by its place among the ids.

    Attributes
    ----------
    given : mapping of int to ObjectStyle
    tracked : mapping of int to ObjectStyle
        Of the tracked objects of a sequence: the same colour in every frame.
    """

    def __init__(self) -> None:
        self.given: Mapping[int, ObjectStyle] = {}
        self.tracked: Mapping[int, ObjectStyle] = {}

    def of(self, frame: Frame | None) -> list[ObjectStyle]:
        """The style of each surface of a frame."""
        surfaces = () if frame is None else frame.surfaces
        given = self.tracked if frame is not None and frame.said else self.given
        return [
            given.get(one.id) or ObjectStyle(unnamed(one.id), object_color(position))
            for position, one in enumerate(surfaces)
        ]


def paint(actors: Sequence[pv.Actor], meshes: Sequence[pv.PolyData], styles: Sequence[ObjectStyle]) -> None:
    """Have surfaces drawn in their styles."""
    for actor, mesh, style in zip(actors, meshes, styles, strict=False):
        actor.prop.color, actor.prop.opacity = style.color, style.opacity
        actor.SetVisibility(mesh.n_points > 0 and style.visible)
