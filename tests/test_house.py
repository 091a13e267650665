"""The rules of the house, read off the source: words, rules, and tests that can fail."""

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support import house

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "accelsurf"

#: Rules of the house (``scripts/house``) and how many places may break each. Sizes have no limit: a
#: limit of lines packs them.
LIMITS = {
    "imports past a room's door": 0,
    "parameters that are unnamed tuples": 0,
    "summaries without a verb or noun first": 0,
    "code named by strings": 1,  # cyclopts imports a command that is named so when it is called
    "variables called one, own": 0,
    "small modules with one user": 5,
    "circles at run time": 0,
    "circles, types counted": 0,
    "public names in more than three modules": 3,
}
#: Attributes that are set from outside of their class, as ``path attribute``, each with the reason.
FROM_OUTSIDE = {
    "accelsurf/cases/interrupts.py warnings.showwarning": "the hook of Python's library for warnings",
    "accelsurf/cases/interrupts.py again.daemon": "threading.Timer takes no such argument",
    "accelsurf/io/dicom/pixels.py meta.TransferSyntaxUID": "pydicom's way to write an element",
    "accelsurf/io/dicom/pixels.py dataset.file_meta": "pydicom's way to write an element",
    "accelsurf/io/dicom/writing_tools.py element.value": "pydicom's way to write an element",
    "accelsurf/io/formats/surface_files.py logger.disabled": "the switch of Python's library for loggers",
    "accelsurf/io/formats/tiff.py page.compression": "tifffile unpacks by this field of its page",
    "accelsurf/napari/widget.py layer.selected_label": "napari's way to select a label",
}

#: Words of the *not* column of record 0001, in identifiers of package, benchmarks and tests, and the term instead.
REPLACED = {
    **dict.fromkeys(("foot", "feet"), "closest point"),
    **dict.fromkeys(("settle", "settles", "settled"), "redistance"),
    **dict.fromkeys(("books", "ledger"), "energy budget, history"),
    **dict.fromkeys(("remembered", "resumed_state"), "checkpoint, state"),
    **dict.fromkeys(("rests", "rested"), "plateau"),
    **dict.fromkeys(("push", "pushed"), "add_velocity, impulse"),
    **dict.fromkeys(("coarsened", "refined", "carried"), "restrict, prolong, transfer"),
    **dict.fromkeys(("fence", "fences", "fenced", "contest", "contested", "against"), "constraint"),
    "everything": "the whole, moments of a region",
    **dict.fromkeys(("chosen", "wish", "facts"), "resolved settings, requested options"),
    **dict.fromkeys(("proposal", "proposals"), "size hypothesis"),
    "sureness": "confidence",
    **dict.fromkeys(("doubt", "doubts"), "uncertain location, warning"),
    **dict.fromkeys(("surprise", "surprises"), "disagreement"),
    **dict.fromkeys(("heard", "disowned", "contradicting"), "active, rejected, inconsistent"),
    **dict.fromkeys(("tissue", "tissues"), "local appearance, homogeneous region"),
    **dict.fromkeys(("draft", "drafts"), "staging files"),
    **dict.fromkeys(("workplace", "finger", "fingers", "wheel"), "actions, touch, scroll"),
}
#: Words of that column that are standard, or plain, in another sense. As the whole name of a function, method or class
#: most of them are refused below (`VAGUE_NAMES`).
OTHER_SENSE = {
    "row": "of a table, an image or a band",
    "part": "of a file, an image or a surface",
    "cut": "graph cut; an object that a border cuts",
    "spread": "of values, in statistics",
    "hold": "what a container or a file has; the option --hold of movies",
    "keep": "the mask of what stays; the option --keep-state",
    "resume": "the option --resume",
    "rest": "the remainder; a velocity of 0; the option --stop-at-rest",
    "reach": "how far a click acts, mm",
    "begin": "where bytes, a box or a run begins",
    "take": "numpy's word for a choice of rows",
    "change": "a difference of numbers; an entry of the viewer's list of changes",
    "edit": "of a run in its course, the option --edit",
    "refinement": "a correction of a finished run, as the setting refine names it",
    "stroke": "the line that a person draws, not its effect",
    "answer": "another object that a first click may mean, as options and reports name it",
    "claim": "what a header says before it is checked; a request of the viewers' protocol",
    "even": "of numbers",
    "quiet": "the option --quiet",
    "learned": "of an appearance: only a 'learned answer' is a score",
    "mixed": "of derivatives: only a 'mixed answer' is a score",
}
#: Identifiers with a replaced word that stay, each with the reason.
STANDARD_NAMES = {
    "SOFT_TISSUE": "a grey window of CT",
    "_TISSUE": "a code of SNOMED",
    "Tissue": "kinds of the phantoms of tissue",
    "TissuePhantom": "kinds of the phantoms of tissue",
    "TissueRecipe": "kinds of the phantoms of tissue",
    "_TISSUES": "kinds of the phantoms of tissue",
    "tissue": "a key of recipes, and the share of soft tissue in a scan",
}
#: Words of the column that are plain English in docstrings and comments.
PLAIN_IN_PROSE = {
    *(
        "against",
        "carried",
        "everything",
        "push",
        "pushed",
        "tissue",
        "tissues",
        "refined",
        "rests",
    ),
}
#: Words that no identifier of the package may have as a part: each has a standard term of the field.
PRIVATE_WORDS = {
    *("fewest", "fingers", "flicker", "kept", "splat", "stirred", "strongest", "told", "twin"),
    *("wells", "wish", "won"),
}
#: The same for sequences of words.
PRIVATE_NAMES = (
    *("hold_back", "travel_dt", "asked_width", "one_slice", "of_patient", "regionsums"),
    *("learned_answer", "mixed_answer", "half_width_of_click", "going_on"),
)
#: Constants are called MAX_, MIN_ and BATCH instead.
PRIVATE_CONSTANTS = re.compile(r"^_?(MOST|LEAST)_|TOGETHER")
#: Plain English that says too little as the name of a function, method or class.
VAGUE_NAMES = {
    *(
        "against",
        "begin",
        "carried",
        "carry",
        "cut",
        "drop",
        "everything",
        "facts",
        "hold",
        "keep",
        "lose",
        "momentum",
    ),
    *(
        "moved",
        "part",
        "parts",
        "prepared",
        "push",
        "reach",
        "refined",
        "rest",
        "resume",
        "row",
        "settle",
    ),
    *("spread", "take"),
}


@cache
def modules(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.py") if "__pycache__" not in path.parts)


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (
        node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    )


def listed(found: list[str]) -> str:
    return "\n".join(["", *found])


def place(path: Path, node: ast.AST, name: str) -> str:
    return f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)} {name}"


def definitions(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """Functions, methods and classes."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node, node.name


def identifiers(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """Everything that is given a name: definitions, parameters, attributes, variables, constants."""
    yield from definitions(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            yield node, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node, node.attr


@cache
def words(name: str) -> set[str]:
    """The words of an identifier, lower case.

    Examples: ``_largest_spacing`` -> largest, spacing; ``HeavyBall`` -> heavy, ball.
    """
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def asserts(node: ast.AST, helpers: frozenset[str] | set[str] = frozenset()) -> bool:
    """Whether something in a function can fail: an assertion, an expected error, or a helper that has one."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Assert):
            return True
        if isinstance(inner, ast.Call):
            called = inner.func
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if name.startswith("assert") or name in {"raises", "warns", "fail"} | helpers:
                return True
    return False


def always_true(test: ast.expr) -> bool:
    if isinstance(test, (ast.Tuple, ast.Constant)):
        return True
    return (
        isinstance(test, ast.BoolOp)
        and isinstance(test.op, ast.Or)
        and any(isinstance(value, ast.Constant) and value.value for value in test.values)
    )


# ------------------------------------------------------------------------------------------------------------- sizes


def test_the_top_of_the_package_has_four_files():
    names = ["__init__.py", "__main__.py", "errors.py", "version.py"]
    assert sorted(path.name for path in PACKAGE.glob("*.py")) == names


@pytest.fixture(scope="module")
def figures():
    return house.figures()


@pytest.mark.parametrize("name", LIMITS)
def test_no_more_places_break_a_rule(figures, name):
    found = figures[name]
    assert (found if isinstance(found, int) else len(found)) <= LIMITS[name], listed(
        [name, str(found)] if isinstance(found, int) else [name, *found]
    )


ROOMS_WITH_DOORS = sorted(stub.parent.name for stub in PACKAGE.glob("*/__init__.pyi"))


@pytest.mark.parametrize("room", ROOMS_WITH_DOORS)
def test_a_door_offers_names_that_exist_and_say_what_they_are(room):
    package = importlib.import_module(f"accelsurf.{room}")
    assert sorted(package.__all__) == sorted(house.door(room))
    named = {name: getattr(package, name) for name in package.__all__}
    silent = [
        name
        for name, thing in named.items()
        if inspect.isroutine(thing) or inspect.isclass(thing)
        if not inspect.getdoc(thing)
    ]
    assert not silent, listed(silent)


def test_a_door_offers_no_name_that_no_other_room_uses():
    users = [
        *(
            path
            for folder in ("benchmarks", "docs", "tests")
            for path in (ROOT / folder).rglob("*")
        ),
        *PACKAGE.rglob("*.py*"),
    ]
    texts = {
        path: path.read_text()
        for path in users
        if path.suffix in (".py", ".pyi", ".md", ".rst", ".ipynb") and "_build" not in path.parts
    }
    unused = []
    for room in ROOMS_WITH_DOORS:
        outside = " ".join(
            text
            for path, text in texts.items()
            if path.parts[: len(PACKAGE.parts) + 1] != (*PACKAGE.parts, room)
        )
        used = set(re.findall(r"\w+", outside))
        unused += [f"{room}.{name}" for name in house.door(room) if name not in used]
    assert not unused, listed(unused)


def without_line(place: str) -> str:
    path, _, rest = place.partition(":")
    return f"{path} {rest.split(' ', 1)[1]}"


def test_an_attribute_that_is_set_from_outside_has_a_reason(figures):
    places = {without_line(place): place for place in figures["attributes set from outside"]}
    assert not places.keys() - FROM_OUTSIDE.keys(), listed(
        [places[key] for key in places.keys() - FROM_OUTSIDE.keys()]
    )
    assert not FROM_OUTSIDE.keys() - places.keys(), listed(
        sorted(FROM_OUTSIDE.keys() - places.keys())
    )


# ------------------------------------------------------------------------------------------------------------- words


def test_identifiers_are_made_of_the_words_of_the_field():
    found = []
    for path in modules(PACKAGE):
        for node, name in identifiers(parsed(path)):
            plain = name.lower()
            if (
                words(name) & PRIVATE_WORDS
                or any(one in plain for one in PRIVATE_NAMES)
                or PRIVATE_CONSTANTS.search(name)
            ):
                found.append(place(path, node, name))
    assert not found, listed(found)


@pytest.mark.parametrize("folder", ["accelsurf", "benchmarks", "tests"])
def test_no_identifier_has_a_word_that_record_0001_replaces(folder):
    used = set()
    found = []
    for path in modules(ROOT / folder):
        for node, name in identifiers(parsed(path)):
            if name.startswith("test_"):
                continue  # a sentence
            replaced = words(name) & REPLACED.keys()
            used |= {name} if replaced else set()
            if replaced and name not in STANDARD_NAMES:
                terms = ", ".join(REPLACED[word] for word in sorted(replaced))
                found.append(f"{place(path, node, name)}: {terms}")
    assert not found, listed(found)
    if folder == "accelsurf":
        assert used == STANDARD_NAMES.keys()  # an exception that nothing needs goes


def test_no_docstring_or_comment_has_a_word_that_record_0001_replaces():
    refused = REPLACED.keys() - PLAIN_IN_PROSE
    found = [
        f"{name}: {word}"
        for name, module in house.modules().items()
        for word in sorted(set(re.findall(r"[a-z]+", house.prose(module))) & refused)
    ]
    assert not found, listed(found)


def test_each_word_that_record_0001_replaces_is_refused_or_has_a_reason():
    """A word that is added to the record's table is added here."""
    record = (ROOT / "docs" / "decisions" / "0001-rooms-and-words.md").read_text(encoding="utf-8")
    column = [line.split("|")[2] for line in record.splitlines() if line.startswith("| ")][1:]
    single = {
        word
        for cell in column
        for word in re.findall(r"(?:^|,|;) *([a-z]+)(?= *(?:,|;|$))", cell.strip())
    }
    known = REPLACED.keys() | OTHER_SENSE.keys()
    assert len(single) > 30 and not {word.rstrip("s") for word in single} - {
        word.rstrip("s") for word in known
    }


def test_functions_and_classes_have_names_that_say_what_they_do():
    found = [
        place(path, node, name)
        for path in modules(PACKAGE)
        for node, name in definitions(parsed(path))
        if name.strip("_").lower() in VAGUE_NAMES
    ]
    assert not found, listed(found)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("_largest_spacing", {"largest", "spacing"}),
        ("HeavyBall", {"heavy", "ball"}),
        ("MAX_ID", {"max", "id"}),
    ],
)
def test_words_of_an_identifier(name, expected):
    assert words(name) == expected


# ------------------------------------------------------------------------------------------------- tests that can fail


def test_every_test_can_fail():
    """Each test has an assertion or expects an error, itself or through a helper of its file or of tests/support."""
    shared = {
        node.name
        for path in modules(ROOT / "tests" / "support")
        for node in functions(parsed(path))
        if asserts(node)
    }
    found = []
    for path in modules(ROOT / "tests"):
        tree = parsed(path)
        helpers = shared | {
            node.name
            for node in functions(tree)
            if not node.name.startswith("test") and asserts(node)
        }
        found += [
            place(path, node, node.name)
            for node in functions(tree)
            if node.name.startswith("test") and not asserts(node, helpers)
        ]
        found += [
            place(path, node, "is always true")
            for node in ast.walk(tree)
            if isinstance(node, ast.Assert) and always_true(node.test)
        ]
    assert not found, listed(found)
