"""The benchmark of a batch: what it measures, on two tiny cases; what it says about it."""

import json
from pathlib import Path

from accelsurf import cli
from benchmarks import batch as benchmark


def test_seconds_are_per_case_and_beyond_the_call(tmp_path, monkeypatch):
    commands = []

    def run(command):
        commands.append(command[3:])
        assert (
            cli.execute(["batch", *command[4:], "--plan"]) == 0
        )  # all words are options of the command
        out = command[command.index("-o") + 1]
        Path(out).mkdir()
        (Path(out) / "batch_report.json").write_text(json.dumps({"jobs": 3}))

    monkeypatch.setattr(benchmark, "execute", run)
    found = benchmark.measure(tmp_path, 2, 12)
    assert [one["name"] for one in found["batches"]] == ["one worker", "as it chooses"]
    assert ["--jobs" in command for command in commands] == [False, True, False]
    assert found["batches"][0]["jobs"] == 3 and found["library"]["seconds"] > 0
    found["library"] |= {"seconds": 0.25, "processor_seconds": 0.2}
    found["batches"][0] |= {"seconds": 0.7, "processor_seconds": 0.45}
    assert "0.450 of the processor, 0.250 beyond the call (wanted 0.3)" in benchmark.table(found)
