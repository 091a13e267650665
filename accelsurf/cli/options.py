"""Options that several commands share. Those of a run are made from RunConfig, so that the two cannot differ."""

from __future__ import annotations

from dataclasses import dataclass, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

from accelsurf.errors import UsageError
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import REPEATED, SWITCHES, RunConfig, read_toml

RUN = Group("What to run", sort_key=1)
FLOW = Group("Fine control of the flow", sort_key=2)
FILES = Group("Files", sort_key=3)
SHOW = Group("Display", sort_key=4)

ProgressKind = Literal["bar", "json", "none"]
Output = Annotated[Path | None, Parameter(name=("--output", "-o"), group=FILES)]
Overwrite = Annotated[bool, Parameter(name="--overwrite", negative=(), show_default=False, group=FILES)]

_GROUPS = {
    **dict.fromkeys(("preset", "energy", "flow", "start", "smoothness", "balance", "presmooth"), RUN),
    **dict.fromkeys(("edge_scale", "edge_contrast", "balloon", "foreground", "background", "channel"), RUN),
    **dict.fromkeys(("objects", "mask", "roi", "max_volume"), RUN),
    **dict.fromkeys(("levels", "max_steps", "edit", "seed", "reproducible", "threads"), RUN),
    **dict.fromkeys(("mesh", "mesh_space", "save_sdf", "format"), FILES),
}
_METAVARS = {
    **dict.fromkeys(("preset", "flow", "format", "mesh_space"), "NAME"),
    **dict.fromkeys(("foreground", "background"), "WHERE"),
    **dict.fromkeys(("objects", "mask", "channel"), "FILE"),
    **{"energy": "EXPRESSION", "roi": "BOX", "max_volume": "MM3"},
    **dict.fromkeys(("max_steps", "seed", "threads", "half_width"), "N"),
    **dict.fromkeys(("edge_scale", "noise_length", "sobolev_length"), "MM|auto"),
    **{"k": "K", "t0": "T|auto", "gravity": "G", "noise": "TAU", "noise_time": "T|auto", "blend": "OMEGA"},
    **{"edge_contrast": "K|auto", "balloon": "C"},
    **{
        "start": "WHERE",
        "smoothness": "MM",
        "balance": "RATIO",
        "presmooth": "MM|Nvox",
        "cfl": "VOXELS",
        "epsilon": "VOXELS",
        "percentile": "PERCENT",
    },
    "edit": "CHANGE",
    **{"levels": "N|auto", "diffusion": "D|free|auto", "friction": "t|A", "restart": "auto|off", "mesh": "NAMES"},
}


def _settings(name: str, leave_out: tuple[str, ...] = ()) -> type:
    """Return a dataclass with an option for each field of RunConfig; ``None`` where the option was not given.

    The values stay text as typed. RunConfig checks them, so that a bad one is told in the same words wherever it
    comes from.
    """
    members: list[tuple[str, Any, Any]] = []
    for key, field in RunConfig.model_fields.items():
        if key in leave_out:
            continue
        kind: Any = bool if key in SWITCHES else tuple[str, ...] if key in REPEATED else str
        parameter = Parameter(
            name="--" + key.replace("_", "-"),
            help=field.description,
            group=_GROUPS.get(key, FLOW),
            show_default=_shown(field.default),
            metavar=_METAVARS.get(key, key.upper()),
            negative_iterable=(),
        )
        members.append((key, Annotated[kind | None, parameter], None))
    # Cyclopts looks into a class only when its module is not the standard library's, where it would be put here.
    made = make_dataclass(name, members, frozen=True, namespace={"__module__": __name__})
    return Parameter(name="*")(made)


def _shown(value: Any) -> str | bool:
    """Return a default as it would be typed; nothing for a field that has none."""
    if value is None:
        return False
    if value == ():
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ",".join(value) if isinstance(value, tuple) else f"{value:g}" if isinstance(value, float) else str(value)


Settings = _settings("Settings")
#: For commands that write none of a run's files.
RunSettings = _settings("RunSettings", leave_out=("mesh", "mesh_space", "save_sdf", "format"))
#: For commands that choose the flow and the files themselves.
SharedSettings = _settings("SharedSettings", leave_out=("flow", "objects", "mesh", "mesh_space", "save_sdf", "format"))


def run_config(settings: Any, file: Path | None = None, **forced: Any) -> RunConfig:
    """Return the configuration of a run: options given beat the file, which beats the defaults.

    A preset given as an option stands for options: it beats the file too, but none of the options beside it. One that
    the file names is beaten by what the file says besides.

    Parameters
    ----------
    settings : Settings or SharedSettings or None
        Options of the command line.
    file : Path, optional
        TOML file of ``--config``.
    **forced
        Fields that the command itself sets.

    Raises
    ------
    UsageError
        When the file or a value is no good.
    """
    given = {f.name: getattr(settings, f.name) for f in fields(settings)} if settings is not None else {}
    typed = {key: value for key, value in given.items() if value is not None}
    preset = typed.get("preset")
    under = PRESETS[preset].settings if preset in PRESETS else {}
    return RunConfig(**{**(read_toml(file) if file is not None else {}), **under, **typed, **forced})


@Parameter(name="*")
@dataclass(frozen=True)
class Display:
    """What a command shows while it runs."""

    quiet: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False
    """Print nothing but warnings and errors."""

    progress: Annotated[ProgressKind | None, Parameter(group=SHOW, show_default="bar on a terminal, else none")] = None
    """Progress on stderr: bar, json (one object per line and step), or none."""


def required(value: Path | None, name: str) -> Path:
    """Return an argument that may only be left out in special cases.

    Raises
    ------
    UsageError
        When it was left out.
    """
    if value is None:
        raise UsageError(f"{name} is missing", "accelsurf COMMAND --help lists what a command needs")
    return value
