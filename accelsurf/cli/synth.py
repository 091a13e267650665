"""``accelsurf synth``: a synthetic volume or sequence and its truth, from a recipe; all files or none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from accelsurf import io
from accelsurf.cli.options import Output, Overwrite, required
from accelsurf.io import FileSet, SequenceWriter, table_text, write_bytes
from accelsurf.output import OutputFolder, describe_staged, naming_final, report_json, versions
from accelsurf.phantoms import recipe_files, recipes
from accelsurf.phantoms.motions import MovingPhantom
from accelsurf.phantoms.recipes import Recipe

if TYPE_CHECKING:
    from accelsurf.phantoms.tissues import TissuePhantom

#: Columns of the table of the bodies, as far as they go the columns of a table of tracks.
COLUMNS = (
    "frame",
    "time",
    "time_unit",
    "id",
    "parent",
    "x_mm",
    "y_mm",
    "z_mm",
    "volume_ml",
    "seen",
)
#: Ends of the names of files by their kind.
VOLUME = {"image": ".nii.gz", "labels": "_truth.nii.gz", "facts": ".json"}
SEQUENCE = {"image": ".nii.gz", "labels": "_truth.nii.gz", "tracks": "_truth.csv", "facts": ".json"}


def synth(
    recipe: Annotated[str, Parameter(name="RECIPE")],
    *,
    output: Output = None,
    seed: int | None = None,
    overwrite: Overwrite = False,
) -> int:
    """Make a synthetic volume and its truth from a recipe.

    Writes NAME.nii.gz (the image), NAME_truth.nii.gz (the labels) and NAME.json (the recipe as used, and the exact
    volume and area where a formula gives them). A recipe in time makes sequences, and NAME_truth.csv: of each body and
    frame the parent, the centre and the exact volume.

    Parameters
    ----------
    recipe
        A TOML file, or the name of a recipe that comes with accelsurf; `accelsurf info recipes` lists them.
    output
        Folder for the outputs; made when missing.
    seed
        Seed of noise and bias; overrides the recipe's.
    overwrite
        Replace outputs that exist.
    """
    folder = required(output, "-o DIR, the output folder,")
    path, values = recipe_files.read_recipe(recipe)
    if seed is not None:
        values["seed"] = seed
    if "motion" in values or "tissue" in values:
        from accelsurf.phantoms.tissues import phantom_from

        paths = write_sequence(phantom_from(values, str(path)), folder, overwrite)
    else:
        paths = write_volume(recipes.recipe_from(values, str(path)), folder, overwrite)
    for kind, written in paths.items():
        print(f"{kind:6} {written.absolute()}")
    return 0


def write_volume(recipe: Recipe, folder: Path, overwrite: bool) -> dict[str, Path]:
    """Write the files of a recipe of a single volume into a folder; they are returned by their kind."""

    def write(files: FileSet, paths: dict[str, Path]) -> dict[str, Any]:
        phantom = recipes.make(recipe)
        with naming_final(files):
            io.write(phantom.image, files.staging / paths["image"].name)
            io.write_labels(phantom.truth, files.staging / paths["labels"].name)
        return {
            "recipe": recipe.model_dump(mode="json"),
            "volume_mm3": phantom.volume_mm3,
            "area_mm2": phantom.area_mm2,
            "truth_voxels": int(phantom.truth.array.sum()),
        }

    return _written(recipe.name, VOLUME, folder, overwrite, write)


def write_sequence(
    phantom: MovingPhantom | TissuePhantom, folder: Path, overwrite: bool
) -> dict[str, Path]:
    """Write the files of a phantom in time into a folder; they are returned by their kind."""
    from accelsurf.track import ML

    def write(files: FileSet, paths: dict[str, Path]) -> dict[str, Any]:
        with naming_final(files):
            for kind, dtype in (("image", np.float32), ("labels", np.uint8)):
                staged = files.staging / paths[kind].name
                with SequenceWriter(
                    staged, phantom.geometry, phantom.times, phantom.time_unit, dtype
                ) as writer:
                    for number in range(len(phantom)):
                        frame = (
                            phantom.frame(number).array
                            if kind == "image"
                            else phantom.truth(number)
                        )
                        writer.write(number, frame)
            lines = (
                (
                    row.frame,
                    row.time,
                    phantom.time_unit,
                    row.id,
                    row.parent or "",
                    *row.center,
                    row.volume_mm3 * ML,
                    row.shown,
                )
                for row in phantom.rows()
            )
            write_bytes(files.staging / paths["tracks"].name, table_text(COLUMNS, lines).encode())
        return {"recipe": phantom.recipe.model_dump(mode="json")}

    return _written(phantom.recipe.name, SEQUENCE, folder, overwrite, write)


def _written(
    name: str,
    ends: dict[str, str],
    folder: Path,
    overwrite: bool,
    write: Callable[[FileSet, dict[str, Path]], dict[str, Any]],
) -> dict[str, Path]:
    """Write a set of files by ``write``, which returns the description, and these last."""
    paths = {kind: folder / f"{name}{end}" for kind, end in ends.items()}
    with OutputFolder(folder, name, overwrite=overwrite).stage(paths) as files:
        description = write(files, paths)
        with naming_final(files):
            kinds = {path.name: kind for kind, path in paths.items() if kind != "facts"}
            description |= {"versions": versions(), "outputs": describe_staged(files, kinds)}
            write_bytes(
                files.staging / paths["facts"].name, (report_json(description) + "\n").encode()
            )
            files.commit(last=paths["facts"].name)
    return paths
