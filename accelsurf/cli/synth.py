"""``accelsurf synth``: a synthetic volume and its truth from a recipe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from accelsurf.cli.options import Output, Overwrite, required

if TYPE_CHECKING:
    from accelsurf.phantoms.recipes import Recipe


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
        A TOML file, or the name of a recipe that comes with accelsurf; `accelsurf info` lists them.
    output
        Folder for the outputs; made when missing.
    seed
        Seed of noise and bias; overrides the recipe's.
    overwrite
        Replace outputs that exist.
    """
    from accelsurf.cli.synth_sequence import synth_sequence
    from accelsurf.phantoms import motions, recipes

    folder = required(output, "-o DIR, the output folder,")
    if (moving := motions.load_motion(recipe)) is not None:
        return synth_sequence(moving if seed is None else moving.model_copy(update={"seed": seed}), folder, overwrite)
    used = recipes.load_recipe(recipe)
    return _synth_volume(used if seed is None else used.changed(seed=seed), folder, overwrite)


def _synth_volume(used: Recipe, folder: Path, overwrite: bool) -> int:
    """Write the files of a recipe of a single volume into a folder; returns the exit code."""
    from accelsurf import io
    from accelsurf.io.files import write_bytes
    from accelsurf.phantoms import recipes
    from accelsurf.report.document import to_json
    from accelsurf.report.environment import versions
    from accelsurf.report.file_entries import describe_drafts
    from accelsurf.report.output_folder import naming_final, opened_set, refuse_existing

    paths = {
        "image": folder / f"{used.name}.nii.gz",
        "labels": folder / f"{used.name}_truth.nii.gz",
        "facts": folder / f"{used.name}.json",
    }
    with opened_set(folder, used.name) as files:
        refuse_existing(paths, overwrite)
        phantom = recipes.make(used)
        with naming_final(files):
            io.write(phantom.image, files.drafts / paths["image"].name)
            io.write_labels(phantom.truth, files.drafts / paths["labels"].name)
            facts = {
                "recipe": used.model_dump(mode="json"),
                "volume_mm3": phantom.volume_mm3,
                "area_mm2": phantom.area_mm2,
                "truth_voxels": int(phantom.truth.array.sum()),
                "versions": versions(),
                "outputs": describe_drafts(files, {paths[kind].name: kind for kind in ("image", "labels")}),
            }
            write_bytes(files.drafts / paths["facts"].name, (to_json(facts) + "\n").encode())
            files.commit(last=paths["facts"].name)
    for kind, path in paths.items():
        print(f"{kind:6} {path.absolute()}")
    return 0
