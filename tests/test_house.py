"""The rules of the house, read off the source: sizes, words, and tests that can fail."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "accelsurf"
MAX_MODULE_LINES, MAX_FUNCTION_LINES = 600, 90

#: Words that no identifier may have as a part: each has a standard term of the field (docs/architecture.md, "Words").
PRIVATE_WORDS = {
    *("books", "chosen", "coarsened", "contested", "feet", "fence", "fenced", "fences", "fewest", "flicker", "foot"),
    *("kept", "ledger", "remembered", "splat", "stirred", "strongest", "told", "twin", "wells"),
}
#: The same for sequences of words.
PRIVATE_NAMES = ("hold_back", "travel_dt", "asked_width", "one_slice", "of_patient", "regionsums")
#: Constants are called MAX_, MIN_ and BATCH instead.
PRIVATE_CONSTANTS = re.compile(r"^_?(MOST|LEAST)_|TOGETHER")
#: Plain English that says too little as the name of a function, method or class.
VAGUE_NAMES = {
    *("against", "begin", "carried", "carry", "cut", "drop", "everything", "facts", "hold", "keep", "lose", "momentum"),
    *("moved", "part", "parts", "prepared", "push", "reach", "refined", "rest", "resume", "row", "settle"),
    *("spread", "take"),
}
#: In kernels `to_closest` is defined once: the closest point of a cell.
KERNEL_WORDS = {"foot", "feet"}


@cache
def modules(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.py") if "__pycache__" not in path.parts)


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)))


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


def test_no_module_is_too_long():
    lengths = {path.relative_to(ROOT): len(path.read_text(encoding="utf-8").splitlines()) for path in modules(PACKAGE)}
    found = [f"{path}: {length} lines" for path, length in lengths.items() if length > MAX_MODULE_LINES]
    assert not found, listed(found)


def test_no_function_is_too_long():
    found = []
    for path in modules(PACKAGE):
        for node in functions(parsed(path)):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            length = (node.end_lineno or first) - first + 1
            if length > MAX_FUNCTION_LINES:
                found.append(f"{place(path, node, node.name)}: {length} lines")
    assert not found, listed(found)


# ------------------------------------------------------------------------------------------------------------- words


def test_identifiers_are_made_of_the_words_of_the_field():
    found = []
    for path in modules(PACKAGE):
        private = PRIVATE_WORDS - KERNEL_WORDS if "kernels" in path.parts else PRIVATE_WORDS
        for node, name in identifiers(parsed(path)):
            plain = name.lower()
            if words(name) & private or any(one in plain for one in PRIVATE_NAMES) or PRIVATE_CONSTANTS.search(name):
                found.append(place(path, node, name))
    assert not found, listed(found)


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
    [("_largest_spacing", {"largest", "spacing"}), ("HeavyBall", {"heavy", "ball"}), ("MAX_ID", {"max", "id"})],
)
def test_words_of_an_identifier(name, expected):
    assert words(name) == expected


# ------------------------------------------------------------------------------------------------- tests that can fail


def test_every_test_can_fail():
    """Each test has an assertion or expects an error, itself or through a helper of its file or of tests/support."""
    shared = {
        node.name for path in modules(ROOT / "tests" / "support") for node in functions(parsed(path)) if asserts(node)
    }
    found = []
    for path in modules(ROOT / "tests"):
        tree = parsed(path)
        helpers = shared | {
            node.name for node in functions(tree) if not node.name.startswith("test") and asserts(node)
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
