"""Write the reference pages from the registries of accelsurf: ``python -m docs.reference.generate``.

Run it from the root of the repository after a setting, term, flow, file format, trace column, preset or exit code has
changed; ``tests/settings/test_reference.py`` fails until then.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

import accelsurf
from accelsurf.cli import EXIT_CODES
from accelsurf.grid.geometry import MAX_ORIGIN, SPACING_RANGE
from accelsurf.image.check import MAX_VALUE, MIN_RANGE
from accelsurf.io.format_functions import functions_of
from accelsurf.io.meshes import MESH_READERS
from accelsurf.run.arguments import GIVEN_KINDS
from accelsurf.settings.budgets import BUDGETS
from accelsurf.settings.catalogue import acts_on, as_typed, default_shown, entry, help_of
from accelsurf.settings.corrections import Correction
from accelsurf.settings.edits import Edit
from accelsurf.settings.energy_expression import MAX_TERMS
from accelsurf.settings.energy_terms import TERMS, TermSpec
from accelsurf.settings.entry import OneOf, SettingGroup, entry_of
from accelsurf.settings.expression import MAGNITUDES, Number, Word
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.file_formats import DEFAULT_IMAGE_FORMAT, IMAGE_FORMATS, ImageFormat
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.mesh_formats import MESH_FORMATS, MeshFormat, Shape
from accelsurf.settings.messages import expected
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.trace_columns import TRACE_COLUMNS
from accelsurf.settings.track_fields import TRACK_FORMATS, TrackFields
from docs.reference.report_keys import REPORT_KEYS

HERE = Path(__file__).parent
#: Types of the options of Python, and the line from which on they are written.
OPTIONS = Path(accelsurf.__file__).parent / "api" / "options.pyi"
OPTIONS_FROM = "# Written by `python -m docs.reference.generate`.\n"
MADE = "<!-- Written by `python -m docs.reference.generate`; changes by hand are lost. -->"


PRESETS_WHY = (
    "Settings for a kind of scan: `--preset NAME`. Settings given beside it win. Most objects need none: a click does "
    "it. These help beside clicks by .02 of Dice or more, or do what a click cannot. Dice is the mean over objects of "
    "public scans, in brackets by default: with the same clicks, or from the same start, without the preset "
    "(`scripts/study presets`)."
)
LIMITS_WHY = (
    "A small file can claim, repeat or pack so much that reading it would fill the memory or take hours. Each reader "
    "therefore has a budget, and asks before it spends. What is beyond it ends with exit code 3 (2 for a text), one "
    "line with both numbers, and what to do. An image that "
    "needs more memory than the machine has is refused by its header, "
    "before a voxel is read."
)
LIMITS_NAMES = (
    "Names of files are text in UTF-8. In a picture, a character that no installed font has is a box.",
    "The header of an `.mhd` or `.nrrd` may name a data file in its own folder or below it, links followed: it "
    "could name any file of the computer. The same holds for links in an OME-Zarr; `cp -rL` copies what they lead to.",
)
LIMITS_HELD = (
    "`scripts/fuzz --count 10000` gives mutated files and texts to every reader. None may crash, hang for more than "
    "20 s, use more than 1 GB (nor map 2 GiB beyond the libraries), end with a traceback, or "
    "be read as what it does not say: images are compared with a second, "
    "independent look at their bytes. `--replay FILE` judges a saved input again. The tests have a part of it "
    "(`tests/fuzz`), and one input for each budget (`tests/io/test_budgets.py`)."
)


def pages() -> dict[str, str]:
    """Return the text of each page by the name of its file."""
    made = {
        "settings.md": _settings(),
        "energy-terms.md": _terms(),
        "flows.md": _flows(),
        "presets.md": _presets(),
        "file-formats.md": _file_formats(),
        "trace.md": _trace(),
        "report.md": _report(),
        "exit-codes.md": _exit_codes(),
        "limits.md": _limits(),
    }
    titles = {name: text.splitlines()[0].removeprefix("# ") for name, text in made.items()}
    index = ["# Reference", "", *(f"* [{title}]({name})" for name, title in titles.items())]
    return {name: _page(lines) for name, lines in {"README.md": "\n".join(index), **made}.items()}


def options_source() -> str:
    """Return the source of `accelsurf.api.options`: each setting with the type of its values."""
    by_hand = (*GIVEN_KINDS, "energy", "objects", "spacing")
    of_run = {key: field for key, field in SettingFields.model_fields.items() if key not in by_hand}
    of_track = TrackFields.model_fields
    classes = {
        "Shared(TypedDict, total=False)": (
            "Settings of a run and of a tracking, where they are the same.",
            {key: field for key, field in of_run.items() if key not in of_track},
        ),
        "Options(Shared, total=False)": (
            "Settings of `RunConfig` but for the energy, the objects, and what may be an array.",
            {key: field for key, field in of_run.items() if key in of_track},
        ),
        "TrackOptions(Shared, GivenTexts, total=False)": ("Settings of `track`.", of_track),
    }
    head, _, _ = OPTIONS.read_text(encoding="utf-8").partition(OPTIONS_FROM)
    for name, (summary, fields) in classes.items():
        rows = [f"    {key}: {_type_of(field)}\n" for key, field in fields.items()]
        head += OPTIONS_FROM if name.startswith("Shared") else "\n"
        head += f'class {name}:\n    """{summary}"""\n\n' + "".join(rows)
    return head


def _type_of(field: FieldInfo) -> str:
    """Return the type of the values that a setting takes, as a type checker reads it."""
    known = [part.names for part in field.metadata if isinstance(part, OneOf)]
    if known:
        return f"Literal[{', '.join(map(json.dumps, known[0]()))}]"
    return " | ".join(dict.fromkeys(_types_in(field.annotation)))


def _types_in(kind: Any) -> Iterator[str]:
    """Yield the parts of a type: words, numbers, texts, several texts."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated and (known := [part for part in parts if isinstance(part, OneOf)]):
        yield f"Literal[{', '.join(map(json.dumps, known[0].names()))}]"
    elif origin is Annotated:
        yield from _types_in(parts[0])
    elif origin is Literal:
        yield f"Literal[{', '.join(map(json.dumps, parts))}]"
    elif origin is tuple:
        values = {Correction: "Correction", Edit: "Edit"}
        item = f"str | {values[parts[0]]} | Mapping[str, Any]" if parts[0] in values else "str"
        yield from ("str", f"Sequence[{item}]")
    elif origin in (Union, UnionType):
        for part in parts:
            yield from _types_in(part)
    elif isinstance(kind, type) and issubclass(kind, str):
        yield "str"
    else:
        yield "None" if kind is type(None) else str(kind.__name__)


def main() -> None:
    """Write the pages beside this file, and the types of the options."""
    OPTIONS.write_text(options_source(), encoding="utf-8")
    for name, text in pages().items():
        (HERE / name).write_text(text, encoding="utf-8")
        print(HERE.name + "/" + name)


def _page(text: str) -> str:
    title, _, rest = text.partition("\n")
    return f"{title}\n\n{MADE}\n\n{rest.strip()}\n"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return [
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    ] + [""]


def _code(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _settings() -> str:
    lines = [
        "# Settings",
        "",
        "Each setting is an option of `accelsurf segment` (`max_steps` is `--max-steps`), a key of a TOML file and an",
        "argument of `accelsurf.segment`. `accelsurf info --json` has them as a JSON schema.",
        "",
    ]
    for group in SettingGroup:
        if group is SettingGroup.TRACK:
            continue
        lines += [f"## {group}", ""]
        for key in SettingFields.model_fields:
            if entry(key).group is group:
                lines += _setting(key)
    return "\n".join([*lines, *_track_settings()])


def _track_settings() -> list[str]:
    """The settings of tracking, those of its own and of its files."""
    lines = [
        "## Tracking",
        "",
        "Options of `accelsurf track`, beside those of the run on each frame; in TOML they are in a table `[track]`.",
        "",
    ]
    for key, field in TrackFields.model_fields.items():
        said, default = entry_of(field), as_typed(field.default)
        facts = [("Option", f"`--{key.replace('_', '-')}`")]
        if key != "correct":
            facts.append(("Values", expected(key, TrackFields).replace("*", "\\*")))
        facts.append(("Default", f"`{default}`" if default else "not set"))
        facts += [("Unit", said.unit)] if said.unit else []
        facts += [("Repeated", "the option may be given several times")] if said.repeated else []
        lines += [
            f"### {key} (tracking)",
            "",
            said.completed(field.description or ""),
            "",
            *_table(("", ""), facts),
        ]
    return lines


def _setting(key: str) -> list[str]:
    said, default = entry(key), default_shown(key)
    facts = [
        ("Option", f"`--{key.replace('_', '-')}`"),
        ("Values", expected(key).replace("*", "\\*")),
    ]
    facts += [("Default", f"`{default}`" if default else "not set")]
    if said.unit:
        facts.append(("Unit", said.unit))
    if acts_on(key):
        facts.append(("Acts on", _code(acts_on(key))))
    if said.repeated:
        facts.append(("Repeated", "the option may be given several times"))
    facts.append(("While a run runs", "fixed" if said.fixed else "can change by an edit"))
    return [f"### {key}", "", help_of(key), "", *_table(("", ""), facts)]


def _terms() -> str:
    lines = [
        "# Energy terms",
        "",
        "An energy is a sum of terms with weights, as in `local-region:R=8 + 0.3*geodesic`. What stands after the",
        "colon are settings of the term, as `key=value`, or values alone in the order of the tables.",
        "",
    ]
    for name, spec in TERMS.items():
        lines += [f"## {name}", "", f"{spec.help[0].upper()}{spec.help[1:]}.", "", *_term(spec)]
    return "\n".join(lines)


def _term(spec: TermSpec) -> list[str]:
    lines = _own_settings(spec.settings)
    if uses := (*spec.uses, *spec.uses_to_learn):
        lines.append(f"* Uses the settings {_code(uses)} of the run.")
    seen = {"first": "the first", "mean": "the mean over all", "sum": "the sum over all"}[
        spec.channels
    ]
    if spec.uses_model:
        lines.append("* Of an image of several channels it is made of all.")
    elif spec.sees_image:
        lines.append(f"* Of an image of several channels it takes {seen}.")
    else:
        lines.append("* It does not see the image: it needs a term beside it that does.")
    lines.append(
        f"* Its weight is {'any number other than 0' if spec.signed else 'a number greater than 0'}."
    )
    return [*lines, ""]


def _flows() -> str:
    lines = [
        "# Flows",
        "",
        "How the surface moves: `--flow NAME`, or with settings of its own, as in `--flow constant-density:k=3,rho=2`:",
        "`key=value`, or values alone in the order of the tables.",
        "",
    ]
    for name, spec in FLOWS.items():
        lines += [f"## {name}", "", f"{spec.help[0].upper()}{spec.help[1:]}.", ""]
        lines += _own_settings(spec.settings)
        if spec.uses:
            lines.append(f"* Uses the settings {_code(spec.uses)} of the run.")
        lines += [f"* Half width of the band: {spec.half_width} voxels.", ""]
    return "\n".join(lines)


def _own_settings(settings: Mapping[str, Number | Word]) -> list[str]:
    """Return the table of the settings of a term or a flow."""
    rows = [(f"`{key}`", kind.expected, kind.help) for key, kind in settings.items()]
    return _table(("Setting", "Values", "Meaning"), rows) if rows else []


def _presets() -> str:
    lines = ["# Presets", "", *_wrapped(PRESETS_WHY), ""]
    measured = {
        name: "; ".join(f"{what}: {said}" for what, said in preset.tried.items())
        for name, preset in PRESETS.items()
    }
    rows = [
        (f"[`{name}`](#{name})", preset.summary, measured[name]) for name, preset in PRESETS.items()
    ]
    lines += _table(("Preset", "For", "Measured"), rows)
    for name, preset in PRESETS.items():
        rows = [
            (f"`{key}`", f"`{as_typed(value)}`", preset.reasons[key])
            for key, value in preset.settings.items()
        ]
        lines += [f"## {name}", "", *_table(("Setting", "Value", "Why"), rows)]
    return "\n".join(lines)


def _file_formats() -> str:
    kept = {
        "all": "the whole grid",
        "spacing": "the spacing",
        "pixel": "the size of a pixel",
        "none": "nothing",
    }
    images = [
        (
            f"`{name}`",
            form.help,
            _code(form.suffixes),
            _values(form),
            kept[form.keeps],
            _channels(form),
            _boxes(form),
        )
        for name, form in IMAGE_FORMATS.items()
    ]
    meshes = [(f"`{name}`", form.help, *_uses(form)) for name, form in MESH_FORMATS.items()]
    tracks = [
        (f"`{name}`", form.help, f"`NAME_{form.ending}`") for name, form in TRACK_FORMATS.items()
    ]
    lines = [
        "# File formats",
        "",
        "## Images, label maps, distances",
        "",
        "The ending of a file's name says which it is. `--format NAME` is the format of the label map, of those that",
        f"are written: unless given that of the input, or `{DEFAULT_IMAGE_FORMAT}`. What is not kept of the grid is",
        "the world's origin, the world's axes and voxels of 1 mm when the file is read; `--spacing` says another size.",
        "",
        *_table(
            ("Format", "What it is", "Endings", "Values", "Keeps", "Channels", "By boxes"), images
        ),
        "By boxes: `accelsurf.open_volume` reads parts of an image that is larger than the memory. NRRD and",
        "MetaImage must then be saved uncompressed, TIFF in grey. TIFF in packings beyond deflate, LZW, LZMA and",
        'PackBits needs `pip install "accelsurf[tiff]"`. OME-Zarr is a folder, for',
        '`pip install "accelsurf[zarr]"`; `accelsurf info IMAGE` shows its levels and chunks. A chunk with more or',
        "fewer bytes than it announces is an error with exit code 3. One that is missing is the same in a store that",
        "accelsurf wrote; in others it has the fill value, and a warning counts those that are missing. Chunks may be",
        "packed with Blosc, zstd, gzip or zlib, in shards or not. Axes that point along lines of the",
        "body are read and written in the words of RFC-4 (`left-to-right`); other directions are in an attribute of",
        "accelsurf, which other programs do not read.",
        "",
        "## Surfaces and contours",
        "",
        "`--mesh NAMES` is the format of the surface in a volume, or of the contours in an image of one slice; a start",
        "`mesh:FILE` is read from those that say so.",
        "",
        *_table(("Format", "What it is", "Surface", "Contours", "Start"), meshes),
        "## Tracks",
        "",
        "`accelsurf track --also NAMES` writes, beside label maps and tables:",
        "",
        *_table(("Name", "What it is", "File or folder"), tracks),
    ]
    return "\n".join(lines)


def _values(form: ImageFormat) -> str:
    values = ", ".join(form.types) or "integers and floats"
    values += "; one slice" if form.only_2d else ""
    return values + (f"; signed distances go to `{form.distances}`" if form.distances else "")


def _channels(form: ImageFormat) -> str:
    return "one" if functions_of(form).read_channels is None else "one or more"


def _boxes(form: ImageFormat) -> str:
    return (
        "no"
        if functions_of(form).open is None
        else "yes"
        if functions_of(form).store is None
        else "yes; label maps also written so"
    )


def _uses(form: MeshFormat) -> list[str]:
    shapes: tuple[Shape, ...] = ("surface", "contour")
    words = [
        ("written by auto" if shape in form.auto else "yes") if shape in form.shapes else "no"
        for shape in shapes
    ]
    return [*words, "yes" if form.suffix in MESH_READERS else "no"]


def _trace() -> str:
    rows = [
        (f"`{name}`", column.unit or "none", column.help) for name, column in TRACE_COLUMNS.items()
    ]
    lines = [
        "# Trace",
        "",
        "`NAME_trace.csv` has a line for each step: the state at its beginning, then what the step did. Of several",
        "objects the lines stand one object after the other, after a column `object`.",
        "",
    ]
    return "\n".join([*lines, *_table(("Column", "Unit", "Meaning"), rows)])


def _report() -> str:
    lines = [
        "# Report",
        "",
        "`NAME_report.json` is written for each run, also for one that fails. Every key is always there; what is not",
        "known is null.",
        "",
    ]
    return "\n".join(
        [
            *lines,
            *_table(("Key", "Meaning"), [(f"`{key}`", text) for key, text in REPORT_KEYS.items()]),
        ]
    )


def _exit_codes() -> str:
    rows = [(str(code), meaning) for code, meaning in EXIT_CODES.items()]
    return "\n".join(["# Exit codes", "", *_table(("Code", "Meaning"), rows)])


def _limits() -> str:
    rows = [
        (one.what, f"{one.limit} {one.unit}" + (f" per {one.per}" if one.per else ""), one.hint)
        for one in BUDGETS
    ]
    numbers = (
        f"Settings and weights: 0, or of a size from {MAGNITUDES[0]:g} to {MAGNITUDES[1]:g}.",
        f"Values of an image: finite, at most {MAX_VALUE:g}, with a range of at least {MIN_RANGE:g}. Larger ones often "
        "mean that there is no value, as those that are NaN do: replace them first.",
        f"Voxels: {SPACING_RANGE[0]:g} to {SPACING_RANGE[1]:g} mm; the origin at most {MAX_ORIGIN:g} mm from 0.",
        "Masked arrays of numpy are refused when a value is masked.",
    )
    return "\n".join(
        [
            *(
                "# Limits",
                "",
                *_wrapped(LIMITS_WHY),
                "",
                "## Budgets",
                "",
                *_table(("What", "At most", "Else"), rows),
            ),
            *(
                f"An energy has at most {MAX_TERMS} terms.",
                "",
                "## Numbers",
                "",
                *_listed(numbers),
                "",
            ),
            *("## Names and data files", "", *_listed(LIMITS_NAMES), "", "## How it is held", ""),
            *_wrapped(LIMITS_HELD),
        ]
    )


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 118)


def _listed(items: Iterable[str]) -> list[str]:
    return [
        line for item in items for line in textwrap.wrap(f"* {item}", 118, subsequent_indent="  ")
    ]


if __name__ == "__main__":
    main()
