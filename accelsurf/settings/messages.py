"""Messages for invalid settings: the value given, the expected one, the valid names."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ValidationError

from accelsurf.errors import UsageError
from accelsurf.settings.catalogue import enumerated
from accelsurf.settings.entry import full_help
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.toml import INTERVAL, VOLUME, VOXELS
from accelsurf.settings.track_fields import GAINS
from accelsurf.settings.wording import did_you_mean, shown

#: Words for texts of a form.
_FORMS = {
    VOXELS: "a number of voxels such as 1.5vox",
    VOLUME: "a volume such as 250ml",
    INTERVAL: "a number of steps such as 50, or a time such as 30s",
    GAINS: "two numbers from 0 to 1, such as 1,0.5",
}


def usage_error(
    error: ValidationError, values: dict[str, Any], fields: type[BaseModel] = SettingFields
) -> UsageError:
    """Turn pydantic's errors into one line about the first of them; ``fields`` has the settings."""
    key = str(error.errors()[0]["loc"][0])
    if key in fields.model_fields:
        return UsageError(*complaint(key, values.get(key), fields))
    return UsageError(*no_such_setting(key, fields))


def no_such_setting(key: str, fields: type[BaseModel] = SettingFields) -> tuple[str, str]:
    """Return message and hint for a setting that there is not."""
    flows = [name for name, spec in FLOWS.items() if key in spec.settings]
    if flows:
        hint = f"it is a setting of a flow, as in flow = '{flows[0]}:{key}=...'"
        return f"{shown(key)}: there is no such setting of a run", hint
    guess = did_you_mean(key, fields.model_fields)
    known = (
        "accelsurf info settings lists them"
        if guess
        else f"valid are {', '.join(fields.model_fields)}"
    )
    return f"{shown(key)}: there is no such setting", guess + known


def complaint(key: str, value: Any, fields: type[BaseModel] = SettingFields) -> tuple[str, str]:
    """Return message and hint for a value that ``key`` does not take."""
    given = [word.strip() for word in value.split(",")] if isinstance(value, str) else value
    names = choices(key, fields)
    wrong = (
        [word for word in given if word not in names]
        if isinstance(given, (list, tuple))
        else [given]
    )
    guess = did_you_mean(wrong[0], names) if wrong else ""
    message = f"{key}: {shown(value)} was given, expected {expected(key, fields)}"
    return message, guess + full_help(fields.model_fields[key])


def choices(key: str, fields: type[BaseModel] = SettingFields) -> list[str]:
    """Names that a field takes, besides numbers and other texts.

    Examples
    --------
    >>> choices("diffusion"), choices("cfl")
    (['auto', 'free'], [])
    """
    return enumerated(fields.model_json_schema()["properties"][key])


def expected(key: str, fields: type[BaseModel] = SettingFields) -> str:
    """Say in words which values a field takes.

    Parameters
    ----------
    key : str
        Name of a field.
    fields : type, optional
        The fields of RunConfig by default.

    Examples
    --------
    >>> expected("diffusion"), expected("restart")
    ('a number at least 0, auto or free', 'auto or off')
    """
    words = _in_words(fields.model_json_schema()["properties"][key])
    return " or ".join(words) if len(words) < 3 else ", ".join(words[:-1]) + " or " + words[-1]


def _in_words(schema: dict[str, Any]) -> list[str]:
    """Return the alternatives that a JSON schema allows, in words."""
    if "anyOf" in schema:
        parts = [_in_words(part) for part in schema["anyOf"]]
        words = [word for part in parts for word in part]
        return (
            [", or ".join(words)] if len(words) == 2 and words[0].startswith("a number") else words
        )
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
            return [
                "one or more of " + ", ".join(names)
                if len(names) > 1
                else "one text or a list of them"
            ]
        case "boolean":
            return ["true", "false"]
        case "null":
            return []
        case _:
            return [_FORMS.get(schema.get("pattern", ""), "a text")]


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
