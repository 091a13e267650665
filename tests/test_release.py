"""What other programs read of a release says the same everywhere: versions, requirements, licence, files."""

import json
import re
import tomllib
from pathlib import Path

import pytest

import accelsurf

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: Names on conda-forge, where they are others than on PyPI.
ON_CONDA = {"SimpleITK": "simpleitk", "Pillow": "pillow", "matplotlib": "matplotlib-base"}


def text(name):
    path = ROOT / name
    if not path.exists():
        pytest.skip(f"{name} is not here: these are not all sources")
    return path.read_text(encoding="utf-8")


def test_the_recipe_wants_what_the_package_wants():
    recipe = text("recipe/meta.yaml")
    found = re.findall(
        r"^    - (\S+) (>=\S+)$", recipe.split("  run:\n")[1].split("\ntest:")[0], re.MULTILINE
    )
    wanted = [
        re.match(r"([\w-]+)(>=[\w.]+)$", requirement).groups()
        for requirement in PROJECT["dependencies"]
    ]
    assert dict(found) == {ON_CONDA.get(name, name): least for name, least in wanted} | {
        "python": PROJECT["requires-python"]
    }
    assert (
        PROJECT["scripts"]["accelsurf"] in recipe and f'version = "{PROJECT["version"]}"' in recipe
    )


def test_version_and_licence_are_those_of_the_package():
    assert accelsurf.__version__ == PROJECT["version"]
    zenodo, citation = json.loads(text(".zenodo.json")), text("CITATION.cff")
    assert (
        zenodo["version"] == PROJECT["version"] and f"\nversion: {PROJECT['version']}\n" in citation
    )
    assert (
        zenodo["license"] == PROJECT["license"] and f"\nlicense: {PROJECT['license']}\n" in citation
    )
    assert zenodo["title"] == PROJECT["name"] and f"\ntitle: {PROJECT['name']}\n" in citation
    assert [creator["name"] for creator in zenodo["creators"]] == [
        author["name"] for author in PROJECT["authors"]
    ]


def test_the_workflow_runs_every_python_that_the_package_names():
    tested = set(
        re.findall(
            r'"(3\.\d+)"', re.search(r"python: \[(.*)\]", text(".github/workflows/test.yml"))[1]
        )
    )
    named = {
        kind.rpartition(" ")[2] for kind in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", kind)
    }
    assert named <= tested and PROJECT["requires-python"].removeprefix(">=") in tested


def test_checks_before_a_commit_are_those_of_the_tests():
    hooks, checks = text(".pre-commit-config.yaml"), text("scripts/test")
    for command in ("-m ruff check", "-m mypy", "lint-imports"):
        assert command in hooks and command in checks
