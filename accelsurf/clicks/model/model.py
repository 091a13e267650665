"""The model of clicks on an object: a score map F, and the object that it shows, click by click.

The first inside click is read in windows from near to far until the answer ends within one. Each later click is read
in a window of its own, with the object before it, and changes that toward its side alone, in voxels connected to it.
So the model after some clicks follows from the model before the last one, and from nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.clicks.model.answers import LIKELIEST, OF_ALIKE, OF_PART, Answer, Levels, grown
from accelsurf.clicks.model.boundary import at_boundary
from accelsurf.clicks.model.even import as_large, dithered, is_beyond_people, smaller_clicks
from accelsurf.clicks.model.features import Features, features_of_first, features_of_later
from accelsurf.clicks.model.network import Network, networks
from accelsurf.clicks.model.reach import (
    ClickReach,
    bounded_by_count,
    distances_from,
    least_reach,
    most_voxels,
    radius_of,
    reach_of,
    separate_part,
)
from accelsurf.clicks.model.surface import mean_curvature
from accelsurf.clicks.model.windows import (
    SCALES,
    Scale,
    Scene,
    Seed,
    Window,
    radius_of_count,
    seed_of,
    window_around,
)
from accelsurf.errors import InputError
from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    common,
    connected_to,
    corner_of,
    counted_from,
    enclosing,
    holes_filled,
    on_box,
    overlap,
    placed_at,
    shared,
    whole_box,
    widened,
)
from accelsurf.grid.clicks import Click, Clicks, Side
from accelsurf.image.blocks import on_voxels

#: A later inside click adds from this probability on, an outside click removes from one less this on: of an object with
#: the Dice d a voxel is worth taking from d/2 on.
ADDED = 0.43
#: An answer goes on beyond its window where it covers this part of the section of the click's ball at the open faces.
ACROSS = 0.25
#: F in clicked voxels.
CLICKED: dict[Side, float] = {"inside": -3.0, "outside": 3.0}
#: F of voxels that the probability puts on the other side than the object's shape does: just on their side.
JUST = 1e-3
#: Blocks that are on the click's side already count so much when its change is brought to voxels.
SIDE = 0.2
#: F is kept on a box that is larger than the object by this part of it.
AROUND = 0.25
#: A click corrects the object where more than this part of the click is on the other side.
WRONG = 0.1
#: The objects of F below this and above its negative are compared.
LEVEL = 0.2
#: A stated size is met up to this factor; nearer to it the image decides.
ABOUT = 1.25
#: Least volume of a window in which a stated size is looked for, over that size.
CLICK_ROOM = 4.0
#: Ratio of the objects' volumes beyond which two readings of a click make it ambiguous.
FACTOR = 2.0
#: The volume of an answer that is not taken is of its fitted voxels in a window of at most this number; else of
#: places between blocks, at most this number to a side of each.
MAX_FITTED = 4_000_000
FINE = 3
#: The boundary is fitted with this margin, in blocks, around the voxels that a click has turned.
WIDE = 3


@dataclass(frozen=True, eq=False)
class ClickModel:
    """Score map and object of some clicks, on a box of the grid; beyond it F is 1 and nothing is inside.

    Attributes
    ----------
    clicks : Clicks
        That it was made from, on the whole grid.
    box : tuple of slice
    field : ndarray float32
        F on the box: the surface grows where F < 0; -3 and 3 in clicked voxels, about -1 to 1 elsewhere.
    inside : ndarray of bool
        Where F < 0, on the box.
    answers : tuple of Answer
        To the first click: the one that was taken, and others that are likely; none of a partition.
    spread : float
        Logarithm of how much larger the first answer is from a low probability on than from a high one.
    correction : float or None
        Radius of the last click that corrected the object, over that of the object; None where none did.
    unchanged : float or None
        Dice of the object before that click with the object after it.
    taken : float
        Share of the object that the last click took away.
    disagreements : tuple of float
        Of each click that corrected something: how sure the model was of the opposite there, the mean of |F| at most 1.
    is_partition : bool
        It is one of several objects that fill a space.
    is_ambiguous : bool
        It is of one click, which means objects whose sizes differ by a factor.
    reach : ClickReach or None
        Of the last click; None where it was on its side already, or is the first.
    least_overlap : float
        Least `level_overlap` of the models before the last click.
    """

    clicks: Clicks
    box: Box
    field: Singles
    inside: Mask
    answers: tuple[Answer, ...] = ()
    spread: float = 0.0
    correction: float | None = None
    unchanged: float | None = None
    taken: float = 0.0
    disagreements: tuple[float, ...] = ()
    is_partition: bool = False
    is_ambiguous: bool = False
    reach: ClickReach | None = None
    least_overlap: float = 1.0

    def field_on(self, box: Box) -> Singles:
        """F on a box of the grid."""
        return on_box(self.field, self.box, box, 1.0)

    def inside_on(self, box: Box) -> Mask:
        """The object on a box of the grid."""
        return on_box(self.inside, self.box, box, False)

    def mean_curvature(self, spacing: Spacing) -> float:
        """Mean curvature of the object, 1/mm; 0 of a partition, whose walls are drawn to no side."""
        return (
            0.0
            if self.is_partition
            else mean_curvature(self.inside_on(whole_box(self.clicks.shape)), spacing)
        )

    @property
    def count(self) -> int:
        """Number of voxels inside."""
        return int(np.count_nonzero(self.inside))


def click_model(
    scene: Scene,
    clicks: Clicks,
    *,
    size_mm3: float | None = None,
    answer: int = 1,
    previous: ClickModel | None = None,
    asked: Mapping[str, Network] | None = None,
) -> ClickModel:
    """Make the model of an object from its clicks.

    Parameters
    ----------
    scene : Scene
    clicks : Clicks
        Clicks of one object, see `Clicks.of`.
    size_mm3 : float, optional
        About the object's volume.
    answer : int, optional
        Which answer to the first click is taken, see `Answer`; the likeliest where it has no part of its own.
    previous : ClickModel, optional
        The model of the first of these clicks, all else being the same: the result is the same, sooner.
    asked : mapping of str to Network, optional
        Other networks than the package's.

    Raises
    ------
    InputError
        When no click is inside; LeavesWindow when it looks beyond the scene's part.
    """
    ordered, using = in_order(clicks), networks() if asked is None else asked
    seeds: list[
        Seed
    ] = []  # clicks are read when they are first needed: of many objects most are far from each other
    model, done = previous, 0 if previous is None else len(previous.clicks)
    if model is None or done == 0 or not ordered.starts_with(in_order(model.clicks)):
        seeds.append(seed_of(ordered.clicks[0], scene))
        model, done = first_model(scene, seeds[0], ordered.shape, size_mm3, answer, using), 1
    for number, click in enumerate(ordered.clicks[done:], done):
        if is_right(model, click):
            model = _with_right_click(model, click, scene)
            continue
        seeds += [seed_of(each, scene) for each in ordered.clicks[len(seeds) : number + 1]]
        model = with_click(model, scene, seeds, using)
    return replace(model, clicks=clicks)


def in_order(clicks: Clicks) -> Clicks:
    """The clicks as a model takes them: the first inside click, then all others as they were given.

    Raises
    ------
    InputError
        When none is inside.
    """
    first = next((click for click in clicks.clicks if click.side == "inside"), None)
    if first is None:
        raise InputError("seeded: no inside click was given", "give one with --inside")
    if first is clicks.clicks[0]:
        return clicks
    return Clicks((first, *(click for click in clicks.clicks if click is not first)), clicks.shape)


class Shown(NamedTuple):
    """An answer to the first click on the blocks of its window: ``field`` (nz, ny, nx) is above 0 in it."""

    window: Window
    field: Singles


class FirstBlocks(NamedTuple):
    """An answer to the first click, on blocks.

    Attributes
    ----------
    window : Window
    field : ndarray (nz, ny, nx) float32
        Of its blocks, above 0 in the answer's.
    levels : Levels
    answers : tuple of Answer
        This one, and others that are likely.
    others : dict of int to Shown
        The others that have a level, by number.
    is_ambiguous : bool
        The click, read as large as it is and as smaller ones, gives objects that differ by a factor.
    """

    window: Window
    field: Singles
    levels: Levels
    answers: tuple[Answer, ...]
    others: Mapping[int, Shown]
    is_ambiguous: bool = False


class _Reading(NamedTuple):
    """A click as it was read in the window where its answer ends."""

    window: Window
    probability: Singles
    levels: Levels
    answers: tuple[Answer, ...]

    @property
    def volume_mm3(self) -> float:
        """Volume of the likeliest answer's blocks, mm3."""
        return self.answers[0].volume_mm3 or 0.0


def first_blocks(
    scene: Scene,
    seed: Seed,
    size_mm3: float | None = None,
    answer: int = 1,
    network: Network | None = None,
) -> FirstBlocks:
    """Return an answer to the first click on blocks, final but for its boundary; see `first_model`.

    A click that is larger than people make them is read as smaller ones too. The first of these whose answer is smaller
    by a factor is taken, and the larger answer is in place of a part of it.
    """
    network = networks()["first"] if network is None else network
    read, noise, is_confident = as_large(seed, scene)
    reading = _read(scene, read, noise, size_mm3, network)
    by_number = {each.number: (reading, each) for each in reading.answers}
    is_ambiguous = False
    is_known = size_mm3 is not None or scene.sizes is not None or is_confident
    if not is_known and is_beyond_people(read, scene):
        for smaller in smaller_clicks(read, scene):
            small = _read(scene, smaller, None, None, network)
            is_ambiguous = small.volume_mm3 * FACTOR < reading.volume_mm3
            if is_ambiguous:
                larger = reading.answers[0]._replace(number=OF_PART)
                by_number |= {LIKELIEST: (small, small.answers[0]), OF_PART: (reading, larger)}
                break
    number = answer if answer in by_number and answer != OF_ALIKE else LIKELIEST
    shown = {n: _shown(*by_number[n]) for n in by_number if n != OF_ALIKE}
    taken = by_number[number][0]
    answers = (
        by_number[number][1],
        *(by_number[n][1] for n in sorted(by_number) if n != number),
    )
    window, field = shown.pop(number)
    return FirstBlocks(window, field, taken.levels, answers, shown, is_ambiguous)


def _read(
    scene: Scene, seed: Seed, noise: float | None, size_mm3: float | None, network: Network
) -> _Reading:
    """Read a click in windows from near to far, until its answer ends within one."""
    least = scene.sizes[0] if size_mm3 is None and scene.sizes is not None else size_mm3
    for window in _windows(scene, [seed], least):
        if noise is not None:
            window = replace(window, values=dithered(window.values, noise))
        probability, levels = read_first(window, network)
        answers = levels.answers() if size_mm3 is None else (levels.of_volume(size_mm3),)
        if not _touches(_object(probability, answers[0], window), window):
            break
    return _Reading(window, probability, levels, answers)


def _shown(reading: _Reading, answer: Answer) -> Shown:
    found = _object(reading.probability, answer, reading.window)
    assert answer.level is not None
    field = _signed(reading.probability, answer.level, found)
    field[holes_filled(found) & ~found] = JUST
    return Shown(reading.window, field)


def first_model(
    scene: Scene,
    seed: Seed,
    shape: tuple[int, int, int],
    size_mm3: float | None,
    answer: int,
    asked: Mapping[str, Network],
) -> ClickModel:
    """The model of the first click.

    Parameters
    ----------
    scene : Scene
    seed : Seed
        The click.
    shape : (nz, ny, nx)
        Of the grid.
    size_mm3 : float or None
        About the object's volume.
    answer : int
        Which of the answers is taken, from 1.
    asked : mapping of str to Network
    """
    found = first_blocks(scene, seed, size_mm3, answer, asked["first"])
    window = found.window
    levels = found.levels
    answers = found.answers
    box, score = _on_voxels(Shown(window, found.field), seed.click, asked)
    if size_mm3 is not None:
        score = _sized(score, size_mm3 / float(np.prod(scene.spacing)))
    elif answer == OF_ALIKE:
        box, score, inside = grown(window, box, score < 0)
        score = np.where(inside, np.minimum(score, -JUST), np.maximum(score, JUST))
        if "boundary" in asked:
            score = _fitted(score, box, window, asked["boundary"], seed.click)
        volume = float(np.count_nonzero(score < 0) * np.prod(scene.spacing))
        answers = (
            Answer(None, volume, OF_ALIKE),
            *(other._replace(volume_mm3=None) for other in answers if other.number != OF_ALIKE),
        )
    else:
        answers = tuple(
            each._replace(volume_mm3=_true_volume(found.others[each.number], seed.click, asked))
            if each.number in found.others
            else each
            for each in answers
        )
    made = ClickModel(
        Clicks((seed.click,), shape),
        box,
        score,
        score < 0,
        answers,
        levels.volume_spread(),
        is_ambiguous=found.is_ambiguous,
    )
    made = _with_clicks(made, scene)
    volume = made.count * float(np.prod(scene.spacing))
    return replace(made, answers=(answers[0]._replace(volume_mm3=volume), *answers[1:]))


class _Score(NamedTuple):
    """F of a first answer on a box of the images at hand."""

    box: Box
    field: Singles


def _on_voxels(shown: Shown, click: Click, asked: Mapping[str, Network]) -> _Score:
    """Bring a first answer to voxels, around its object, with its boundary fitted to the image."""
    window = shown.window
    score = -window.on_voxels(shown.field)
    tight = bounding_box(score < 0)
    if tight is None:  # of a block alone nothing may be left between its neighbours
        mask = click.mask_on(window.box)
        score[mask], tight = -JUST, bounding_box(mask)
    assert tight is not None  # the click is in it
    margin = [
        int(AROUND * (s.stop - s.start)) + int(n) for s, n in zip(tight, window.steps, strict=True)
    ]
    part = widened(tight, score.shape, margin)
    box, score = placed_at(part, corner_of(window.box)), score[part].copy()
    if "boundary" in asked:
        score = _fitted(score, box, window, asked["boundary"], click)
    return _Score(box, score)


def _true_volume(shown: Shown, click: Click, asked: Mapping[str, Network]) -> float:
    """Return the volume, mm3, of an answer that is not taken, as one gets it; of a very large one without its fit."""
    window = shown.window
    voxel = float(np.prod(window.scene.spacing))
    sides = np.array([side.stop - side.start for side in window.box])
    if np.prod(sides) <= MAX_FITTED:
        return float(np.count_nonzero(_on_voxels(shown, click, asked).field < 0)) * voxel
    steps = np.minimum(window.steps, FINE)
    shape = np.ceil(sides * steps / window.steps).astype(int)
    values = on_voxels(shown.field, steps.tolist(), shape.tolist())
    return float(np.mean(values > 0)) * float(np.prod(sides)) * voxel


def read_first(window: Window, network: Network) -> tuple[Singles, Levels]:
    """Probability of each block of a window after its click, and the objects by the level of that."""
    probability = asked_of(features_of_first(window), network, window)
    return probability, Levels(probability, window)


def _object(probability: Singles, answer: Answer, window: Window) -> Mask:
    """Blocks of an answer that has a level."""
    assert answer.level is not None
    return connected_to((probability > answer.level) | window.mine, window.mine)


def _fitted(
    score: Singles,
    box: Box,
    window: Window,
    network: Network,
    click: Click | None,
    near: Mask | None = None,
) -> Singles:
    """F on a box with its boundary fitted to the image; in one piece with a click, if given."""
    image, spacing = window.image_on(box), window.scene.spacing
    out = at_boundary(network, image, spacing, score, score < 0, window.steps.tolist(), near)
    if click is not None:
        found = connected_to((out < 0) | click.mask_on(box), click.mask_on(box))
        out[~found] = np.maximum(out[~found], JUST)
    return out


def _sized(score: Singles, count: float) -> Singles:
    """F, shifted where it gives an object that is too far from a number of voxels; with holes filled."""
    found = int(np.count_nonzero(score < 0))
    wanted = int(np.clip(found, count / ABOUT, count * ABOUT))
    if wanted == found or not 0 < wanted < score.size:
        return score
    shifted = score - np.partition(score.ravel(), wanted)[wanted]
    return np.where(holes_filled(shifted < 0), np.minimum(shifted, np.float32(-JUST)), shifted)


def _has_room(window: Window, size_mm3: float | None) -> bool:
    """Test if an object of a size fits into a window, or there is no larger one."""
    return size_mm3 is None or not window.faces.any() or window.volume_mm3 >= CLICK_ROOM * size_mm3


def is_right(model: ClickModel, click: Click) -> bool:
    """Test if a click is on its side already, but for a small part of it."""
    there = model.inside_on(click.box)[click.mask]
    return int(np.count_nonzero(there != (click.side == "inside"))) <= WRONG * there.size


def clicked_inside(model: ClickModel) -> Mask:
    """Return the mask of the inside clicks, on the box of the model."""
    clicked = np.zeros(model.field.shape, np.bool_)
    for click in model.clicks.clicks:
        if click.side == "inside":
            clicked |= click.mask_on(model.box)
    return clicked


def level_overlap(model: ClickModel) -> float:
    """Return the Dice of the objects of F below a level and below its negative: 1 where F is steep at its boundary."""
    clicked = clicked_inside(model)
    # F is -3 and 3 in clicks: they are on their sides of both.
    smaller = int(np.count_nonzero(model.inside & (model.field < -LEVEL)))
    both = smaller + int(np.count_nonzero(connected_to(model.field < LEVEL, clicked)))
    return 2.0 * smaller / both if both else 0.0


def least_overlap_with(model: ClickModel) -> float:
    """Return the least `level_overlap` of a model and those before it."""
    return min(model.least_overlap, level_overlap(model))


def _with_right_click(model: ClickModel, click: Click, scene: Scene) -> ClickModel:
    """The model after one more click that is on its side already: its own voxels alone may change."""
    after = replace(model, clicks=model.clicks.with_more([click]), taken=0.0, reach=None)
    is_beyond = click.side == "outside" and not overlap(click.box, model.box)
    if is_beyond:
        return after
    return _with_clicks(replace(after, least_overlap=least_overlap_with(model)), scene)


def with_click(
    model: ClickModel, scene: Scene, seeds: Sequence[Seed], asked: Mapping[str, Network]
) -> ClickModel:
    """The model after one more click that corrects it, the last of ``seeds``; it was made from the others."""
    seed, known = seeds[-1], model.clicks.with_more([seeds[-1].click])
    click = seed.click
    inside = click.side == "inside"
    least = ADDED if inside else 1.0 - ADDED
    for window in _windows(scene, seeds):
        features, side = features_of_later(
            window, model.inside_on(window.box), len(seeds), model.count
        )
        probability = asked_of(features, asked["later"], window)
        probability[window.theirs] = 0.0
        found = connected_to(((probability > least) & ~side) | window.mine, window.mine)
        if not _touches(found & ~side, window):
            break
    field = _signed(probability, least, found)
    field[side] = np.maximum(field[side], SIDE)
    change = window.on_voxels(field)
    tight = bounding_box(change > 0) if inside else None
    box = (
        model.box
        if tight is None
        else enclosing(model.box, placed_at(tight, corner_of(window.box)))
    )
    score, change = model.field_on(box), on_box(change, window.box, box, -1.0)
    sign = -1.0 if inside else 1.0
    was_there = (score < 0) == inside
    turned = (change > 0) & ~was_there
    before, score = (
        score,
        np.where(turned, sign * np.maximum(change, JUST), score).astype(np.float32),
    )
    if "boundary" in asked and turned.any():
        changed = bounding_box(turned)
        assert changed is not None
        part = widened(changed, turned.shape, [WIDE * int(n) for n in window.steps])
        part = counted_from(common(placed_at(part, corner_of(box)), window.box), corner_of(box))
        near = ndimage.maximum_filter(turned[part], [2 * int(n) + 1 for n in window.steps])
        score[part] = _fitted(
            score[part], placed_at(part, corner_of(box)), window, asked["boundary"], None, near
        )
        score[was_there] = before[was_there]
    after = _with_clicks(
        replace(model, clicks=known, box=box, field=score, inside=score < 0), scene
    )
    if not inside:
        after = without_cut_off(after, model)
    after = within_reach(after, model, click, scene.spacing)
    width = radius_of_count(max(after.count, 1), scene)
    # Of the two objects one lies in the other.
    unchanged = 2.0 * min(model.count, after.count) / max(model.count + after.count, 1)
    wrong = model.field_on(click.box)[click.mask] * (1.0 if inside else -1.0)
    disagreements = (*model.disagreements, float(np.clip(wrong, -1.0, 1.0).mean()))
    taken = 0.0 if inside else 1.0 - after.count / max(model.count, 1)
    return replace(
        after,
        correction=seed.radius / width,
        unchanged=unchanged,
        taken=taken,
        disagreements=disagreements,
        is_ambiguous=False,
        least_overlap=least_overlap_with(model),
    )


def within_reach(
    after: ClickModel, before: ClickModel, click: Click, spacing: Spacing
) -> ClickModel:
    """Return the model after a click where changes are in its reach and connected to it; elsewhere the model before.

    Parameters
    ----------
    after, before : ClickModel
        With the click, and without it.
    click : Click
    spacing : (hz, hy, hx)
        mm.
    """
    box, shape = enclosing(after.box, click.box), after.clicks.shape
    before_on, after_on = before.field_on(box), after.field_on(box)
    differs = bounding_box((before_on != after_on) | click.mask_on(box))
    assert differs is not None  # the click is in it
    part = placed_at(differs, corner_of(box))
    old = before_on[differs]
    new = after_on[differs]
    clicked = click.mask_on(part)
    distance, turned = distances_from(click, part, spacing), (old < 0) != (new < 0)
    far = distance[turned]
    reach = click.near
    if reach is None:
        reach = largest_reach(click, before, spacing)
        radius = radius_of(click, shape, spacing)
        most = most_voxels(click.side, radius, before.count, spacing, shape[0] == 1)
        reach = bounded_by_count(far, reach, most, least_reach(shape, spacing))
    changed = connected_to(((old != new) & (distance <= reach)) | clicked, clicked)
    before_on[differs] = np.where(changed, new, old)
    left = int(np.count_nonzero(turned & ~changed))
    known = ClickReach(reach, int(far.size), left, float(far.max(initial=0.0)))
    return replace(after, box=box, field=before_on, inside=before_on < 0, reach=known)


def largest_reach(click: Click, model: ClickModel, spacing: Spacing) -> float:
    """Return how far a click may change a model that is wrong there, mm; a share of the object may bound it more.

    By its radius and depth, and to the end of a separate part that an outside click lies in.
    """
    found = reach_of(click, model.inside_on, model.clicks.shape, spacing)
    return max(found, 0.0 if click.side == "inside" else _to_end_of_part(click, model, spacing))


def _to_end_of_part(click: Click, model: ClickModel, spacing: Spacing) -> float:
    """Return how far the part of an object goes from a click in it, mm, where it is no main part; else 0."""
    part = separate_part(click, model.box, model.inside, clicked_inside(model))
    if part is None:
        return 0.0
    tight = bounding_box(part)
    assert tight is not None  # the click is in it
    box = placed_at(tight, corner_of(model.box))
    return float(distances_from(click, box, spacing)[part[tight]].max())


def without_cut_off(model: ClickModel, before: ClickModel) -> ClickModel:
    """A model without the part that its last click has cut off from all inside clicks, where the rest is no smaller."""
    held = clicked_inside(model)
    remains = connected_to(model.inside, held)
    cut = model.inside & ~remains & connected_to(before.inside_on(model.box), held)
    if not 0 < np.count_nonzero(cut) <= np.count_nonzero(remains):
        return model
    field = np.where(cut, np.float32(JUST), model.field)
    return replace(model, field=field, inside=field < 0)


def asked_of(features: Features, network: Network, window: Window) -> Singles:
    """Probability of each block that it is on the side of the window's click; 0 where the object cannot be."""
    out = network.probability(features, window.values.shape)
    if window.closed is not None and window.seed.click.side == "inside":
        out[window.closed] = 0.0
    return out


def _windows(
    scene: Scene, seeds: Sequence[Seed], size_mm3: float | None = None
) -> Iterator[Window]:
    """Windows around the last click with room for a size, from near to far, until one holds all of the image.

    Windows of a click whose radius says little of the object's go on beyond the last scale.
    """
    for scale in SCALES:
        window = window_around(scene, seeds, scale)
        has_room = _has_room(window, size_mm3)
        if has_room:
            yield window
        if not window.faces.any():
            return
    while window.faces.any() and (seeds[-1].is_limited or not has_room):
        scale = Scale(0.5 * scale.blocks, 2.0 * scale.reach)
        window = window_around(scene, seeds, scale)
        has_room = _has_room(window, size_mm3)
        if has_room:
            yield window


def _with_clicks(model: ClickModel, scene: Scene) -> ClickModel:
    """The model with every clicked voxel on its side, and nothing where the object cannot be."""
    box, clicks = model.box, model.clicks.clicks
    for click in clicks:
        if click.side == "inside":
            box = enclosing(box, click.box)
    field = model.field_on(box) if box != model.box else model.field.copy()
    if scene.open is not None:
        field[~scene.open[box]] = np.maximum(field[~scene.open[box]], JUST)
    for click in clicks:
        if overlap(click.box, box):
            here, there = shared(
                corner_of(box), field.shape, corner_of(click.box), click.mask.shape
            )
            field[here][click.mask[there]] = CLICKED[click.side]
    return replace(model, box=box, field=field, inside=field < 0)


def _signed(probability: Singles, level: float, found: Mask) -> Singles:
    """From -1 where the probability is 0 to 1 where it is 1, 0 at a level; above 0 where something was found alone."""
    above = probability - np.float32(level)
    field = above / np.where(above > 0, np.float32(1.0 - level), np.float32(level))
    return np.where(found, np.maximum(field, JUST), np.minimum(field, -JUST)).astype(np.float32)


def _touches(found: Mask, window: Window) -> bool:
    """Test if an object goes on beyond the window: at its faces it is as wide as a part of the click's ball."""
    across = np.pi * window.radius**2 / window.width**2
    count = np.count_nonzero(found & window.faces)
    return bool(count > 0 and count >= ACROSS * across)
