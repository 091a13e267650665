"""Figures of the house: how large the package is, how its rooms hang together, how it speaks.

``scripts/house`` prints them and forbids nothing; ``tests/test_house.py`` has the rules that hold. Size is counted in
statements and tokens, which no packing of lines changes.
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
#: More parameters are a class that has no name yet.
MAX_PARAMETERS = 8
#: Tuples of more targets than that are rows of a table, or packed lines.
MAX_TARGETS, MAX_COMPREHENSION = 2, 100
#: Words that avoid a noun, counted in 10,000 words of docstrings and comments.
EMPTY_WORDS = ("what", "those of", "so many", "such")
#: Code that is named by a string: ``package.module:function``, also as the end of an f-string.
CODE_NAME = re.compile(r"[a-z_]\w*(\.[a-z_]\w*)+:[A-Za-z_]\w*")
CODE_NAME_END = re.compile(r"(\.\w+)*:[A-Za-z_]\w*$")
#: A name that a module or class keeps to itself; not those of Python's protocols, as ``_repr_html_``.
PRIVATE_NAME = re.compile(r"_[A-Za-z]\w*(?<!_)")
#: Names of every named tuple, which Python documents.
TUPLE_NAMES = {"_asdict", "_fields", "_make", "_replace"}
#: Rooms that are libraries of all others: their modules may be imported. Every other room has a door, its ``__init__``.
SHARED_ROOMS = {"kernels", "grid", "image", "settings", "text", "phantoms"}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
#: Tokens that are no code.
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


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
        return "kernels" in self.path.relative_to(PACKAGE).parts

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"

    def place(self, node: ast.AST, text: str) -> str:
        return f"{self.path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)} {text}"


def code_lines(text: str, tree: ast.Module) -> int:
    """Count the lines with code."""
    docstrings = set()
    for node in ast.walk(tree):
        documented = isinstance(node, DOCUMENTED)
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


def tokens(module: Module) -> list[tokenize.TokenInfo]:
    """Split a module into tokens."""
    return list(tokenize.generate_tokens(io.StringIO(module.text).readline))


def statements(module: Module) -> int:
    """Count the statements of a module but for its docstrings."""
    docstrings = {
        id(node.body[0])
        for node in ast.walk(module.tree)
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, False) is not None
    }
    return sum(
        isinstance(node, ast.stmt) and id(node) not in docstrings for node in ast.walk(module.tree)
    )


def prose(module: Module) -> str:
    """Return the docstrings and comments of a module in lower case."""
    docstrings = [
        ast.get_docstring(node) or ""
        for node in ast.walk(module.tree)
        if isinstance(node, DOCUMENTED)
    ]
    comments = [token.string for token in tokens(module) if token.type == tokenize.COMMENT]
    return " ".join([*docstrings, *comments]).lower()


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


def long_signatures(module: Module) -> Iterator[str]:
    """Yield functions with more than `MAX_PARAMETERS` parameters; kernels have theirs from the formulas."""
    if module.in_kernels:
        return
    for node in ast.walk(module.tree):
        if isinstance(node, FUNCTIONS):
            every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            count = sum(argument.arg not in ("self", "cls") for argument in every)
            if count > MAX_PARAMETERS:
                yield module.place(node, f"{node.name} {count}")


def long_lines(module: Module) -> Iterator[str]:
    """Yield lines of more than 100 characters."""
    for number, line in enumerate(module.text.splitlines(), start=1):
        if len(line) > 100:
            yield f"{module.path.relative_to(ROOT)}:{number}"


def wide_assignments(module: Module) -> Iterator[str]:
    """Yield assignments with more than `MAX_TARGETS` targets in a tuple."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Assign) and any(
            isinstance(target, ast.Tuple) and len(target.elts) > MAX_TARGETS
            for target in node.targets
        ):
            yield module.place(node, ast.unparse(node)[:80])


def long_comprehensions(module: Module) -> Iterator[str]:
    """Yield comprehensions of more than `MAX_COMPREHENSION` characters."""
    for node in ast.walk(module.tree):
        if isinstance(node, COMPREHENSIONS) and len(ast.unparse(node)) > MAX_COMPREHENSION:
            yield module.place(node, ast.unparse(node)[:80])


def code_named_by_strings(module: Module) -> Iterator[str]:
    """Yield strings, f-strings too, that name a function or class of a module."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if CODE_NAME.fullmatch(node.value):
                yield module.place(node, node.value)
        elif isinstance(node, ast.JoinedStr):
            parts = [part.value for part in node.values if isinstance(part, ast.Constant)]
            if any(CODE_NAME_END.match(str(part)) for part in parts):
                yield module.place(node, ast.unparse(node))


def imported_names(node: ast.AST) -> Iterator[str]:
    """Yield the dotted names that an import loads, as ``accelsurf.io.read``."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.level == 0:
        yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imports_past_a_door(module: Module) -> Iterator[str]:
    """Yield imports of another room's module: a room is entered by its ``__init__``, that says what it offers.

    A stub alone (``.pyi``) has types and no code: it may be imported.
    """
    home = module.path.relative_to(PACKAGE).parts[0]
    for node in ast.walk(module.tree):
        for name in imported_names(node):
            package, *path = name.split(".")
            if package != PACKAGE.name or len(path) < 2 or path[0] in SHARED_ROOMS | {home}:
                continue
            room, *inner = path
            folder = PACKAGE / room
            deep = len(inner) > 1 and not folder.joinpath(*inner[:-1]).with_suffix(".pyi").is_file()
            is_module = folder.joinpath(*inner).with_suffix(".py").is_file()
            if folder.is_dir() and (deep or (is_module and inner[0] not in door(room))):
                yield module.place(node, name)


def door(room: str) -> dict[str, str]:
    """Return the names that a room offers, each with its module within the room."""
    stub = PACKAGE / room / "__init__.pyi"
    if not stub.is_file():
        return {}
    imports = [
        node for node in ast.parse(stub.read_text()).body if isinstance(node, ast.ImportFrom)
    ]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


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
    if module.in_kernels or "viewer" in module.path.relative_to(PACKAGE).parts:
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
        if isinstance(node, DOCUMENTED):
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
    """List the small modules that only one module of the same folder imports, and no other room by the door."""
    users = defaultdict(set)
    for module in package.values():
        for target in module.imports | module.type_imports:
            users[target].add(module.name)
    offered = {
        f"{PACKAGE.name}.{stub.parent.name}.{inner}"
        for stub in PACKAGE.glob("*/__init__.pyi")
        for inner in door(stub.parent.name).values()
    }
    return [
        str(module.path.relative_to(ROOT))
        for module in package.values()
        if not module.is_package
        and module.name not in offered
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


def private_names_in_tests(package: dict[str, Module]) -> list[str]:
    """List the places where tests use a name that the package keeps to itself."""
    private = {
        name
        for module in package.values()
        for node in ast.walk(module.tree)
        if PRIVATE_NAME.fullmatch(name := _defined(node))
    } - TUPLE_NAMES
    return [
        f"{path.relative_to(ROOT)}:{node.lineno} {name}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in sorted(private & _used(node))
    ]


def _defined(node: ast.AST) -> str:
    """Return the name that a node gives to something, or an empty text."""
    if isinstance(node, (*FUNCTIONS, ast.ClassDef)):
        return node.name
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return node.id
    return node.attr if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) else ""


def _used(node: ast.AST) -> set[str]:
    """Return the names that a node takes of a module or an object other than `self`, or replaces there."""
    if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("accelsurf"):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.Attribute) and ast.unparse(node.value) != "self":
        return {node.attr}
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(".setattr"):
        return {given.value for given in node.args if isinstance(given, ast.Constant)}
    return set()


PER_MODULE = {
    "modules above 600 lines": long_modules,
    "functions above 90 lines": long_functions,
    "lines above 100 characters": long_lines,
    "assignments of three targets and more": wide_assignments,
    "comprehensions above 100 characters": long_comprehensions,
    "functions with more than 8 parameters": long_signatures,
    "code named by strings": code_named_by_strings,
    "imports past a room's door": imports_past_a_door,
    "parameters that are unnamed tuples": unnamed_tuples,
    "attributes set from outside": attributes_from_outside,
    "summaries without a verb or noun first": summaries_without_verb_or_noun,
    "variables called one, own": empty_names,
}


def words(package: dict[str, Module]) -> dict[str, float]:
    """Return how often each of `EMPTY_WORDS` stands in 10,000 words of prose."""
    text = " ".join(prose(module) for module in package.values())
    total = max(len(re.findall(r"[a-z]+", text)), 1)
    return {
        word: round(1e4 * len(re.findall(rf"\b{word}\b", text)) / total, 1) for word in EMPTY_WORDS
    }


def by_room(package: dict[str, Module]) -> dict[str, int]:
    """Return the statements of each room, the largest first."""
    rooms: Counter[str] = Counter()
    for module in package.values():
        folder = module.path.relative_to(PACKAGE).parts
        rooms[folder[0] if len(folder) > 1 else "."] += statements(module)
    return dict(rooms.most_common())


def figures() -> dict[str, int | float | list[str]]:
    """Count everything: numbers, and lists of places."""
    package = modules()
    code = sum(module.code for module in package.values())
    all_tokens = sum(
        token.type not in LAYOUT for module in package.values() for token in tokens(module)
    )
    folders = Counter(
        str(m.path.parent.relative_to(ROOT)) for m in package.values() if not m.is_package
    )
    return {
        "statements": sum(statements(module) for module in package.values()),
        "tokens": all_tokens,
        "tokens a line of code": round(all_tokens / max(code, 1), 1),
        "modules": sum(folders.values()),
        "code lines": code,
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
        "private names that tests use": private_names_in_tests(package),
        "public names in more than three modules": names_in_many_modules(package),
        **{f"'{word}' in 10,000 words": count for word, count in words(package).items()},
        **{f"statements of {room}": count for room, count in by_room(package).items()},
    }


def main() -> None:
    with_places = "--list" in sys.argv
    for name, value in figures().items():
        print(f"{name:45s} {len(value) if isinstance(value, list) else value}")
        if with_places and isinstance(value, list):
            print("".join(f"    {place}\n" for place in value), end="")


if __name__ == "__main__":
    main()
