"""What is special about a run of several objects: its outputs, and what is wrong with its result."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelsurf.errors import (
    AccelsurfError,
    DivergedError,
    DoubtfulError,
    EmptyResultError,
    NotConvergedError,
    OutputError,
)
from accelsurf.io.files import write_bytes
from accelsurf.report import document, preview

if TYPE_CHECKING:
    from accelsurf.cli.case import Case
    from accelsurf.segmentation.several import ObjectsResult
    from accelsurf.settings.run_config import RunConfig

Writer = Callable[[Path], None]
#: Kinds of outputs that there is one of for each object.
EACH = ("surface", "contour")


def paths(case: Case, names: dict[str, str]) -> dict[str, Path]:
    """Return the outputs by kind, as far as they are known before the ids are, and meshes that there are already."""
    whole = {kind: name for kind, name in names.items() if not kind.startswith(EACH)} | {"objects": "objects.csv"}
    out = {kind: case.folder / f"{case.name}_{name}" for kind, name in whole.items()}
    return out | {path.name: path for path in meshes(case, names)}


def meshes(case: Case, names: dict[str, str]) -> list[Path]:
    """Return the files there are that are named as the mesh of an object, whatever its id."""
    each = (names[kind].partition(".") for kind in names if kind.startswith(EACH))
    known = re.compile(
        "|".join(rf"{re.escape(f'{case.name}_{stem}')}_[1-9][0-9]*\.{suffix}" for stem, _, suffix in each)
    )
    there = case.folder.iterdir() if case.folder.is_dir() else ()
    return sorted(path for path in there if known.fullmatch(path.name))


def remove_old(case: Case, names: dict[str, str], written: Collection[Path]) -> None:
    """Remove meshes of objects that this run does not have: with the new label map they would be taken for its own.

    Raises
    ------
    OutputError
        When one cannot be removed.
    """
    for path in meshes(case, names):
        if path not in written:
            try:
                path.unlink()
            except OSError as error:
                raise OutputError(
                    f"{path}: cannot be removed ({error.strerror or error})", "choose another folder with -o"
                ) from None


def writers(
    case: Case, config: RunConfig, result: ObjectsResult, names: dict[str, str], picture: preview.Scene
) -> dict[Path, tuple[str, Writer]]:
    """Return what is to be written: path to kind and what writes it. Objects without a voxel have no mesh."""
    from accelsurf import io

    out: dict[Path, tuple[str, Writer]] = {}

    def add(name: str, kind: str, writer: Writer) -> None:
        out[case.folder / f"{case.name}_{name}"] = kind, writer

    if result.labels.any():
        add(names["labels"], "labels", lambda path: io.write_labels(result.labels_volume(), path))
        for own, one in result.objects.items():
            for kind in (kind for kind in names if kind.startswith(EACH) and one.labels.any()):
                stem, _, suffix = names[kind].partition(".")
                add(f"{stem}_{own}.{suffix}", kind.partition("-")[0], _mesh_writer(case, one, config))
        if config.save_sdf:
            add(names["sdf"], "sdf", lambda path: io.write(result.labels_volume().with_array(result.psi), path))
    rows = document.describe_objects(result)
    add("objects.csv", "objects", lambda path: _write(path, document.objects_csv(rows)))
    histories = {own: one.history for own, one in result.objects.items()}
    add(names["trace"], "trace", lambda path: _write(path, document.objects_trace_csv(histories)))
    add(names["preview"], "preview", lambda path: write_bytes(path, preview.preview_png(picture)))
    return out


def _mesh_writer(case: Case, one: Any, config: RunConfig) -> Writer:
    def write(path: Path) -> None:
        (one.contours if case.is_2d else one.surface).write(path, config.mesh_space)

    return write


def _write(path: Path, text: str) -> None:
    write_bytes(path, text.encode())


def shortcoming(case: Case, result: ObjectsResult) -> AccelsurfError | None:
    """Say what is wrong with a run of several objects, or None. Short of an error it is a warning.

    An object that vanished is a warning; it is an error when none is left.
    """
    told = f"{case.name}: {result.stop.message}"
    if not result.labels.any():
        return EmptyResultError(told, "start closer to the objects, or with less --smoothness")
    if result.stop.reason == "diverged":
        return DivergedError(told, "use a smaller --cfl; and please report this image and its settings")
    late, doubts = [], []
    for own, one in result.objects.items():
        if one.stop.reason in ("max-steps", "stalled"):
            late.append(f"object {own}: {one.stop.reason} after {one.stop.steps} steps: {one.stop.message}")
        elif not one.labels.any():
            doubts.append(f"object {own}: vanished after {one.stop.steps} steps")
        doubts += [f"object {own}: {doubt}" for doubt in one.quality.warnings if one.labels.any()]
    if case.strict and late:
        return NotConvergedError(f"{late[0]}{_more(late)}", "raise --max-steps; the outputs show how far it got")
    if case.strict and doubts:
        hint = "look at the picture; without --strict it is a warning"
        return DoubtfulError(f"{doubts[0]}{_more(doubts)}", hint)
    case.warnings.extend(late + doubts)
    return None


def _more(told: list[str]) -> str:
    return f" (and {len(told) - 1} more)" if len(told) > 1 else ""


def summary(case: Case, result: ObjectsResult) -> list[str]:
    """Return the lines that a person sees at the end: how objects ended, what they are, what was written."""
    lines = [
        f"{case.name}: {result.stop.message}; up to {result.stop.steps} steps, {case.seconds['total']:.1f} s",
        f"volume {result.volume_mm3:.6g} mm3, area {result.area_mm2:.6g} mm2 in all",
    ]
    if case.is_2d:
        lines[1] = f"area {result.enclosed_mm2:.6g} mm2, length {result.length_mm:.6g} mm in all"
    seen: dict[str, list[str]] = {}
    for output in case.outputs:
        seen.setdefault(output["kind"], []).append(output["path"])
    for kind, written in seen.items():
        more = f" and {len(written) - 1} more" if len(written) > 1 else ""
        lines.append(f"  {kind:8} {written[0]}{more}")
    return [*lines, f"  {'report':8} {case.report_path.absolute()}"]
