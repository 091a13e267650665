"""Solver of a run under given settings: levels, flow, stop rule, band, makers of energies; and the run's memory."""

from __future__ import annotations

import functools
import secrets
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import CheckedEnergy, Energy
from accelsurf.errors import UsageError
from accelsurf.evolution import Restart, SolverSetup, StopRule
from accelsurf.flows import Flow, StepLimits
from accelsurf.grid import pyramid
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.pyramid import AUTO_MIN_VOXELS, count_resolved_levels
from accelsurf.grid.window import NeedsLevels, Window
from accelsurf.image.volume import Volume
from accelsurf.io import available_cores
from accelsurf.run.energy import make_energy
from accelsurf.run.evolving_object import EnergyMaker, MadeEnergy
from accelsurf.run.image_context import ImageContext
from accelsurf.run.makers import FLOW_MAKERS, TERM_REACHES
from accelsurf.settings.catalogue import default_of, energy_settings
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.flow_specs import AUTO, DESCENT, FLOWS, MOMENTUM, FlowText, spec_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.trace_columns import added_measures
from accelsurf.settings.wording import size_text
from accelsurf.starts import ObjectStart
from accelsurf.text.starts import CLICKS

#: Ratio of the spacings from which on slices are thick.
THICK = 4.0
#: Energy as `segment` takes it: a name, an energy, or a function that makes one of the image, (nz, ny, nx)
#: float32 as in `Result.image`, and the spacing, (hz, hy, hx) mm.
EnergyLike = str | Energy | Callable[[NDArray[np.float32], tuple[float, float, float]], Energy]
#: First voxels of objects as `segment_objects` takes them: a file, a label map, first surfaces.
ObjectsLike = str | Volume | NDArray[Any] | Sequence[ObjectStart]
#: Motion in the steps to come, by the trend, that a converged surface may still make, as a share of the tolerance: the
#: trend tells it too low by up to this.
_FURTHER = 0.7
#: Flows whose surface moves slowly also where it has not converged, and the share of the tolerance that it then moves.
_SHORT_STEPS = ("flowable-mass", "region-mass", "sobolev")
SLOW = 0.4
#: Steps without a lower energy after which a correction has converged: an oscillation from step to step finds one in
#: two.
PATIENCE = 3


def choose_levels(
    config: RunConfig,
    geometry: Geometry,
    psi: NDArray[np.float32] | None,
    has_name: bool,
    window: Window | None = None,
) -> list[pyramid.Level]:
    """The levels of a configuration, finest first; record 0014 defines ``auto``.

    Parameters
    ----------
    config : RunConfig
    geometry : Geometry
        Of the region of interest.
    psi : ndarray or None
        Of the start; None for several objects, for which ``auto`` is the image's own grid.
    has_name : bool
        Whether the energy is one with a name.
    window : Window, optional
        The part of a larger grid that ``geometry`` is: there are as many levels as that grid has.

    Raises
    ------
    UsageError
        When the grid has fewer levels; NeedsLevels when the window may be too small for all that there are.
    """
    spacing, wanted = geometry.spacing, config.levels
    shape = geometry.shape if window is None else window.geometry.shape

    def in_window(grids: list[pyramid.Level]) -> list[pyramid.Level]:
        if window is None:
            return grids
        return pyramid.levels(geometry.shape, spacing, min(len(grids), window.levels), min_voxels=1)

    if wanted == "auto":
        if (
            psi is None
            or not has_name
            or begins_at_model(config)
            or any(TERMS[term.name].keeps_fine_edges for term in config.terms)
        ):
            return in_window(pyramid.levels(shape, spacing, 1))
        possible = pyramid.levels(shape, spacing, min_voxels=AUTO_MIN_VOXELS)
        grids = in_window(possible)
        count = count_resolved_levels(grids, psi)
        if window is not None and count == window.levels < len(possible):
            raise NeedsLevels(count + 1)
        return grids[:count]
    grids = pyramid.levels(shape, spacing, wanted)
    if len(grids) < wanted:
        raise UsageError(
            f"levels: {wanted} was given, expected at most {len(grids)} for this image",
            f"the coarsest grid has at least {pyramid.MIN_VOXELS} voxels along an axis that is halved",
        )
    return in_window(grids)


def setup_of(settings: RunConfig, place: int, levels: int, geometry: Geometry) -> SolverSetup:
    """Solver settings of the object at a position in the run; each has its own random numbers."""
    seed = None if settings.seed is None else settings.seed + place
    return SolverSetup(
        make_flow(settings.replace(seed=seed) if place else settings),
        StepLimits(settings.cfl, settings.percentile),
        Restart() if settings.restart == "auto" else None,
        half_width(settings),
        stop_rule(settings, levels),
        settings.max_volume,
        window_reach(settings, geometry),
        settings.stop_at_rest,
        settings.extension,
        settings.end,
        added_measures(),
    )


def energy_maker(
    energy: EnergyLike | None, settings: RunConfig, levels: int, has_ids: bool
) -> EnergyMaker:
    """The function that makes the energy on each grid; an energy object belongs to one grid only.

    Raises
    ------
    UsageError
        When an energy object was given for several levels or objects.
    """
    if energy is None or isinstance(energy, str):
        return functools.partial(make_energy, settings)
    if (levels > 1 or has_ids) and not is_maker(energy):
        subject = (
            f"levels: {levels} was given, expected 1"
            if levels > 1
            else "objects: several were given"
        )
        raise UsageError(
            f"{subject}: the energy has one image, and each {'level' if levels > 1 else 'object'} needs its own",
            "give a class or function that makes the energy of (image, spacing), or levels=1 and one object",
        )
    return functools.partial(own_energy, energy, settings)


def needs_seed(config: RunConfig) -> bool:
    """Return True if a configuration has noise at any time, and no seed."""
    noisy = config.noise > 0 or any(
        config.at(edit.step).noise > 0 for edit in config.edit if "noise" in edit.settings
    )
    return noisy and config.seed is None


def seeded(config: RunConfig) -> RunConfig:
    """The configuration, with a seed if it needs one; drawn once, so that it repeats the run."""
    return config.replace(seed=secrets.randbelow(2**31)) if needs_seed(config) else config


def thin_start_warnings(
    starts: Sequence[ObjectStart], geometry: Geometry, has_ids: bool
) -> list[str]:
    """A line for each start that lies in a single thick slice, where its surface is known to within a slice only.

    Examples
    --------
    >>> psi = np.ones((5, 9, 9), np.float32)
    >>> psi[2, 3:6, 3:6] = -1.0
    >>> thin_start_warnings([ObjectStart(1, (0, 0, 0), psi)], Geometry((5, 9, 9), (7.5, 0.5, 0.5)), False)
    ['start: all of it lies in one slice of 7.5 mm; give one that spans two slices, if the object does']
    """
    steps = [h if n > 1 else 0.0 for h, n in zip(geometry.spacing, geometry.shape, strict=True)]
    axis = int(np.argmax(steps))
    if steps[axis] < THICK * min(geometry.steps):
        return []
    lines = []
    for start in starts:
        others = tuple(a for a in range(3) if a != axis)
        if int((start.psi < 0).any(axis=others).sum()) == 1:
            name = f"object {start.id}: start" if has_ids else "start"
            lines.append(
                f"{name}: all of it lies in one slice of {size_text(steps[axis], geometry.unit)}; give one that spans "
                "two slices, if the object does"
            )
    return lines


def thread_count(config: RunConfig) -> int:
    """Return the number of threads of a run."""
    return available_cores() if config.threads == "auto" else config.threads


def energy_key(config: RunConfig) -> tuple[Any, ...]:
    """The values of the settings that the energy depends on."""
    return tuple(getattr(config, key) for key in ("energy", *energy_settings()))


def window_reach(settings: RunConfig, geometry: Geometry) -> float:
    """Return the reach of the energy's terms beyond an object, mm; 0 where none has a window."""
    largest = max(geometry.steps)
    return max(
        (
            TERM_REACHES[term.name](term.settings, largest)
            for term in settings.terms
            if term.name in TERM_REACHES
        ),
        default=0.0,
    )


def begins_at_model(config: RunConfig) -> bool:
    """Return True if a run begins at the object that the model of the clicks shows, and that model is its energy."""
    is_shown = config.start == (CLICKS,) or config.objects is not None or config.energy.parts_space
    return is_shown and all(TERMS[term.name].uses_model for term in config.terms)


def is_least_at_model(config: RunConfig) -> bool:
    """Return True if nothing can move objects that part the space from where the model of their clicks shows them.

    Without a weight of the area their energy is the sum of F inside, least where F < 0.
    """
    moved = (
        config.smoothness
        or config.noise
        or config.edit
        or config.max_volume
        or config.levels not in ("auto", 1)
    )
    return not moved and all(
        term.name == "partition" and term.settings.get("area") == 0 for term in config.terms
    )


def stop_rule(config: RunConfig, levels: int) -> StopRule:
    """Return the rule by which a run on a number of levels has converged on the finest one.

    After a coarser level the run begins near its end and is checked more often. The window has an even number of steps,
    so that an oscillation from step to step cancels. The waves of flowable-mass and region-mass keep their steps short,
    and the Sobolev gradient is small where forces are uneven: there a slow surface has not converged yet. At the object
    that the clicks' model shows a run begins as a correction does.
    """
    if begins_at_model(config):
        return correction_rule(config)
    if levels == 1:
        waves = config.flow.name in ("flowable-mass", "region-mass")
        motion = SLOW * config.tolerance if waves else config.tolerance
        return StopRule(motion=motion, further=_FURTHER * config.tolerance)
    return _rule_near_the_end(config)


def correction_rule(config: RunConfig) -> StopRule:
    """Return the rule by which a correction has converged: it begins near its end, as after a coarser level."""
    rule = _rule_near_the_end(config)
    return rule if config.flow.name in _SHORT_STEPS else rule._replace(patience=PATIENCE)


def _rule_near_the_end(config: RunConfig) -> StopRule:
    further = _FURTHER * config.tolerance
    if config.flow.name in _SHORT_STEPS:
        return StopRule(10, SLOW * config.tolerance, further=further)
    return StopRule(6, config.tolerance, further=further)


def half_width(config: RunConfig) -> float:
    """Half width of the band in voxels; ``auto`` is the one that the flow needs."""
    if config.half_width == "auto":
        return float(spec_of(config.flow.name).half_width)
    return float(config.half_width)


def own_energy(
    energy: Any,
    config: RunConfig,
    image: NDArray[np.float32],
    spacing: tuple[float, float, float],
    context: ImageContext,
) -> MadeEnergy:
    """An energy of the user's own, made of image and spacing if a class or function is given, with checks.

    Raises
    ------
    UsageError
        When it is incomplete, or a setting was given that it would ignore.
    """
    for key in energy_settings():
        if getattr(config, key) != default_of(key):
            raise UsageError(
                f"{key}: {getattr(config, key)} was given, but the energy is one of your own and would ignore it",
                "give it to the energy itself",
            )
    checked = CheckedEnergy(energy(image, spacing) if is_maker(energy) else energy)
    return MadeEnergy(checked, checked.name, [])


def is_maker(energy: Any) -> bool:
    """Return True if an energy of the user's own is a class or function that makes it of ``(image, spacing)``."""
    return isinstance(energy, type) or (callable(energy) and not hasattr(energy, "force"))


def make_flow(config: RunConfig) -> Flow:
    """The flow of a configuration in which one is named."""
    return FLOW_MAKERS[config.flow.name](config)


class FlowChoice(NamedTuple):
    """The ``flow`` for settings that leave it open, and ``why`` in a sentence."""

    flow: str
    why: str

    def applied(self, config: RunConfig) -> RunConfig:
        """The settings with this flow, where they leave it open; with momentum, where an edit gave a setting of it."""
        if config.flow != AUTO:
            return config
        return config.model_copy(
            update={"flow": FlowText(MOMENTUM if _given_of_momentum(config) else self.flow)}
        )


def choose_flow(config: RunConfig, has_name: bool) -> FlowChoice:
    """The flow for settings that leave it open; ``has_name``: the energy is one with a name."""
    wanted = _given_of_momentum(config)
    if wanted:
        return FlowChoice(
            MOMENTUM, f"momentum, as {wanted[0]} was given, which descent does not have"
        )
    if not has_name:
        return FlowChoice(MOMENTUM, "momentum, as the energy is one of your own")
    if config.energy.uses_model:
        return FlowChoice(MOMENTUM, "momentum, as from clicks all flows end at the same surface")
    names = {term.name for term in config.terms} - {"area"}
    if names == {"threshold"}:
        return FlowChoice(
            DESCENT, "descent, as under bounds of brightness momentum may leak through thin walls"
        )
    return FlowChoice(
        MOMENTUM, f"momentum, as under {config.energy} descent rests too soon or finds less"
    )


def _given_of_momentum(config: RunConfig) -> list[str]:
    """Settings that only momentum has, of those that were changed from their defaults."""
    keys = (key for key in FLOWS[MOMENTUM].uses if key not in FLOWS[DESCENT].uses)
    return [key for key in keys if getattr(config, key) != default_of(key)]
