"""The documents: links lead somewhere, files and tests that are named exist, records have their form."""

import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import accelsurf

ROOT = Path(__file__).parents[2]
BUILT = ("_build", "examples", "generated")
PAGES = [
    *(
        ROOT / name
        for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md")
    ),
    *(ROOT / name for name in ("SECURITY.md", "CODE_OF_CONDUCT.md")),
    *(path for path in sorted((ROOT / "docs").rglob("*.md")) if not set(path.parts) & set(BUILT)),
]
RECORDS = sorted((ROOT / "docs" / "decisions").glob("[0-9]*.md"))
#: They name modules and settings of the days on which they were written.
NOTES = sorted((ROOT / "benchmarks" / "notes").glob("*.md"))
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
#: Folders that exist only after a command was run.
LEFT_BY_COMMANDS = (
    "out/",
    "liver/",
    "mended/",
    "first/",
    "both/",
    "volumes/",
    "dist/",
    "docs/_build",
    "results/",
    "benchmarks/r",
)
CODE = re.compile(r"^(`{3,}).*?^\1", re.DOTALL | re.MULTILINE)


@cache
def anchors(page):
    """The anchors of a page's headings, as GitHub and the site make them."""
    text = CODE.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ +(.*?) *$", text, re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


@cache
def code_of_tests():
    """The names of the modules of tests, and their text."""
    paths = list((ROOT / "tests").rglob("*.py"))
    return {path.name for path in paths}, "\n".join(
        path.read_text(encoding="utf-8") for path in paths
    )


@pytest.mark.parametrize("page", [*PAGES, *NOTES], ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page):
    for target, anchor in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        if target.startswith(("http:", "https:")):
            continue
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), f"{target}: there is no such file"
        if anchor:
            assert anchor in anchors(path), f"{target}#{anchor}: there is no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_and_tests_that_are_named_exist(page):
    if page.name == "CHANGELOG.md":
        return  # names what was, too
    named = re.findall(
        r"`([\w/.-]+)`", page.read_text(encoding="utf-8").replace("NNNN-title.md", "")
    )
    modules, tests = code_of_tests()
    for name in named:
        if re.fullmatch(r"test_\w+", name):
            assert f"def {name}(" in tests, name
        elif re.fullmatch(r"test_\w+\.py", name):
            assert name in modules, name
        elif re.fullmatch(r"(?:[\w-]+/)+[\w-]*(?:\.(?:py|md|toml|json))?", name):
            places = (ROOT, ROOT / "accelsurf", ROOT / "benchmarks", page.parent)
            assert any((place / name).exists() for place in places) or name.startswith(
                LEFT_BY_COMMANDS
            ), name


#: The page of the method alone, which uses its rooms: tests/docs/test_method.py says of which.
METHOD = ROOT / "docs" / "explanation" / "method.md"


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page != METHOD],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_code_of_pages_imports_public_names_alone(page):
    code = "\n".join(
        re.findall(
            r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        )
    )
    assert not re.findall(r"^ *(?:from|import) +accelsurf\..*", code, re.MULTILINE)


@pytest.mark.parametrize("record", RECORDS, ids=lambda path: path.stem)
def test_a_record_has_its_form(record):
    text = record.read_text(encoding="utf-8")
    status = r"Date: \d{4}-\d\d-\d\d\n\nStatus: (?:accepted|superseded (?:in part )?by (\d{4}))\n"
    form = re.match(rf"# {record.stem[:4]}: \S.*\n\n{status}", text)
    assert form
    assert form[1] is None or form[1] in {
        path.stem[:4] for path in RECORDS if path.stem > record.stem
    }
    headings = re.findall(r"^## (.*)$", CODE.sub("", text), re.MULTILINE)
    assert headings == ["Context", "Options", "Decision", "Consequence"]


def test_numbers_of_records_are_given_once():
    numbers = [record.stem[:4] for record in RECORDS]
    assert len(set(numbers)) == len(numbers)


def test_records_are_listed_by_their_titles():
    listed = (ROOT / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    for record in RECORDS:
        title = record.read_text(encoding="utf-8").splitlines()[0].split(": ", 1)[1]
        assert f"| [{record.stem[:4]}]({record.name}) | {title} |" in listed


def test_the_reference_lists_every_public_name():
    """ObjectsResult is another name of Result."""
    page = (ROOT / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^   (\w+)$", page, re.MULTILINE))
    assert set(accelsurf.__all__) - {"__version__", "ObjectsResult"} <= listed
    assert all(hasattr(accelsurf, name) for name in listed)


def test_a_function_of_the_name_of_its_room_stays_a_function():
    assert (
        callable(accelsurf.track)
        and import_module("accelsurf.track.track").track is accelsurf.track
    )
