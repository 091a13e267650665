"""Messages for invalid settings: what was given, what is expected, which names are valid."""

from __future__ import annotations

import difflib
import json
from typing import Any

from pydantic import ValidationError

from accelsurf.errors import UsageError
from accelsurf.settings.catalogue import help_of
from accelsurf.settings.fields import VOXELS, SettingFields


def usage_error(error: ValidationError, values: dict[str, Any]) -> UsageError:
    """Turn pydantic's errors into one line about the first of them."""
    key = str(error.errors()[0]["loc"][0])
    if key in SettingFields.model_fields:
        return UsageError(*complaint(key, values.get(key)))
    near = difflib.get_close_matches(key.replace("-", "_"), SettingFields.model_fields, n=1, cutoff=0.5)
    guess = f"did you mean {near[0]}? " if near else ""
    return UsageError(f"{key}: there is no such setting", f"{guess}Valid are {', '.join(SettingFields.model_fields)}")


def complaint(key: str, value: Any) -> tuple[str, str]:
    """Return message and hint for a value that ``key`` does not take."""
    given = value if isinstance(value, str) and value else json.dumps(value, default=str)
    return f"{key}: {given} was given, expected {expected(key)}", help_of(key)


def expected(key: str) -> str:
    """Say in words which values a field takes.

    Parameters
    ----------
    key : str
        Name of a field of RunConfig.

    Examples
    --------
    >>> expected("diffusion"), expected("restart")
    ('a number at least 0, auto or free', 'auto or off')
    """
    words = _in_words(SettingFields.model_json_schema()["properties"][key])
    return " or ".join(words) if len(words) < 3 else ", ".join(words[:-1]) + " or " + words[-1]


def _in_words(schema: dict[str, Any]) -> list[str]:
    """Return the alternatives that a JSON schema allows, in words."""
    if "anyOf" in schema:
        parts = [_in_words(part) for part in schema["anyOf"]]
        words = [word for part in parts for word in part]
        return [", or ".join(words)] if len(words) == 2 and words[0].startswith("a number") else words
    if "const" in schema:
        return [schema["const"]]
    if "enum" in schema:
        return list(schema["enum"])
    match schema["type"]:
        case "number" | "integer":
            noun = "a number" if schema["type"] == "number" else "a whole number"
            return [noun + _bounds(schema)]
        case "array" if "$ref" in schema["items"]:
            return ["changes, each with the step that it comes before"]
        case "array":
            names = _in_words(schema["items"])
            return ["one or more of " + ", ".join(names) if len(names) > 1 else "one text or a list of them"]
        case "boolean":
            return ["true", "false"]
        case "null":
            return []
        case "string" if schema.get("pattern") == VOXELS:
            return ["a number of voxels such as 1.5vox"]
        case _:
            return ["a text"]


def _bounds(schema: dict[str, Any]) -> str:
    """Return the bounds of a number in words, with a leading blank, or nothing."""
    names = {
        "exclusiveMinimum": "greater than",
        "minimum": "at least",
        "exclusiveMaximum": "less than",
        "maximum": "at most",
    }
    parts = [f"{word} {schema[name]:g}" for name, word in names.items() if name in schema]
    return " " + " and ".join(parts) if parts else ""
