"""`segment-real`: a brain scan, every program as a process from file to files at the best settings of a search."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.measure.metrics import dice
from benchmarks.peers.baselines import BASELINES
from benchmarks.peers.comparison import (
    OWN,
    SEARCH_S,
    TRANSFERRED,
    available,
    judge,
    program_table,
    report,
    reporter,
    time_best,
)
from benchmarks.peers.measure import (
    LONG,
    MissingError,
    Options,
    Trial,
    best,
    goal,
    ranked,
    run_process,
    search,
    set_threads,
    timed,
)
from benchmarks.peers.programs import Peer
from benchmarks.peers.work import BRAIN, BRAIN_REFERENCE, scan

#: A peer so far below accelsurf at half the resolution is not run at the whole: it would take minutes.
HOPELESS = 0.1
#: accelsurf's settings, for which nothing is searched: what docs/explanation/real-scans.md has is what is timed.
OWN_SETTINGS = {"preset": "mr-brain"}


def segment_real(options: Options) -> dict[str, Any]:
    """The brain scan, every program as a process from file to files."""
    image_path, reference_path = (
        scan(options.volumes, BRAIN),
        scan(options.volumes, BRAIN_REFERENCE),
    )
    set_threads(options.threads)
    with tempfile.TemporaryDirectory() as folder:
        return _segment_real(options, image_path, reference_path, Path(folder))


def _segment_real(
    options: Options, image_path: Path, reference_path: Path, folder: Path
) -> dict[str, Any]:
    truth = io.read_labels(reference_path).array > 0
    volume = io.read(image_path)
    image = volume.as_float32()
    means = (float(image[truth].mean()), float(image[~truth].mean()))
    centre, radius = [0.5 * (n - 1) for n in image.shape], 30.0
    world = ",".join(f"{v:.2f}" for v in volume.geometry.center_world())
    written = folder / "labels.nii.gz"

    def own(settings: Mapping[str, Any]) -> Path:
        call = [
            sys.executable,
            "-m",
            "accelsurf",
            "segment",
            str(image_path),
            "-o",
            str(folder / "own"),
            "--quiet",
        ]
        call += [
            "--overwrite",
            "--start",
            f"ball:{world},{radius:g}",
            "--threads",
            str(options.threads),
        ]
        for key, value in settings.items():
            call += [f"--{key.replace('_', '-')}", str(value)]
        run_process(call, options.threads)
        return folder / "own" / image_path.name.replace(".nii.gz", "_seg.nii.gz")

    def whole(peer: Peer) -> Callable[[Mapping[str, Any]], Path]:
        def call(settings: Mapping[str, Any]) -> Path:
            task = {
                "peer": peer.name,
                "settings": dict(settings),
                "centre": centre,
                "radius": radius,
                "means": means,
            }
            command = [
                sys.executable,
                "-m",
                "benchmarks.peers.whole",
                str(image_path),
                str(written),
                json.dumps(task),
            ]
            run_process(command, options.threads)
            return written

        return call

    calls: dict[str, Callable[[Mapping[str, Any]], Any]] = {OWN: own}
    own({"max_steps": 3})  # compile
    peers = {peer.name: peer for peer in (*available(options), *available(options, BASELINES))}
    for peer in peers.values():
        if image.size > peer.most:
            options.say(f"{peer.name}: not run, it takes several GB above {peer.most:.0f} voxels")
    calls |= {name: whole(peer) for name, peer in peers.items() if image.size <= peer.most}
    if options.again:
        trials = read_search(options)
        # The others are what they were; of accelsurf what this code reaches counts, not what it reached then.
        trials[OWN] = searched(own, _dice_of(truth), [OWN_SETTINGS], None, options)
    else:
        mine = {**OWN_SETTINGS, "max_steps": 3} if options.quick else OWN_SETTINGS
        trials = {OWN: searched(own, _dice_of(truth), [mine], None, options)}
        half = halved(image, truth, centre, radius, means)
        quarter = halved(
            half["image"], half["truth"], [0.5 * c - 0.25 for c in centre], 0.5 * radius, means
        )
        for name in calls:
            if name == OWN:
                continue
            settings = small_search(peers[name], quarter, half, best(trials[OWN]).dice, options)
            if settings:
                trials[name] = searched(calls[name], _dice_of(truth), settings, LONG, options)
                report(name, best(trials[name]))
        write_search(trials, options)
    report(OWN, best(trials[OWN]))
    programs = time_best(trials, calls, options)
    goals, pairs = judge(programs, "brain", 25.0)
    goals.append(goal("brain: whole command", 10.0, programs[OWN]["median_s"], "<=", "s"))
    return {
        "work": f"brain MRI {'x'.join(map(str, image.shape))} ({BRAIN}), a whole command each, from file to files, "
        f"warm compile cache, {options.threads} threads",
        "threads": options.threads,
        "means": means,
        "goals": goals,
        "pairs": pairs,
        "programs": programs,
        "tables": [program_table("Brain scan, one ball", programs)],
        "bars": [[name, f["median_s"]] for name, f in programs.items()],
    }


def write_search(trials: Mapping[str, list[Trial]], options: Options) -> None:
    """Write what a search found, for ``--again``."""
    found = {
        "messages": options.messages,
        "trials": {n: [t.to_dict() for t in ts] for n, ts in trials.items()},
    }
    if options.search is not None:
        options.search.write_text(json.dumps(found, indent=1) + "\n")


def read_search(options: Options) -> dict[str, list[Trial]]:
    """What the last search found.

    Raises
    ------
    MissingError
        When there was none.
    """
    if options.search is None or not options.search.is_file():
        raise MissingError(f"{options.search} is not there: run it without --again first")
    found = json.loads(options.search.read_text())
    options.messages += found["messages"]
    return {name: [Trial(**trial) for trial in trials] for name, trials in found["trials"].items()}


def _dice_of(truth: np.ndarray) -> Callable[[Path], float]:
    return lambda path: dice(io.read_labels(path).array > 0, truth)


def searched(
    call: Callable[[Mapping[str, Any]], Path],
    read: Callable[[Path], float],
    grid: Iterable[dict[str, Any]],
    limit_s: float | None,
    options: Options,
) -> list[Trial]:
    """Run whole commands with some settings; the seconds are those of the command, not of reading its result."""
    trials: list[Trial] = []
    grid = list(grid)
    for i, settings in enumerate(grid):
        if trials and limit_s is not None and sum(t.seconds for t in trials) > limit_s:
            options.say(
                f"search of whole commands stopped after {limit_s:.0f} s, {len(grid) - i} settings not tried"
            )
            break
        seconds, path = timed(lambda settings=settings: call(settings))
        trials.append(Trial(settings, read(path), seconds))
        print(f"     {settings}: Dice {trials[-1].dice:.4f}, {seconds:.1f} s", flush=True)
    return trials


def halved(
    image: np.ndarray,
    truth: np.ndarray,
    centre: list[float],
    radius: float,
    means: tuple[float, float],
) -> dict[str, Any]:
    """A scan at half its resolution, on which the peers' settings are searched."""
    shape = tuple(n // 2 * 2 for n in image.shape)
    even = tuple(slice(0, n) for n in shape)
    blocks = [n for size in shape for n in (size // 2, 2)]
    small = image[even].reshape(blocks).mean(axis=(1, 3, 5)).astype(np.float32)
    inside = truth[even].reshape(blocks).mean(axis=(1, 3, 5)) >= 0.5
    z, y, x = (np.arange(n // 2) * 2 + 0.5 - c for n, c in zip(shape, centre, strict=True))
    start = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2) - radius
    return {
        "image": small,
        "truth": inside,
        "start": (0.5 * start).astype(np.float32),
        "means": means,
    }


def small_search(
    peer: Peer, quarter: dict[str, Any], half: dict[str, Any], reached: float, options: Options
) -> list[dict[str, Any]]:
    """The settings to try at full size: all at a quarter of the resolution, the best at half.

    Sigmas stay in voxels, as coarsening smooths already; iterations grow with the side. None where the best is
    `HOPELESS` below the Dice that accelsurf ``reached``.
    """

    def run_on(scale: dict[str, Any]) -> Callable[[Mapping[str, Any]], float]:
        return lambda s: dice(
            peer.run(scale["image"], scale["start"], scale["means"], s), scale["truth"]
        )

    say = reporter(peer.name, options)
    grid = [
        {**peer.scaled(s, max(quarter["image"].shape)), **more}
        for s in peer.coarse
        for more in real_changes(s)
    ]
    if options.quick:
        grid = [
            {**settings, "iterations": 2} if "iterations" in settings else settings
            for settings in grid
        ]
    first = search(
        run_on(quarter), grid[:1] if options.quick else grid, None, 0.5 * SEARCH_S[0], say
    )
    candidates = [doubled(t.settings) for t in ranked(first)[: 3 * TRANSFERRED]]
    fine = {} if options.quick or "iterations" not in candidates[0] else {"iterations": (0.5, 1.6)}
    trials = search(run_on(half), candidates, fine, SEARCH_S[0], say)
    report(f"{peer.name} at half resolution", best(trials))
    if best(trials).dice < reached - HOPELESS and not options.quick:
        options.say(
            f"{peer.name}: Dice {best(trials).dice:.3f} at half the resolution, not run at the whole"
        )
        return []
    return [doubled(t.settings) for t in ranked(trials)[: 1 if options.quick else TRANSFERRED]]


def doubled(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings for twice the resolution."""
    return (
        {**settings, "iterations": 2 * settings["iterations"]}
        if "iterations" in settings
        else dict(settings)
    )


def real_changes(settings: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What is searched on a scan besides: less presmoothing, and the threshold where the program needs one.

    0.6 is close to where two means meet with the balance of 2 that accelsurf is given on this scan.
    """
    if "sigma" not in settings:
        return [{}]
    sigmas = {1.0: 0.0, 1.5: 0.5, 2.0: 1.0, 2.5: 0.7, 3.0: 1.5}
    sigma = sigmas.get(settings["sigma"], settings["sigma"])
    if "edge" in settings or "alpha" in settings:
        sigma = max(sigma, 0.7)
    return (
        [{"sigma": sigma, "where": where} for where in (0.5, 0.6)]
        if "where" in settings
        else [{"sigma": sigma}]
    )
