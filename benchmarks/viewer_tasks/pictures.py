"""Pictures of window and page with a real scan, at the sizes of common screens, and the share that slices take of each.

Usage: python -m benchmarks.viewer_tasks.pictures SCAN FOLDER [--only window|page] [--sheet PICTURE]
           [--before FOLDER] [-o benchmarks/results/viewer_screens.json] [--themes dark,light]

The window at 1024 x 768, 1280 x 720, 1920 x 1080 and 2880 x 1800 (factor 2), the page at widths of 700, 1280 and
1920: when the image is open, and after a run from a click in the middle of the axial slice. FOLDER/shares.json has, of
each, the part of the window that is image in slices, and the sides of the largest slice. With --sheet all pictures are
in one small picture, too; with --before those of an earlier version, from its FOLDER, above them.
"""

from __future__ import annotations

import argparse
import json
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

WINDOWS = ((1024, 768, 1.0), (1280, 720, 1.0), (1920, 1080, 1.0), (2880, 1800, 2.0))
PAGES = ((700, 900), (1280, 720), (1920, 1080))
#: Height of a picture in the sheet, and what is left between them, pixels.
ROW, GAP = 200, 6
#: Of the sheet: enough for grey images and few colours, in a small file.
COLORS = 160


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("scan", type=Path)
    options.add_argument("folder", type=Path)
    options.add_argument("--only", choices=("window", "page"))
    options.add_argument("--sheet", type=Path)
    options.add_argument("--before", type=Path)
    options.add_argument("--themes", default="dark,light")
    options.add_argument("-o", "--output", type=Path)
    given = options.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    words = ["view", str(given.scan)]
    shares: dict[str, Any] = {}
    for theme in given.themes.split(","):
        if given.only != "page":
            for width, height, factor in WINDOWS:
                shares |= window_pictures(words, width, height, factor, theme, given.folder)
        if given.only != "window":
            shares |= page_pictures(words, theme, given.folder)
        (given.folder / "shares.json").write_text(json.dumps(shares, indent=2) + "\n")
    folders = [folder for folder in (given.before, given.folder) if folder is not None]
    if given.output is not None:
        known = {
            folder.name: json.loads((folder / "shares.json").read_text()) for folder in folders
        }
        given.output.write_text(json.dumps(known, indent=2) + "\n")
    if given.sheet is not None:
        write_sheet(folders, given.sheet)


def write_sheet(folders: list[Path], path: Path) -> None:
    """Put the pictures of folders beside each other: of each a row for window and page, when opened and after a run."""
    rows = []
    for folder in folders:
        for kind in ("window", "page"):
            for when in ("opened", "result"):
                found = sorted(
                    folder.glob(f"{kind}-*-{when}.png"),
                    key=lambda each: int(each.name.split("-")[1]),
                )
                rows.append([in_row(Image.open(each).convert("RGB")) for each in found])
    rows = [row for row in rows if row]
    width = max(sum(each.width + GAP for each in row) for row in rows) + GAP
    sheet = Image.new("RGB", (width, len(rows) * (ROW + GAP) + GAP), "#808080")
    for number, row in enumerate(rows):
        left = GAP
        for each in row:
            sheet.paste(each, (left, GAP + number * (ROW + GAP)))
            left += each.width + GAP
    sheet.quantize(COLORS).save(path, optimize=True)


def in_row(picture: Image.Image) -> Image.Image:
    """A picture as high as a row of the sheet."""
    return picture.resize(
        (round(picture.width * ROW / picture.height), ROW), Image.Resampling.LANCZOS
    )


def share_of(slices: dict[str, list[float]], width: float, height: float) -> dict[str, float]:
    """The part of a window that is image in slices, and the sides of the largest one, pixels of a usual screen."""
    areas = {name: wide * high for name, (wide, high) in slices.items()}
    largest = slices[max(areas, key=lambda name: areas[name])]
    return {
        "share": round(sum(areas.values()) / (width * height), 3),
        "largest": [round(side) for side in largest],
    }


def window_pictures(
    words: list[str], width: int, height: int, factor: float, theme: str, folder: Path
) -> dict[str, Any]:
    """Pictures of the window when the image is open, and after the run; returns the shares of slices."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as home, own_screen(width, height) as display:
        person = Person(
            display, Path(home), [*words, "--theme", theme], size=(width, height), scale=factor
        )

        def take(when: str) -> None:
            time.sleep(3.0)
            name = f"window-{width}-{height}-{theme}-{when}"
            person.picture(folder / f"{name}.png")
            found[name] = share_of(person.now()["slices"], width / factor, height / factor)
            print(name, found[name], flush=True)

        person.until(lambda now: now["state"]["ready"], 120)
        take("opened")
        person.key("s")
        person.click(person.now()["tiles"]["axial"]["middle"])
        person.until(lambda now: now["stop"] is not None and not now["playing"], 300)
        take("result")
        person.close()
    return found


def page_pictures(words: list[str], theme: str, folder: Path) -> dict[str, Any]:
    """Pictures of the page at each width when the image is open, and after the run; returns the shares of slices."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as home, page_of(words, theme, Path(home)) as browser:
        for when in ("opened", "result"):
            if when == "result":
                click_in_axial(browser, Path(home) / "page.json")
                wait(lambda: has_ended(browser), 300)
            for width, height in PAGES:
                name = f"page-{width}-{height}-{theme}-{when}"
                take_page(browser, width, height, folder / f"{name}.png")
                slices = json.loads((Path(home) / "page.json").read_text())["slices"]
                inner = browser.execute_script("return [window.innerWidth, window.innerHeight]")
                found[name] = share_of(slices, *inner)
                print(name, found[name], flush=True)
    return found


def click_in_axial(browser: Any, state_file: Path) -> None:
    """Press in the middle of the axial slice with the tool *Size*."""
    from selenium.webdriver import ActionChains

    picture = browser.find_element("id", "picture")
    across, down = json.loads(state_file.read_text())["axial"]
    right, below = (across - 0.5) * picture.size["width"], (down - 0.5) * picture.size["height"]
    browser.find_element("id", "tool-size").click()
    ActionChains(browser).move_to_element_with_offset(
        picture, round(right), round(below)
    ).click().perform()


def has_ended(browser: Any) -> bool:
    """Whether the run of a page has come to its end."""
    return any(
        shown.text not in ("", "running", "paused")
        for shown in browser.find_elements("id", "state")
    )


def take_page(browser: Any, width: int, height: int, path: Path) -> None:
    """A picture of a page in a window of a size."""
    browser.set_window_size(width, height)
    time.sleep(4.0)
    browser.save_screenshot(str(path))


@contextmanager
def page_of(words: list[str], theme: str, home: Path) -> Iterator[Any]:
    """A browser at the page of a command, once its picture is there."""
    from selenium import webdriver

    command = [
        sys.executable,
        "-m",
        "benchmarks.viewer_tasks.window_watch",
        str(home / "page.json"),
        "-",
        "1",
    ]
    env = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    server = subprocess.Popen(
        [*command, *words, "--browser", "--no-open", "--theme", theme],
        env=env,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
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
