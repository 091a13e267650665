"""``accelsurf synth``: a synthetic volume and its truth from a recipe."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from accelsurf.cli.options import Output, Overwrite, required


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
    from accelsurf.cli.synth_files import write_sequence, write_volume
    from accelsurf.phantoms import motions, recipe_files, recipes

    folder = required(output, "-o DIR, the output folder,")
    path, values = recipe_files.read_recipe(recipe)
    if seed is not None:
        values["seed"] = seed
    if "motion" in values:
        paths = write_sequence(motions.motion_from(values, str(path)), folder, overwrite)
    else:
        paths = write_volume(recipes.recipe_from(values, str(path)), folder, overwrite)
    for kind, written in paths.items():
        print(f"{kind:6} {written.absolute()}")
    return 0
