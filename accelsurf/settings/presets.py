"""Presets: settings for a kind of scan, each with the meaning of its values and the scans that it was tried on.

They are in ``presets.toml`` beside this file, whose head has the rules for their content.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from accelsurf.settings.registry import by_name


class Preset(NamedTuple):
    """Settings for a kind of scan.

    Attributes
    ----------
    name : str
        Value of ``--preset``.
    summary : str
        Purpose, and the start that it needs.
    settings : mapping
        Values of `RunConfig` by name; those not named keep their defaults.
    reasons : mapping
        Meaning of each of these values, by the same names.
    tried : mapping of str to str
        Outcome on the volumes that it was tried on, by their public source.
    """

    name: str
    summary: str
    settings: Mapping[str, Any]
    reasons: Mapping[str, str]
    tried: Mapping[str, str]


def _built_in() -> Iterator[Preset]:
    tables = tomllib.loads(Path(__file__).with_name("presets.toml").read_text(encoding="utf-8"))
    for name, table in tables.items():
        values = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in table["settings"].items()
        }
        yield Preset(name, table["summary"], values, table["reasons"], table["tried"])


PRESETS: dict[str, Preset] = by_name(*_built_in())
