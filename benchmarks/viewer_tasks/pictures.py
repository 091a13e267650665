"""Pictures of window and page with a real scan, at the sizes of common screens, dark and light, to be looked at.

Usage: python -m benchmarks.viewer_tasks.pictures SCAN FOLDER [--inside WHERE] [--only window|page] [--sheet PICTURE]

The window at 1280 x 720, 1920 x 1080 and 2880 x 1800 (factor 2), the page at widths of 700, 1280 and 1920, after a run
from one click. With --sheet all of them in one small picture, too: window, then page, dark and light in turn.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.viewer_tasks.person import ROOT, Person
from tests.support.screen import own_screen
from tests.support.viewing import CHROMIUM_FLAGS

WINDOWS = ((1280, 720, 1.0), (1920, 1080, 1.0), (2880, 1800, 2.0))
PAGES = ((700, 900), (1280, 720), (1920, 1080))
THEMES = ("dark", "light")
STEPS = 40
#: Height of a picture in the sheet, and what is left between them, pixels.
ROW, GAP = 240, 6
#: Of the sheet: enough for grey images and few colours, in a small file.
COLORS = 160


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("scan", type=Path)
    options.add_argument("folder", type=Path)
    options.add_argument("--inside", default="")
    options.add_argument("--only", choices=("window", "page"))
    options.add_argument("--sheet", type=Path)
    given = options.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    words = ["view", str(given.scan), *(["--inside", given.inside] if given.inside else [])]
    if given.only != "page":
        for width, height, factor in WINDOWS:
            for theme in THEMES:
                window_picture(words, width, height, factor, theme, given.folder)
    if given.only != "window":
        for theme in THEMES:
            page_pictures(words, theme, given.folder)
    if given.sheet is not None:
        write_sheet(given.folder, given.sheet)


def write_sheet(folder: Path, path: Path) -> None:
    """Put the pictures of a folder beside each other: a row for window and page, dark and light."""
    windows = [f"window-{width}x{height}@{factor:g}" for width, height, factor in WINDOWS]
    pages = [f"page-{width}x{height}" for width, height in PAGES]
    rows = [[folder / f"{name}-{theme}.png" for name in names] for names in (windows, pages) for theme in THEMES]
    small = [[in_row(Image.open(one).convert("RGB")) for one in row if one.exists()] for row in rows]
    width = max(sum(one.width + GAP for one in row) for row in small) + GAP
    sheet = Image.new("RGB", (width, len(small) * (ROW + GAP) + GAP), "#808080")
    for number, row in enumerate(small):
        left = GAP
        for one in row:
            sheet.paste(one, (left, GAP + number * (ROW + GAP)))
            left += one.width + GAP
    sheet.quantize(COLORS).save(path, optimize=True)


def in_row(picture: Image.Image) -> Image.Image:
    """A picture as high as a row of the sheet."""
    return picture.resize((round(picture.width * ROW / picture.height), ROW), Image.Resampling.LANCZOS)


def window_picture(words: list[str], width: int, height: int, factor: float, theme: str, folder: Path) -> None:
    """A picture of the window after some steps."""
    with tempfile.TemporaryDirectory() as home, own_screen(width, height) as display:
        person = Person(display, Path(home), [*words, "--theme", theme], size=(width, height), scale=factor)
        person.key("space")
        person.until(lambda now: now["step"] >= STEPS or now["stop"], 300)
        person.key("space", "a")
        time.sleep(3.0)
        person.picture(folder / f"window-{width}x{height}@{factor:g}-{theme}.png")
        person.close()


def page_pictures(words: list[str], theme: str, folder: Path) -> None:
    """Pictures of the page at each width, after some steps."""
    with page_after(words, theme, STEPS) as browser:
        for width, height in PAGES:
            take(browser, width, height, folder / f"page-{width}x{height}-{theme}.png")


def take(browser: Any, width: int, height: int, path: Path) -> None:
    """A picture of a page in a window of a size."""
    browser.set_window_size(width, height)
    time.sleep(4.0)
    browser.save_screenshot(str(path))


@contextmanager
def page_after(words: list[str], theme: str, steps: int) -> Iterator[Any]:
    """A browser at the page of a command, with a run that is paused after some steps."""
    from selenium import webdriver

    command = [sys.executable, "-m", "accelsurf", *words, "--browser", "--no-open", "--theme", theme]
    env = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    server = subprocess.Popen(command, env=env, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    address = server.stdout.readline().strip()
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for flag in CHROMIUM_FLAGS:
        options.add_argument(flag)
    browser = webdriver.Chrome(options=options)
    try:
        browser.get(address)
        wait(lambda: bool(browser.find_elements("id", "picture")), 120)
        browser.find_element("id", "play").click()
        wait(lambda: int(browser.find_element("id", "step").text.split()[1]) >= steps, 300)
        browser.find_element("id", "play").click()
        yield browser
    finally:
        browser.quit()
        server.send_signal(signal.SIGINT)
        server.wait(60)


def wait(condition: object, seconds: float) -> None:
    """Wait until something is so."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():  # type: ignore[operator]
            return
        time.sleep(0.2)
    raise TimeoutError("never seen in the page")


if __name__ == "__main__":
    main()
