"""Choose the tests of the rooms that a change touches: what ``scripts/test fast`` runs.

    python -m tests.support.touched [COMMIT]

prints their paths. A change is what differs from the commit where the branch left ``main``, or from COMMIT; files that
are not committed count.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Names of the branch that changes go into, the first that is there.
MAIN = ("main", "origin/main")
#: What a module of the tests imports from others: ``from tests.a import b``, ``from tests.a.b import c``.
IMPORTED = re.compile(r"^\s*from tests\.([\w.]+) import (?:\(([^)]*)\)|([\w, ]*))", re.MULTILINE)
#: Tests of pages that run no command of theirs.
PAGES = "tests/docs/test_links.py"


def changed_files(root: Path, commit: str | None = None) -> list[str]:
    """Return the paths that differ from a commit, those that are not committed or not tracked included.

    Parameters
    ----------
    root
        Folder of the repository.
    commit
        By default the commit where the branch left ``main``.

    Raises
    ------
    SystemExit
        If git does not know the commit, with its message.
    """
    base = commit or next(
        (name for name in MAIN if _git(root, "rev-parse", "-q", "--verify", name)), ""
    )
    if not base:
        raise SystemExit(
            f"error: expected a branch called {' or '.join(MAIN)}, found none\n"
            "hint: name the commit to compare with: scripts/test fast COMMIT"
        )
    if not (left := _git(root, "merge-base", "HEAD", base)):
        raise SystemExit(
            f"error: expected a commit that HEAD has a common history with, got {base}\n"
            "hint: git log lists commits"
        )
    tracked = _git(root, "diff", "--name-only", "--no-renames", "-z", left[0].strip())
    return sorted({*tracked, *_git(root, "ls-files", "--others", "--exclude-standard", "-z")})


def _git(root: Path, *words: str) -> list[str]:
    """Return the lines, or names that end with a zero byte, that git prints; none where it fails."""
    found = subprocess.run(
        ["git", "-C", str(root), *words], capture_output=True, text=True, check=False
    )
    return (
        [line for line in re.split("[\0\n]", found.stdout) if line] if not found.returncode else []
    )


def touched_tests(changed: Iterable[str], root: Path) -> list[str]:
    """Return the paths of tests that a change of files may break first, none of them below another.

    A file of a room of the package stands for the tests of this room and the examples in its docstrings; a file of
    tests for itself and for the tests that import it. The tests of the whole house always belong to them.

    Parameters
    ----------
    changed
        Paths below ``root``, with ``/``; files that are not there any more are taken, too.
    root
        Folder of the repository.
    """
    importers = _importers(root)
    found = {path.relative_to(root).as_posix() for path in (root / "tests").glob("test_*.py")}
    for name in changed:
        path = Path(name)
        if len(path.parts) > 2 and path.parts[0] == "accelsurf":
            found |= {f"tests/{path.parts[1]}", f"accelsurf/{path.parts[1]}"}
        elif path.parts[0] == "accelsurf":
            found.add("tests/api")
        elif path.parts[0] == "benchmarks" and path.suffix == ".py":
            found.add("tests/benchmarks")
        elif path.name == "conftest.py" and len(path.parts) > 2:
            found.add(path.parent.as_posix())
        elif path.parts[0] == "tests" and path.suffix == ".py":
            found |= {
                test for test in _users(name, importers) if Path(test).name.startswith("test_")
            }
        elif path.suffix == ".md":
            found.add(PAGES)
    return sorted(
        name
        for name in found
        if (root / name).exists() and not any(map(found.__contains__, _folders_above(name)))
    )


def _folders_above(name: str) -> list[str]:
    return [folder.as_posix() for folder in Path(name).parents]


def _importers(root: Path) -> dict[str, set[str]]:
    """Return the files of tests that import each file of tests."""
    importers: dict[str, set[str]] = defaultdict(set)
    for path in (root / "tests").rglob("*.py"):
        for module, *names in IMPORTED.findall(path.read_text(encoding="utf-8")):
            place = "tests/" + module.replace(".", "/")
            # A name may be a module of the folder.
            for imported in (
                place,
                *(f"{place}/{name}" for name in re.findall(r"\w+", " ".join(names))),
            ):
                importers[f"{imported}.py"].add(path.relative_to(root).as_posix())
    return importers


def _users(name: str, importers: dict[str, set[str]]) -> set[str]:
    """Return a file of tests and all that import it, also through others."""
    found, new = set(), {name}
    while new:
        found |= new
        new = {user for file in new for user in importers.get(file, ())} - found
    return found


if __name__ == "__main__":
    print(*touched_tests(changed_files(ROOT, *sys.argv[1:2]), ROOT), sep="\n")
