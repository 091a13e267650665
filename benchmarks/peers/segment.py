"""`segment-noise` and `segment-real`: whole segmentations, every program at the best settings that a search finds."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf import io
from accelsurf.analysis.metrics import dice
from accelsurf.segmentation.api import segment
from benchmarks.peers.measure import (
    LONG,
    MissingError,
    Options,
    Timing,
    Trial,
    best,
    combinations,
    goal,
    in_turn,
    ranked,
    repeats_for,
    run_process,
    search,
    set_threads,
    table,
    timed,
)
from benchmarks.peers.programs import PEERS, Peer
from benchmarks.peers.work import BRAIN, BRAIN_REFERENCE, noisy_cube, scan

OWN = "accelsurf"
#: Its fastest setting whose Dice is no lower than any peer's best: peers stop where they are best, so is their pace.
LEVEL = "accelsurf, level with the best peer"
#: A peer this far below the best Dice, or this many times slower than the fastest that is not, cannot be the best one:
#: it is timed twice only.
BEHIND, SLOWER = 0.02, 3.0
#: A peer so far below accelsurf at half the resolution is not run at the whole: it would take minutes to lose.
HOPELESS = 0.1
#: Seconds after which a search begins no new setting: on the small problem, on the large one.
SEARCH_S = (60.0, 40.0)
#: How many of the best settings of the small problem are tried on the large one.
CARRIED = 2


def own_noise_grid() -> list[dict[str, Any]]:
    """Settings of accelsurf in noise."""
    return [
        *combinations(
            epsilon=(0.0,), presmooth=(1.5,), smoothness=(0.2, 0.1), tolerance=(0.1, 0.3, 0.5), levels=("auto", 3)
        ),
        *combinations(epsilon=(0.0, 1.5), presmooth=(1.5, 1.0, 2.0), smoothness=(0.1, 0.2, 0.0)),
        *combinations(flow=("gradient",), epsilon=(0.0,), presmooth=(1.5,), tolerance=(0.1, 0.3)),
    ]


def own_real_grid() -> list[dict[str, Any]]:
    """Settings of accelsurf on the brain scan; the first are those of docs/explanation/real-scans.md."""
    return [
        *combinations(epsilon=(0.0,), balance=(2.0,), tolerance=(0.1, 0.3, 0.6, 1.0)),
        *combinations(epsilon=(0.0,), balance=(3.0,), tolerance=(0.1, 0.6)),
        *combinations(epsilon=(0.0,), balance=(2.0,), smoothness=(0.1,)),
    ]


# -- in noise ----------------------------------------------------------------------------------------------


def segment_noise(options: Options) -> dict[str, Any]:
    """Cubes in noise of their contrast: every program's best, the library call alone timed."""
    set_threads(options.threads)
    sides = (32, 40) if options.quick else (96, 128)
    carried: dict[str, list[Trial]] = {}
    cases = []
    for i, side in enumerate(sides):
        cases.append(noise_case(side, options, carried, SEARCH_S[min(i, 1)]))
    goals: list[dict[str, Any]] = []
    pairs: list[dict[str, Any]] = []
    tables = []
    for case in cases:
        label = f"{case['side']}^3"
        more, ratios = judge(case["programs"], label)
        goals += more
        pairs += ratios
        tables.append(program_table(f"Cube of {case['side'] // 2} in {label}", case["programs"]))
    bars = [[f"{n}, {c['side']}^3", p["median_s"]] for c in cases for n, p in c["programs"].items()]
    return {
        "work": f"cube in noise sigma 1 of the contrast, {sides[0]}^3 and {sides[1]}^3, off-centre ball, library call, "
        f"{options.threads} threads",
        "threads": options.threads, "cases": cases, "goals": goals, "pairs": pairs, "tables": tables, "bars": bars,
    }


def noise_case(side: int, options: Options, carried: dict[str, list[Trial]], limit_s: float) -> dict[str, Any]:
    """One size: search, then timing in turn. ``carried`` brings the settings of a smaller size, and takes these."""
    image, truth, start, distance = noisy_cube(side)
    segment(image, start=start, threads=options.threads, max_steps=3)  # compile

    def own(settings: Mapping[str, Any]) -> np.ndarray:
        return segment(image, start=start, threads=options.threads, **settings).labels.astype(bool)

    calls: dict[str, Callable[[Mapping[str, Any]], np.ndarray]] = {OWN: own}
    grids: dict[str, tuple[list[dict[str, Any]], Any]] = {OWN: (own_noise_grid(), None)}
    for peer in available(options):
        calls[peer.name] = lambda settings, peer=peer: peer.run(image, distance, (1.0, 0.0), settings)
        grids[peer.name] = ([peer.scaled(s, side) for s in peer.coarse], peer.fine)
    if options.quick:
        grids = {name: (coarse[:2], None) for name, (coarse, _) in grids.items()}
    trials = {}
    for name, (coarse, fine) in grids.items():
        if name in carried:
            # Both sizes have the same noise: the best of the smaller one, iterations grown with the side.
            coarse, fine = from_smaller(carried[name], side), None
        trials[name] = search(lambda s, c=calls[name]: dice(c(s), truth), coarse, fine, limit_s, teller(name, options))
        report(name, best(trials[name]))
    carried |= {name: [regrown(t, 96 / side) for t in ranked(ts)[:CARRIED]] for name, ts in trials.items()}
    carried[OWN] += [regrown(t, 96 / side) for t in level(trials)]
    programs = time_best(trials, calls, options)
    return {"side": side, "start": start, "programs": programs}


def regrown(trial: Trial, factor: float) -> Trial:
    """A trial whose iterations are those of another size."""
    settings = dict(trial.settings)
    if "iterations" in settings:
        settings["iterations"] = max(2, round(settings["iterations"] * factor))
    return Trial(settings, trial.dice, trial.seconds)


def from_smaller(trials: Iterable[Trial], side: int) -> list[dict[str, Any]]:
    """Settings of the smaller problem, for ``side`` voxels."""
    return [regrown(trial, side / 96).settings for trial in trials]


def available(options: Options) -> list[Peer]:
    """The peers that are installed; the others are told, once."""
    for peer in PEERS.values():
        if peer.missing and peer.missing not in options.messages:
            options.say(peer.missing)
    return [peer for peer in PEERS.values() if not peer.missing]


def teller(name: str, options: Options) -> Callable[[str], None]:
    """Says what a search tells, with the program's name."""
    return lambda text: options.say(f"{name}: {text}")


def report(name: str, trial: Trial) -> None:
    """Tell how a search ended."""
    print(f"   {name}: Dice {trial.dice:.4f} in {trial.seconds:.2f} s with {trial.settings}", flush=True)


def time_best(
    trials: Mapping[str, list[Trial]], calls: Mapping[str, Callable[[Mapping[str, Any]], Any]], options: Options
) -> dict[str, dict[str, Any]]:
    """Time the best setting of every program in turn, and gather what is known of it."""
    trials, calls = dict(trials), dict(calls)
    tops = {name: best(tried) for name, tried in trials.items()}
    for trial in level(trials):
        tops[LEVEL], trials[LEVEL], calls[LEVEL] = trial, trials[OWN], calls[OWN]
    highest = max(top.dice for top in tops.values())
    good = [t.seconds for n, t in tops.items() if n not in (OWN, LEVEL) and t.dice >= highest - BEHIND]
    slow = SLOWER * min(good, default=float("inf"))
    repeats = {}
    for name, top in tops.items():
        hopeless = name not in (OWN, LEVEL) and (top.dice < highest - BEHIND or top.seconds > slow)
        repeats[name] = repeats_for(top, options, hopeless)
    works = {name: (lambda c=calls[name], s=top.settings: c(s)) for name, top in tops.items()}
    times = in_turn(works, repeats)
    programs = {}
    for name, top in tops.items():
        timing = times[name]
        if top.seconds > LONG and not options.again:
            options.say(f"{name}: a run takes {top.seconds:.0f} s, timed once more only")
            timing = Timing([top.seconds, *timing.seconds])
        programs[name] = {
            "settings": top.settings, "dice": top.dice, **timing.to_dict(),
            "highest_dice": max(t.dice for t in trials[name]), "search": [t.to_dict() for t in trials[name]],
        }
    return programs


def level(trials: Mapping[str, list[Trial]]) -> list[Trial]:
    """The fastest trial of accelsurf with a Dice no lower than any peer's best, if there is one."""
    highest = max((best(tried).dice for name, tried in trials.items() if name != OWN), default=1.0)
    good = [trial for trial in trials[OWN] if trial.dice >= highest]
    return [min(good, key=lambda trial: trial.seconds)] if good else []


def judge(
    programs: Mapping[str, Mapping[str, Any]], label: str, wanted: float = 10.0
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Goals and pairs: Dice against the best peer's, seconds against that peer's."""
    own = programs[OWN]
    peers = {name: facts for name, facts in programs.items() if name not in (OWN, LEVEL)}
    pairs = [
        {"pair": f"{label}: {name} / accelsurf", "ratio": f["median_s"] / own["median_s"], "dice": f["dice"]}
        for name, f in peers.items()
    ]
    if not peers:
        return [goal(f"{label}: times faster than the best peer", wanted, None)], pairs
    top = best(Trial({"name": name}, facts["dice"], facts["median_s"]) for name, facts in peers.items())
    highest = max(facts["dice"] for facts in peers.values())
    name = top.settings["name"]
    return [
        goal(f"{label}: Dice less the best peer's", 0.0, own["dice"] - highest, unit=""),
        goal(
            f"{label}: times faster than the best peer ({name}), at no lower Dice than any",
            wanted,
            top.seconds / programs[LEVEL]["median_s"] if LEVEL in programs else None,
        ),
        goal(f"{label}: the same at its own best Dice", wanted, top.seconds / own["median_s"]),
    ], pairs


def program_table(title: str, programs: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Everything that was reached, best first."""
    rows = []
    for name, f in sorted(programs.items(), key=lambda item: -item[1]["dice"]):
        chosen = ", ".join(f"{k} {v}" for k, v in f["settings"].items())
        ratio = f["median_s"] / programs[OWN]["median_s"]
        counts = len(f["seconds"]), len(f["search"])
        rows.append((name, f["dice"], f["highest_dice"], f["median_s"], ratio, *counts, chosen))
    columns = (
        "program", "Dice", "highest tried", "seconds", "/ accelsurf's", "runs", "settings tried", "settings"
    )
    return table(title, columns, rows)


# -- on a scan ---------------------------------------------------------------------------------------------


def segment_real(options: Options) -> dict[str, Any]:
    """The brain scan, every program as a process from file to files."""
    image_path, reference_path = scan(options.volumes, BRAIN), scan(options.volumes, BRAIN_REFERENCE)
    set_threads(options.threads)
    with tempfile.TemporaryDirectory() as folder:
        return _segment_real(options, image_path, reference_path, Path(folder))


def _segment_real(options: Options, image_path: Path, reference_path: Path, folder: Path) -> dict[str, Any]:
    truth = io.read_labels(reference_path).array > 0
    volume = io.read(image_path)
    image = volume.as_float32()
    means = (float(image[truth].mean()), float(image[~truth].mean()))
    centre, radius = [0.5 * (n - 1) for n in image.shape], 30.0
    world = ",".join(f"{v:.2f}" for v in volume.geometry.center_world())
    written = folder / "labels.nii.gz"

    def own(settings: Mapping[str, Any]) -> Path:
        call = [sys.executable, "-m", "accelsurf", "segment", str(image_path), "-o", str(folder / "own"), "--quiet"]
        call += ["--overwrite", "--start", f"ball:{world},{radius:g}", "--threads", str(options.threads)]
        for key, value in settings.items():
            call += [f"--{key.replace('_', '-')}", str(value)]
        run_process(call, options.threads)
        return folder / "own" / image_path.name.replace(".nii.gz", "_seg.nii.gz")

    def whole(peer: Peer) -> Callable[[Mapping[str, Any]], Path]:
        def call(settings: Mapping[str, Any]) -> Path:
            task = {"peer": peer.name, "settings": dict(settings), "centre": centre, "radius": radius, "means": means}
            command = [sys.executable, "-m", "benchmarks.peers.whole", str(image_path), str(written), json.dumps(task)]
            run_process(command, options.threads)
            return written

        return call

    calls: dict[str, Callable[[Mapping[str, Any]], Any]] = {OWN: own}
    own({"max_steps": 3})  # compile
    calls |= {peer.name: whole(peer) for peer in available(options)}
    if options.again:
        trials = kept_search(options)
        # The others are what they were; of accelsurf what this code reaches counts, not what it reached then.
        trials[OWN] = searched(own, _dice_of(truth), [trial.settings for trial in trials[OWN]], None, options)
    else:
        grid = [{**own_real_grid()[0], "max_steps": 3}] if options.quick else own_real_grid()
        # The search calls the whole command, and reads back what it wrote: its seconds are the command's alone.
        trials = {OWN: searched(own, _dice_of(truth), grid, 150.0, options)}
        half = halved(image, truth, centre, radius, means)
        quarter = halved(half["image"], half["truth"], [0.5 * c - 0.25 for c in centre], 0.5 * radius, means)
        for name in calls:
            if name == OWN:
                continue
            settings = small_search(PEERS[name], quarter, half, best(trials[OWN]).dice, options)
            if settings:
                trials[name] = searched(calls[name], _dice_of(truth), settings, LONG, options)
                report(name, best(trials[name]))
        keep_search(trials, options)
    report(OWN, best(trials[OWN]))
    programs = time_best(trials, calls, options)
    goals, pairs = judge(programs, "brain")
    return {
        "work": f"brain MRI {'x'.join(map(str, image.shape))} ({BRAIN}), a whole command each, from file to files, "
        f"warm compile cache, {options.threads} threads",
        "threads": options.threads, "means": means, "goals": goals, "pairs": pairs, "programs": programs,
        "tables": [program_table("Brain scan, one ball", programs)],
        "bars": [[name, f["median_s"]] for name, f in programs.items()],
    }


def keep_search(trials: Mapping[str, list[Trial]], options: Options) -> None:
    """Write what a search found, for ``--again``."""
    assert options.search is not None
    found = {"messages": options.messages, "trials": {n: [t.to_dict() for t in ts] for n, ts in trials.items()}}
    options.search.write_text(json.dumps(found, indent=1) + "\n")


def kept_search(options: Options) -> dict[str, list[Trial]]:
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
    call: Callable[[Mapping[str, Any]], Path], read: Callable[[Path], float], grid: Iterable[dict[str, Any]],
    limit_s: float | None, options: Options,
) -> list[Trial]:
    """Run whole commands with some settings; the seconds are those of the command, not of reading its result."""
    trials: list[Trial] = []
    grid = list(grid)
    for i, settings in enumerate(grid):
        if trials and limit_s is not None and sum(t.seconds for t in trials) > limit_s:
            options.say(f"search of whole commands stopped after {limit_s:.0f} s, {len(grid) - i} settings not tried")
            break
        seconds, path = timed(lambda settings=settings: call(settings))
        trials.append(Trial(settings, read(path), seconds))
        print(f"     {settings}: Dice {trials[-1].dice:.4f}, {seconds:.1f} s", flush=True)
    return trials


def halved(
    image: np.ndarray, truth: np.ndarray, centre: list[float], radius: float, means: tuple[float, float]
) -> dict[str, Any]:
    """A scan at half its resolution, on which the peers' settings are searched."""
    shape = tuple(n // 2 * 2 for n in image.shape)
    cut = tuple(slice(0, n) for n in shape)
    parts = [n for size in shape for n in (size // 2, 2)]
    small = image[cut].reshape(parts).mean(axis=(1, 3, 5)).astype(np.float32)
    inside = truth[cut].reshape(parts).mean(axis=(1, 3, 5)) >= 0.5
    z, y, x = (np.arange(n // 2) * 2 + 0.5 - c for n, c in zip(shape, centre, strict=True))
    start = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2) - radius
    return {"image": small, "truth": inside, "start": (0.5 * start).astype(np.float32), "means": means}


def small_search(
    peer: Peer, quarter: dict[str, Any], half: dict[str, Any], reached: float, options: Options
) -> list[dict[str, Any]]:
    """The settings to try at full size: all at a quarter of the resolution, the best at half.

    Sigmas stay in voxels, as coarsening smooths already; iterations grow with the side. None where the best is
    `HOPELESS` below the Dice that accelsurf ``reached``.
    """

    def run_on(scale: dict[str, Any]) -> Callable[[Mapping[str, Any]], float]:
        return lambda s: dice(peer.run(scale["image"], scale["start"], scale["means"], s), scale["truth"])

    say = teller(peer.name, options)
    grid = [{**peer.scaled(s, max(quarter["image"].shape)), **more} for s in peer.coarse for more in real_changes(s)]
    if options.quick:
        grid = [{**settings, "iterations": 2} for settings in grid]
    first = search(run_on(quarter), grid[:1] if options.quick else grid, None, 0.5 * SEARCH_S[0], say)
    kept = [grown(t.settings) for t in ranked(first)[: 3 * CARRIED]]
    fine = {} if options.quick else {"iterations": (0.5, 1.6)}
    trials = search(run_on(half), kept, fine, SEARCH_S[0], say)
    report(f"{peer.name} at half resolution", best(trials))
    if best(trials).dice < reached - HOPELESS and not options.quick:
        options.say(f"{peer.name}: Dice {best(trials).dice:.3f} at half the resolution, not run at the whole")
        return []
    return [grown(t.settings) for t in ranked(trials)[: 1 if options.quick else CARRIED]]


def grown(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings for twice the resolution."""
    return {**settings, "iterations": 2 * settings["iterations"]}


def real_changes(settings: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What is searched on a scan besides: less presmoothing, and the threshold where the program needs one.

    0.6 is close to where two means meet with the balance of 2 that accelsurf is given on this scan.
    """
    sigmas = {1.0: 0.0, 1.5: 0.5, 2.0: 1.0, 2.5: 0.7, 3.0: 1.5}
    sigma = sigmas.get(settings["sigma"], settings["sigma"])
    if "edge" in settings or "alpha" in settings:
        sigma = max(sigma, 0.7)
    return [{"sigma": sigma, "where": where} for where in (0.5, 0.6)] if "where" in settings else [{"sigma": sigma}]
