"""``accelsurf batch --track``: each row is an `accelsurf track`; tables, failures, --resume, mixtures refused."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.batch import pool as pools
from accelsurf.batch import worker
from accelsurf.batch.outcome import CaseTask
from accelsurf.batch.pool import Failure
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.track.track import Tracking
from tests.support.batch_jobs import InlinePool

GRID = Geometry((1, 26, 40), (1.0, 0.5, 0.5))
FRAMES = 3
#: What differs from run to run: seconds, dates, command lines.
UNSTEADY = ("report.json", "case.json", "run.toml")


@pytest.fixture
def inline(monkeypatch):
    """Cases run in this process, one after another; the list of those that did."""
    monkeypatch.setattr(pools, "LocalPool", InlinePool)
    monkeypatch.setattr(InlinePool, "ran", [])
    return InlinePool


def frame(number: int, speed: float) -> np.ndarray:
    """A disc that travels, in a little noise."""
    y, x = np.indices(GRID.shape[1:]).astype(float)
    disc = np.clip(6.5 - np.hypot(x - 12 - speed * number, y - 13), 0, 1)
    return (100 * disc + np.random.default_rng(number).normal(0, 4, x.shape))[None].astype(
        np.float32
    )


@pytest.fixture(scope="session")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a file with time and a folder of frames, and beside it a table of both and of one that is torn."""
    folder = tmp_path_factory.mktemp("films") / "films"
    (folder / "slow").mkdir(parents=True)
    with io.SequenceWriter(
        folder / "fast.nii.gz", GRID, tuple(range(FRAMES)), "s", np.float32
    ) as writer:
        for number in range(FRAMES):
            writer.write(number, frame(number, 3.0))
            io.write(Volume(frame(number, 1.0), GRID), folder / "slow" / f"t{number}.nii.gz")
    torn = folder.parent / "torn.nii.gz"
    torn.write_bytes((folder / "fast.nii.gz").read_bytes()[:200])
    (folder.parent / "films.csv").write_text(
        "image,id,model,frame,direction,start,observer,correct\n"
        "films/fast.nii.gz,one,none,,,otsu,,\n"
        'films/slow/*.nii.gz,two,,1,both,"ball:6.5,6,0,2","1,0.5","frame=2 inside=point:7,6,0 object=1"\n'
        "torn.nii.gz,,,,,otsu,,\n"
        "films/slow,nine,,9,,otsu,,\n"
    )
    return folder


def run(*words: object) -> int:
    return cli.execute(["batch", *map(str, words), "--threads", "1", "--quiet"])


def track(*words: object) -> int:
    return cli.execute(["track", *map(str, words), "--threads", "1", "--quiet"])


def table(out: Path) -> dict[str, dict[str, str]]:
    return {row["id"]: row for row in csv.DictReader((out / "batch.csv").read_text().splitlines())}


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of a case's files that are the same from run to run."""
    paths = (
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(UNSTEADY)
    )
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.fixture(scope="session")
def done(films: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The outputs of one batch by the table, with a real worker."""
    out = tmp_path_factory.mktemp("done") / "out"
    common = ("--track", "--also", "ctc", "--max-gap", 2)
    assert run(films.parent / "films.csv", "-o", out, *common, "--jobs", 1) == 9
    return out


@pytest.mark.slow
def test_a_row_has_the_bytes_of_one_track(done: Path, films: Path, tmp_path: Path) -> None:
    shutil.copy(
        films / "fast.nii.gz", tmp_path / "one.nii.gz"
    )  # files and their titles are named by the id
    shutil.copytree(films / "slow", tmp_path / "two")
    common = ("--also", "ctc", "--max-gap", 2)
    own = {
        "one": (tmp_path / "one.nii.gz", "--model", "none", "--start", "otsu"),
        "two": (
            tmp_path / "two" / "*.nii.gz",
            "--frame",
            1,
            "--direction",
            "both",
            "--start",
            "ball:6.5,6,0,2",
            "--observer",
            "1,0.5",
            "--correct",
            "frame=2 inside=point:7,6,0 object=1",
        ),
    }
    for name, words in own.items():
        assert track(*words, *common, "-o", tmp_path / "out") == 0
        alone = {
            file: text for file, text in contents(tmp_path / "out").items() if file.startswith(name)
        }
        ends = ("labels.nii.gz", "tracks.csv", "preview.png", "RES/res_track.txt")
        assert {f"{name}_{end}" for end in ends} <= set(alone)
        assert alone == contents(done / name)
        reports = [at / f"{name}_report.json" for at in (tmp_path / "out", done / name)]
        configs = [json.loads(path.read_text())["config"] for path in reports]
        for one in configs:
            one["run"].pop("seed")  # drawn anew
        assert configs[0] == configs[1] and configs[0]["model"] == (
            "none" if name == "one" else "flowable-mass"
        )


@pytest.mark.slow
def test_the_tables_say_what_became_of_each_sequence(done: Path) -> None:
    rows = table(done)
    assert [(row["status"], row["objects"], row["frames"]) for row in rows.values()] == [
        ("ok", "1", "3"),
        ("ok", "1", "3"),
        ("failed", "", ""),
        ("failed", "", ""),
    ]
    assert "ml" not in rows["one"] and rows["one"]["reason"] == "1 end of sequence"
    report = json.loads((done / "one" / "one_report.json").read_text())
    assert float(rows["one"]["probability"]) == pytest.approx(
        report["tracks"][0]["quality_lowest"], rel=1e-3
    )
    assert float(rows["one"]["seconds"]) == sum(one["seconds"] for one in report["frames"]) > 0
    assert rows["nine"]["reason"] == "frame: frame 9 was given, expected 0 to 2"
    for name in ("torn", "nine"):  # their reports say why
        own = json.loads((done / name / f"{name}_report.json").read_text())
        assert (
            own["status"] == "failed"
            and own["error"]["message"] == rows[name]["reason"]
            and own["input"]["path"]
        )
    page = (done / "batch.html").read_text()
    assert (
        "1 object in 3 frames" in page
        and 'src="one/one_preview.png"' in page
        and "<th>ml</th>" not in page
    )
    whole = json.loads((done / "batch_report.json").read_text())
    assert (
        whole["counts"] == {"cases": 4, "ok": 2, "failed": 2, "waiting": 0}
        and whole["exit_code"] == 9
    )
    assert not [
        path
        for path in done.rglob("*")
        if path.name.startswith(".") or path.name.endswith("_frames")
    ]


def test_a_folder_of_sequences_resumes_what_is_not_finished(
    inline, films: Path, tmp_path: Path, monkeypatch
) -> None:
    out, words = tmp_path / "out", ("--track", "--start", "otsu", "--model", "none")
    step = Tracking.step

    def dies(self: Tracking):  # type: ignore[no-untyped-def]
        if self.done == 2 and self.sequence.source.endswith("slow"):
            raise ZeroDivisionError("a bug")
        return step(self)

    with monkeypatch.context() as patch:
        patch.setattr(Tracking, "step", dies)
        assert run(films, "-o", out, *words) == 9
    assert inline.ran == ["fast", "slow"] and (out / "slow" / "slow_checkpoint.npz").exists()
    assert json.loads((out / "slow" / "slow_report.json").read_text())["status"] == "failed"
    assert run(films, "-o", out, *words) == 7  # there are results
    done: list[int] = []
    with monkeypatch.context() as patch:
        patch.setattr(Tracking, "step", lambda self: (done.append(self.done), step(self))[1])
        assert run(films, "-o", out, *words, "--resume") == 0
    assert inline.ran == ["fast", "slow", "slow"] and done == [
        2
    ]  # from the state, not from the start
    assert track(films / "slow", "-o", tmp_path / "alone", *words[1:]) == 0
    assert contents(out / "slow") == contents(tmp_path / "alone")
    assert run(films, "-o", out, *words, "--resume") == 0 and len(inline.ran) == 3
    before = table(out)
    assert (
        run(films, "-o", out, *words[:-1], "last-displacement", "--resume") == 0
        and len(inline.ran) == 5
    )
    assert list(before) == list(table(out)) == ["fast", "slow"]


def test_a_case_whose_worker_is_gone_has_a_report(films: Path, tmp_path: Path) -> None:
    from accelsurf.batch.case import Case
    from accelsurf.settings.track_config import TrackConfig

    task = CaseTask(Case("slow", films / "slow"), tmp_path / "slow", TrackConfig())
    outcome = worker.lost_outcome(task, Failure("timeout", "did not end within 1 s"))
    assert (outcome.status, outcome.reason) == ("failed", "did not end within 1 s")
    report = json.loads((tmp_path / "slow" / "slow_report.json").read_text())
    assert (report["kind"], report["status"], report["error"]["message"]) == (
        "tracking",
        "failed",
        outcome.reason,
    )


def test_a_plan_reads_headers_only(inline, films: Path, tmp_path: Path, capsys) -> None:
    assert cli.execute(["batch", str(films), "--track", "--plan", "--max-memory", "4GB"]) == 0
    lines = capsys.readouterr().out.splitlines()
    values = str(FRAMES * np.prod(GRID.shape))
    assert [line.split()[:2] for line in lines[1:3]] == [
        ["fast", values],
        ["slow", values],
    ] and not inline.ran
    assert lines[-1].startswith("2 cases of a folder of sequences")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("FILMS", "--model", "none"), 2, "--model is a setting of tracking"),
        (
            ("FILMS", "--track", "--save-sdf"),
            2,
            "--save-sdf is of single images, --track was given",
        ),
        (("FILMS", "--track", "--layout", "bids"), 2, "--layout is of single images"),
        (("FILMS", "--track", "--output-layout", "bids"), 2, "--output-layout is of single images"),
        (("FILMS", "--track", "--strict"), 2, "--strict is of single images"),
        (("FILMS", "--track", "--model", "magic"), 2, "model: magic was given"),
        (("FILMS", "--config", "TOML"), 2, "track: the configuration file has a table of tracking"),
        (("TABLE0",), 3, "the column model is a setting of tracking"),
        (("TABLE1", "--track"), 3, "the column reference is of single images"),
        (("TABLE2", "--track"), 3, "the column layout is of single images"),
        (("TABLE3", "--track"), 2, "row 2: observer: 2,1 was given"),
        (
            ("TABLE4", "--track"),
            3,
            "modell: there is no such column, image, id or a setting expected",
        ),
        (("EMPTY", "--track"), 3, "no sequence in this folder"),
    ],
)
def test_mixtures_are_refused_in_a_line(
    inline, words, code, message, films: Path, tmp_path: Path, capsys
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "run.toml").write_text('[track]\nmodel = "none"\n')
    columns = ("model,none", "reference,a.nii", "layout,bids", 'observer,"2,1"', "modell,none")
    for number, text in enumerate(columns):
        name, _, value = text.partition(",")
        (tmp_path / f"{number}.csv").write_text(f"image,{name}\n{films}/fast.nii.gz,{value}\n")
    places = {"FILMS": films, "EMPTY": tmp_path / "empty", "TOML": tmp_path / "run.toml"}
    places |= {f"TABLE{number}": tmp_path / f"{number}.csv" for number in range(len(columns))}
    assert run(*(places.get(word, word) for word in words), "-o", tmp_path / "out") == code
    error, *rest = capsys.readouterr().err.splitlines()
    assert (
        error.startswith("error: ")
        and message in error
        and len(rest) == 1
        and rest[0].startswith("hint: ")
    )
    assert not (tmp_path / "out").exists() and not inline.ran


def test_files_of_a_table_are_looked_for_in_its_folder(tmp_path: Path) -> None:
    from accelsurf.batch.case_table import read_cases

    (tmp_path / "t.csv").write_text(
        'image,correct,channel\nfilm,"frame=1 new=2 inside=label:a.nii@2 outside=point:1,2,3; frame=2 remove=1",b.nii\n'
    )
    (case,) = read_cases(tmp_path / "t.csv", tracking=True)
    assert (case.id, case.settings["channel"]) == ("film", (str(tmp_path / "b.nii"),))
    assert case.settings["correct"] == (
        f"frame=1 new=2 inside=label:{tmp_path}/a.nii@2 outside=point:1,2,3",
        "frame=2 remove=1",
    )
