"""Run the commands of the tutorials, and make their pictures and figures again.

    python -m benchmarks.tutorial [PAGE ...] [-o FOLDER]

What `accelsurf fetch` would bring is taken from the folder that ACCELSURF_VOLUMES names, where it has that. After each
command the pictures that it makes go to docs/images; on by-clicks.md also the Dice of each result, between comments
that name it.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from accelsurf import io
from accelsurf.measure.metrics import dice

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("first-scan", "by-clicks")
#: Folder of a run, or file of `look` -> picture.
PICTURES = {
    "look.png": "tutorial-look",
    "liver": "tutorial-click",
    "mended": "tutorial-refine",
    "scene.png": "tutorial-scene",
    "first": "tutorial-first",
    "both": "tutorial-objects",
    "spleen_look.png": "tutorial-spleen-look",
    "spleen": "tutorial-spleen",
    "cord_look.png": "tutorial-cord-look",
    "cord refined": "tutorial-cord",
    "nuclei_look.png": "tutorial-nucleus-look",
    "nucleus": "tutorial-nucleus",
}
COLOURS = 256
#: Folder of a run -> label of the reference.
REFERENCES = {"spleen": 1, "cord": 1, "nucleus": 5}
CONSOLE = re.compile(r"```console\n(.*?)```", re.DOTALL)
FILE = re.compile(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", nargs="*", help="first-scan, by-clicks")
    parser.add_argument("-o", "--output", type=Path, help="where the commands run; kept if given")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for page in options.pages or PAGES:
            work = (options.output or Path(folder)).resolve() / page
            work.mkdir(parents=True)
            play(ROOT / "docs" / "tutorial" / f"{page}.md", work)


def play(page: Path, work: Path) -> None:
    """Run the commands of a page in a folder."""
    text = page.read_text(encoding="utf-8")
    for name, content in FILE.findall(text):
        (work / name).write_text(content)
    for line in (line for block in CONSOLE.findall(text) for line in block.splitlines()):
        words = shlex.split(line.removeprefix("$ "))
        bring(words, work)
        print(line, flush=True)
        subprocess.run([sys.executable, "-m", *words], cwd=work, check=True)
        if words[1] in ("segment", "refine", "look", "movie"):
            keep(page, work, words)


def bring(words: list[str], work: Path) -> None:
    """Copy what `accelsurf fetch` would download, from ACCELSURF_VOLUMES; where that lacks it, it is downloaded."""
    if words[:2] == ["accelsurf", "fetch"]:
        for path in Path(os.environ.get("ACCELSURF_VOLUMES", os.devnull)).glob(f"{words[2]}*"):
            shutil.copy(path, work)


def keep(page: Path, work: Path, words: list[str]) -> None:
    """Keep the picture that a command made, and the Dice of its result."""
    made = words[words.index("-o") + 1] if "-o" in words else words[2]
    name = f"{made} refined" if words[1] == "refine" and made == words[2] else made
    if name in PICTURES:
        found = work / made if made.endswith(".png") else next((work / made).glob("*_preview.png"))
        # As a palette: a quarter of the size.
        drawn = Image.open(found).convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
        drawn.save(ROOT / "docs" / "images" / f"{PICTURES[name]}.png", optimize=True)
    if made in REFERENCES:
        (found,) = (work / made).glob("*_seg.*")
        (known,) = work.glob(found.name.replace("_seg", "_labels"))
        truth = io.read_labels(known).array == REFERENCES[made]
        value = dice(np.asarray(io.read_labels(found).array > 0), truth)
        begin = f"<!-- tutorial {name} -->"
        text = page.read_text(encoding="utf-8")
        page.write_text(
            re.sub(f"{re.escape(begin)}[^<]*<", f"{begin}{value:.3f}<", text), encoding="utf-8"
        )
        print(f"{name}: Dice {value:.3f}", flush=True)


if __name__ == "__main__":
    main()
