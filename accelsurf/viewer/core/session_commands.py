"""What can be asked of a session: commands, carried out between two steps; each returns a Future at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from accelsurf.analysis.diameters import Diameters
from accelsurf.grid.clicks import Side
from accelsurf.viewer.core.saved_kinds import KINDS
from accelsurf.viewer.core.size_drag import FIRST_VOXELS, SizeDrag

if TYPE_CHECKING:
    from accelsurf.segmentation.run import Run
    from accelsurf.viewer.core.figures import Figures
    from accelsurf.viewer.core.object_commands import ObjectCommands
    from accelsurf.viewer.core.timeline import Timeline

T = TypeVar("T")


class SessionCommands:
    """The commands of a session; who derives from it says how one is carried out.

    Attributes
    ----------
    name : str
        First part of the names of files.
    source : Path or None
        The image's file.
    """

    name: str
    source: Path | None

    def _do(self, work: Callable[[Timeline], T], changes: bool = True) -> Future[T]:
        """Have a command carried out on the timeline."""
        raise NotImplementedError

    def play(self) -> Future[None]:
        """Make steps until the run ends or is paused; a converged run continues, with its stop rule reset."""
        return self._do(lambda timeline: timeline.play())

    def play_to(self, step: int) -> Future[None]:
        """Make steps until there are so many."""
        return self._do(lambda timeline: timeline.play(step))

    def single_step(self) -> Future[None]:
        """Make one step; asked for twice at once, two. A run that plays is paused after it."""
        return self._do(lambda timeline: timeline.single_step())

    def pause(self) -> Future[None]:
        """Pause after the present step."""
        return self._do(lambda timeline: timeline.pause())

    def go_to(self, step: int) -> Future[None]:
        """Go back, or forward again, to a step; where it has no checkpoint the steps before it are made again."""
        return self._do(lambda timeline: timeline.go_to(step))

    def restart(self) -> Future[None]:
        """Begin again from the start with the settings in force; without the balls that were added or removed."""
        return self._do(lambda timeline: timeline.restart())

    def change(self, **settings: Any) -> Future[None]:
        """Change settings from the present step on.

        Raises
        ------
        UsageError
            From the Future, when a setting is not valid; nothing is changed then.
        """
        return self._do(lambda timeline: timeline.change(settings))

    def change_files(self, **settings: Any) -> Future[None]:
        """Change settings of the files that are saved: formats of meshes and labels, names and layout; the run goes on.

        Raises
        ------
        UsageError
            From the Future, when one is no such setting or not valid; nothing is changed then.
        """
        return self._do(lambda timeline: timeline.files.change(settings))

    def edit_ball(
        self, kind: Literal["add", "remove"], ball: str, object_id: int | None = None, joined: bool = False
    ) -> Future[None]:
        """Add a ball, ``ball:X,Y,Z,R``, to an object, or remove one from it, see `edit_balls`."""
        return self.edit_balls(kind, (ball,), object_id, joined)

    def edit_balls(
        self, kind: Literal["add", "remove"], balls: Sequence[str], object_id: int | None = None, joined: bool = False
    ) -> Future[None]:
        """Add balls, ``ball:X,Y,Z,R``, to an object, or remove them from it: one change.

        Of several objects it is the one with this id, or else the one that is nearest to the first ball's centre. A
        change that is ``joined``, a further part of a stroke, is undone together with the change before it. What is no
        ball or lies outside is refused.
        """
        texts = tuple(balls)
        return self._do(lambda timeline: timeline.edit_balls(kind, texts, object_id, joined))

    def add_click(self, side: Side, where: str | Sequence[str], object_id: int | None = None) -> Future[None]:
        """Say of voxels that they are in the object, or are not, as `--inside` takes them: balls, points, paths.

        Several at once are one stroke: one change. They take voxels that they contradict from earlier ones. While the
        run goes on they are an edit; after its end a correction, as `accelsurf refine` makes it. Of several objects it
        is the one with this id, or else the one that is nearest to where the first begins. What is no place, lies
        outside, or would leave nothing clicked inside is refused.
        """
        texts = (where,) if isinstance(where, str) else tuple(where)
        return self._do(lambda timeline: timeline.add_click(side, texts, object_id))

    def press(self, ball: str, voxels: int = FIRST_VOXELS, object_id: int | None = None) -> Future[SizeDrag]:
        """Begin to drag the size of an object from a ball in it, ``ball:X,Y,Z,R``.

        The answer has the arrival times: what they show for any size is read from it in the caller's own thread, so
        that a drag never waits for a step. They reach ``voxels`` voxels; `size_drag.Dragging` asks for more when a
        drag needs them. `release` ends it. Of several objects one is named; with an id that none has it is a new one.
        What is no ball or lies outside is refused.
        """
        return self._do(lambda timeline: timeline.objects.press(ball, voxels, object_id))

    def release(self, drag_mm: float) -> Future[None]:
        """Play another run from what was pressed, of a size that a drag of so many mm stands for; others stay."""
        return self._do(lambda timeline: timeline.objects.release(drag_mm))

    def objects(self, work: Callable[[ObjectCommands], Any]) -> Future[None]:
        """Have objects merged, split, removed, named or coloured; all or nothing."""
        return self._do(lambda timeline: work(timeline.objects))

    def start_from(self, start: Sequence[str]) -> Future[None]:
        """Begin another run from another start, with the settings in force."""
        return self._do(lambda timeline: timeline.start_from(tuple(start)))

    def restart_with(self, **settings: Any) -> Future[None]:
        """Begin another run from the start with other settings, also those that are fixed while a run runs.

        Clicks stay, balls that were added or removed do not. A ``preset`` overrides the settings in force, but for what
        it needs clicks for where there are none yet.

        Raises
        ------
        UsageError, InputError
            From the Future, when a setting is not valid, or no run can be made with it; nothing is changed then.
        """
        return self._do(lambda timeline: timeline.restart_with(settings))

    def look(self, work: Callable[[Run], T]) -> Future[T]:
        """Have a function read the run between two steps; it must change nothing, and no new view follows."""
        return self._do(lambda timeline: work(timeline.run), changes=False)

    def undo(self) -> Future[None]:
        """Undo the last change, and go to the step where it was made."""
        return self._do(lambda timeline: timeline.undo())

    def redo(self) -> Future[None]:
        """Make the change again that was undone last."""
        return self._do(lambda timeline: timeline.redo())

    def figures(self) -> Future[Figures]:
        """Compute the figures of the objects as they are now: volume, surface, intensities, diameters."""
        return self._do(_figures)

    def diameters(self, object_id: int) -> Future[Diameters]:
        """Compute the longest lines of an object as it is now; fails when it has no voxel."""
        return self._do(lambda timeline: _diameters(timeline, object_id))

    def go_to_change(self, count: int) -> Future[None]:
        """Undo changes, or make them again, until the first ``count`` of `Status.changes` are in force; in one go."""
        return self._do(lambda timeline: timeline.go_to_change(count))

    def save(
        self, folder: Path, what: Sequence[str] = KINDS, overwrite: bool = False
    ) -> Future[list[Path]]:
        """Write files into a folder as `accelsurf segment` does, and ``run.toml``, which repeats the run.

        Parameters
        ----------
        folder : Path
            Made when missing.
        what : sequence of str
            Of `saved_kinds.KINDS`.
        overwrite : bool
            Replace files that another session or program has written; those of this one are always replaced.

        Raises
        ------
        OutputError, UsageError
            From the Future; files written before stay whole.
        """
        kinds = tuple(what)
        return self._do(lambda timeline: timeline.save(Path(folder), self.name, self.source, kinds, overwrite))


# Both are called in the session's thread, which has loaded the solver; who asks may do so before.
def _figures(timeline: Timeline) -> Figures:
    from accelsurf.viewer.core.figures import figures_of

    return figures_of(timeline)


def _diameters(timeline: Timeline, object_id: int) -> Diameters:
    from accelsurf.viewer.core.figures import diameters_of

    return diameters_of(timeline, object_id)
