"""Plug-in of napari: opens images and result folders, has phantoms, and a widget for clicks (`widget`).

``napari.yaml`` beside this file is its manifest. It knows public names of accelsurf alone. Layers have the axes of the
array, z, y, x, and the size of a voxel in mm as their scale; the direction of an oblique scan is not shown.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import accelsurf

#: As napari takes a layer: its data, its settings, its type.
LayerData = tuple[Any, dict[str, Any], str]


def reader(path: str | Sequence[str]) -> Callable[[str], list[LayerData]] | None:
    """Return the function that opens an image or a folder with results; None for anything else."""
    if not isinstance(path, str):
        return None
    if Path(path).is_dir():
        return open_results if any(_reports(Path(path))) else None
    return open_image


def open_image(path: str) -> list[LayerData]:
    """Open an image of any format that accelsurf reads."""
    return [_layer(accelsurf.read(path), Path(path).name, "image")]


def open_results(path: str) -> list[LayerData]:
    """Open the results in a folder: for each the image, where it is still there, the labels, the doubtful places.

    Raises
    ------
    InputError
        When the labels of a result cannot be read.

    Warns
    -----
    UserWarning
        When the image of a result cannot be opened.
    """
    layers: list[LayerData] = []
    for file, report in _reports(Path(path)):
        name = file.name.removesuffix("_report.json")
        written = [
            Path(output["path"]).name for output in report["outputs"] if output["kind"] == "labels"
        ]
        for labels in written[:1]:
            volume = accelsurf.read_labels(Path(path) / labels)
            image = _image_of(report, name)
            if image is not None and image.geometry.matches(volume.geometry):
                layers.append(_layer(image, name, "image"))
            layers.append(_layer(volume, f"{name} labels", "labels"))
            layers += _doubtful(report, volume, name)
    return layers


def _image_of(report: dict[str, Any], name: str) -> accelsurf.Volume | None:
    """Return the image of a result; None, with a warning, where it cannot be read."""
    source, settings = (report.get("input") or {}).get("path"), report.get("config") or {}
    try:
        if not isinstance(source, str):
            raise accelsurf.InputError("the report names none")
        asked = {field.name for field in fields(accelsurf.RunConfig().reading)} & settings.keys()
        run = accelsurf.RunConfig(**{key: settings[key] for key in asked})
        return accelsurf.read(source, options=run.reading)
    except accelsurf.AccelsurfError as error:
        warnings.warn(f"{name}: its image cannot be opened ({error})", stacklevel=3)
        return None


def torus() -> list[LayerData]:
    """Return a ring in noise, and its truth."""
    return _phantom("torus")


def two_balls() -> list[LayerData]:
    """Return two balls that touch, and their truth."""
    return _phantom("two_balls")


def vessel() -> list[LayerData]:
    """Return a vessel with branches, and its truth."""
    return _phantom("vessel")


def _phantom(name: str) -> list[LayerData]:
    made = accelsurf.phantom(name)
    truth = _layer(made.truth, f"{name} truth", "labels")
    return [_layer(made.image, name, "image"), (truth[0], truth[1] | {"visible": False}, "labels")]


def _layer(volume: accelsurf.Volume, name: str, kind: str) -> LayerData:
    return (
        volume.array,
        {"name": name, "scale": volume.geometry.spacing, "units": ("mm",) * 3},
        kind,
    )


def _reports(folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield the reports of complete runs in a folder."""
    for file in sorted(folder.glob("*_report.json")):
        report = accelsurf.load_report(file)
        if report is not None and "schema_version" in report and report["status"] == "ok":
            yield file, report


def _doubtful(report: dict[str, Any], labels: accelsurf.Volume, name: str) -> list[LayerData]:
    """Return a layer with the most doubtful place of each object."""
    objects = [each for each in report.get("objects") or () if isinstance(each, dict)]
    found = [report.get("quality"), *(each.get("quality") for each in objects)]
    seen = [quality for quality in found if isinstance(quality, dict) and _has_place(quality)]
    if not seen:
        return []
    places = labels.geometry.world_to_index([quality["next_click"] for quality in seen])
    probability = [quality["probability"] for quality in seen]
    settings = _layer(labels, f"{name} doubtful", "points")[1]
    return [
        (
            places,
            settings | {"symbol": "diamond", "size": 5, "features": {"probability": probability}},
            "points",
        )
    ]


def _has_place(quality: dict[str, Any]) -> bool:
    """Test if a report names a place and a probability; it may have come with somebody's data."""
    place = quality.get("next_click")
    if not isinstance(place, list) or len(place) != 3:
        return False
    return all(
        isinstance(number, (int, float)) and abs(number) < 1e9
        for number in (*place, quality.get("probability"))
    )
