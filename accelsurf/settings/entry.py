"""The entry of a setting: all but its type, bounds and default, as one record in the field of RunConfig.

The command line, the viewer, ``accelsurf info``, the JSON schema and the reference pages take it from there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema


class SettingGroup(StrEnum):
    """Groups of the help and of the reference pages, in their order."""

    RUN = "What to run"
    TRACK = "From frame to frame"
    FLOW = "Fine control of the flow"
    IMAGE = "The image"
    FILES = "Files"


@dataclass(frozen=True)
class Slider:
    """Slider of a setting that is a number, in the viewer.

    Attributes
    ----------
    low, high : float
        Ends of the slider, in voxels to the power ``voxel_power`` of the smallest spacing.
    voxel_power : int
        0 where the setting is no length: then the ends are the numbers themselves.
    words : tuple of str
        Words that may stand for a number.
    power : float
        Above 1 the slider is finer at its lower end.
    limit : float
        Largest number that can be typed.
    """

    low: float
    high: float
    voxel_power: int = 0
    words: tuple[str, ...] = ()
    power: float = 2.0
    limit: float = 1e6


@dataclass(frozen=True)
class SettingEntry:
    """The entry of a setting in its field; pydantic calls it to complete the JSON schema of the field.

    Attributes
    ----------
    group : SettingGroup
    unit : str
        Of the number; empty where there is none.
    metavar : str
        Placeholder of the value in the help.
    scope : {"run", "energy", "flow", "term"}
        Where it acts: every run, every named energy, or the flows or terms whose entry names it
        (`accelsurf.settings.flow_specs`, `accelsurf.settings.energy_terms`).
    repeated : bool
        Whether it is a list of texts whose option may be repeated.
    fixed : bool
        Whether it cannot change while a run runs.
    slider : Slider, optional
        How the viewer shows it.
    choice : bool
        Whether the viewer shows it as a list to choose from.
    viewer : {"first", "more", "elsewhere"}
        Where the viewer shows it: among the common ones, under "more" with its group, or not as a setting: clicks
        and drawings, the reading of the image, names of objects.
    names : callable, optional
        Names that the value is made of, with the meaning of each; they are appended to the help.
    listed : callable, optional
        Returns the text in place of ``{}`` in the help.
    """

    group: SettingGroup = SettingGroup.FLOW
    unit: str = ""
    metavar: str = ""
    scope: Literal["run", "energy", "flow", "term"] = "run"
    repeated: bool = False
    fixed: bool = False
    slider: Slider | None = None
    choice: bool = False
    viewer: Literal["first", "more", "elsewhere"] = "more"
    names: Callable[[], Mapping[str, str]] | None = None
    listed: Callable[[], str] | None = None

    def __call__(self, schema: dict[str, Any]) -> None:
        """Complete the JSON schema of the field, in place."""
        schema["group"] = str(self.group)
        if self.unit:
            schema["unit"] = self.unit
        schema["description"] = self.completed(schema["description"])

    def completed(self, help: str) -> str:
        """The help of the field with the registered names."""
        if self.listed is not None:
            help = help.replace("{}", self.listed())
        if self.names is None:
            return help
        return (
            f"{help} "
            + "; ".join(f"{name}: {meaning}" for name, meaning in self.names().items())
            + "."
        )


def setting(default: Any, help: str, *, entry: SettingEntry, **bounds: Any) -> Any:
    """Return the field of RunConfig for a setting.

    Parameters
    ----------
    default
        Its value unless given.
    help : str
        One or more sentences, with the unit.
    entry : SettingEntry
    **bounds
        As `pydantic.Field` takes them: ge, gt, le, lt, min_length.
    """
    return Field(default, description=help, json_schema_extra=entry, **bounds)


def full_help(field: FieldInfo) -> str:
    """The help of a setting, with the registered names."""
    return entry_of(field).completed(field.description or "")


def entry_of(field: FieldInfo) -> SettingEntry:
    """Return the entry that `setting` has put into a field.

    Raises
    ------
    TypeError
        When the field was not made by it.
    """
    if not isinstance(field.json_schema_extra, SettingEntry):
        raise TypeError("a setting is made by accelsurf.settings.entry.setting")
    return field.json_schema_extra


@dataclass(frozen=True)
class OneOf:
    """Annotation of a text that is one of the names; the JSON schema lists them.

    Attributes
    ----------
    names : callable
        Returns the names that there are now.
    """

    names: Callable[[], Collection[str]]

    def _checked(self, value: str) -> str:
        if value not in self.names():
            raise ValueError("no such name")
        return value

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {**handler(schema), "enum": list(self.names())}
