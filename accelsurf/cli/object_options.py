"""Options of ``accelsurf segment`` for many objects in an image that is read in parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from accelsurf.cli import large_image
from accelsurf.cli.large_image import ImageParts
from accelsurf.errors import UsageError
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.cli.place import Place
    from accelsurf.segmentation.windowed import LargeImage

OBJECTS = Group("Many objects in a large image", sort_key=0)


@Parameter(name="*")
@dataclass(frozen=True)
class ObjectOptions:
    """How the objects of a large image are run."""

    jobs: Annotated[int | None, Parameter(group=OBJECTS, metavar="N", show_default="1")] = None
    """With --objects: read the image in parts, and run so many groups of objects at the same time, each in a process of
    its own. They share --max-memory. The result is the same."""

    scheduler: Annotated[str | None, Parameter(group=OBJECTS, metavar="ADDRESS")] = None
    """With --objects: the same on a Dask cluster: the address of its scheduler, or its scheduler file. --max-memory is
    that of each worker then. Image and outputs must have the same paths there."""

    @property
    def given(self) -> bool:
        """Whether the image is to be read in parts even if it fits."""
        return self.jobs is not None or self.scheduler is not None

    def check(self, config: RunConfig) -> None:
        """Refuse what does not fit together.

        Raises
        ------
        UsageError
        """
        if self.given and config.objects is None:
            raise UsageError("--jobs, --scheduler: were given without --objects", "accelsurf batch runs many images")
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"--jobs: {self.jobs} was given, expected a whole number at least 1", "leave it out")
        if self.jobs is not None and self.scheduler is not None:
            raise UsageError("--jobs: was given with --scheduler, which decides that itself", "leave one out")

    def image(self, place: Place, config: RunConfig, parts: ImageParts) -> LargeImage | None:
        """Return the image where its objects are to be run in groups; None where all is read into memory.

        Raises
        ------
        UsageError, InputError
            When the options do not fit together, or the image cannot be opened.
        """
        self.check(config)
        if config.objects is None:
            return None
        if self.given:
            return large_image.opened(place.source, config, parts)
        image = large_image.large_image(place.source, config, parts)
        return None if image is None or large_image.fits(image, config) else image
