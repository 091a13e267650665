"""Everything a run needs, validated once.

One model serves the command line, Python, batches and reports: it is read from TOML, written back to TOML without
loss, and described by a JSON schema. Its fields are in `accelsurf.settings.fields`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict, ValidationError, model_validator

from accelsurf.errors import UsageError
from accelsurf.settings import messages, toml
from accelsurf.settings.catalogue import default_of, entry, help_of, is_switch
from accelsurf.settings.edits import refuse_unknown
from accelsurf.settings.energy_expression import Term
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.expression import MAGNITUDES
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.flow_specs import spec_of
from accelsurf.settings.older import modern
from accelsurf.settings.presets import PRESETS

#: Settings that a run which begins and ends with a label map does not take.
_NOT_WITH_LABELS = (
    "start",
    "objects",
    "inside",
    "outside",
    "mask",
    "roi",
    "box",
    "edit",
    "levels",
    "size",
)
#: Largest whole number of TOML.
MAX_WHOLE = 2**63 - 1


def _with_clicks(values: dict[str, Any]) -> dict[str, Any]:
    """Settings with the energy and the start that clicks choose where none is given."""
    if values.get("labels") is not None:
        return {"energy": "seeded", **values}
    if not values.get("inside"):
        return values
    defaults = (
        {"energy": "seeded"}
        if values.get("objects") is not None
        else {"energy": "seeded", "start": ("clicks",)}
    )
    return {**defaults, **values}


class RunConfig(SettingFields):
    """Settings of one segmentation run.

    The fields are the options of ``accelsurf segment`` (``max_steps`` is ``--max-steps``) and the keys of a TOML
    configuration file. Instances cannot be changed; use :meth:`replace`.

    Raises
    ------
    UsageError
        When a key is unknown or a value is out of bounds. The message names the key, the value given and the
        expected one.

    Examples
    --------
    >>> config = RunConfig(start="ball:0,0,0,20", smoothness=0.5)
    >>> config.start, config.flow, config.diffusion
    (('ball:0,0,0,20',), 'auto', 'auto')
    >>> RunConfig(cfl=3)
    Traceback (most recent call last):
    ...
    accelsurf.errors.UsageError: cfl: 3 was given, expected a number greater than 0 and at most 1
    hint: ...
    """

    model_config = ConfigDict(defer_build=False)

    def __init__(self, **values: Any) -> None:
        # The validation refuses an unknown preset.
        preset = values.get("preset")
        under = (
            dict(PRESETS[preset].settings) if isinstance(preset, str) and preset in PRESETS else {}
        )
        if values.get("objects") is not None or values.get("labels") is not None:
            under.pop("start", None)  # objects are starts
        values = _with_clicks({**under, **values})
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise messages.usage_error(error, values) from None
        self._check_sizes()
        self._check_together()

    def _check_sizes(self) -> None:
        """Refuse numbers so large or small that nothing can be computed with them."""
        low, high = MAGNITUDES
        for key in type(self).model_fields:
            value = getattr(self, key)
            if isinstance(value, float) and value != 0 and not low <= abs(value) <= high:
                raise UsageError(
                    f"{key}: {value:g} was given, expected 0 or a size of {low:g} to {high:g}, as far as "
                    f"{messages.expected(key)} allows",
                    help_of(key),
                )
            if isinstance(value, int) and value > MAX_WHOLE:
                raise UsageError(
                    f"{key}: expected a whole number of at most {MAX_WHOLE}", help_of(key)
                )

    def _check_together(self) -> None:
        """Refuse values that are valid one by one but not together."""
        if self.reproducible and self.noise > 0 and self.seed is None:
            raise UsageError(
                f"seed: none was given, expected a whole number at least 0: noise {self.noise:g} is random and the run "
                "is to be reproducible",
                "add --seed 1, or leave --reproducible out",
            )
        if self.objects is not None and self.start != default_of("start"):
            raise UsageError(
                f"start: {' + '.join(self.start)} was given with objects {self.objects}, expected one of the two",
                "objects are starts: put what is to be segmented into that file",
            )
        if self.objects is not None and self.inside:
            raise UsageError(
                f"inside: {' + '.join(self.inside)} was given with objects {self.objects}, which does not say of which",
                "give the table of objects a column side, with a row for each click",
            )
        if self.labels is not None:
            for key in _NOT_WITH_LABELS:
                if getattr(self, key) != default_of(key) and (key, self.levels) != ("levels", 1):
                    raise UsageError(
                        f"{key}: it was given with labels {self.labels}, which are the result but for corrections",
                        "give clicks to accelsurf refine --labels, or the label map as a start: --start label:FILE",
                    )
        for edit in self.edit:
            refuse_unknown(edit, type(self).model_fields)
        if self.edit:
            self.at(self.edit[-1].step)

    @property
    def has_ids(self) -> bool:
        """True if the result has objects with ids: given to the run, or made by corrections.

        Examples
        --------
        >>> RunConfig().has_ids, RunConfig(refine=["new=2 inside=point:1,2,3"]).has_ids
        (False, True)
        """
        given = self.objects is not None or self.labels is not None
        return given or any(
            refinement.kind in ("new", "split", "remove") for refinement in self.refine
        )

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the energy.

        Examples
        --------
        >>> [term.name for term in RunConfig(energy="chan-vese + 0.1*area").terms]
        ['chan-vese', 'area']
        """
        return self.energy.terms

    def matters(self, key: str) -> bool:
        """Return True if a setting acts on this flow and energy.

        Examples
        --------
        >>> RunConfig(flow="gradient").matters("friction"), RunConfig().matters("smoothness")
        (False, True)
        """
        match entry(key).scope:
            case "flow":
                return key in spec_of(self.flow.name).uses
            case "term":
                return any(TERMS[term.name].is_used(key, term.settings) for term in self.terms)
            case _:
                return True

    def unused(self) -> list[str]:
        """Return the settings that were changed from their defaults and have no effect on this flow and energy.

        A preset has none where each of its values was given otherwise, is the default, or has none.

        Examples
        --------
        >>> RunConfig(flow="gradient", friction=0.1).unused()
        ['friction']
        >>> RunConfig(preset="mr-brain", energy="geodesic", cfl=0.5, tolerance=0.1).unused()
        ['balance', 'epsilon', 'preset']
        """
        changed = (key for key in type(self).model_fields if getattr(self, key) != default_of(key))
        found = [key for key in changed if not self.matters(key)]
        if self.preset is None:
            return found
        values, preset = PRESETS[self.preset].settings, type(self)(preset=self.preset)
        others = type(self)(**self.model_dump(include=self.model_fields_set - {*values, "preset"}))
        acts = any(
            getattr(others, key) != getattr(self, key) == getattr(preset, key)
            for key in values
            if self.matters(key)
        )
        return found if acts else [*found, "preset"]

    @model_validator(mode="before")
    @classmethod
    def _no_truth_for_numbers(cls, values: Any) -> Any:
        # Pydantic takes True for 1; in a configuration file that is always a mistake.
        for key, value in values.items() if isinstance(values, dict) else ():
            if isinstance(value, bool) and key in cls.model_fields and not is_switch(key):
                raise UsageError(*messages.complaint(key, value))
        return values

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed, validated again.

        Parameters
        ----------
        **changes
            New values by field name. With a ``preset`` among them, its values replace defaults and the values of
            the former preset; other given settings stay.

        Raises
        ------
        UsageError
            When a key is unknown or a value is out of bounds.

        Examples
        --------
        >>> RunConfig().replace(flow="gradient").flow
        'gradient'
        """
        # Given settings stay given and defaults stay defaults: the defaults of some settings depend on others.
        present = self.model_dump(include=self.model_fields_set)
        if "preset" in changes:
            under = PRESETS[self.preset].settings if self.preset is not None else {}
            former = type(self)(**{**under, "inside": self.inside})
            former = former.model_copy(update={"inside": default_of("inside")})
            present = {
                key: value for key, value in present.items() if value != getattr(former, key)
            }
        return type(self)(**{**present, **changes})

    def at(self, step: int) -> Self:
        """Return the settings in force at a step: with the edits up to it, and without later ones.

        Parameters
        ----------
        step : int
            Number of the step; its own edits are included.

        Raises
        ------
        UsageError
            When an edit has a value that is out of bounds.

        Examples
        --------
        >>> config = RunConfig(edit=["step=30 smoothness=0.5"])
        >>> config.at(29).smoothness, config.at(30).smoothness
        (0.0, 0.5)
        """
        now = self.model_copy(update={"edit": ()})
        for edit in self.edit:
            if edit.step > step:
                break
            try:
                now = now.replace(**edit.settings) if edit.settings else now
            except UsageError as error:
                raise UsageError(f"edit at step {edit.step}: {error.message}", error.hint) from None
        return now

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a configuration file; keys that are not in it keep their defaults.

        Parameters
        ----------
        path : str or Path
            TOML file with fields of this class at its top level.

        Raises
        ------
        UsageError
            When the file cannot be read, is not TOML, has an unknown key (the nearest valid one is named), or a
            value is out of bounds.
        """
        return cls(**modern(toml.read_toml(path)))

    def to_toml(self) -> str:
        """Return the configuration as TOML; :meth:`from_toml` gives an equal object back.

        Returns
        -------
        str
            One line per field, a table per edit and refinement; fields that are ``None`` are left out.

        Examples
        --------
        >>> print(RunConfig(mesh="ply,stl").to_toml())
        energy = "chan-vese"
        ...
        mesh = ["ply", "stl"]
        ...
        """
        return toml.toml_text(self.model_dump(), tables=("edit", "refine"))

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON schema of a configuration: types, bounds, defaults and descriptions.

        Examples
        --------
        >>> RunConfig.json_schema()["properties"]["cfl"]["maximum"]
        1
        """
        return cls.model_json_schema()
