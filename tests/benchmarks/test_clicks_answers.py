"""Answers to the first click in the games: the best of them is one more figure, and the game goes on from the first."""

from __future__ import annotations

import numpy as np

from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from benchmarks.clicks import own, tables
from benchmarks.clicks.games import Hints, play, summary
from benchmarks.clicks.objects import Scene
from benchmarks.clicks.person import PersonClick, ball_voxels
from tests.support.part_and_whole import part_and_whole

IMAGE, PART, WHOLE = part_and_whole()
CLICK = PersonClick("inside", (12, 16, 14), (14.0, 16.0, 24.0), 4.0)


class Painter:
    """A session that labels the clicked balls alone."""

    def __init__(self, image: Volume, hints: Hints) -> None:
        self.image, self.count = image, 0
        self.labels = np.zeros(image.array.shape, bool)

    def click(self, click: PersonClick) -> np.ndarray:
        self.count += 1
        box, ball = ball_voxels(click, self.image.geometry)
        self.labels[box][ball] = click.side == "inside"
        return self.labels.copy()


class Choosing(Painter):
    """The same, with two answers more to the first click."""

    def other_answers(self) -> list[np.ndarray]:
        assert self.count == 1
        wide = PART.copy()
        wide[:, :, 40:] = True
        return [wide, np.zeros_like(PART)]


def test_the_best_answer_is_a_row_of_its_own_and_the_game_goes_on_from_the_first() -> None:
    game, usual = (play(kind, Scene(IMAGE, PART), 3) for kind in (Choosing, Painter))
    best = dice(PART | (np.arange(46) >= 40), PART)
    assert [each.get("best_of_answers") for each in game["clicks"]] == [best, None, None]
    assert [each["dice"] for each in game["clicks"]] == [each["dice"] for each in usual["clicks"]]
    assert summary([game])["best_of_answers"] == (best, best)
    # Other methods, and games of before, have none.
    assert summary([usual])["best_of_answers"] is summary([game, usual])["best_of_answers"] is None
    before = tables.method_rows({"accelsurf": summary([usual])})
    rows = tables.method_rows({"accelsurf": summary([usual]), "accelsurf-start": summary([game])})
    assert rows[: len(before)] == before and len(rows) == len(before) + 2
    words = "best of its answers (one more decision of the person)"
    assert rows[-1].startswith(f"| accelsurf-start, {words} | {best:.3f} ({best:.3f}) |")
    assert rows[-1].count("|") == rows[-2].count("|")


def test_in_the_game_of_answers_a_better_one_is_taken_in_place_of_the_second_click() -> None:
    class Taking(Choosing):
        def other_answers(self) -> list[np.ndarray]:
            return [self.labels & False, *super().other_answers()]

        def take(self, number: int) -> np.ndarray:
            assert number == 1
            self.labels = super().other_answers()[0]
            return self.labels

    clicked, taken, then = play(Taking, Scene(IMAGE, PART), 3, "answers")["clicks"]
    assert clicked["side"] == "inside" and (taken["answer"], taken["dice"]) == (
        1,
        clicked["best_of_answers"],
    )
    assert taken["dice"] > clicked["dice"] and then["side"] == "outside"
    # What is not better by more than .02 is not taken, nor in the other games.
    assert "answer" not in play(Taking, Scene(IMAGE, PART), 2)["clicks"][1]


def test_the_start_goes_on_from_the_answer_that_was_taken() -> None:
    session = own.StartAlone(IMAGE, Hints())
    session.click(CLICK)
    others = session.other_answers()
    taken = session.take(0)
    assert (taken == others[0]).all()
    after = session.click(PersonClick("outside", (12, 16, 40), (40.0, 16.0, 24.0), 2.0))
    assert dice(after, taken) > 0.9 and not after[12, 16, 40]


def test_the_best_is_of_the_region_alone_and_never_worse_than_the_first() -> None:
    region = (slice(0, 24), slice(0, 44), slice(0, 40))
    assert play(Choosing, Scene(IMAGE, PART, region), 1)["clicks"][0]["best_of_answers"] == 1.0

    class Worse(Painter):
        def other_answers(self) -> list[np.ndarray]:
            return [np.zeros_like(PART)]

    (first,) = play(Worse, Scene(IMAGE, PART), 1)["clicks"]
    assert first["best_of_answers"] == first["dice"] > 0


def test_the_start_alone_has_the_other_answers_to_its_first_click() -> None:
    session = own.StartAlone(IMAGE, Hints())
    assert session.other_answers() == []
    first = session.click(CLICK)
    other, *_ = session.other_answers()
    assert dice(first, WHOLE) > 0.85 and dice(other, PART) > 0.9
    sized = own.StartAlone(IMAGE, Hints(2.0 * float(PART.sum())))
    sized.click(CLICK)
    assert sized.other_answers() == []
