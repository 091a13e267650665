"""Recipes of phantoms as files: their folders, how one is found and read, and the error of a wrong one."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from accelsurf.errors import InputError, UsageError
from accelsurf.settings import budgets
from accelsurf.settings.reading import check_readable

#: Of recipes in `checked`.
Kind = TypeVar("Kind", bound=BaseModel)
#: Folder of the recipes in time that come with accelsurf, beside the recipes of single volumes.
SEQUENCES = "sequences"


def recipe_folder() -> Path:
    """Return the folder of the recipes that come with accelsurf: in the package, or volumes_synth/ of a checkout."""
    here = Path(__file__).parents[1]
    packaged = here / "_recipes"
    return packaged if packaged.is_dir() else here.parent / "volumes_synth"


def recipe_names() -> list[str]:
    """Names of the recipes that come with accelsurf.

    Examples
    --------
    >>> "cube_noisy" in recipe_names()
    True
    """
    return sorted(path.stem for path in recipe_folder().glob("*.toml"))


def sequence_names() -> list[str]:
    """Names of the recipes in time that come with accelsurf; see `accelsurf.phantoms.motions`.

    Examples
    --------
    >>> "ball_moving" in sequence_names()
    True
    """
    return sorted(path.stem for path in (recipe_folder() / SEQUENCES).glob("*.toml"))


def read_recipe(recipe: str | Path) -> tuple[Path, dict[str, Any]]:
    """The file of a recipe, of a volume or in time, and its keys and values, with the name that it has by its file.

    Raises
    ------
    InputError
        When the file cannot be read or is not TOML.
    UsageError
        When no recipe has this name.
    """
    path, known = Path(recipe), [*recipe_names(), *sequence_names()]
    if path.suffix != ".toml" and path.name == str(recipe) and not path.is_file():
        if str(recipe) not in known:
            raise UsageError(
                f"no recipe is called {str(recipe)!r}", hint=f"there are: {', '.join(known)}"
            )
        path = (
            recipe_folder()
            / ("" if str(recipe) in recipe_names() else SEQUENCES)
            / f"{recipe}.toml"
        )
    check_readable(path, f"{path}: the recipe: ")
    try:
        with path.open("rb") as file:
            content = file.read(budgets.CONFIG.limit + 1)
        budgets.CONFIG.check(len(content), f"{path}: the recipe")
        values = tomllib.loads(content.decode())
    except OSError as error:
        raise InputError(
            f"{path}: the recipe cannot be read ({error.strerror})",
            hint=f"give a TOML file, or a name out of: {', '.join(known)}",
        ) from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, nested too deeply
        raise InputError(f"{path}: the recipe is not TOML ({error})") from error
    return path, {"name": path.stem} | values


def checked(kind: type[Kind], values: Mapping[str, Any], where: str) -> Kind:
    """A recipe of a kind from its keys and values; errors as `accelsurf.phantoms.recipes.recipe_from`."""
    try:
        return kind(**values)
    except ValidationError as error:
        raise UsageError(
            *_message_and_hint(error.errors()[0], where, list(kind.model_fields))
        ) from None


def _message_and_hint(problem: Any, where: str, keys: list[str]) -> tuple[str, str]:
    """Message and hint for the first thing pydantic found wrong."""
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        close = difflib.get_close_matches(key, keys, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known keys: {', '.join(keys)}"
        return f"{where}: unknown key {key!r}", hint
    if problem["type"] == "missing":
        return f"{where}: {key} is missing", ""
    if not key:
        return f"{where}: {problem['msg'].removeprefix('Value error, ')}", ""
    return (
        f"{where}: {key} = {problem['input']!r} given; {problem['msg'][0].lower()}{problem['msg'][1:]}",
        "",
    )
