"""``--resume``: what a run that is repeated finds of an earlier one in its folder."""

from __future__ import annotations

from dataclasses import replace

from accelsurf.cli.place import Place
from accelsurf.io import is_stored
from accelsurf.io.file_set import finish_killed_runs
from accelsurf.report import result_sets
from accelsurf.settings.run_config import RunConfig


def code_of_ended(place: Place, config: RunConfig, quiet: bool = False) -> int | None:
    """The exit code of a run that has ended with these settings, of this image, which is said unless ``quiet``.

    None where there is something to do.

    Raises
    ------
    OutputError
        When files of a killed run cannot be put in place.
    """
    if not place.folder.is_dir():
        return None
    finish_killed_runs(place.folder)
    document = result_sets.load_report(place.report_path)
    if document is None or document["status"] != "ok" or not is_stored(place.source):
        return None
    if not result_sets.is_of(document, config, place.source):
        return None
    there = result_sets.unchanged_outputs(place.report_path, ())
    if len(there) < len(document["outputs"]):
        return None
    if not quiet:
        print(f"{place.name}: has ended already, see {place.report_path.absolute()}")
    return int(document["exit_code"])


def taken_up(place: Place, config: RunConfig) -> Place:
    """The place to go on at: the files of a run that was interrupted or failed may be replaced."""
    is_free = result_sets.unfinished_alone(place.report_path, place.paths(config).values())
    return replace(place, resume=True, overwrite=place.overwrite or is_free)
