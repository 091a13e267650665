"""The energy of an expression on an image: its terms, their weights, their sum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from accelsurf.energies import Area, Energy, WeightedSum
from accelsurf.errors import UsageError
from accelsurf.grid.arrays import Image, Spacing
from accelsurf.run.evolving_object import MadeEnergy
from accelsurf.run.image_context import ImageContext, Scale, TermInputs
from accelsurf.run.makers import TERM_MAKERS
from accelsurf.settings.energy_expression import Term
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.run_config import RunConfig


def make_energy(
    config: RunConfig, image: Image, spacing: Spacing, context: ImageContext | None = None
) -> MadeEnergy:
    """The energy of a configuration, of an image on a grid of ``spacing`` (hz, hy, hx) mm.

    Parameters
    ----------
    config : RunConfig
    image : ndarray (nz, ny, nx), float32
        First channel, 0 and 1 at its percentiles; on any level.
    spacing : (hz, hy, hx)
        mm.
    context : ImageContext, optional
        Of the image on its own grid. Without it, ``image`` is on its own grid and in its own unit.

    Returns
    -------
    MadeEnergy
        Its terms have every setting with the value that it has in the run, also where it was taken from the image;
        image values are in the file's unit.

    Raises
    ------
    UsageError
        When a term names a channel that does not exist, or training voxels are given that it would not use.
    """
    context = context or ImageContext([image], [Scale()], spacing)
    terms = config.terms
    channels = [image, *context.others]
    # One term of weight 1 on one channel includes the area itself.
    alone = (
        len(terms) == 1 and terms[0].weight == 1.0 and len(_channels_seen(terms[0], channels)) == 1
    )
    made: list[tuple[float, Energy]] = []
    resolved = []
    for term in terms:
        inputs = TermInputs(
            term.settings,
            config,
            image,
            spacing,
            context,
            alpha=config.smoothness if alone else 0.0,
        )
        parts, settings = make_term(term, inputs, channels)
        made += parts
        resolved.append(settings)
    if alone:
        return MadeEnergy(made[0][1], config.energy, resolved)
    if config.smoothness > 0:
        made.append((config.smoothness, Area()))
    return MadeEnergy(WeightedSum(made), config.energy, resolved)


def _channels_seen(term: Term, channels: Sequence[Image]) -> list[int]:
    """Indices of the channels that a term sees."""
    given = term.settings.get("channel")
    if isinstance(given, float):
        if given != int(given) or given > len(channels):
            raise UsageError(
                f"energy: channel {given:g} of {term.name} was given, expected 1 to {len(channels)}",
                "--channel FILE adds one to those of the input",
            )
        return [int(given) - 1]
    return [0] if TERMS[term.name].channels == "first" else list(range(len(channels)))


def make_term(
    term: Term, inputs: TermInputs, channels: Sequence[Image]
) -> tuple[list[tuple[float, Energy]], dict[str, Any]]:
    """The energies of a term with their weights, one for each channel that it sees, and its resolved settings."""
    spec, seen = TERMS[term.name], _channels_seen(term, channels)
    weight = term.weight * (1.0 / len(seen) if spec.channels == "mean" else 1.0)
    make = TERM_MAKERS[term.name]
    resolved: dict[str, Any] = {"term": term.name, "weight": term.weight}
    energies: list[tuple[float, Energy]] = []
    for channel in seen:
        energy, settings = make(replace(inputs, image=channels[channel], channel=channel))
        energies.append((weight, energy))
        if len(channels) > 1 and spec.sees_image:
            resolved.setdefault("channels", []).append({"channel": channel + 1, **settings})
        else:
            resolved |= settings
    return energies, resolved
