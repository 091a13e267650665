"""Answers to the first click: what else it may mean is drawn and said, and a key takes it; the window, the page."""

import importlib.util
import time

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.errors import UsageError
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.page.page import document
from tests.support import viewing
from tests.support.offscreen import lines_of
from tests.support.page_scripts import run_in_node
from tests.support.part_and_whole import BEYOND, CLICK, SHAPE, part_and_whole

EVERYWHERE = tuple(slice(0, n) for n in SHAPE)


@pytest.fixture(scope="module")
def image():
    return part_and_whole()


def config(**more):
    return RunConfig(**{"inside": CLICK, "levels": 1, "max_steps": 60, "threads": 1, **more})


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    assert found
    return found


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def numbers(session):
    """Of the first two answers; there may be a third."""
    return [(answer.number, answer.is_taken) for answer in session.status.answers[:2]]


def test_an_answer_is_taken_as_one_change_and_the_run_is_that_of_the_setting(image):
    volume, part, whole = image
    with Session(volume, config()) as session:
        offered = until(lambda: session.status.answers)
        first, second = offered[:2]
        assert (
            numbers(session) == [(1, True), (2, False)]
            and first.volume_mm3 > 1.3 * second.volume_mm3
        )
        assert dice(second.surface.inside(EVERYWHERE), part) > 0.9
        assert first.surface is None and dice(second.surface.inside(EVERYWHERE), whole) < 0.8
        assert session.status.step == 0 and session.status.changes == ()
        session.take_answer(2).result()
        assert (
            session.wait(60)
            and session.status.stop is not None
            and session.status.settings.answer == 2
        )
        back = until(
            lambda: (
                numbers(session) == [(1, False), (2, True)] and session.status.answers[0].surface
            )
        )
        shown = back.inside(EVERYWHERE)
        assert (
            2.0 * np.count_nonzero(shown) == pytest.approx(first.volume_mm3, rel=0.1)
            and dice(shown, whole) > 0.8
        )
        inside = viewing.look(session, lambda run: run.objects[0].surface.psi < 0).result()
        assert np.array_equal(inside, segment(volume, config=config(answer=2)).labels > 0)
        assert [answer.volume_mm3 for answer in session.status.answers] == [
            answer.volume_mm3 for answer in offered
        ]
        session.take_answer(2).result()  # is shown already
        assert session.wait(60) and len(session.status.changes) == 1
        session.undo().result()
        assert session.wait(60) and session.status.settings.answer == 1
        until(lambda: numbers(session) == [(1, True), (2, False)])
        with pytest.raises(UsageError, match="no answer 4"):
            session.take_answer(4).result()


def test_another_click_ends_the_choice_and_undoing_it_brings_it_back(image):
    volume, _, _ = image
    with Session(volume, config()) as session:
        until(lambda: session.status.answers)
        session.add_click("outside", BEYOND).result()  # while it runs
        assert session.status.answers == ()
        with pytest.raises(UsageError, match="no answer 2"):
            session.take_answer(2).result()
        session.undo().result()
        until(lambda: session.status.answers)
        session.play()
        assert session.wait(60)
        session.add_click("outside", BEYOND).result()  # after its end
        assert session.wait(60) and session.status.refinements and session.status.answers == ()
        session.undo().result()
        until(lambda: session.status.answers)


OTHERS = ({"size": "4ml"}, {"energy": "chan-vese", "start": CLICK}, {"outside": "point:1,1,1"})


@pytest.mark.parametrize("given", OTHERS)
def test_with_a_size_another_energy_or_two_clicks_nothing_is_offered(image, given):
    with Session(image[0], config(**given)) as session:
        session.ready.result(60)
        time.sleep(0.5)
        assert session.status.answers == ()


def test_with_a_second_object_there_is_no_choice(image):
    with Session(image[0], config()) as session:
        until(lambda: session.status.answers)
        session.play()
        assert session.wait(60)
        session.add_click("inside", "ball:32,32,24,3", 2).result()
        assert session.status.objects == (1, 2) and session.status.answers == ()
        with pytest.raises(UsageError, match="no answer 2"):
            session.take_answer(2).result()


def test_a_press_without_a_drag_is_a_first_click(image):
    volume, part, _ = image
    with Session(
        volume, RunConfig(start="ball:5,5,5,2", max_steps=60, levels=1, threads=1)
    ) as session:
        session.press(CLICK).result()
        session.release(0.0).result()
        assert session.wait(60)
        settings = session.status.settings
        assert (settings.inside, settings.size, settings.energy) == ((CLICK,), None, "seeded")
        assert len(session.status.changes) == 1 and session.status.stop is not None
        until(lambda: numbers(session) == [(1, True), (2, False)])
        session.take_answer(2).result()
        session.press(CLICK).result()
        session.release(0.0).result()  # a new first click: the likeliest answer again
        assert session.wait(60) and session.status.settings.answer == 1


@pytest.fixture
def actions(image, scene_of):
    viewing.needs_graphics()
    scene = scene_of(image[0], size=(960, 544))
    with Session(image[0], config()) as session:
        session.ready.result(60)
        made = Actions(session, scene)
        scene.cursor = (14.0, 16.0, 24.0)
        viewing.wait_until_idle(made)
        yield made


def test_other_answers_are_outlines_in_the_slices_until_escape_or_a_click(actions):
    said = until(lambda: actions.state()["first_answers"])
    assert [(one["number"], one["key"], one["taken"]) for one in said[:2]] == [
        (1, "7", True),
        (2, "8", False),
    ]
    assert all(one["volume"].endswith("ml") for one in said)
    others = len(said) - 1
    assert len(actions.scene.marks.answers) == others and actions.changed
    drawn = actions.scene.screenshot()
    actions.request("key", "Escape")
    said = actions.state()["first_answers"]
    assert (
        len(said) == others + 1 and actions.scene.marks.answers == ()
    )  # the line stays, and the keys
    plain = actions.scene.screenshot()
    (left, bottom, right, top), (high, wide, _) = (
        actions.scene.space.renderer.GetViewport(),
        drawn.shape,
    )
    space = (
        slice(round(high * (1 - top)), round(high * (1 - bottom))),
        slice(round(wide * left), round(wide * right)),
    )
    assert np.array_equal(drawn[space], plain[space]) and not np.array_equal(drawn, plain)
    actions.request("key", "8")
    viewing.wait_until_idle(actions)
    until(lambda: [one["taken"] for one in actions.state()["first_answers"][:2]] == [False, True])
    assert (
        len(actions.scene.marks.answers) == others and actions.session.status.settings.answer == 2
    )
    one = actions.scene.slice_tiles["axial"]
    lines = one.lines["answers"][0].mapper.GetInput().n_cells
    actions.scene.cursor = (14.0, 16.0, 2.0)  # beside it
    assert lines > 10 and not one.lines["answers"][0].GetVisibility()
    actions.session.add_click("outside", BEYOND).result(60)
    assert actions.state()["first_answers"] == [] and actions.scene.marks.answers == ()


def test_a_request_that_fits_nothing_is_refused(actions):
    until(lambda: actions.state()["first_answers"])
    for value, words in ((0, "from 1 to 3"), (4, "from 1 to 3"), ("x", "expected a number")):
        actions.request("take_answer", value)
        actions.session.wait(60)
        actions.collect_results()
        assert words in actions.message, value
    assert actions.session.status.changes == ()


def test_the_keys_are_in_the_help_and_nothing_else_has_them(actions):
    for number, key in ((1, "7"), (2, "8"), (3, "9")):
        assert (actions.keys[key].request, actions.keys[key].values) == ("take_answer", (number,))
    features = [key for feature in actions.features for key in feature.keys()]
    assert len(set(features)) == len(features) and not set("789") & {
        tool.key for tool in actions.tools.values()
    }


#: Two answers, the first one taken.
CHOICE = [
    {"number": 1, "key": "7", "volume": "3.7 ml", "taken": True},
    {"number": 3, "key": "9", "volume": "5.9 ml", "taken": False},
]
ROW = f"""
from PySide6.QtWidgets import QApplication
app = QApplication([])
from accelsurf.viewer.window.desktop import AnswersRow
class Asked:
    def request(self, *request):
        print(*request)
row = AnswersRow(Asked())
def shown(answers):
    row.show_state({{"first_answers": answers}})
    print(row.isHidden(), *[made.text() for made in row.buttons.values() if not made.isHidden()],
          [number for number, made in row.buttons.items() if made.isChecked() and not made.isHidden()])
choice = {CHOICE!r}
shown([])
shown(choice)
row.buttons[3].click()
shown(choice)
shown([])
"""


@pytest.mark.skipif(importlib.util.find_spec("PySide6") is None, reason="PySide6 is not installed")
def test_the_window_has_a_button_for_each_answer():
    assert lines_of(ROW) == [
        "True []",
        "False 3.7 ml 5.9 ml [1]",
        "take_answer 3",
        "False 3.7 ml 5.9 ml [1]",
        "True []",
    ]


def test_the_page_has_a_button_for_each_answer():
    script = """
    const buttons = find((props) => /^answer-/.test(props.id || ''));
    say(buttons.map((one) => [one.children.trim(), one.props['aria-checked']]));
    for (const one of buttons) one.props.onClick({});
    say(asked);
    """
    state = {
        "picture": "data:,",
        "theme": "dark",
        "rests": [],
        "keys": ["7"],
        "choices": [],
        "tools": [],
        "tool": "look",
        "radius_row": {
            "unit": "mm",
            "value": 1.0,
            "tick": 0,
            "low": 0,
            "high": 1,
            "power": 1,
            "digits": 1,
        },
        "as_point": "",
        "as_ball": "",
        "as_correction": "",
    }
    said, asked = run_in_node(document(("tools",)), {**state, "first_answers": CHOICE}, script)
    assert said == [["3.7 ml", "true"], ["5.9 ml", "false"]]
    assert asked == [["take_answer", 1], ["take_answer", 3]]
    assert run_in_node(document(("tools",)), {**state, "first_answers": []}, script) == [[], []]
