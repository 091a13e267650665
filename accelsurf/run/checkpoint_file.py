"""File to which a run writes its state at intervals, and from which it goes on after it was killed."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Self

from accelsurf.grid.boxes import box_at
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window
from accelsurf.run.checkpoint import (
    CheckpointHeader,
    checkpoint_header,
    read_checkpoint,
    refuse_another_run,
    save_checkpoint,
    versions,
)
from accelsurf.run.late_growth import LateLeakage
from accelsurf.run.run import Run
from accelsurf.run.setup import needs_seed
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.toml import interval_of

#: Interval at which a run writes its state to its file, unless one is given.
_DEFAULT_INTERVAL = "1min"


class CheckpointFile:
    """An observer of a run: it writes the state of the run, and changes nothing.

    Parameters
    ----------
    path : Path
        Where it exists, the run continues from it.
    at_intervals : bool, optional
        Without, the state is written only where the run is asked to stop.
    """

    def __init__(self, path: Path, at_intervals: bool = True) -> None:
        self.path, self._at_intervals = path, at_intervals
        self._interval = interval_of(_DEFAULT_INTERVAL)
        self._header: CheckpointHeader | None = None
        self._written_at, self._seconds = 0, 0.0

    @classmethod
    def of(cls, given: str | Path | Self | None) -> Self | None:
        """Return the file that a caller names, if any."""
        return cls(Path(given)) if isinstance(given, (str, Path)) else given

    def begun(self, config: RunConfig) -> RunConfig:
        """The settings with the seed that the run drew when it began, where it continues and none is given.

        Raises
        ------
        InputError
            When the file is damaged.
        """
        if not needs_seed(config) or not self.path.exists():
            return config
        seed = read_checkpoint(self.path)[0].settings.get("seed")
        return config if seed is None else config.replace(seed=seed)

    def window(self, geometry: Geometry) -> Window | None:
        """The part of a large image, on the grid ``geometry``, on which the run continues; None where it begins anew.

        Raises
        ------
        InputError
            When the file is damaged.
        """
        if not self.path.exists():
            return None
        found = read_checkpoint(self.path)[0].window
        if found is None:
            return None
        return Window(geometry, box_at((found[0], found[1], found[2]), found[3:6]), found[6])

    def clear(self) -> None:
        """Remove the file: the run begins anew."""
        self.path.unlink(missing_ok=True)

    def restore(self, run: Run, growth: LateLeakage) -> list[str]:
        """Continue from the file, where it exists, and begin to count steps and seconds.

        Returns
        -------
        list of str
            Reasons for which the last bits of the result may differ from the result of a run that was never stopped.

        Raises
        ------
        InputError
            When the file is damaged, or of another run.
        """
        self._interval = interval_of(run.config.checkpoint or _DEFAULT_INTERVAL)
        self._header, warnings = checkpoint_header(run), []
        if self.path.exists():
            header, state = read_checkpoint(self.path)
            refuse_another_run(self.path, header, self._header)
            warnings = _differences(header)
            run.restore(state)
            if state.growth is not None:
                growth.restore(state.growth)
        self._written_at, self._seconds = run.step_number, time.monotonic()
        return warnings

    def watch(self, run: Run, growth: LateLeakage, at_once: bool = False) -> None:
        """Write the state if the interval is over, or ``at_once``; between two steps.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        assert self._header is not None  # restore() was called
        since = run.step_number - self._written_at, time.monotonic() - self._seconds
        if run.stop is None and (
            at_once or (self._at_intervals and self._interval.is_over(*since))
        ):
            save_checkpoint(
                self.path, run.checkpoint()._replace(growth=growth.state()), self._header
            )
            self._written_at, self._seconds = run.step_number, time.monotonic()


def _differences(header: CheckpointHeader) -> list[str]:
    """A line where a checkpoint was written by other versions, or on another kind of processor."""
    here = versions()
    other = [
        f"{name} {header.versions.get(name)}, here {version}"
        for name, version in here.items()
        if header.versions.get(name) != version
    ]
    if not other:
        return []
    return [
        f"the checkpoint was written with {'; '.join(other)}: the last bits of the result may differ"
    ]
