"""The settings of how the image is read, one entry each; see `accelsurf.settings.fields`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from accelsurf.settings.entry import SettingEntry, SettingGroup, setting
from accelsurf.settings.reading import ReadOptions, spacing_of
from accelsurf.settings.run_fields import RunFields
from accelsurf.settings.written_values import checked_spacing

IMAGE = SettingGroup.IMAGE


class ImageFields(RunFields):
    """Which part of a file is the image, and where its voxels lie."""

    level: Annotated[int, Field(ge=0)] | Literal["auto"] = setting(
        0,
        "Level of an image that is stored as a pyramid (OME-Zarr); 0 is the finest, auto the finest that fits into the "
        "memory.",
        entry=SettingEntry(IMAGE, metavar="N|auto", fixed=True),
    )
    channel_index: Annotated[int, Field(ge=0)] | None = setting(
        None,
        "Channel of an image that has several, from 0 on.",
        entry=SettingEntry(IMAGE, metavar="N", fixed=True),
    )
    time_index: Annotated[int, Field(ge=0)] | None = setting(
        None,
        "Time point of an image that has several, from 0 on; needed then.",
        entry=SettingEntry(IMAGE, metavar="N", fixed=True),
    )
    channels_from_time: bool = setting(
        False,
        "The time points are channels of one image.",
        entry=SettingEntry(IMAGE, fixed=True),
    )
    series: str | None = setting(
        None,
        "Which series of a DICOM folder: its UID, or its number as accelsurf info FOLDER lists it.",
        entry=SettingEntry(IMAGE, metavar="UID|N", fixed=True),
    )
    spacing: Annotated[str | None, BeforeValidator(checked_spacing)] = setting(
        None,
        "Size of a voxel, X,Y,Z or one number, in mm or with a unit (0.2,0.2,1um), where the file does not say it.",
        entry=SettingEntry(IMAGE, metavar="X,Y,Z", fixed=True),
    )
    resample: bool = setting(
        False,
        "Put slices that lie on no regular grid (gaps, uneven spacing, a tilted gantry) on one, by linear "
        "interpolation.",
        entry=SettingEntry(IMAGE, fixed=True),
    )

    @property
    def reading(self) -> ReadOptions:
        """How the image is read."""
        return ReadOptions(
            self.level, self.channel_index, self.time_index, self.channels_from_time, self.series,
            None if self.spacing is None else spacing_of(self.spacing), self.resample,
        )
