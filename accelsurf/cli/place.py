"""Where the image of a case is, and where its files go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from accelsurf.report import layouts, output_names, result_sets
from accelsurf.report.inputs import inputs_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig


@dataclass(frozen=True)
class Place:
    """Where the image of a case is, and where its outputs go.

    Attributes
    ----------
    source : Path
        The image.
    folder : Path
    name : str
        First part of every output's name.
    overwrite : bool
        Whether existing outputs may be replaced.
    resume : bool
        Whether the run goes on from the checkpoint of an earlier one.
    has_checkpoint : bool
        Whether it may have one: a correction has none.
    further : tuple of Path or None
        Files that the command reads beside the image and what its settings name.
    """

    source: Path
    folder: Path
    name: str
    overwrite: bool = False
    resume: bool = False
    has_checkpoint: bool = True
    further: tuple[Path | None, ...] = ()

    @classmethod
    def of(cls, source: Path, folder: Path, overwrite: bool = False, *further: Path | None) -> Place:
        """The place of an image whose outputs have its name, without suffix; ``further`` files are read, too."""
        from accelsurf.io.headers import name_of

        return cls(source, folder, name_of(source), overwrite, further=further)

    def inputs(self, config: RunConfig | TrackConfig | None) -> list[Path]:
        """All files that the command reads: none of them may be replaced."""
        return inputs_of(self.source, config, *self.further)

    @property
    def report_path(self) -> Path:
        """Where the report goes."""
        return self.folder / result_sets.report_name(self.name)

    @property
    def checkpoint_path(self) -> Path:
        """Where the state of the run is while it goes on."""
        return self.folder / f"{self.name}_checkpoint.npz"

    def beside_result(self, config: RunConfig | None) -> Place:
        """Where the files of a failed run go: here, or where a result stands beside it, under other names."""
        planned = self.paths(config or RunConfig()).values()
        if result_sets.result_stands(self.folder, self.name, planned):
            return replace(self, name=self.name + result_sets.FAILED)
        return self

    def label_format(self, config: RunConfig) -> str:
        """The format of the label map."""
        from accelsurf.io import split_name

        return output_names.label_format(config, split_name(self.source)[1])

    def names(self, config: RunConfig, is_2d: bool | None = None) -> dict[str, str]:
        """Name of every output by its kind; before the image is read (``is_2d`` is None), of all possible ones."""
        names = output_names.names(config, self.label_format(config), is_2d)
        names = {kind: f"{self.name}_{name}" for kind, name in names.items()}
        return layouts.renamed(config, self.source, self.name, names)

    def laid_out(self, config: RunConfig) -> Place:
        """Where the files go in the layout of the settings.

        Raises
        ------
        UsageError
            When the image cannot be in that layout.
        """
        layouts.check(config, self.source, self.folder, self.name)
        return replace(self, folder=layouts.folder_of(config, self.source, self.folder))

    def paths(self, config: RunConfig) -> dict[str, Path]:
        """Every possible output by kind, the report last; of several objects those that exist already."""
        names = self.names(config)
        if not config.has_ids:
            paths = {kind: self.folder / name for kind, name in names.items()}
        else:
            paths = {k: self.folder / name for k, name in names.items() if not k.startswith(output_names.EACH)}
            paths |= {path.name: path for path in output_names.existing(self.folder, names)}
        return paths | {"report": self.report_path}
