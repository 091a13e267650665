"""Everything a run needs, validated once.

One model serves the command line, Python, batches and reports: it is read from TOML, written back to TOML without
loss, and described by a JSON schema. Lengths are millimetres unless the description says voxels.
"""

from __future__ import annotations

import difflib
import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from accelsurf.errors import UsageError
from accelsurf.settings import energy_expression
from accelsurf.settings.edits import Edit, edits_of, refuse_unknown
from accelsurf.settings.presets import PRESETS, PresetName

FlowName = Literal["constant-density", "flowable-mass", "gradient", "sobolev", "momentum"]
MeshFormat = Literal["ply", "stl", "obj", "vtp", "csv"]
LabelFormat = Literal["nii.gz", "nii", "nrrd", "mha", "mhd", "png", "tif"]


#: Settings that are lists of texts, whose options may be repeated.
REPEATED = ("start", "foreground", "background", "channel", "edit")
#: Settings that are true or false.
SWITCHES = ("save_sdf", "reproducible")
#: A length in voxels, as it is written.
VOXELS = r"^(\d+\.?\d*|\.\d+)vox$"
_WITH_MOMENTUM = ("constant-density", "flowable-mass")
#: Flows and terms of energies that a setting means something to; settings not named here mean something to all.
_ONLY_FOR: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("k", "t0", "lam", "rho", "friction", "noise", "noise_length", "noise_time"), _WITH_MOMENTUM),
    "gravity": ("flowable-mass",),
    "diffusion": (*_WITH_MOMENTUM, "gradient"),
    "sobolev_length": ("sobolev",),
    "blend": ("momentum",),
    "balance": ("chan-vese",),
    "epsilon": ("chan-vese", "local-region"),
    "foreground": ("likelihood", "learning"),
    "background": ("likelihood",),
    **dict.fromkeys(("edge_scale", "edge_contrast", "balloon"), ("geodesic",)),
}


def _one_or_many(value: Any) -> Any:
    """Let a single start stand for a tuple of one."""
    return (value,) if isinstance(value, str) else value


def _expression(value: Any) -> Any:
    """Check an energy; a list of tables becomes the text that it stands for."""
    if isinstance(value, (list, tuple)):
        value = energy_expression.from_tables(value)
    if isinstance(value, str):
        value = " ".join(value.split())
        energy_expression.parse(value)
    return value


def _split_commas(value: Any) -> Any:
    """Let ``"ply,stl"`` stand for ``("ply", "stl")``; names given twice count once."""
    if value == "auto":
        return value
    if isinstance(value, str):
        value = value.split(",")
    if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
        return tuple(dict.fromkeys(item.strip().lower() for item in value))
    return value


class RunConfig(BaseModel):
    """Settings of one segmentation run.

    The fields are the options of ``accelsurf segment`` (``max_steps`` is ``--max-steps``) and the keys of a TOML
    configuration file. Instances cannot be changed; use :meth:`replace`.

    Raises
    ------
    UsageError
        When a key is unknown or a value is out of bounds. The message names the key, the value given and what is
        expected.

    Examples
    --------
    >>> config = RunConfig(start="ball:0,0,0,20", smoothness=0.5)
    >>> config.start, config.flow, config.diffusion
    (('ball:0,0,0,20',), 'constant-density', 'auto')
    >>> RunConfig(cfl=3)
    Traceback (most recent call last):
    ...
    accelsurf.errors.UsageError: cfl: 3 was given, expected a number greater than 0 and at most 1
    hint: ...
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    preset: PresetName | None = Field(
        None,
        description="Settings for a kind of scan, under those given beside it: " + ", ".join(PRESETS) + ". "
        "accelsurf info says what each sets, and why.",
    )
    energy: Annotated[str, BeforeValidator(_expression)] = Field(
        "chan-vese",
        description="Energy to minimise: terms with weights, as 'local-region:R=8 + 0.3*geodesic'. chan-vese: two "
        "regions, each with its own mean; local-region: the same within R mm of each place; likelihood: regions by "
        "their distributions; threshold:LO,HI: a window of values; geodesic: the area, counted less on edges; area; "
        "balloon.",
    )
    flow: FlowName = Field(
        "constant-density",
        description="How the surface moves. With momentum: constant-density, or flowable-mass (mass that flows along "
        "the surface). Descent, as baselines: gradient, sobolev (smoothed gradient), momentum (Andersson et al. 2013).",
    )
    start: Annotated[tuple[str, ...], BeforeValidator(_one_or_many)] = Field(
        ("center",),
        min_length=1,
        description="First surface: ball:X,Y,Z,R, box:X0,Y0,Z0,X1,Y1,Z1, seed:X,Y,Z,R, label:FILE, threshold:LO,HI, "
        "largest:LO,HI, otsu, mesh:FILE or center. "
        "Coordinates in world mm (LPS), or voxel indices (x,y,z) with the suffix vox. Several are united.",
    )
    objects: str | None = Field(
        None,
        description="Several objects at once, in place of --start: label map of first voxels on the image's grid, each "
        "object its id (FILE@2,5-9: these only), or table of balls, FILE.csv with columns id,x,y,z,r in world mm or "
        "id,x_vox,y_vox,z_vox,r_vox. They never overlap.",
    )
    mask: str | None = Field(
        None, description="Label map on the image's grid: the surface never leaves the voxels above 0."
    )
    roi: str | None = Field(
        None,
        description="Box X0,Y0,Z0,X1,Y1,Z1 in world mm, or voxel indices with the suffix vox: only there the run "
        "is made; what is written is on the whole grid.",
    )
    foreground: Annotated[tuple[str, ...], BeforeValidator(_one_or_many)] = Field(
        (), description="Voxels of the object that likelihood learns from, written as a start; several are united."
    )
    background: Annotated[tuple[str, ...], BeforeValidator(_one_or_many)] = Field(
        (), description="Voxels around the object that likelihood learns from, written as a start; several are united."
    )
    channel: Annotated[tuple[str, ...], BeforeValidator(_one_or_many)] = Field(
        (), description="Further channels of the image: files on the same grid, in order after those of the input."
    )
    max_volume: Annotated[float, Field(gt=0)] | None = Field(
        None, description="Leak guard: the run ends when the object is larger than this, in mm^3."
    )
    smoothness: float = Field(
        0.0,
        ge=0,
        description="Weight of the surface's area, in mm: larger is smoother; 0 keeps corners. "
        "Independent of the image's intensity scale.",
    )
    balance: float = Field(
        1.0,
        gt=0,
        description="Weight of the fit inside against the fit outside (lambda1/lambda2 of Chan and Vese, no unit): "
        "above 1 the object must be closer to its mean, so a bright object loses its dim rim.",
    )
    presmooth: Annotated[float, Field(ge=0)] | Annotated[str, Field(pattern=VOXELS)] = Field(
        0.0,
        description="Sigma of a Gaussian applied to the image before the run, in mm, or in voxels of the smallest "
        "spacing with the suffix vox; 0 for none.",
    )
    edge_scale: Annotated[float, Field(gt=0)] | Literal["auto"] = Field(
        "auto",
        description="Scale at which the geodesic energy sees edges: sigma of the Gaussian gradient, in mm; "
        "auto is one voxel (the largest spacing).",
    )
    edge_contrast: Annotated[float, Field(gt=0)] | Literal["auto"] = Field(
        "auto",
        description="Gradient magnitude that counts as half an edge, in parts of the image's range per mm; "
        "auto takes it from the image.",
    )
    balloon: float = Field(
        0.0,
        description="Pressure of the geodesic energy away from edges, per mm: above 0 the surface shrinks, "
        "below 0 it grows.",
    )
    k: float = Field(2.0, gt=0, description="Order of the accelerated flow (no unit); it sets the friction (k+1)/t.")
    t0: Annotated[float, Field(ge=0)] | Literal["auto"] = Field(
        "auto",
        description="Time on the clock of the friction (k+1)/t when the surface starts at rest; auto is 0, "
        "or with k <= 1, where that is impossible, the time in which the first step is made.",
    )
    lam: float = Field(1.0, gt=0, description="Strength of the energy against inertia (no unit), the paper's lambda.")
    rho: float = Field(1.0, gt=0, description="Mass per area of the surface (relative units).")
    gravity: float = Field(
        0.0, ge=0, description="Strength g of the mass potential of flowable-mass, which evens its density out."
    )
    diffusion: Annotated[float, Field(ge=0)] | Literal["auto", "free"] = Field(
        "auto",
        description="Diffusion of the surface's speed along the surface, in mm^2 per unit of flow time; 0 is none; "
        "free is as much as costs no shorter step, within a mixing length; auto is free with momentum, else none.",
    )
    noise: float = Field(
        0.0,
        ge=0,
        description="Strength of random acceleration, smooth in space, in mm per unit of flow time^1.5; 0 is none.",
    )
    noise_length: Annotated[float, Field(gt=0)] | Literal["auto"] = Field(
        "auto", description="Correlation length of the noise, in mm; auto is 4 voxels (the largest spacing)."
    )
    noise_time: Annotated[float, Field(gt=0)] | Literal["auto"] = Field(
        "auto", description="How long the noise acts, in flow time; auto is until the first restart."
    )
    sobolev_length: Annotated[float, Field(gt=0)] | Literal["auto"] = Field(
        "auto", description="Length over which the sobolev flow smooths the force, in mm; auto is 5 voxels."
    )
    blend: float = Field(
        0.8, ge=0, lt=1, description="Part of the last step that the momentum flow keeps in the next (no unit)."
    )
    friction: Annotated[float, Field(gt=0)] | Literal["t"] = Field(
        "t", description="Friction of the accelerated flow: t is (k+1)/t, a number is constant, per unit of flow time."
    )
    restart: Literal["auto", "off"] = Field(
        "auto", description="auto puts the surface at rest when its energy rises, after it has travelled; off never."
    )
    cfl: float = Field(0.5, gt=0, le=1, description="Largest motion of the surface in one step, in voxels.")
    max_steps: int = Field(
        1000, ge=0, description="The run ends after this many steps, converged or not; 0 leaves the start."
    )
    tolerance: float = Field(
        0.1,
        gt=0,
        le=2,
        description="Converged is a surface that lies on average within this many voxels of where it lay 20 steps "
        "before, or 6 steps before where a coarser level has gone ahead. Larger is sooner and rougher.",
    )
    levels: Annotated[int, Field(ge=1)] | Literal["auto"] = Field(
        "auto",
        description="Grids to run on, coarsest first, each with half the voxels along an axis of the next; 1 is the "
        "image's own grid alone. auto takes as many as resolve image and start.",
    )
    percentile: float = Field(
        95.0,
        gt=0,
        le=100,
        description="Speed limiter: the time step follows this percentile of the speeds on the surface (percent); "
        "faster places are held to cfl voxels per step. 100 limits nothing.",
    )
    epsilon: float = Field(
        1.5,
        ge=0,
        le=2.5,
        description="Half width of the smeared interface in the energy, in voxels along the normal; 0 is sharp.",
    )
    half_width: Annotated[int, Field(ge=3, le=32)] | Literal["auto"] = Field(
        "auto", description="Half width of the narrow band, in voxels; auto is 3, for flowable-mass 4."
    )
    mesh: Annotated[
        Annotated[tuple[MeshFormat, ...], Field(min_length=1)] | Literal["auto"], BeforeValidator(_split_commas)
    ] = Field(
        "auto",
        description="Formats, separated by commas, of the surface: ply, stl, obj, vtp; of the contours of an image of "
        "one slice: vtp, csv. auto is ply, or for one slice vtp,csv.",
    )
    mesh_space: Literal["lps", "ras"] = Field(
        "lps", description="World axes of the mesh or contours, in mm: lps as ITK, or ras as NIfTI."
    )
    save_sdf: bool = Field(False, description="Also write the signed distance (mm, negative inside) as a volume.")
    format: LabelFormat | None = Field(
        None,
        description="Format of the label map: nii.gz, nii, nrrd, mha, mhd, tif, or for one slice png. "
        "Follows the input unless given.",
    )
    seed: Annotated[int, Field(ge=0)] | None = Field(
        None, description="Seed of everything random in the run; drawn and reported unless given."
    )
    reproducible: bool = Field(False, description="Refuse to run anything random without a seed.")
    threads: Literal["auto"] | Annotated[int, Field(ge=1)] = Field(
        "auto", description="Number of threads; auto: one for each core. The result does not depend on it."
    )
    edit: Annotated[tuple[Edit, ...], BeforeValidator(edits_of)] = Field(
        (),
        description="Changes while it runs, each before a step: 'step=30 smoothness=0.5', 'step=40 add=ball:X,Y,Z,R' "
        "(or remove=); in TOML tables [[edit]].",
    )

    def __init__(self, **values: Any) -> None:
        # A preset that is none is told by the validation.
        preset = values.get("preset")
        under = PRESETS[preset].settings if isinstance(preset, str) and preset in PRESETS else {}
        try:
            super().__init__(**{**under, **values})
        except ValidationError as error:
            raise _usage_error(error, values) from None
        self._check_together()

    def _check_together(self) -> None:
        """Refuse values that are valid one by one but not together."""
        if self.reproducible and self.noise > 0 and self.seed is None:
            raise UsageError(
                f"seed: none was given, expected a whole number at least 0: noise {self.noise:g} is random and the run "
                "is to be reproducible",
                "add --seed 1, or leave --reproducible out",
            )
        if self.objects is not None and self.start != _default("start"):
            raise UsageError(
                f"start: {' + '.join(self.start)} was given with objects {self.objects}, expected one of the two",
                "objects are starts: put what is to be segmented into that file",
            )
        if self.t0 == 0 and self.k <= 1:
            raise UsageError(
                f"t0: 0 was given, expected a number greater than 0 with k = {self.k:g}",
                "for k <= 1 the accelerated flow has no start from rest at time 0; auto chooses a time",
            )
        for edit in self.edit:
            refuse_unknown(edit, type(self).model_fields)
        if self.edit:
            self.at(self.edit[-1].step)

    def matters(self, key: str) -> bool:
        """Whether a setting means something to this flow and energy.

        Examples
        --------
        >>> RunConfig(flow="gradient").matters("gravity"), RunConfig().matters("smoothness")
        (False, True)
        """
        terms = energy_expression.parse(self.energy)
        used = {self.flow, *(term.name for term in terms)}
        if any(energy_expression.learns(term) for term in terms):
            used.add("learning")
        return key not in _ONLY_FOR or not used.isdisjoint(_ONLY_FOR[key])

    def unused(self) -> list[str]:
        """Return the settings that were changed from their defaults and mean nothing to this flow and energy.

        Examples
        --------
        >>> RunConfig(flow="gradient", gravity=0.1).unused()
        ['gravity']
        """
        return [key for key in _ONLY_FOR if not self.matters(key) and getattr(self, key) != _default(key)]

    @model_validator(mode="before")
    @classmethod
    def _no_truth_for_numbers(cls, values: Any) -> Any:
        # Pydantic takes True for 1; in a configuration file that is always a mistake.
        for key, value in values.items() if isinstance(values, dict) else ():
            if isinstance(value, bool) and key in cls.model_fields and key not in SWITCHES:
                raise UsageError(*_complaint(key, value))
        return values

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed, validated again.

        Parameters
        ----------
        **changes
            New values by field name. With a ``preset`` among them, its values replace defaults and those of the former
            preset; what was set otherwise stays.

        Raises
        ------
        UsageError
            When a key is unknown or a value is out of bounds.

        Examples
        --------
        >>> RunConfig().replace(flow="gradient").flow
        'gradient'
        """
        kept = self.model_dump()
        if "preset" in changes:
            under = PRESETS[self.preset].settings if self.preset is not None else {}
            former = type(self)(**under)
            kept = {key: value for key, value in kept.items() if value != getattr(former, key)}
        return type(self)(**{**kept, **changes})

    def at(self, step: int) -> Self:
        """Return the settings in force when a step is made: with the edits up to it, and without any to come.

        Parameters
        ----------
        step : int
            Number of the step; its own edits have happened.

        Raises
        ------
        UsageError
            When an edit has a value that is out of bounds.

        Examples
        --------
        >>> config = RunConfig(edit=["step=30 smoothness=0.5"])
        >>> config.at(29).smoothness, config.at(30).smoothness
        (0.0, 0.5)
        """
        now = self.model_copy(update={"edit": ()})
        for edit in self.edit:
            if edit.step > step:
                break
            try:
                now = now.replace(**edit.settings) if edit.settings else now
            except UsageError as error:
                raise UsageError(f"edit at step {edit.step}: {error.message}", error.hint) from None
        return now

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a configuration file; keys that are not in it keep their defaults.

        Parameters
        ----------
        path : str or Path
            TOML file with fields of this class at its top level.

        Raises
        ------
        UsageError
            When the file cannot be read, is not TOML, has an unknown key (the nearest valid one is named), or a
            value is out of bounds.
        """
        return cls(**read_toml(path))

    def to_toml(self) -> str:
        """Return the configuration as TOML; :meth:`from_toml` gives an equal object back.

        Returns
        -------
        str
            One line per field, a table per edit; fields that are ``None`` are left out.

        Examples
        --------
        >>> print(RunConfig(mesh="ply,stl").to_toml())
        energy = "chan-vese"
        ...
        mesh = ["ply", "stl"]
        ...
        """
        values = self.model_dump()
        edits = values.pop("edit")
        lines = [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
        for edit in edits:
            lines += ["", "[[edit]]", *(f"{key} = {_toml(value)}" for key, value in edit.items())]
        return "\n".join(lines) + "\n"

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON schema of a configuration: types, bounds, defaults and descriptions.

        Examples
        --------
        >>> RunConfig.json_schema()["properties"]["cfl"]["maximum"]
        1
        """
        return cls.model_json_schema()


def _default(key: str) -> Any:
    return RunConfig.model_fields[key].default


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file as a dictionary.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    UsageError
        When the file is missing, unreadable or not TOML.
    """
    try:
        with open(path, "rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise UsageError(
            f"{path}: the configuration cannot be read ({error.strerror or error})",
            "accelsurf segment INPUT -o DIR --dump-config prints one to start from",
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(
            f"{path}: not a TOML file: {error}", "write one setting per line, e.g.: smoothness = 0.5"
        ) from None


def _toml(value: Any) -> str:
    """Return one value as TOML. Only what RunConfig holds: str, bool, int, finite float, tuple."""
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        # A JSON string is a TOML string but for DEL, which TOML wants escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)


def _usage_error(error: ValidationError, values: dict[str, Any]) -> UsageError:
    """Turn pydantic's findings into one line about the first of them."""
    key = str(error.errors()[0]["loc"][0])
    if key in RunConfig.model_fields:
        return UsageError(*_complaint(key, values.get(key)))
    near = difflib.get_close_matches(key.replace("-", "_"), RunConfig.model_fields, n=1, cutoff=0.5)
    guess = f"did you mean {near[0]}? " if near else ""
    return UsageError(f"{key}: there is no such setting", f"{guess}Valid are {', '.join(RunConfig.model_fields)}")


def _complaint(key: str, value: Any) -> tuple[str, str]:
    """Return message and hint for a value that ``key`` does not take."""
    given = value if isinstance(value, str) and value else json.dumps(value, default=str)
    return f"{key}: {given} was given, expected {expected(key)}", RunConfig.model_fields[key].description or ""


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
    words = _in_words(RunConfig.json_schema()["properties"][key])
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


#: Names a caller can list without building a configuration.
ENERGIES: tuple[str, ...] = energy_expression.IMAGE_TERMS
FLOWS: tuple[str, ...] = get_args(FlowName)
