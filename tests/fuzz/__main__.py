"""The long form of the fuzzer: ``scripts/fuzz --minutes M`` or ``--count N``, with a result as JSON."""

import argparse
import itertools
import json
import os
import sys
import time
from collections import Counter
from pathlib import Path

from tests.fuzz import corpus
from tests.fuzz.corpus import input_of
from tests.fuzz.inputs import Input
from tests.fuzz.workers import ADDRESS_BYTES, SECONDS, Judged, Limits, judged, warm_up


def main() -> int:
    """Judge mutated inputs and save those that are faults; the exit code is 1 when there is one."""
    parser = argparse.ArgumentParser(
        prog="scripts/fuzz", description="Give mutated inputs to every reader."
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, help="inputs; 10000 unless --minutes is given")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("fuzz-faults"),
        help="folder for faulty inputs and result.json",
    )
    parser.add_argument("--kind", nargs="+", default=[], help="only inputs of these kinds")
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, help="for an input, default %(default)g"
    )
    parser.add_argument(
        "--limit",
        type=float,
        default=ADDRESS_BYTES / (1 << 30),
        help="GiB that a process may map (RLIMIT_AS) beyond what its libraries map when imported, default %(default)g",
    )
    parser.add_argument("--replay", type=Path, nargs="+", help="judge these saved inputs again")
    options = parser.parse_args()
    limits = Limits(options.seconds, int(options.limit * (1 << 30)))
    if options.replay:
        return _replay(options.replay, limits)
    inputs = corpus.seeds_of_name(options.kind)
    if not inputs:
        parser.error(
            f"no such kind; there are {', '.join(sorted({given.kind for given in corpus.seeds()}))}"
        )
    count = options.count or (None if options.minutes else 10_000)
    end = time.monotonic() + 60 * options.minutes if options.minutes else float("inf")
    numbers = (
        iter(range(options.first, options.first + count))
        if count
        else itertools.count(options.first)
    )
    warm_up(inputs)
    began, outcomes, faults, slowest = time.monotonic(), Counter(), [], 0.0
    results = judged(
        numbers,
        options.seed,
        options.processes,
        lambda: time.monotonic() < end,
        inputs,
        limits=limits,
    )
    for result in results:
        given = input_of(options.seed, result.number, inputs)
        verdict = result.verdict
        checked = verdict.text.partition(" ")[0] if verdict.outcome == "read" else ""
        outcome = f"read, {checked}" if checked.endswith("verified") else verdict.outcome
        outcomes[f"{given.kind}: {outcome}"] += 1
        slowest = max(slowest, result.seconds)
        if verdict.is_fault:
            faults.append(saved_input(result, given, options))
            what = f"{given.kind} {given.case} {given.name or given.suffix}"
            print(f"{result.number} {what} {verdict.outcome}: {verdict.text}", flush=True)
    total, seconds = sum(outcomes.values()), time.monotonic() - began
    found = {
        "seed": options.seed,
        "seconds_for_an_input": limits.seconds,
        "mapped_bytes_beyond_imports": limits.address_bytes,
        "first": options.first,
        "inputs": total,
        "faults": faults,
        "seconds": round(seconds, 1),
        "inputs_per_second": round(total / seconds, 1),
        "slowest_seconds": round(slowest, 2),
        "outcomes": dict(sorted(outcomes.items())),
    }
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "result.json").write_text(
        json.dumps(found, indent=1) + "\n", encoding="utf-8"
    )
    print(
        f"{total} inputs, {len(faults)} faults, {total / seconds:.0f} a second, slowest {slowest:.1f} s"
    )
    return 1 if faults else 0


def saved_input(result: Judged, given: Input, options: argparse.Namespace) -> dict[str, object]:
    """Save an input: a file, or a folder with all files of a case."""
    name = f"{given.kind}+{given.case}+{options.seed}-{result.number}" + (
        "" if given.case else given.suffix
    )
    base = options.output / name if given.case else options.output
    for path, content in given.written().items():
        place = base / path if given.case else base / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    verdict = result.verdict
    return {
        "input": name,
        "outcome": verdict.outcome,
        "text": verdict.text,
        "seconds": round(result.seconds, 2),
    }


def replayed(path: Path) -> Input:
    """An input that was saved."""
    kind, case, _ = path.name.split("+", 2)
    if not case:
        suffixes = sorted({given.suffix for given in corpus.seeds()}, key=len, reverse=True)
        return Input(
            kind, next(s for s in suffixes if path.name.endswith(s)), "binary", path.read_bytes()
        )
    valid = [given for given in corpus.seeds() if (given.kind, given.case) == (kind, case)]
    changed = [given for given in valid if (path / given.name).read_bytes() != given.content]
    given = (changed or valid)[0]
    files = tuple((name, (path / name).read_bytes()) for name, _ in given.files)
    return given._replace(content=(path / given.name).read_bytes(), files=files)


def _replay(paths: list[Path], limits: Limits) -> int:
    inputs = tuple(replayed(path) for path in paths)
    bad = 0
    for result in judged(iter(range(len(inputs))), 0, 1, lambda: True, inputs, True, limits):
        print(
            f"{paths[result.number]}: {result.verdict.outcome} {result.verdict.text} ({result.seconds:.2f} s)"
        )
        bad += result.verdict.is_fault
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
