"""Make of a command line once what does not change between the commands that tests run in one process.

A program runs one command, and reads the signatures of its options and the versions of its packages for it: more than
half of the time of a small run.
"""

import copy
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata

import cyclopts
import pydantic
import pytest
from cyclopts.argument import ArgumentCollection


def without_values(made: ArgumentCollection) -> ArgumentCollection:
    """Return a copy of what was read of a signature, to be given the values of a command line."""
    copies = {id(argument): copy.copy(argument) for argument in made}
    for argument in copies.values():
        argument.tokens = []
        argument.children = ArgumentCollection(copies[id(child)] for child in argument.children)
    return ArgumentCollection(copies.values())


@contextmanager
def signatures_read_once() -> Iterator[None]:
    """Read signatures and versions once, and make the check of each type of option once."""
    read, check = cyclopts.App.assemble_argument_collection, functools.cache(pydantic.TypeAdapter)
    version = functools.cache(metadata.version)
    made: dict[tuple[object, bool], ArgumentCollection] = {}

    def assemble(app: cyclopts.App, *, parse_docstring: bool = False) -> ArgumentCollection:
        key = (app.default_command, parse_docstring)
        if key not in made:
            made[key] = read(app, parse_docstring=parse_docstring)
        return without_values(made[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cyclopts.App, "assemble_argument_collection", assemble)
        patch.setattr(pydantic, "TypeAdapter", check)
        patch.setattr(metadata, "version", version)
        yield
