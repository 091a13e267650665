"""The files of a run, each written completely, from the result and the settings of the run.

Meshes are smoothed, simplified, named and coloured as the settings say. `accelsurf.output.folder` has the names of
all files, and the place.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import NDArray

from accelsurf import io
from accelsurf.image.grey_window import parse_window
from accelsurf.interact import state_bytes
from accelsurf.io import LABELS_KEY, shows_patient, write_bytes
from accelsurf.measure import Contours
from accelsurf.output import layouts, tables
from accelsurf.output.document import describe_object
from accelsurf.output.folder import EACH, name_of
from accelsurf.output.label_files import LABEL_WRITERS, given_labels, is_named, table_of
from accelsurf.output.mesh_files import MeshNotes, is_shaped, shaped
from accelsurf.output.pictures import preview
from accelsurf.output.pictures.preview_content import ObjectShape, PreviewContent, marks_of
from accelsurf.settings.labels import LabelEntry, LabelTable
from accelsurf.settings.mesh_formats import LABEL_OUTPUTS
from accelsurf.settings.wording import size_text, volume_text

if TYPE_CHECKING:
    from accelsurf.measure import Surface
    from accelsurf.run import Result


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
        SHA-256 of the image as it was read; without it there is no state.
    meshes : MeshNotes, optional
        Statistics and warnings of meshes that were made smoother or coarser are added.

    Raises
    ------
    OutputError
        When a file cannot be written; those before it are complete.
    """
    seconds = {} if seconds is None else seconds
    began = time.perf_counter()
    has_surface = _has_surface(result)
    mesh_writers = list(_mesh_writers(result, names, meshes or MeshNotes())) if has_surface else []
    seconds["mesh"] = seconds.get("mesh", 0.0) + time.perf_counter() - began
    writers = [*_label_writers(result, names)] if has_surface else []
    writers += mesh_writers
    if "sdf" in names and has_surface:
        distance = functools.partial(io.write, result.labels_volume().with_array(result.psi))
        writers.append(("sdf", names["sdf"], distance))
    writers += [*_table_writers(result, names, content)]
    if result.state is not None and image is not None and has_surface:
        contents = {
            "state": lambda: state_bytes(result, image),
            "config": lambda: result.config.to_toml().encode(),
        }
        writers += [
            (kind, names[kind], _writer(content))
            for kind, content in contents.items()
            if kind in names
        ]
    for kind, name, write in writers:
        began = time.perf_counter()
        write(folder / name)
        seconds["write"] = seconds.get("write", 0.0) + time.perf_counter() - began
        yield kind, folder / name


def _writer(content: Callable[[], bytes]) -> Callable[[Path], None]:
    """Return the writer of a file of bytes, which are made when it is written."""
    return lambda path: write_bytes(path, content())


def _has_surface(result: Result) -> bool:
    return any(segmented.has_surface for segmented in result.objects)


def _write_labels(result: Result, labels: NDArray[Any], path: Path) -> None:
    """Write labels on the image's grid; of a result in a window they are 0 beyond it."""
    volume, window = result.labels_volume().with_array(labels), result.window
    if is_named(result.config):
        volume.metadata[LABELS_KEY] = (
            table_of(result.config).of(segmented.id for segmented in result.objects).to_json()
        )
    if window is None:
        io.write_labels(volume, path)
        return
    typed = volume.array.astype(io.label_type(int(volume.array.max())))
    with io.LabelStore(path, window.geometry, typed.dtype, volume.metadata) as store:
        store.write(window.box, typed)


def _label_writers(result: Result, names: Mapping[str, str]) -> Iterator[Writer]:
    """Yield the writers of the label map, and of further files of the objects."""
    if "labels" in names:
        yield "labels", names["labels"], functools.partial(_write_labels, result, result.labels)
    if layouts.SIDECAR in names:
        text = layouts.sidecar(Path(result.volume.source or ""), result.config.energy)
        yield layouts.SIDECAR, names[layouts.SIDECAR], _writer(text.encode)
    table = table_of(result.config)
    for kind in (kind for kind in names if kind.startswith("also-")):
        name = kind.partition("-")[2]
        if name in LABEL_OUTPUTS:
            yield (
                name,
                names[kind],
                functools.partial(_label_writer(name), result, table),
            )
        else:
            yield "labels", names[kind], functools.partial(_write_labels, result, result.labels)


def _label_writer(name: str) -> Callable[[Result, LabelTable, Path], None]:
    """Return the writer of a further file of the objects."""
    if LABEL_OUTPUTS[name].needs_dicom:
        from accelsurf.output import dicom  # loads pydicom

        return {
            "dicom-seg": dicom.write_segmentation,
            "dicom-labelmap": dicom.write_labelmap,
            "rtstruct": dicom.write_structure_set,
        }[name]
    return LABEL_WRITERS[name]


def _mesh_writers(result: Result, names: Mapping[str, str], notes: MeshNotes) -> Iterator[Writer]:
    """The writers of surfaces or contours, which are extracted here; of several objects those with a voxel."""
    kinds = [kind for kind in names if kind.startswith(EACH)]
    if not kinds:
        return
    is_2d, space = result.geometry.slice_axis is not None, result.config.mesh_space
    table = table_of(result.config) if is_named(result.config) else None
    for segmented in result.objects:
        if not segmented.has_surface:
            continue
        label = None if table is None else table[segmented.id]
        mesh, statistics = segmented.contours if is_2d else segmented.surface, None
        if not is_2d and is_shaped(result.config):
            mesh, statistics, warnings = shaped(segmented.surface, result.config)
            notes.warn(
                f"object {segmented.id}: {line}" if result.has_ids else line for line in warnings
            )
        for kind in kinds:
            name = name_of(names[kind], segmented.id) if result.has_ids else names[kind]
            if statistics is not None:
                notes.statistics[name] = statistics
            yield kind.partition("-")[0], name, functools.partial(_write_mesh, mesh, space, label)


def _write_mesh(
    mesh: Surface | Contours, space: Literal["lps", "ras"], label: LabelEntry | None, path: Path
) -> None:
    if isinstance(mesh, Contours):
        mesh.write(path, space)
    else:
        mesh.write(path, space, label)


def _table_writers(
    result: Result, names: Mapping[str, str], content: PreviewContent
) -> Iterator[Writer]:
    """The writers of the tables and of the picture."""
    if "objects" in names and result.has_ids:
        rows = [describe_object(segmented) for segmented in result.objects]
        yield "objects", names["objects"], _writer(lambda: tables.objects_csv(rows).encode())
    if "trace" in names:
        if result.has_ids:
            text = tables.objects_trace_csv(
                {segmented.id: segmented.history for segmented in result.objects}
            )
        else:
            text = tables.trace_csv(result.history)
        yield "trace", names["trace"], _writer(text.encode)
    if "preview" in names:
        yield "preview", names["preview"], _writer(lambda: preview.preview_png(content))
    if "statistics" in names and _has_surface(result):
        figures = tables.rows_of(result, table_of(result.config))
        yield (
            "statistics",
            names["statistics"],
            _writer(tables.statistics_csv(figures, result).encode),
        )
        yield (
            "statistics",
            names["statistics-json"],
            _writer(tables.statistics_json(figures, result).encode),
        )


def outcome_title(name: str, result: Result) -> str:
    """Return the heading of a picture: how the run ended, and how large the object is."""
    unit = result.geometry.unit
    if result.enclosed_mm2 is not None:
        size = size_text(result.enclosed_mm2, unit, 2)
    else:
        size = volume_text(result.estimates.volume_mm3, unit)
    reason = "" if result.stop.reason == "converged" else f", {result.stop.reason}"
    return f"{name}: {size}{_likely(result)}{reason}"


def _likely(result: Result) -> str:
    """Say how likely the object is good, of a single one."""
    found = result.objects[0]
    if result.has_ids or not found.has_surface:
        return ""
    return f", {found.quality.likely}"


def preview_content(result: Result, title: str) -> PreviewContent:
    """Return the content of a picture of a result.

    Parameters
    ----------
    result : Result
    title : str
        Its heading.
    """
    shapes = [ObjectShape(found.id, found.box, found.psi) for found in result.objects]
    return PreviewContent(
        image=result.volume.array,
        psi=result.psi,
        geometry=result.geometry,
        history=result.run_history,
        steps_left_out=len(result.history) - len(result.run_history),
        start=result.start,
        title=title,
        anatomical=shows_patient(result.volume),
        objects=shapes if result.has_ids else (),
        late_growth=result.late_leakage,
        next_clicks=_next_clicks(result),
        window=parse_window(result.config.window),
        unit=result.geometry.unit,
        labels=given_labels(result.config),
        clicks=marks_of(
            result.clicks.clicks if result.clicks is not None else (), result.geometry.spacing
        ),
    )


def _next_clicks(result: Result) -> list[tuple[float, float, float]]:
    """Return the voxels of the suggested next clicks, the most uncertain object's first."""
    judged = [segmented.quality for segmented in result.objects if segmented.has_surface]
    places = []
    for quality in sorted(judged, key=lambda quality: quality.probability):
        if quality.next_click is not None:
            z, y, x = (float(at) for at in result.geometry.world_to_index(quality.next_click))
            places.append((z, y, x))
    return places
