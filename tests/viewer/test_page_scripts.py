"""What the page does itself: pointers, wheel, clipboard, ticks; its own Vue runs it, without a browser."""

import pytest

from accelsurf.viewer.page.page import document
from tests.support.page_scripts import run_in_node

#: A picture of 200 x 100 pixels on the screen, and events over it.
EVENTS = """
const img = {clientWidth: 200, clientHeight: 100, setPointerCapture: (number) => asked.push(['captured', number])};
const at = (x, y, more) => ({target: img, offsetX: x, offsetY: y, preventDefault: () => {}, ...more});
const touch = (x, y, pointerId, isPrimary) =>
  at(x, y, {pointerType: 'touch', pointerId, isPrimary, buttons: 1, button: 0});
const mouse = (x, y, more) => at(x, y, {pointerType: 'mouse', pointerId: 1, isPrimary: true, button: 0, ...more});
"""

#: A window of a browser: what is copied, and where the keys go. ``secure`` has a clipboard.
WINDOW = """
const copied = [], page = {tagName: 'DIV', matches: () => false, focus: () => { view.document.activeElement = page; }};
const field = {select: () => { view.document.activeElement = field; }};
const view = {navigator: {}, getSelection: () => ({isCollapsed: true}), document: {activeElement: page,
  getElementById: (id) => id === 'copied' ? field : null,
  execCommand: (name) => { copied.push(field.value); return given.state.works; }}};
if (given.state.secure) view.navigator.clipboard = {
  writeText: (text) => { copied.push(text); return Promise.resolve(); }};
let stopped = 0;
const key = (name, more) => ({key: name, ctrlKey: false, shiftKey: false, altKey: false, metaKey: false, view,
  target: page, preventDefault: () => { stopped += 1; }, ...more});
const press = (event) => tree.props.onKeydown(event);
"""


#: As much of the state as the panels below need.
STATE = {
    "picture": "data:,",
    "theme": "dark",
    "rests": [],
    "keys": ["Ctrl+C", "Ctrl+Shift+C", "/"],
    "choices": [],
    "as_point": "point:1,2,3",
    "as_ball": "ball:1,2,3,4",
    "as_correction": "",
    "files": [],
    "hints": [],
    "can_run": True,
    "result": ["volume 1 ml"],
    "uncertain": [],
}


def rendered(script, **state):
    return run_in_node(document(("head", "result")), {**STATE, **state}, script)


def test_pointers_are_sent_as_what_they_are():
    script = (
        EVENTS
        + """
    fire('picture', 'onPointerdown', touch(50, 50, 12, true));
    fire('picture', 'onPointerdown', touch(150, 25, 13, false));
    fire('picture', 'onPointermove', touch(230, -5, 13, false));
    fire('picture', 'onPointerup', touch(150, 25, 13, false));
    fire('picture', 'onPointercancel', touch(50, 50, 12, true));
    fire('picture', 'onPointerdown', mouse(50, 50, {button: 2, shiftKey: true}));
    fire('picture', 'onPointermove', mouse(100, 50, {buttons: 2}));
    fire('picture', 'onPointermove', mouse(100, 50, {buttons: 0}));
    fire('picture', 'onPointerup', mouse(100, 50));
    fire('picture', 'onPointercancel', mouse(100, 50));
    say(asked);
    """
    )
    (asked,) = rendered(script)
    assert [one for one in asked if one[0] != "captured"] == [
        ["touch_down", 0.25, 0.5, 12, True],
        ["touch_down", 0.75, 0.25, 13, False],
        ["touch_move", 1, 0, 13],
        ["touch_up", 13],
        ["touch_cancel", 12],
        ["press", 0.25, 0.5, 2, True],
        ["move", 0.5, 0.5],
        ["hover", 0.5, 0.5],
        ["release"],
        ["cancel"],
    ]
    assert [one for one in asked if one[0] == "captured"] == [
        ["captured", 12],
        ["captured", 13],
        ["captured", 1],
    ]


def test_the_scroll_is_sent_as_the_browser_counts_it():
    script = (
        EVENTS
        + """
    fire('picture', 'onWheel', at(50, 50, {deltaY: -4.25, deltaMode: 0, ctrlKey: true}));
    fire('picture', 'onWheel', at(50, 50, {deltaY: 3, deltaMode: 1, ctrlKey: false}));
    fire('picture', 'onWheel', at(50, 50, {deltaY: 0, deltaMode: 0, ctrlKey: false}));
    say(asked);
    """
    )
    (asked,) = rendered(script)
    assert [one[3:] for one in asked] == [[-4.25, 0, True], [3, 1, False], [0, 0, False]]


@pytest.mark.parametrize("secure", [True, False])
def test_places_are_copied_with_and_without_a_clipboard(secure):
    script = (
        WINDOW
        + """
    press(key('c', {ctrlKey: true}));
    press(key('C', {ctrlKey: true, shiftKey: true}));
    press(key('/'));
    say(copied); say(asked); say(view.document.activeElement === page);
    """
    )
    copied, asked, has_keys = rendered(script, secure=secure, works=True, as_correction="--correct")
    assert copied == ["point:1,2,3", "ball:1,2,3,4", "--correct"] and has_keys
    assert asked == [["key", "Ctrl+C"], ["key", "Ctrl+Shift+C"], ["key", "/"]]


def test_a_copy_that_fails_is_said():
    (asked,) = rendered(
        WINDOW + "press(key('c', {ctrlKey: true})); say(asked);", secure=False, works=False
    )
    assert asked == [["key", "Ctrl+C"], ["copy_failed"]]


def test_a_text_that_is_selected_is_copied_by_the_browser():
    script = (
        WINDOW
        + """
    press(key('c', {ctrlKey: true, target: {tagName: 'INPUT', matches: (what) => what.includes('input[type=text]')}}));
    view.getSelection = () => ({isCollapsed: false});
    press(key('c', {ctrlKey: true}));
    say([copied, asked, stopped]);
    """
    )
    assert rendered(script, secure=True, works=True) == [[[], [], 0]]


def test_steps_of_plateaus_are_ticks_and_buttons():
    script = """
    const ticks = find((props, one) => one.type === 'datalist')[0];
    say(find((props) => props.id === 'back').map((one) => [one.props.list === ticks.props.id, one.props.max]));
    say([...nodes(ticks.children)].filter((one) => one.type === 'option').map((one) => one.props.value));
    const buttons = find((props) => /^rest-/.test(props.id || ''));
    for (const one of buttons) one.props.onClick({});
    say(buttons.map((one) => one.children)); say(asked);
    """
    slider, ticks, buttons, asked = rendered(script, rests=[40, 80], last=90, step=3)
    assert slider == [[True, 90]] and ticks == [40, 80] and buttons == ["40", "80"]
    assert asked == [["go_to", 40], ["go_to", 80]]
    assert rendered(script, rests=[], last=90, step=3) == [[[True, 90]], [], [], []]
