"""Names and colours of the objects of a run: from its settings, and from the files that they name."""

from __future__ import annotations

from pathlib import Path

from accelsurf.errors import InputError
from accelsurf.io import label_tables
from accelsurf.settings.labels import LabelEntry, LabelTable
from accelsurf.settings.run_config import RunConfig

#: What the one object of a run without ids is called.
ONE = "object"


def table_of(config: RunConfig) -> LabelTable:
    """Return what is known of labels: the table of the settings, else that of a label map of objects; then names and
    colours of the settings.

    Raises
    ------
    InputError
        When a table cannot be read.
    """
    known = LabelTable()
    if config.label_table is not None:
        known = label_tables.read(config.label_table)
    elif config.objects is not None and config.objects.partition("@")[0].lower().endswith((".seg.nrrd", ".dcm")):
        try:
            known = label_tables.read(Path(config.objects.partition("@")[0]))
        except InputError:
            known = LabelTable()  # a label map of that name without segments is a label map
    if not config.has_ids and 1 not in known.entries:
        known = LabelTable({**known.entries, 1: LabelEntry(1, ONE, known[1].color)})
    return known.with_settings(config.name, config.color)


def given_of(config: RunConfig) -> LabelTable:
    """Return `table_of` where settings or the file of the objects name labels, else an empty table.

    What draws objects has colours of its own for those that nothing was said of.

    Raises
    ------
    InputError
        When a table cannot be read.

    Examples
    --------
    >>> given_of(RunConfig(name=["liver"])).entries[1].name, given_of(RunConfig()).entries
    ('liver', {})
    """
    return table_of(config) if is_named(config) or config.objects is not None else LabelTable()


def is_named(config: RunConfig) -> bool:
    """Whether the settings name labels, so that label maps carry names."""
    return bool(config.name or config.color or config.label_table)
