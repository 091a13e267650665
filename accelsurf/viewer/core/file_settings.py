"""Which files a session writes: settings that change nothing of a run, so that they may be given at any time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from accelsurf.errors import UsageError
from accelsurf.settings.catalogue import entry
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.change_words import in_words

if TYPE_CHECKING:
    from accelsurf.viewer.core.timeline import Timeline


class FileSettings:
    """The settings of the files of a timeline, in place of those of its run.

    Parameters
    ----------
    timeline : Timeline

    Attributes
    ----------
    changed : dict
        Those that were given.
    """

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self.changed: dict[str, Any] = {}
        self._last: tuple[RunConfig, RunConfig] | None = None

    def change(self, settings: Mapping[str, Any]) -> None:
        """Write other files from now on.

        Raises
        ------
        UsageError
            When one is no setting of files, or is not valid; nothing is changed then.
        """
        for key in settings:
            if key not in RunConfig.model_fields or entry(key).group is not SettingGroup.FILES:
                raise UsageError(f"{key}: it says nothing of the files that are written")
        now = self._timeline.run.settings.replace(**{**self.changed, **settings})
        self.changed |= {key: getattr(now, key) for key in settings}
        self._last = None
        self._timeline.say(in_words({key: self.changed[key] for key in settings}))

    def in_force(self, settings: RunConfig) -> RunConfig:
        """Settings of the run with those of the files; the same object while both stay the same."""
        if not self.changed:
            return settings
        if self._last is None or self._last[0] is not settings:
            self._last = settings, settings.replace(**self.changed)
        return self._last[1]
