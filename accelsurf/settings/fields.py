"""The settings of a run, one entry each: type, bounds, default, help, unit and more.

The command line, TOML files, the viewer, the JSON schema, ``accelsurf info`` and the reference pages follow from these
entries. Lengths are in mm unless the help says voxels. The fields are in `run_fields`, `image_fields` and
`output_fields`.
"""

from __future__ import annotations

from accelsurf.settings.output_fields import OutputFields


class SettingFields(OutputFields):
    """The fields of `accelsurf.settings.run_config.RunConfig`, without what it does with them."""
