"""The files of a run, each written completely; `output_names` says which."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.analysis import shared_walls
from accelsurf.analysis.contours import Contours
from accelsurf.grid.grey_window import parse_window
from accelsurf.io.files import write_bytes
from accelsurf.io.headers import LABELS_KEY, UNIT_KEY, is_anatomical
from accelsurf.report import layouts, object_files, preview, statistics_files, tables
from accelsurf.report.document import describe_objects
from accelsurf.report.label_names import given_of, is_named, table_of
from accelsurf.report.mesh_files import MeshNotes, is_shaped, shaped
from accelsurf.report.preview_content import ObjectShape, PreviewContent, marks_of
from accelsurf.segmentation.state_file import state_bytes
from accelsurf.settings.label_outputs import LABEL_OUTPUTS
from accelsurf.settings.labels import LabelEntry
from accelsurf.settings.registry import load
from accelsurf.settings.wording import size_text, volume_text

if TYPE_CHECKING:
    from accelsurf.analysis.surface_mesh import Surface
    from accelsurf.segmentation.result import Result

#: Kind of a file, its name, and the function that writes it.
Writer = tuple[str, str, Callable[[Path], None]]


def write_result(
    result: Result,
    folder: Path,
    names: Mapping[str, str],
    content: PreviewContent,
    seconds: dict[str, float] | None = None,
    image: str | None = None,
    meshes: MeshNotes | None = None,
) -> Iterator[tuple[str, Path]]:
    """Write the files of a result, yielding kind and path of each when it is complete.

    A result without a surface has a trace and a picture only, one of several objects also its table.

    Parameters
    ----------
    result : Result
    folder : Path
        Where they go; it exists.
    names : mapping of str to str
        Name of the file by kind, as from `names`; other kinds are not written. Of several objects, surfaces and
        contours get the object's id into their names.
    content : PreviewContent
        For ``preview``.
    seconds : dict, optional
        The durations of ``mesh`` and ``write`` are added.
    image : str, optional
        SHA-256 of the image's file; without it there is no state.
    meshes : MeshNotes, optional
        What is said of meshes that were made smoother or coarser is added.

    Raises
    ------
    OutputError
        When a file cannot be written; those before it are complete.
    """
    seconds = {} if seconds is None else seconds
    began = time.perf_counter()
    own_meshes = list(_mesh_writers(result, names, MeshNotes() if meshes is None else meshes))
    seconds["mesh"] = seconds.get("mesh", 0.0) + time.perf_counter() - began
    writers = [*_label_writer(result, names), *_also_writers(result, names), *_rest_writers(result, names), *own_meshes]
    writers += _distance_writer(result, names)
    writers += [*_table_writers(result, names, content), *_state_writers(result, names, image)]
    for kind, name, write in writers:
        began = time.perf_counter()
        write(folder / name)
        seconds["write"] = seconds.get("write", 0.0) + time.perf_counter() - began
        yield kind, folder / name


def _has_surface(result: Result) -> bool:
    return any(one.has_surface for one in result.objects)


def _label_writer(result: Result, names: Mapping[str, str]) -> Iterator[Writer]:
    """The writer of the label map."""
    if "labels" in names and _has_surface(result):
        yield "labels", names["labels"], lambda path: _write_labels(result, result.labels, path)


def _write_labels(result: Result, labels: NDArray[Any], path: Path) -> None:
    """Write labels on the image's grid; of a result in a window they are 0 beyond it."""
    volume, window = result.labels_volume().with_array(labels), result.window
    if is_named(result.config):
        volume.metadata[LABELS_KEY] = table_of(result.config).of(one.id for one in result.objects).to_json()
    if window is None:
        io.write_labels(volume, path)
        return
    own = volume.array.astype(io.label_type(int(volume.array.max())))
    with io.LabelStore(path, window.geometry, own.dtype, volume.metadata) as store:
        store.write(window.box, own)


def _also_writers(result: Result, names: Mapping[str, str]) -> Iterator[Writer]:
    """The writers of further files of the objects."""
    if not _has_surface(result):
        return
    table = table_of(result.config)
    if layouts.SIDECAR in names:
        text = layouts.sidecar(Path(result.volume.source or ""), result.config.energy)
        yield layouts.SIDECAR, names[layouts.SIDECAR], lambda path: write_bytes(path, text.encode())
    for kind in (kind for kind in names if kind.startswith("also-")):
        name = kind.partition("-")[2]
        if name in LABEL_OUTPUTS:
            yield name, names[kind], functools.partial(load(LABEL_OUTPUTS[name].write), result, table)
        else:
            yield "labels", names[kind], functools.partial(_write_labels, result, result.labels)


def _rest_writers(result: Result, names: Mapping[str, str]) -> Iterator[Writer]:
    """The writers of the label maps of rests: each object at that rest, or without it as it is."""
    count = max((len(one.rests) for one in result.objects), default=0)
    for number in range(1, count + 1):
        if (kind := f"rest{number}") in names:
            yield kind, names[kind], functools.partial(_write_rest, result, number)


def _write_rest(result: Result, number: int, path: Path) -> None:
    labels = np.zeros_like(result.labels)
    for one in result.objects:
        own = one.labels if len(one.rests) < number else one.rests[number - 1].labels
        part = labels[one.box]
        part[(own > 0) & (part == 0)] = one.id
    _write_labels(result, labels, path)


def _distance_writer(result: Result, names: Mapping[str, str]) -> Iterator[Writer]:
    """The writer of the signed distance."""
    if "sdf" in names and _has_surface(result):
        yield "sdf", names["sdf"], lambda path: io.write(result.labels_volume().with_array(result.psi), path)


def _state_writers(result: Result, names: Mapping[str, str], image: str | None) -> Iterator[Writer]:
    """The writers of the state, and of the settings that repeat the run."""
    if result.state is None or image is None or not _has_surface(result):
        return
    if "state" in names:
        yield "state", names["state"], lambda path: write_bytes(path, state_bytes(result, image))
    if "config" in names:
        yield "config", names["config"], lambda path: write_bytes(path, result.config.to_toml().encode())


def _mesh_writers(result: Result, names: Mapping[str, str], notes: MeshNotes) -> Iterator[Writer]:
    """The writers of surfaces or contours, which are extracted here; of several objects those with a voxel."""
    kinds = [kind for kind in names if kind.startswith(object_files.EACH)]
    if not kinds or not _has_surface(result):
        return
    is_2d, space = result.geometry.slice_axis is not None, result.config.mesh_space
    common = {} if is_2d or result.config.mesh_walls == "own" else shared_walls.extract(result.objects, result.geometry)
    table = table_of(result.config) if is_named(result.config) else None
    for one in result.objects:
        if not one.has_surface:
            continue
        label = None if table is None else table[one.id]
        mesh, facts = one.contours if is_2d else common.get(one.id, one.surface), None
        if not is_2d and is_shaped(result.config):
            mesh, facts, warnings = shaped(one.surface, result.config)
            notes.warnings += [f"object {one.id}: {line}" if result.has_ids else line for line in warnings]
        for kind in kinds:
            name = object_files.name_of(names[kind], one.id) if result.has_ids else names[kind]
            if facts is not None:
                notes.facts[name] = facts
            yield kind.partition("-")[0], name, functools.partial(_write_mesh, mesh, space, label)


def _write_mesh(
    mesh: Surface | Contours, space: Literal["lps", "ras"], label: LabelEntry | None, path: Path
) -> None:
    if isinstance(mesh, Contours):
        mesh.write(path, space)
    else:
        mesh.write(path, space, label)


def _table_writers(result: Result, names: Mapping[str, str], content: PreviewContent) -> Iterator[Writer]:
    """The writers of the tables and of the picture."""
    if "objects" in names and result.has_ids:
        rows = describe_objects(result)
        yield "objects", names["objects"], lambda path: write_bytes(path, tables.objects_csv(rows).encode())
    if "trace" in names:
        if result.has_ids:
            text = tables.objects_trace_csv({one.id: one.history for one in result.objects})
        else:
            text = tables.trace_csv(result.history)
        yield "trace", names["trace"], lambda path: write_bytes(path, text.encode())
    if "preview" in names:
        yield "preview", names["preview"], lambda path: write_bytes(path, preview.preview_png(content))
    if "statistics" in names and _has_surface(result):
        figures = statistics_files.rows_of(result, table_of(result.config))
        text_csv = statistics_files.statistics_csv(figures, result)
        text_json = statistics_files.statistics_json(figures, result)
        yield "statistics", names["statistics"], lambda path: write_bytes(path, text_csv.encode())
        yield "statistics", names["statistics-json"], lambda path: write_bytes(path, text_json.encode())


def outcome_title(name: str, result: Result) -> str:
    """Return the heading of a picture: how the run ended, and how large the object is."""
    unit = result.volume.metadata.get(UNIT_KEY, "mm")
    if result.enclosed_mm2 is not None:
        size = size_text(result.enclosed_mm2, unit, 2, digits=4)
    else:
        size = volume_text(result.volume_mm3) if unit == "mm" else size_text(result.volume_mm3, unit, 3, digits=4)
    return f"{name}: {size}, {result.config.flow} flow, {result.stop.steps} steps, {result.stop.reason}"


def preview_content(result: Result, title: str, reference: Any = None) -> PreviewContent:
    """Return what a picture of a result shows.

    Parameters
    ----------
    result : Result
    title : str
        Its heading.
    reference : ndarray, optional
        Labels to draw as a second contour.
    """
    is_2d = result.geometry.slice_axis is not None
    return PreviewContent(
        image=result.volume.array,
        psi=result.psi,
        geometry=result.geometry,
        history=result.run_history,
        steps_left_out=len(result.history) - len(result.run_history),
        surface=result.surface if not is_2d and _has_surface(result) else None,
        start=result.start,
        title=title,
        anatomical=is_anatomical(result.volume.metadata),
        reference=reference,
        objects=_object_shapes(result) if result.has_ids else (),
        late_growth=result.late_growth,
        next_clicks=_next_clicks(result),
        window=parse_window(result.config.window),
        unit=result.volume.metadata.get(UNIT_KEY, "mm"),
        labels=given_of(result.config),
        clicks=marks_of(result.clicks.clicks if result.clicks is not None else (), result.geometry.spacing),
    )


def _next_clicks(result: Result) -> list[tuple[float, float, float]]:
    """Where it is said to click next, the most doubtful object's first."""
    judged = [one.quality for one in result.objects if one.has_surface]
    places = []
    for quality in sorted(judged, key=lambda quality: quality.probability):
        if quality.next_click is not None:
            z, y, x = (float(at) for at in result.geometry.world_to_index(quality.next_click))
            places.append((z, y, x))
    return places


def _object_shapes(result: Result) -> tuple[ObjectShape, ...]:
    """What is drawn of each of several objects."""
    is_2d = result.geometry.slice_axis is not None
    return tuple(
        ObjectShape(one.id, one.box, one.psi, len(one.surface.vertices) if one.has_surface and not is_2d else 0)
        for one in result.objects
    )
