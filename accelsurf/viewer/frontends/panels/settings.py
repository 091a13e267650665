"""The panel of settings that change while the run goes on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtWidgets import QFormLayout, QLabel

from accelsurf.settings.catalogue import choices, help_of, sliders
from accelsurf.settings.entry import Slider
from accelsurf.viewer.frontends.panels.amount import Amount
from accelsurf.viewer.frontends.panels.section import Section, choice, show_choice
from accelsurf.viewer.workplace.tool import finest
from accelsurf.viewer.workplace.workplace import Workplace

#: Setting -> where the state lists its words.
_LISTS = {"energy": "energies", "flow": "flows"}


class SettingsPanel(Section):
    """Sliders and lists of settings."""

    def __init__(self, workplace: Workplace) -> None:
        super().__init__("Settings", workplace)
        smallest = finest(workplace.scene.geometry)
        form = QFormLayout(self.body)
        form.setSpacing(5)
        form.setContentsMargins(8, 2, 8, 6)
        self.choices = {key: choice(label=key) for key in choices()}
        self.amounts = {key: _amount(slider, smallest) for key, slider in sliders().items()}
        for key, made in self.choices.items():
            made.activated.connect(lambda _, key=key, made=made: self.ask("set", key, made.currentText()))
            made.setToolTip(help_of(key))
            form.addRow(key.capitalize(), made)
        for key, amount in self.amounts.items():
            amount.changed.connect(lambda value, key=key: self.ask("set", key, value))
            amount.setToolTip(help_of(key))
            form.addRow(QLabel(sliders()[key].label))
            form.addRow(amount)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the settings in force, except where the user is changing one."""
        settings = self.workplace.session.status.settings
        for key, made in self.choices.items():
            show_choice(made, state[_LISTS[key]], state[key])
        for key, amount in self.amounts.items():
            if not amount.is_being_moved:
                amount.show_value(state[key])
            amount.setEnabled(settings.matters(key))


def _amount(slider: Slider, smallest: float) -> Amount:
    """The widget of a setting, in an image whose smallest spacing is ``smallest`` mm."""
    unit = smallest**slider.voxel_power
    return Amount(slider.low * unit, slider.high * unit, slider.words, slider.power, slider.digits, slider.limit)
