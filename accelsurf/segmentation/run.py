"""A run made ready: image prepared, start built, parts chosen; steered by edits, put aside and taken back."""

from __future__ import annotations

import functools
import os
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Energy
from accelsurf.errors import InputError, UsageError
from accelsurf.evolution.loop import Kept, Restart, Step, Stop
from accelsurf.evolution.multilevel import Multilevel, SolverSetup
from accelsurf.flows import StepLimits
from accelsurf.grid import pyramid
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.initialization import starts
from accelsurf.io.channels import read_further
from accelsurf.levelset import LevelSet, Workers
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.segmentation.solver_setup import (
    ENERGY_SETTINGS,
    half_width,
    is_maker,
    make_energy,
    make_flow,
    own_energy,
    stop_rule,
)
from accelsurf.settings import energy_expression
from accelsurf.settings.edits import Edit
from accelsurf.settings.run_config import RunConfig

#: What `segment` takes for an energy: a name, an energy, or what makes one of the image, (nz, ny, nx) float32 as in
#: `Result.image`, and the spacing, (hz, hy, hx) mm.
EnergyLike = str | Energy | Callable[[NDArray[np.float32], tuple[float, float, float]], Energy]


class RunCheckpoint(NamedTuple):
    """A run between two steps, before the edits of the coming one: the number of that ``step``; the settings ``now`` in
    force; how many edits were ``done``; and the ``evolution``.
    """

    step: int
    now: RunConfig
    done: int
    evolution: Kept

    @property
    def level(self) -> int:
        """The level that it is of."""
        return int(self.evolution.scalars["level"])

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        return self.evolution.nbytes


class Run:
    """A run, one step at a time; iterate over it to run to the end.

    Between two steps it can be put aside (`checkpoint`) and taken back (`restore`), and its edits can be changed
    (`set_edits`): those whose step has come are applied right before it.

    Parameters
    ----------
    volume : Volume
    config : RunConfig
    energy : Energy or callable, optional
        In place of the energy that ``config`` names; see `accelsurf.segment`.
    channels : sequence of Volume, optional
        Further channels, before those that ``config`` names.

    Attributes
    ----------
    config : RunConfig
        As given, with the edits there are now, and with the seed that was drawn if none was given.
    now : RunConfig
        The settings in force.
    prepared : Prepared
        Image, start and fence, on the grid of the region of interest.
    evolution : Multilevel
    workers : Workers
        To be closed at the end.
    start_seconds, began : float
        What the preparation took, and the clock (`time.perf_counter`) when it was done.
    """

    def __init__(
        self,
        volume: Volume,
        config: RunConfig,
        energy: EnergyLike | None = None,
        channels: Sequence[Volume] = (),
    ) -> None:
        began = time.perf_counter()
        if config.objects is not None:
            raise UsageError(
                f"objects: {config.objects} was given to a run of one object",
                "`accelsurf segment --objects` and accelsurf.segment_objects move several; to watch one, start it "
                "alone with --start label:FILE@ID or --start ball:X,Y,Z,R",
            )
        config = seeded(config)
        self.volume, self.config, self._energy = volume, config, energy
        self.now, self._done, self._leaked = config.model_copy(update={"edit": ()}), 0, False
        self.prepared = PreprocessedInput(volume, [*channels, *read_further(config.channel)], config)
        for edit in config.edit:
            self.check(edit)
        self.workers = Workers(available_cores() if config.threads == "auto" else config.threads)
        grids = self._grids(self.prepared.psi, energy)
        self._levels = len(grids)
        self.evolution = Multilevel(
            grids, self.prepared.image, self.prepared.psi, self._parts(self.now), config.max_steps, self.workers
        )
        # The evolution uses its memory up.
        del self.prepared.psi
        self.start_seconds = time.perf_counter() - began
        self.workers.seconds.clear()
        self.began = time.perf_counter()

    def _grids(self, psi: NDArray[np.float32], energy: EnergyLike | None) -> list[pyramid.Level]:
        """The levels that the configuration asks for; see record 0015 for what ``auto`` is."""
        shape, spacing, wanted = self.geometry.shape, self.geometry.spacing, self.config.levels
        if wanted == "auto":
            terms = energy_expression.parse(self.config.energy)
            if energy is not None or any(term.name == "geodesic" for term in terms):
                return pyramid.levels(shape, spacing, 1)
            grids = pyramid.levels(shape, spacing, min_voxels=pyramid.AUTO_MIN_VOXELS)
            return grids[: pyramid.count_resolved_levels(grids, psi)]
        grids = pyramid.levels(shape, spacing, wanted)
        if len(grids) < wanted:
            raise UsageError(
                f"levels: {wanted} was given, expected at most {len(grids)} for this image",
                f"the coarsest grid has at least {pyramid.MIN_VOXELS} voxels along an axis that is halved",
            )
        return grids

    def _parts(self, now: RunConfig) -> SolverSetup:
        """What moves the surface under these settings."""
        return SolverSetup(
            self._energy_maker(now),
            make_flow(now),
            StepLimits(now.cfl, now.percentile),
            Restart() if now.restart == "auto" else None,
            half_width(now),
            stop_rule(now, self._levels),
        )

    def _energy_maker(
        self, now: RunConfig
    ) -> Callable[[NDArray[np.float32], tuple[float, float, float]], Energy]:
        """What makes the energy of each level; an energy that is made already is only for one."""
        energy, prepared = self._energy, self.prepared
        self.energy_name: str = now.energy
        if energy is None or isinstance(energy, str):
            context = prepared.context
            return lambda image, spacing: prepared.fenced(make_energy(now, image, spacing, context), image.shape)
        if self._levels > 1 and not is_maker(energy):
            raise UsageError(
                f"levels: {self._levels} was given, expected 1: the energy has one image, and each level needs its own",
                "give a class or function that makes the energy of (image, spacing), or levels=1",
            )

        def made(image: NDArray[np.float32], spacing: tuple[float, float, float]) -> Energy:
            own = own_energy(energy, now, image, spacing)
            self.energy_name = own.name
            return prepared.fenced(own, image.shape)

        return made

    @property
    def geometry(self) -> Geometry:
        """The grid that the surface lives on, on the finest level: that of the region of interest."""
        return self.prepared.geometry

    @property
    def stop(self) -> Stop | None:
        """Why the run ended; None while it goes on."""
        stop = self.evolution.stop
        if stop is not None and self._leaked and stop.reason == "interrupted":
            message = f"the object grew beyond {self.now.max_volume:g} mm3, the largest volume it may have"
            return stop._replace(reason="leaked", message=message)
        return stop

    # -- to run --------------------------------------------------------------------------------------------

    @property
    def step_number(self) -> int:
        """Number of the step that comes next."""
        return len(self.evolution.history)

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of the surface."""
        while (step := self.step()) is not None:
            yield step

    def step(self) -> Step | None:
        """Apply the edits that come before it and make one step; None when the run has ended.

        The run ends when the object is larger than it may be.
        """
        self.apply()
        step, most = self.evolution.step(), self.now.max_volume
        if step is not None and most is not None and step.row.volume_mm3 > most and not self._leaked:
            self._leaked = True
            self.evolution.ask_to_stop()
        return step

    def apply(self) -> None:
        """Apply the edits whose step has come, if that has not been done; `step` does it by itself."""
        while self.evolution.stop is None and self._done < len(self.config.edit):
            edit = self.config.edit[self._done]
            if edit.step > self.step_number:
                break
            now = self.now.replace(**edit.settings, seed=self.config.seed) if edit.settings else self.now
            push = functools.partial(self._push, edit.balls) if edit.balls else None
            self.evolution.edit(self._parts(now), _energy_key(now) != _energy_key(self.now), push)
            self.now, self._done = now, self._done + 1

    @property
    def edits_done(self) -> int:
        """How many of the edits have been applied."""
        return self._done

    def set_edits(self, edits: tuple[Edit, ...]) -> None:
        """Have other edits; those that have been applied must stay as they are.

        Raises
        ------
        UsageError
            When one makes no sense.
        InputError
            When a ball lies outside the volume.
        """
        same = 0
        while same < min(len(edits), len(self.config.edit)) and edits[same] == self.config.edit[same]:
            same += 1
        for edit in edits[same:]:
            self.check(edit)
        config = seeded(self.config.replace(edit=edits))
        if config.edit[: self._done] != self.config.edit[: self._done]:
            raise ValueError("an edit that has been applied cannot change: go back to before it first")
        self.config = config

    def look(self) -> Step:
        """Return the state now: the last row once the run has ended, else one of a step that moves nothing."""
        if self.evolution.stop is None:
            return self.evolution.look()
        return Step(self.evolution.history[-1], self.evolution.surface, self.evolution.step_fields)

    def checkpoint(self) -> RunCheckpoint:
        """Put the state aside, between two steps and before the edits of the coming one are applied."""
        return RunCheckpoint(self.step_number, self.now, self._done, self.evolution.checkpoint())

    def restore(self, kept: RunCheckpoint) -> None:
        """Go back to a state of this run and level: the same edits then make the same steps, bit for bit."""
        changed = _energy_key(kept.now) != _energy_key(self.now)
        self.evolution.restore(kept.evolution, self._parts(kept.now), changed)
        self.now, self._done, self._leaked = kept.now, kept.done, False

    def check(self, edit: Edit) -> None:
        """Refuse what this run cannot do: a ball outside the grid, an energy or a setting that it has nothing for."""
        terms = energy_expression.parse(str(edit.settings.get("energy", self.config.energy)))
        if self.prepared.context.foreground is None and any(term.settings.get("update") == "no" for term in terms):
            raise UsageError(
                f"edit at step {edit.step}: likelihood:update=no was given, and the run has nothing to learn from",
                "give --foreground to the run, or use update=yes",
            )
        for _, ball in edit.balls:
            try:
                starts.ball_of(ball, self.geometry)
            except (UsageError, InputError) as error:
                raise type(error)(f"edit at step {edit.step}: {error.message}", error.hint) from None
        if self._energy is not None and not isinstance(self._energy, str):
            for key in edit.settings:
                if key == "energy" or key in ENERGY_SETTINGS:
                    raise UsageError(
                        f"edit at step {edit.step}: {key} was given, but the energy is one of your own",
                        "it has its own settings, which do not change while it runs",
                    )

    def _push(self, balls: tuple[tuple[str, str], ...], surface: LevelSet) -> None:
        """Unite the object with balls, or take them away from it: psi near them, negative inside."""
        level = self.evolution.level
        psi = surface.dense.psi.reshape(surface.shape)
        for kind, text in balls:
            centre, radius = starts.ball_of(text, self.geometry)
            middle = (np.array(centre) + 0.5) / level.factors - 0.5
            reach = (radius + float(surface.gamma)) / np.array(level.spacing)
            low = np.maximum(np.floor(middle - reach), 0).astype(int)
            high = np.minimum(np.ceil(middle + reach) + 1, surface.shape).astype(int)
            box = tuple(slice(a, max(a, b)) for a, b in zip(low, high, strict=True))
            axes = [np.arange(s.start, s.stop) for s in box]
            squares = [((x - m) * h) ** 2 for x, m, h in zip(axes, middle, level.spacing, strict=True)]
            far = np.sqrt(squares[0][:, None, None] + squares[1][None, :, None] + squares[2][None, None, :])
            inside = (far - radius).astype(np.float32)
            part = psi[box]
            if kind == "add":
                np.minimum(part, inside, out=part)
            else:
                np.maximum(part, -inside, out=part)
        self.prepared.project(psi)


def seeded(config: RunConfig) -> RunConfig:
    """The configuration, with a seed if it has noise at any time; drawn once and kept, so that it repeats the run."""
    noisy = config.noise > 0 or any(config.at(edit.step).noise > 0 for edit in config.edit if "noise" in edit.settings)
    return config.replace(seed=secrets.randbelow(2**31)) if noisy and config.seed is None else config


def _energy_key(config: RunConfig) -> tuple[Any, ...]:
    """The settings that make the energy what it is."""
    return tuple(getattr(config, key) for key in ("energy", *ENERGY_SETTINGS))


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
