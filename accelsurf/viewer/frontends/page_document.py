"""Document of the page: its panels, its picture, its keys, and what happens to a file that is dropped on it."""

from __future__ import annotations

import html
from collections.abc import Sequence
from importlib import resources

from accelsurf.viewer.scene.colors import ALARM, EDGE, MARK, ON_SURFACE, SURFACE

#: A key by Qt's name of it; keys that are typed into a field, or turn a control, are left to it.
_ON_KEY = """
  const typed = ['INPUT', 'SELECT', 'TEXTAREA', 'BUTTON', 'SUMMARY', 'A'].includes($event.target.tagName);
  const names = {' ': 'Space', ArrowRight: 'Right', ArrowLeft: 'Left', ArrowUp: 'Up', ArrowDown: 'Down'};
  const key = names[$event.key] || ($event.key.length === 1 ? $event.key.toUpperCase() : $event.key);
  const name = ($event.ctrlKey ? 'Ctrl+' : '') + ($event.shiftKey && $event.ctrlKey ? 'Shift+' : '') + key;
  const words = {'Ctrl+C': as_point, 'Ctrl+Shift+C': as_ball, '/': as_correction}[name];
  const selects = name === 'Ctrl+C' && (!$event.view.getSelection().isCollapsed
    || $event.target.matches('input[type=text], input[type=number], textarea'));
  if (!$event.altKey && !$event.metaKey && ($event.ctrlKey || !typed) && keys.includes(name) && !selects) {
    $event.preventDefault(); trigger('ask', ['key', name]);
    if (words) { COPY } }
"""

#: Puts ``words`` on the clipboard. A page on http of another machine has none of its own; there a text is selected and
#: copied as a person would, and who had the keys has them again.
_COPY = """
  const view = $event.view, failed = () => trigger('ask', ['copy_failed']);
  if (view.navigator.clipboard) { view.navigator.clipboard.writeText(words).catch(failed); }
  else {
    const field = view.document.getElementById('copied'), before = view.document.activeElement;
    field.value = words; field.select();
    if (!view.document.execCommand('copy')) { failed(); }
    before.focus();
  }
"""

#: Where a pointer is, as parts of the width and of the height from the top; a drag may leave the picture.
_PLACE = ", ".join(
    f"Math.min(Math.max($event.offset{axis} / $event.target.client{side}, 0), 1)"
    for axis, side in (("X", "Width"), ("Y", "Height"))
)

#: A file that is dropped, or chosen in a field, is sent to the address for uploads.
_SEND = """
  const files = FILES;
  const view = $event.target.ownerDocument.defaultView;
  if (files.length === 1) {
    const place = upload_to + encodeURIComponent(files[0].name);
    view.fetch(place, {method: 'POST', body: files[0]}).catch(() => trigger('ask', ['drop_failed']));
  } else if (files.length) { trigger('ask', ['drop_failed']); }
"""


def document(panels: Sequence[str]) -> str:
    """Return the page: panels and the picture, or, where there are no panels, what can be opened.

    Parameters
    ----------
    panels : sequence of str
        Names of their files, in their order.
    """
    drop = f'@dragover.prevent="0" @drop.prevent="{_inline(_SEND.replace("FILES", "$event.dataTransfer.files"))}"'
    asked = page_text("opening.html")
    if not panels:
        begin = f'<div class="begin">{_with_lists("start.html")}{asked}</div>'
        return f'<div class="page" :class="theme" {drop}>{begin}</div>'
    inner = "\n".join(_with_lists(f"{name}.html") for name in panels)
    on_key = _inline(_ON_KEY.replace("COPY", _COPY))
    canvas = page_text("canvas.html").replace("PLACE", _inline(_PLACE))
    return f"""<div class="page" :class="theme" tabindex="0" autofocus @keydown="{on_key}" {drop}>
<details class="panels" open><summary id="fold">Panels</summary>
<aside aria-label="panels">{asked}{inner}</aside></details>{canvas}
<textarea id="copied" class="aside" readonly tabindex="-1" aria-hidden="true"></textarea></div>"""


def style_sheet() -> str:
    """Return the style sheet of the page, with the colours that it shares with the scene and the window."""
    shared = {"main": SURFACE, "on": ON_SURFACE, "mark": MARK}
    dark = {**shared, "edge": EDGE["dark"], "alarm": ALARM["dark"]}
    light = {"edge": EDGE["light"], "alarm": ALARM["light"]}
    sheets = ((".page", dark), (".page.light", light))
    colors_of_page = "\n".join(
        f"{where} {{ {' '.join(f'--{name}: {color};' for name, color in colors.items())} }}" for where, colors in sheets
    )
    return f"{colors_of_page}\n{page_text('page.css')}"


def _inline(script: str) -> str:
    """A script as the value of an attribute."""
    return html.escape(" ".join(script.split()))


def _with_lists(name: str) -> str:
    """A file of the page, with the lists of what can be opened, and what copies, where it has them."""
    send = _inline(_SEND.replace("FILES", "$event.target.files"))
    text = page_text(name).replace("LISTS", page_text("lists.html"))
    return text.replace("UPLOAD", send).replace("COPY", _inline(_COPY))


def page_text(name: str) -> str:
    """Return the text of a file of the page."""
    return resources.files("accelsurf.viewer").joinpath("page", name).read_text(encoding="utf-8")
