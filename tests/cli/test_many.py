"""segment_many(), and batches on a cluster: the same files as one case after another."""

import json
import os
import signal
import threading
import time

import pytest
from distributed import LocalCluster

import accelsurf
from accelsurf import cli
from accelsurf.errors import OutputError, UsageError
from tests.cli.test_batch import contents, done, image, inline, report, scans, table  # noqa: F401 (fixtures)
from tests.support.batch_jobs import InlinePool

START = {"start": "ball:0,0,0,4", "threads": 1}
WORDS = ("--start", "ball:0,0,0,4", "--threads", "1")


def test_each_case_is_a_future(inline, scans, tmp_path):  # noqa: F811
    with accelsurf.segment_many(scans, tmp_path / "out", **START) as many:
        assert list(many) == ["a", "b", "c"] and len(many) == 3
        lines = many.outcomes()
    assert all(line.status == "ok" and line.ml > 0 for line in lines.values())
    assert table(tmp_path / "out")["b"]["status"] == "ok"
    with pytest.raises(OutputError, match="exists already"):
        accelsurf.segment_many(scans, tmp_path / "out", **START)
    InlinePool.ran.clear()
    with accelsurf.segment_many(scans, tmp_path / "out", resume=True, **START) as again:
        assert again.outcomes() == lines
    assert InlinePool.ran == []


def test_a_list_of_cases_with_settings_of_their_own(inline, scans, tmp_path):  # noqa: F811
    truth = scans.parent / "truth" / "b.nii.gz"
    cases = [
        scans / "a.nii.gz",
        {"image": scans / "b.nii.gz", "id": "second", "reference": truth, "smoothness": 0.5},
        {"image": scans / "absent.nii.gz"},
    ]
    with accelsurf.segment_many(cases, tmp_path / "out", **START) as many:
        lines = many.outcomes()
    assert [line.status for line in lines.values()] == ["ok", "ok", "failed"]
    assert lines["second"].dice > 0.9 and "absent.nii.gz" in lines["absent"].reason
    written = json.loads((tmp_path / "out" / "second" / "second_report.json").read_text())
    assert written["config"]["smoothness"] == 0.5


@pytest.mark.parametrize(
    ("cases", "named"),
    [
        ([{"id": "a"}], "case 0 has no image"),
        ([{"image": "a.nii", "smothness": 1}], "case 0: smothness"),
        ([{"image": "a.nii"}, {"image": "b/a.nii"}], "given 2 times"),
    ],
)
def test_cases_that_are_none(cases, named, tmp_path):
    with pytest.raises(accelsurf.AccelsurfError, match=named):
        accelsurf.segment_many(cases, tmp_path)


def test_leaving_early_keeps_what_is_finished(scans, tmp_path):  # noqa: F811
    """With a real worker: the second case hangs, as its image never comes."""
    hanging = tmp_path / "scans"
    hanging.mkdir()
    (hanging / "a.nii.gz").symlink_to(scans / "a.nii.gz")
    os.mkfifo(hanging / "b.nii.gz")
    with (
        pytest.raises(KeyboardInterrupt),
        accelsurf.segment_many(hanging, tmp_path / "out", jobs=1, **START) as many,
    ):
        assert many["a"].result(timeout=120).status == "ok"
        raise KeyboardInterrupt
    assert many["b"].cancelled()
    assert (
        report(tmp_path / "out")["status"] == "interrupted"
        and table(tmp_path / "out")["a"]["status"] == "ok"
    )


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_leaves_the_same_files(done, scans, tmp_path):  # noqa: F811
    made = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True)
    with made as cluster:

        def kill():
            while not list(tmp_path.glob("out/*/.*")):
                time.sleep(0.01)
            os.kill(next(iter(cluster.workers.values())).process.pid, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        words = ("batch", str(scans.parent / "cases.csv"), "-o", str(tmp_path / "out"), *WORDS)
        assert cli.execute([*words, "--scheduler", cluster.scheduler_address, "--quiet"]) == 0
        killer.join()
    for name in ("case-a", "case-b", "case-c"):
        assert contents(tmp_path / "out" / name) == contents(done / name)


def test_what_a_cluster_decides_is_refused(scans, tmp_path, capsys):  # noqa: F811
    for words in (("--jobs", "2"), ("--case-timeout", "5"), ("--max-memory", "1GB")):
        assert (
            cli.execute(
                ["batch", str(scans), "-o", str(tmp_path), "--scheduler", "tcp://x:1", *words]
            )
            == 2
        )
        assert f"{words[0]}: was given with --scheduler" in capsys.readouterr().err
    with pytest.raises(UsageError, match="--jobs"):
        accelsurf.segment_many(scans, tmp_path, scheduler="tcp://x:1", jobs=2)
