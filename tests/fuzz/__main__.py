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
from tests.fuzz.corpus import Input, input_of
from tests.fuzz.workers import Judged, judged, warm_up


def main() -> int:
    """Judge mutated inputs and save those that are faults; the exit code is 1 when there is one."""
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description="Give mutated inputs to every reader.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, help="inputs; 10000 unless --minutes is given")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--output", type=Path, default=Path("fuzz-faults"), help="folder for faulty inputs and result.json"
    )
    parser.add_argument("--replay", type=Path, nargs="+", help="judge these saved inputs again")
    options = parser.parse_args()
    if options.replay:
        return _replay(options.replay)
    count = options.count or (None if options.minutes else 10_000)
    end = time.monotonic() + 60 * options.minutes if options.minutes else float("inf")
    numbers = iter(range(options.first, options.first + count)) if count else itertools.count(options.first)
    warm_up()
    began, outcomes, faults, slowest = time.monotonic(), Counter(), [], 0.0
    for one in judged(numbers, options.seed, options.processes, lambda: time.monotonic() < end):
        given = input_of(options.seed, one.number)
        checked = one.verdict.text.partition(" ")[0] if one.verdict.outcome == "read" else ""
        outcome = f"read, {checked}" if checked.endswith("verified") else one.verdict.outcome
        outcomes[f"{given.kind}: {outcome}"] += 1
        slowest = max(slowest, one.seconds)
        if one.verdict.is_fault:
            faults.append(_saved(one, given, options))
            print(f"{one.number} {given.kind}{given.suffix} {one.verdict.outcome}: {one.verdict.text}", flush=True)
    total, seconds = sum(outcomes.values()), time.monotonic() - began
    result = {
        "seed": options.seed,
        "first": options.first,
        "inputs": total,
        "faults": faults,
        "seconds": round(seconds, 1),
        "inputs_per_second": round(total / seconds, 1),
        "slowest_seconds": round(slowest, 2),
        "outcomes": dict(sorted(outcomes.items())),
    }
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"{total} inputs, {len(faults)} faults, {total / seconds:.0f} a second, slowest {slowest:.1f} s")
    return 1 if faults else 0


def _saved(one: Judged, given: Input, options: argparse.Namespace) -> dict[str, object]:
    options.output.mkdir(parents=True, exist_ok=True)
    name = f"{given.kind}-{options.seed}-{one.number}{given.suffix}"
    (options.output / name).write_bytes(given.content)
    return {"input": name, "outcome": one.verdict.outcome, "text": one.verdict.text, "seconds": round(one.seconds, 2)}


def _replay(paths: list[Path]) -> int:
    suffixes = sorted({one.suffix for one in corpus.seeds()}, key=len, reverse=True)
    inputs = tuple(
        Input(path.name.split("-")[0], next(s for s in suffixes if path.name.endswith(s)), "binary", path.read_bytes())
        for path in paths
    )
    bad = 0
    for one in judged(iter(range(len(inputs))), 0, 1, lambda: True, inputs):
        print(f"{paths[one.number]}: {one.verdict.outcome} {one.verdict.text} ({one.seconds:.2f} s)")
        bad += one.verdict.is_fault
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
