"""Options that several commands share. Options of a run are made from RunConfig, so that the two cannot differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, make_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter
from pydantic.fields import FieldInfo

from accelsurf.errors import UsageError
from accelsurf.settings import toml
from accelsurf.settings.catalogue import default_shown, entry, is_switch, names_of
from accelsurf.settings.entry import SettingGroup, entry_of, full_help
from accelsurf.settings.file_formats import input_help
from accelsurf.settings.older import modern
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import RunConfig

GROUPS = {group: Group(str(group), sort_key=place) for place, group in enumerate(SettingGroup, 1)}
RUN, IMAGE, FILES = (
    GROUPS[group] for group in (SettingGroup.RUN, SettingGroup.IMAGE, SettingGroup.FILES)
)
SHOW = Group("Display", sort_key=len(GROUPS) + 1)
#: For commands that write none of a run's files.
WITHOUT_FILES = tuple(group for group in SettingGroup if group is not SettingGroup.FILES)

ProgressKind = Literal["bar", "json", "none"]
InputFile = Annotated[
    Path | None, Parameter(name=("--input", "-i"), group=FILES, help=f"The image: {input_help()}.")
]
Output = Annotated[Path | None, Parameter(name=("--output", "-o"), group=FILES)]
File = Annotated[Path | None, Parameter(group=FILES)]
Switch = Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)]
Overwrite = Annotated[
    bool, Parameter(name="--overwrite", negative=(), show_default=False, group=FILES)
]


def settings_class(
    name: str,
    leave_out: tuple[str, ...] = (),
    groups: tuple[SettingGroup, ...] = tuple(SettingGroup),
    further: tuple[str, ...] = (),
) -> type:
    """Return a dataclass with an option for each field of RunConfig that is in a group, and for further ones.

    Each is ``None`` where it was not given. The values stay text as typed. RunConfig checks them, so that an invalid
    one has the same message in a file, on the command line and in Python. A class takes 5 ms: each command makes the
    one that it needs.
    """
    members: list[tuple[str, Any, Any]] = []
    for key in RunConfig.model_fields:
        said = entry(key)
        if key in leave_out or (said.group not in groups and key not in further):
            continue
        completer = None if is_switch(key) else partial(_completions, key)
        members.append(
            option(key, RunConfig.model_fields[key], default_shown(key), completer=completer)
        )
    return options_class(name, members)


def option(key: str, field: FieldInfo, default: str, **more: Any) -> tuple[str, Any, Any]:
    """Return the member of `options_class` for a setting; ``more`` as of cyclopts' Parameter."""
    said, switch = entry_of(field), field.annotation is bool
    kind: Any = bool if switch else tuple[str, ...] if said.repeated else str
    parameter = Parameter(
        name="--" + key.replace("_", "-"),
        help=full_help(field),
        group=GROUPS[said.group],
        show_default=default or False,
        metavar=said.metavar or key.upper(),
        negative_iterable=(),
        **more,
    )
    return key, Annotated[kind | None, parameter], None


def options_class(name: str, members: list[tuple[str, Any, Any]]) -> type:
    """Return a dataclass of options that commands take."""
    # Cyclopts looks into a class only when its module is not the standard library's, where it would be put here.
    made = make_dataclass(name, members, frozen=True, namespace={"__module__": __name__})
    return Parameter(name="*")(made)


def _completions(key: str, context: object) -> dict[str, str]:
    """Names that a shell offers for a setting, with their meaning; a setting without names has none."""
    return names_of(key)


def given_options(settings: Any) -> dict[str, Any]:
    """Return the options of an instance of an `options_class`, or of None, that were given."""
    every = (
        {field.name: getattr(settings, field.name) for field in fields(settings)}
        if settings is not None
        else {}
    )
    return {key: value for key, value in every.items() if value is not None}


def run_config(
    settings: Any, file: Path | Mapping[str, Any] | None = None, **forced: Any
) -> RunConfig:
    """Return the configuration of a run: options override the file, which overrides the defaults.

    A preset given as an option overrides the file, but not the other options. A preset named in the file is overridden
    by the other settings of the file.

    Parameters
    ----------
    settings : instance of a `settings_class`, or None
        Options of the command line.
    file : Path or mapping, optional
        TOML file of ``--config``, or its content.
    **forced
        Fields that the command itself sets; a preset among them counts as one that was given as an option.

    Raises
    ------
    UsageError
        When the file or a value is not valid.
    """
    typed = given_options(settings)
    preset = forced.get("preset", typed.get("preset"))
    under = PRESETS[preset].settings if preset is not None and preset in PRESETS else {}
    below = toml.read_toml(file) if isinstance(file, Path) else file or {}
    return RunConfig(**{**modern(below), **under, **typed, **forced})


@Parameter(name="*")
@dataclass(frozen=True)
class Display:
    """Progress and messages of a command."""

    quiet: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False
    """Print nothing but warnings and errors."""

    progress: Annotated[
        ProgressKind | None, Parameter(group=SHOW, show_default="bar on a terminal, else none")
    ] = None
    """Progress on stderr: bar, json (one object per line and step), or none."""


def required(value: Path | None, name: str) -> Path:
    """Return an argument that only special cases may omit.

    Raises
    ------
    UsageError
        When it is missing.
    """
    if value is None:
        raise UsageError(
            f"{name} is missing", "accelsurf COMMAND --help lists what a command needs"
        )
    return value
