"""Start of a run: its image, its clicks, and the first surface of each object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import GivenMask
from accelsurf.errors import UsageError
from accelsurf.grid.boxes import bounding_box, box_at, corner_of, placed_at, whole_box, widened
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import read_further
from accelsurf.run.arguments import given_arrays, surfaces_of
from accelsurf.run.checkpoint import digest_of
from accelsurf.run.ensemble import union_of, within
from accelsurf.run.image_context import ImageContext
from accelsurf.run.preprocessing import PreprocessedInput, preprocess
from accelsurf.run.setup import is_least_at_model, thread_count
from accelsurf.run.window_input import WindowInput
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart, core_of
from accelsurf.text.object_clicks import read_object_clicks, starts_of
from accelsurf.text.objects import read_label_map, read_objects

#: Voxels around an object's own grid that belong to its part of a result.
AROUND = 2
#: Number of models that are made at once: each marches on arrays of the whole grid, and has threads for its parts.
_MODELS_AT_ONCE = 2


@dataclass(frozen=True, eq=False)
class RunStart:
    """Image, clicks and first surfaces of a run.

    Attributes
    ----------
    config : RunConfig
        With the energy that clicks on several objects choose where none was given.
    has_ids : bool
        Whether objects with ids were given.
    given : tuple of str
        Settings given as arrays in place of texts.
    given_digest : str
        Their SHA-256.
    prepared : PreprocessedInput
    starts : list of ObjectStart
        On the grid of the region of interest, in order of their ids; 0 first, where the background competes.
    contexts : list of ImageContext
        Of the same objects.
    at_least : bool
        The first surfaces are where the energy that ``config`` names is least.
    """

    config: RunConfig
    has_ids: bool
    given: tuple[str, ...]
    given_digest: str
    prepared: PreprocessedInput
    starts: list[ObjectStart]
    contexts: list[ImageContext]
    at_least: bool = False


def start_of_run(
    volume: Volume,
    config: RunConfig,
    channels: Sequence[Volume],
    objects: Any,
    arrays: Mapping[str, NDArray[np.float32]] | None,
    clicks: Sequence[Click],
    part: WindowInput | None = None,
    labels_given: Volume | NDArray[Any] | None = None,
) -> RunStart:
    """Read and prepare the start of a run; parameters as of `accelsurf.run.run.Run`.

    Raises
    ------
    UsageError, InputError
        As of `accelsurf.segment`.
    """
    if config.labels is not None or labels_given is not None:
        if part is not None:
            raise UsageError(
                "labels: a label map was given, and the image is read in parts",
                "let it be read into memory",
            )
        if objects is not None or arrays or clicks:
            raise UsageError(
                "labels: a label map was given with a start, a mask, objects or clicks",
                "give clicks to refine",
            )
        return _start_of_labels(volume, config, channels, labels_given)
    labels = config.objects if objects is None else objects
    surfaces = surfaces_of(labels)
    by_array = given_arrays(labels, arrays) | _masks_of(clicks, volume.geometry)
    table = None if labels is None or surfaces else read_object_clicks(labels, volume.geometry)
    if table is not None:
        clicks = [*clicks, *table.clicks]
        if "energy" not in config.model_fields_set:
            config = config.replace(energy="seeded")
    if (
        labels is not None
        and any(click.id == 1 for click in clicks)
        and table is None
        and not surfaces
    ):
        raise UsageError(
            "inside: clicks were given with objects", "give a table of objects with a column side"
        )
    volumes = [
        volume,
        *channels,
        *([] if part is not None else read_further(config.channel, config.reading)),
    ]
    has_ids = labels is not None
    if surfaces:
        several = surfaces
    elif part is not None and part.starts is not None:
        several, has_ids = list(part.starts), True
    else:
        several = _several(labels, table, clicks, config, volume.geometry)
    union = {"start": union_of(several, volume.geometry)} if several else {}
    prepared, psi = preprocess(volumes, config, {**(arrays or {}), **union}, clicks, has_ids, part)
    contexts, starts = [prepared.context], [ObjectStart(1, (0, 0, 0), psi)]
    if not has_ids:
        if contexts[0].clicks is None:
            contexts = [_with_clicks(contexts[0], prepared.clicks, 1)]
    else:
        if not several or several[0].id != NO_OBJECT:
            several = _no_object(prepared, config) + several
        starts = [within(start, prepared) for start in several]
        contexts = [_context_of(start, prepared, bool(surfaces)) for start in starts]
        if table is not None and config.energy.uses_model:
            starts = _of_models(starts, contexts, prepared.geometry, thread_count(config))
    at_least = table is not None and is_least_at_model(config)
    return RunStart(
        config, has_ids, tuple(by_array), digest_of(by_array), prepared, starts, contexts, at_least
    )


def _start_of_labels(
    volume: Volume,
    config: RunConfig,
    channels: Sequence[Volume],
    given: Volume | NDArray[Any] | None,
) -> RunStart:
    """The start of a run that begins and ends with the objects of a label map; the other labels are not entered."""
    geometry = volume.geometry
    starts, others = read_label_map(
        str(config.labels) if given is None else given, geometry, AROUND
    )
    volumes = [volume, *channels, *read_further(config.channel, config.reading)]
    prepared, _ = preprocess(volumes, config, {"start": union_of(starts, geometry)}, (), True)
    prepared = replace(prepared, other_labels=others)
    is_open, contexts = prepared.open_on(whole_box(geometry.shape)), []
    for start in starts:
        context = prepared.context.of_object(start.corner, start.psi < 0)
        mask = GivenMask(box_at(start.corner, start.psi.shape), start.psi < 0)
        contexts.append(
            context.with_model_inputs(context.model_inputs._replace(given=mask, mask=is_open))
        )
    by_array = given_arrays(None, None, given)
    return RunStart(config, True, tuple(by_array), digest_of(by_array), prepared, starts, contexts)


def _context_of(start: ObjectStart, prepared: PreprocessedInput, is_surface: bool) -> ImageContext:
    """The context of one of several objects.

    Of a first surface that was given, a prediction, the rim may be wrong: models learn from its core, and that of the
    clicks takes its size for the object's.
    """
    spacing = prepared.geometry.spacing
    context = prepared.context.of_object(
        start.corner, core_of(start.psi, spacing) if is_surface else start.psi < 0
    )
    if is_surface and context.model_inputs.size_mm3 is None:
        size = float(np.count_nonzero(start.psi < 0)) * prepared.geometry.voxel_volume
        context = context.with_model_inputs(context.model_inputs._replace(size_mm3=size))
    return _with_clicks(context, prepared.clicks, start.id)


def _masks_of(clicks: Sequence[Click], geometry: Geometry) -> dict[str, NDArray[Any]]:
    """Clicks that were given as arrays, by side."""
    given = Clicks(tuple(clicks), geometry.shape)
    sides = {click.side for click in clicks}
    return {side: given.mask(side).view(np.uint8) for side in sorted(sides)}


def _several(
    labels: Any,
    table: Clicks | None,
    clicks: Sequence[Click],
    config: RunConfig,
    geometry: Geometry,
) -> list[ObjectStart]:
    """First surfaces of several objects on the image's grid; none for a single one."""
    if labels is None:
        return []
    if table is None:
        return read_objects(labels, geometry, AROUND)
    # With a model the competition is in the force: the background needs no surface.
    starts = starts_of(table, geometry, AROUND)
    return [start for start in starts if start.id != NO_OBJECT or not config.energy.uses_model]


def _no_object(prepared: PreprocessedInput, config: RunConfig) -> list[ObjectStart]:
    """The surface that competes for the background, where --outside was given with objects."""
    if prepared.clicks is None or config.energy.uses_model:
        return []
    whole = Clicks(
        tuple(click for click in prepared.clicks.clicks if click.id == NO_OBJECT),
        prepared.clicks.shape,
    )
    found = starts_of(whole, prepared.geometry, AROUND)
    return [start._replace(corner=prepared.corner_on_image(start.corner)) for start in found]


def _with_clicks(context: ImageContext, clicks: Clicks | None, id: int) -> ImageContext:
    return context if clicks is None else context.with_clicks(clicks.of(id))


def _make_models(contexts: Sequence[ImageContext], threads: int) -> None:
    """Make the models of several objects, some at a time; models of a partition share too much for that."""
    at_once = min(threads, _MODELS_AT_ONCE)
    if contexts[0].model_inputs.partition is not None or at_once < 2:
        return
    with ThreadPoolExecutor(at_once) as pool:
        for _ in pool.map(ImageContext.click_model, contexts):
            pass


def _of_models(
    starts: list[ObjectStart], contexts: list[ImageContext], geometry: Geometry, threads: int
) -> list[ObjectStart]:
    """First surfaces of several objects by the model of each; where two overlap, the one with the lower F is there."""
    _make_models(contexts, threads)
    owner, least = np.full(geometry.shape, -1, np.int32), np.zeros(geometry.shape, np.float32)
    for number, context in enumerate(contexts):
        model = context.click_model()
        lower = model.inside & (model.field < least[model.box])
        owner[model.box][lower], least[model.box][lower] = number, model.field[lower]
    out = []
    for number, (start, context) in enumerate(zip(starts, contexts, strict=True)):
        around = context.click_model().box
        tight = bounding_box(owner[around] == number)
        if tight is None:
            out.append(start)
            continue
        box = widened(placed_at(tight, corner_of(around)), geometry.shape, (AROUND, AROUND, AROUND))
        psi = context.model_start(box)
        out.append(
            ObjectStart(start.id, corner_of(box), np.where(owner[box] == number, psi, np.abs(psi)))
        )
    return out
