"""Figures of the house: how large the package is, how its rooms hang together, how it speaks.

``scripts/house`` prints them; ``tests/test_house.py`` has the limits.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "accelsurf"
#: A summary begins with a verb or with the noun of what is returned, not with one of these.
NO_FIRST_WORDS = re.compile(r"(What|Whether|How|So|Such|Of|By|Where|Those|That|Which|Who|As)\b")
#: Names that say nothing of what they name.
NO_NAMES = {"one", "own"}
#: A module below this size with one user belongs into its user.
SMALL_MODULE = 70
MAX_MODULE_LINES, MAX_FUNCTION_LINES = 600, 90
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(slots=True)
class Module:
    """A module of the package: its source, and the modules that it imports."""

    name: str
    path: Path
    text: str
    tree: ast.Module
    #: Lines with code: no docstring, no comment, no blank.
    code: int = 0
    imports: set[str] = field(default_factory=set)
    #: Imports for type checkers alone.
    type_imports: set[str] = field(default_factory=set)

    @property
    def in_kernels(self) -> bool:
        return "kernels" in self.path.parts

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"

    def place(self, node: ast.AST, text: str) -> str:
        return f"{self.path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)} {text}"


def code_lines(text: str, tree: ast.Module) -> int:
    """Count the lines with code."""
    docstrings = set()
    for node in ast.walk(tree):
        documented = isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS))
        if documented and ast.get_docstring(node, clean=False) is not None:
            docstrings |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    no_code = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in no_code
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - docstrings)


def modules() -> dict[str, Module]:
    """Read all modules of the package, by name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        found[name] = Module(name, path, text, tree, code_lines(text, tree))
    for module in found.values():
        for_types = {
            id(inner)
            for block in ast.walk(module.tree)
            if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
            for inner in ast.walk(block)
        }
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    full = f"{node.module}.{alias.name}"
                    target = full if full in found else node.module
                    if target in found and target != module.name:
                        (module.type_imports if id(node) in for_types else module.imports).add(
                            target
                        )
    return found


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Find the sets of more than one module that import each other, by Tarjan's algorithm."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    open_modules: set[str] = set()
    found = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        open_modules.add(module)
        for other in sorted(edges.get(module, ())):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in open_modules:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            part: list[str] = []
            while not part or part[-1] != module:
                part.append(stack.pop())
                open_modules.discard(part[-1])
            if len(part) > 1:
                found.append(sorted(part))

    before = sys.getrecursionlimit()
    sys.setrecursionlimit(20_000)
    try:
        for module in edges:
            if module not in index:
                visit(module)
    finally:
        sys.setrecursionlimit(before)
    return found


# --------------------------------------------------------------------------------------------- figures, with places


def long_modules(module: Module) -> Iterator[str]:
    """Yield a module with more than `MAX_MODULE_LINES` lines."""
    lines = len(module.text.splitlines())
    if lines > MAX_MODULE_LINES:
        yield module.place(module.tree, f"{lines} lines")


def long_functions(module: Module) -> Iterator[str]:
    """Yield functions with more than `MAX_FUNCTION_LINES` lines."""
    for node in ast.walk(module.tree):
        if isinstance(node, FUNCTIONS):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            lines = (node.end_lineno or first) - first + 1
            if lines > MAX_FUNCTION_LINES:
                yield module.place(node, f"{node.name} {lines} lines")


def unnamed_tuples(module: Module) -> Iterator[str]:
    """Yield parameters that are tuples of unlike things without names."""
    for node in ast.walk(module.tree):
        if not isinstance(node, FUNCTIONS):
            continue
        for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs):
            note = ast.unparse(argument.annotation) if argument.annotation else ""
            if (
                re.match(r"['\"]?tuple\[", note)
                and "..." not in note
                and re.search(r"[A-Z]\w+|None|bool", note)
            ):
                yield module.place(node, f"{node.name}({argument.arg}: {note})")


def attributes_from_outside(module: Module) -> Iterator[str]:
    """Yield attributes that are set on an object other than `self`."""
    if module.in_kernels or "viewer" in module.path.parts:
        return
    for node in ast.walk(module.tree):
        if not isinstance(node, (ast.Assign, ast.AugAssign)):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        for target in targets:
            for inner in target.elts if isinstance(target, ast.Tuple) else [target]:
                if (
                    isinstance(inner, ast.Attribute)
                    and isinstance(inner.value, (ast.Name, ast.Attribute))
                    and not ast.unparse(inner.value).startswith(("self", "cls", "np", "os", "sys"))
                ):
                    yield module.place(node, ast.unparse(inner))


def summaries_without_verb_or_noun(module: Module) -> Iterator[str]:
    """Yield docstrings whose first word is one of `NO_FIRST_WORDS`."""
    for node in ast.walk(module.tree):
        if isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS)):
            summary = (ast.get_docstring(node) or "").strip()
            if NO_FIRST_WORDS.match(summary):
                yield module.place(node, summary.splitlines()[0])


def empty_names(module: Module) -> Iterator[str]:
    """Yield variables and parameters whose name is one of `NO_NAMES`."""
    for node in ast.walk(module.tree):
        name = (
            node.id if isinstance(node, ast.Name) else node.arg if isinstance(node, ast.arg) else ""
        )
        if name in NO_NAMES:
            yield module.place(node, name)


def small_modules_with_one_user(package: dict[str, Module]) -> list[str]:
    """List the small modules that only one module of the same folder imports."""
    users = defaultdict(set)
    for module in package.values():
        for target in module.imports | module.type_imports:
            users[target].add(module.name)
    return [
        str(module.path.relative_to(ROOT))
        for module in package.values()
        if not module.is_package
        and module.code <= SMALL_MODULE
        and len(users[module.name]) == 1
        and package[next(iter(users[module.name]))].path.parent == module.path.parent
    ]


def names_in_many_modules(package: dict[str, Module]) -> list[str]:
    """List the public functions whose name stands in more than three modules."""
    homes = Counter(
        node.name
        for module in package.values()
        if not module.in_kernels
        for node in module.tree.body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
    )
    return [f"{name} x{count}" for name, count in sorted(homes.items()) if count > 3]


PER_MODULE = {
    "modules above 600 lines": long_modules,
    "functions above 90 lines": long_functions,
    "parameters that are unnamed tuples": unnamed_tuples,
    "attributes set from outside": attributes_from_outside,
    "summaries without a verb or noun first": summaries_without_verb_or_noun,
    "variables called one, own": empty_names,
}


def figures() -> dict[str, int | list[str]]:
    """Count everything: numbers, and lists of places."""
    package = modules()
    folders = Counter(
        str(m.path.parent.relative_to(ROOT)) for m in package.values() if not m.is_package
    )
    return {
        "modules": sum(folders.values()),
        "code lines": sum(module.code for module in package.values()),
        "files of the largest folder": max(folders.values()),
        **{
            name: [place for m in package.values() for place in found(m)]
            for name, found in PER_MODULE.items()
        },
        "small modules with one user": small_modules_with_one_user(package),
        "circles at run time": [
            " ".join(c) for c in circles({m.name: m.imports for m in package.values()})
        ],
        "circles, types counted": [
            " ".join(c)
            for c in circles({m.name: m.imports | m.type_imports for m in package.values()})
        ],
        "public names in more than three modules": names_in_many_modules(package),
    }


def main() -> None:
    with_places = "--list" in sys.argv
    for name, value in figures().items():
        print(f"{name:45s} {value if isinstance(value, int) else len(value)}")
        if with_places and isinstance(value, list):
            print("".join(f"    {place}\n" for place in value), end="")


if __name__ == "__main__":
    main()
