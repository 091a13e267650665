"""The tests that ``scripts/test fast`` chooses for a change."""

import subprocess

import pytest

from tests.support.touched import ROOT, changed_files, touched_tests

HOUSE = [
    "tests/test_errors.py",
    "tests/test_house.py",
    "tests/test_release.py",
    "tests/test_touched.py",
]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ([], []),
        (["accelsurf/flows/noise.py"], ["accelsurf/flows", "tests/flows"]),
        (["accelsurf/io/dicom/removed.py"], ["accelsurf/io", "tests/io"]),
        (["accelsurf/__init__.pyi"], ["tests/api"]),
        (["tests/flows/test_noise.py"], ["tests/flows/test_noise.py"]),
        (["tests/flows/test_removed.py"], []),
        # A test of a room that is touched runs with its room.
        (["tests/io/test_cells.py", "accelsurf/io/cells.py"], ["accelsurf/io", "tests/io"]),
        (["tests/viewer/conftest.py"], ["tests/viewer"]),
        (["benchmarks/scenes.py"], ["tests/benchmarks"]),
        (["docs/explanation/method.md", "README.md"], ["tests/docs/test_links.py"]),
        (["scripts/test", "pyproject.toml", "docs/conf.py", "volumes_synth/a.toml"], []),
    ],
)
def test_a_change_runs_the_tests_of_its_rooms_and_those_of_the_house(changed, expected):
    assert touched_tests(changed, ROOT) == sorted(HOUSE + expected)


def test_a_helper_of_tests_runs_those_that_use_it_directly_or_through_others(tmp_path):
    tests = {
        "support/balls.py": "RADIUS = 3\n",
        "support/scenes.py": "from tests.support import (\n    balls,\n    other,\n)\n",
        "run/test_direct.py": "def test():\n    from tests.support.balls import RADIUS\n",
        "run/test_through.py": "import pytest\nfrom tests.support.scenes import two\n",
        "run/test_without.py": "from tests.support.ballsy import RADIUS\n",
    }
    for name, text in tests.items():
        path = tmp_path / "tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = touched_tests(["tests/support/balls.py"], tmp_path)
    assert found == ["tests/run/test_direct.py", "tests/run/test_through.py"]


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Return a function that runs git in a repository with one commit on its branch ``main``."""
    for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
        monkeypatch.delenv(name, raising=False)

    def git(*words):
        user = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", *user, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init", "--initial-branch", "main")
    (tmp_path / "first.txt").write_text("1")
    git("add", "-A")
    git("commit", "-m", "first")
    return git


def test_a_change_is_what_the_branch_and_the_folder_have_beyond_main(repository, tmp_path):
    assert changed_files(tmp_path) == []
    repository("checkout", "-b", "work")
    (tmp_path / "a file, committed.txt").write_text("2")
    repository("add", "-A")
    repository("commit", "-m", "second")
    repository("checkout", "main")
    (tmp_path / "meanwhile.txt").write_text("3")
    repository("add", "-A")
    repository("commit", "-m", "third")
    repository("checkout", "work")
    (tmp_path / "new.txt").write_text("4")
    (tmp_path / "first.txt").unlink()
    assert changed_files(tmp_path) == ["a file, committed.txt", "first.txt", "new.txt"]
    assert changed_files(tmp_path, "HEAD") == ["first.txt", "new.txt"]


def test_a_commit_that_is_not_there_is_refused_in_a_line(repository, tmp_path):
    with pytest.raises(
        SystemExit, match="^error: expected .* common history with, got nothing\nhint"
    ):
        changed_files(tmp_path, "nothing")
    repository("branch", "--move", "trunk")
    with pytest.raises(SystemExit, match="^error: expected a branch called main .*\nhint"):
        changed_files(tmp_path)
