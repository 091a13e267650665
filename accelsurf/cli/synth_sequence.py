"""``accelsurf synth`` of a recipe in time: the sequence, its truth, and a table of the bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from accelsurf.io.files import write_bytes
from accelsurf.io.sequence_writing import SequenceWriter
from accelsurf.phantoms.motions import MotionRecipe, MovingPhantom
from accelsurf.report.document import to_json
from accelsurf.report.environment import versions
from accelsurf.report.file_entries import describe_drafts
from accelsurf.report.output_folder import naming_final, opened_set, refuse_existing
from accelsurf.report.tables import csv_text

#: Columns of the table of the bodies, as far as they go those of a table of tracks.
COLUMNS = ("frame", "time", "time_unit", "id", "parent", "x_mm", "y_mm", "z_mm", "volume_ml", "seen")
ML = 1e-3  # mm3


def synth_sequence(recipe: MotionRecipe, folder: Path, overwrite: bool) -> int:
    """Write the files of a recipe in time into a folder; returns the exit code."""
    paths = {
        "image": folder / f"{recipe.name}.nii.gz",
        "labels": folder / f"{recipe.name}_truth.nii.gz",
        "tracks": folder / f"{recipe.name}_truth.csv",
        "facts": folder / f"{recipe.name}.json",
    }
    phantom = MovingPhantom(recipe)
    with opened_set(folder, recipe.name) as files:
        refuse_existing(paths, overwrite)
        with naming_final(files):
            for kind, dtype in (("image", np.float32), ("labels", np.uint8)):
                draft = files.drafts / paths[kind].name
                with SequenceWriter(draft, phantom.geometry, phantom.times, phantom.time_unit, dtype) as writer:
                    for number in range(len(phantom)):
                        frame = phantom.frame(number).array if kind == "image" else phantom.truth(number)
                        writer.write(number, frame)
            lines = (
                (row.frame, row.time, phantom.time_unit, row.id, row.parent or "", *row.center, row.volume_mm3 * ML,
                 row.shown)
                for row in phantom.rows()
            )
            write_bytes(files.drafts / paths["tracks"].name, csv_text(COLUMNS, lines).encode())
            kinds = {paths[kind].name: kind for kind in ("image", "labels", "tracks")}
            facts = {
                "recipe": recipe.model_dump(mode="json"), "versions": versions(),
                "outputs": describe_drafts(files, kinds),
            }
            write_bytes(files.drafts / paths["facts"].name, (to_json(facts) + "\n").encode())
            files.commit(last=paths["facts"].name)
    for kind, path in paths.items():
        print(f"{kind:6} {path.absolute()}")
    return 0
