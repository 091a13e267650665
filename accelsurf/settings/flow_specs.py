"""The flows: one entry each, with its settings; and a flow as it is written."""

from __future__ import annotations

from dataclasses import dataclass

from accelsurf.settings.expression import (
    MAGNITUDES,
    Named,
    Number,
    Reader,
    Spec,
    Values,
    Word,
    Written,
)
from accelsurf.settings.registry import by_name


@dataclass(frozen=True)
class FlowSpec(Spec):
    """The entry of a flow.

    Attributes
    ----------
    half_width : int
        Half width of the narrow band that it needs, in voxels.
    voxel_bytes : int
        Memory that it takes for each voxel, beside the memory of every run.
    """

    half_width: int = 3
    voxel_bytes: int = 0


#: The flow is selected when the image is known, of the next two (`accelsurf.run.setup`).
AUTO = "auto"
MOMENTUM = "constant-density"
DESCENT = "gradient"
_POSITIVE = Number(0.0, low_too=False)
_LENGTH = _POSITIVE._replace(words=("auto",))
_CLOCK: dict[str, Number | Word] = {
    "k": Number(
        0.1,
        20.0,
        help="order of the flow, no unit (2): it sets how fast friction fades, (k+1)/t; larger brakes more",
    ),
    "t0": Number(
        0.0,
        words=("auto",),
        help="flow time t, in the friction (k+1)/t, of a surface that starts at rest: larger brakes less; auto is 0, "
        "or with k <= 1, where 0 is impossible, the length of the first step",
    ),
    "lam": _POSITIVE._replace(
        help="how strongly the energy pulls (1; the paper's lambda): larger moves the surface faster"
    ),
    "rho": _POSITIVE._replace(
        help="mass of the moving surface per area, of region-mass per volume, relative units (1): larger is more inert"
    ),
}
_NOISE: dict[str, Number | Word] = {
    "noise_length": _LENGTH._replace(
        help="correlation length of --noise, mm; auto is 4 voxels (the largest spacing)"
    ),
    "noise_time": _LENGTH._replace(
        help="how long --noise acts, in flow time; auto is until the first restart"
    ),
}
_GRAVITY = Number(
    0.0,
    help="how strongly mass pushes itself apart (g, no unit): it spreads mass evenly over the surface, or puts the "
    "mass inside the surface under pressure; 0, the default, for not",
)


def _start_expected(settings: Values) -> str:
    k, t0 = settings.get("k", 2.0), settings.get("t0", "auto")
    if t0 == 0.0 and isinstance(k, float) and k <= 1.0:
        return f"t0 greater than 0 with k = {k:g}, for which the flow has no start from rest at time 0, or auto"
    return ""


FLOWS: dict[str, FlowSpec] = by_name(
    FlowSpec(
        MOMENTUM,
        "momentum of a constant mass per area",
        {**_CLOCK, **_NOISE},
        ("friction", "noise", "diffusion"),
        check=_start_expected,
    ),
    FlowSpec(
        "flowable-mass",
        "momentum with mass that flows along the surface",
        {**_CLOCK, "gravity": _GRAVITY, **_NOISE},
        ("friction", "noise", "diffusion"),
        # The mass is transported along the surface by cubic interpolation, which needs a wider band.
        half_width=4,
        check=_start_expected,
    ),
    FlowSpec(
        "region-mass",
        "momentum of mass on the whole grid",
        {**_CLOCK, "gravity": _GRAVITY},
        ("friction",),
        # The surface moves with means over a layer to either side of it; mass and momentum are on the grid.
        half_width=4,
        voxel_bytes=64,
        check=_start_expected,
    ),
    FlowSpec(DESCENT, "descent, the plain baseline", uses=("diffusion",)),
    FlowSpec(
        "sobolev",
        "descent along the smoothed gradient",
        {
            "length": _LENGTH._replace(
                help="length over which the force is smoothed, mm; auto is 5 voxels"
            )
        },
    ),
    FlowSpec(
        "momentum",
        "descent that adds a fraction of the last step (Andersson et al. 2013)",
        {
            "blend": Number(
                0.0,
                1.0,
                help="fraction of the last step that is added to the next, no unit (0.8): larger has more momentum",
            )
        },
        check=lambda settings: "a blend below 1" if settings.get("blend") == 1.0 else "",
    ),
)
_AUTO_SPEC = FlowSpec(
    AUTO,
    "momentum or descent, by the noise of the image and the energy; the report says which and why",
)


class FlowText(Written):
    """A flow as it is written: its ``name``, and its ``settings`` by key.

    Parameters
    ----------
    text : str
        As on the command line.

    Raises
    ------
    UsageError
        When it names something unknown, or a value is out of bounds.

    Examples
    --------
    >>> flow = FlowText("constant-density:rho=2")
    >>> flow.name, flow.settings, flow == "constant-density:rho=2"
    ('constant-density', {'rho': 2.0}, True)
    """

    name: str
    settings: Values

    def _read(self) -> None:
        self.name, self.settings = _reader().read(self, self)

    @property
    def numbers(self) -> dict[str, float]:
        """The settings that are numbers; words stand for values selected when the run begins."""
        return {key: value for key, value in self.settings.items() if isinstance(value, float)}

    def with_setting(self, key: str, value: str) -> FlowText:
        """Return the flow with another value of a setting; "" leaves it out, and `AUTO` becomes momentum.

        Examples
        --------
        >>> FlowText("auto").with_setting("k", "3").with_setting("rho", "2").with_setting("k", "")
        'constant-density:rho=2'
        """
        named = Named(MOMENTUM if self.name == AUTO else self.name, self.settings)
        return FlowText(str(_reader().changed(self, named, key, value)))


def _reader() -> Reader:
    """Return the reader of flows, with those that were registered."""
    entries = {AUTO: _AUTO_SPEC, **FLOWS}
    return Reader("flow", "constant-density:rho=2", entries, *MAGNITUDES)


def spec_of(name: str) -> FlowSpec:
    """The entry of a flow; before `AUTO` is resolved, that of momentum, which needs all that descent does."""
    return FLOWS[MOMENTUM if name == AUTO else name]


def flow_names() -> dict[str, str]:
    """The names that a run takes, with their meaning."""
    return {AUTO: _AUTO_SPEC.help} | {name: flow.help for name, flow in FLOWS.items()}
