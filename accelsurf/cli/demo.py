"""``accelsurf demo``: a cube in noise as strong as its contrast, with and without momentum."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from accelsurf.cli.options import Display, OutputFolder, Overwrite

#: Small ball inside the cube, off its centre: most of the object has to be found.
START = "ball:9,-7,6,10"
#: Descent and momentum.
FLOWS = ("gradient", "constant-density")
MAX_STEPS = 250
#: The largest speed sets the time step, for both flows: with the default percentile descent comes close to
#: momentum within these steps. So it does on a coarser grid, where noise is averaged, and with the area that noise
#: asks for.
FIXED: dict[str, Any] = {"percentile": 100.0, "levels": 1, "energy": "chan-vese:area=0"}


def demo(
    *, output: OutputFolder = Path("accelsurf-demo"), overwrite: Overwrite = False, display: Display | None = None
) -> int:
    """Segment a cube in noise with and without momentum.

    Makes a volume of 96^3 voxels with a cube of side 48 mm, contrast 1 and noise of standard deviation 1, and runs
    gradient descent and the constant-density flow on it: same start, same step control, same step budget. Prints a
    table and writes every output of both runs, the volume, and a picture of the two side by side.

    Parameters
    ----------
    output
        Folder for the outputs; made when missing.
    overwrite
        Replace outputs that exist.
    """
    from accelsurf import io
    from accelsurf.cli.case import run_case
    from accelsurf.cli.compare import conclude
    from accelsurf.cli.place import Place
    from accelsurf.cli.progress import Watcher
    from accelsurf.phantoms import recipes
    from accelsurf.report.document import describe_input
    from accelsurf.report.output_folder import naming_final, opened_set, refuse_existing
    from accelsurf.settings.run_config import RunConfig

    display = display or Display()
    recipe, image, labels = recipes.load_recipe("cube_noisy"), output / "cube.nii.gz", output / "cube_truth.nii.gz"
    paths = {"comparison": output / "demo.json", "picture": output / "demo.png"}
    common = RunConfig(start=START, max_steps=MAX_STEPS, threads=min(2, os.cpu_count() or 1), **FIXED)
    places = {flow: Place(image, output, f"cube_{flow}", overwrite) for flow in FLOWS}
    planned = [place.paths(common.replace(flow=flow)) for flow, place in places.items()]
    everything = {"image": image, "labels": labels, **paths}
    everything |= {f"{number}-{kind}": path for number, some in enumerate(planned) for kind, path in some.items()}
    refuse_existing(everything, overwrite)

    began = time.perf_counter()
    if not display.quiet:
        print(f"A cube of side {recipe.side:g} mm in noise as strong as its contrast; start: {START}", flush=True)
    phantom = recipes.make(recipe)
    with opened_set(output, "cube") as files, naming_final(files):
        io.write(phantom.image, files.drafts / image.name)
        io.write_labels(phantom.truth, files.drafts / labels.name)
        files.commit()
    watcher = Watcher(display)
    results, code = {}, 0
    for flow, place in places.items():
        done = run_case(place, common.replace(flow=flow), watcher)
        results[place.name], code = done.result, max(code, done.code)
        if watcher.interrupted:
            break
    facts = {"input": describe_input(image, geometry=phantom.image.geometry, checksum=io.sha256(image))}
    facts["reference"] = describe_input(labels, checksum=io.sha256(labels))
    title = "A cube in noise: gradient descent and accelerated flow"
    with opened_set(output, "demo") as files, watcher.writing():
        conclude(results, files, paths, facts, phantom.truth, title, display.quiet)
    if not display.quiet:
        print(f"\nAll files are in {output.absolute()} ({time.perf_counter() - began:.0f} s)")
    return code
