"""The settings of tracking, one entry each: type, bounds, default, help and unit.

The command line, TOML files, the report and the reference pages take them from here, and the formats of tracks. The
settings of the run on each frame are in `accelsurf.settings.fields`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from accelsurf.settings.corrections import FrameCorrections
from accelsurf.settings.energy_expression import EnergyText
from accelsurf.settings.entry import OneOf, SettingEntry, SettingGroup, setting
from accelsurf.settings.file_formats import DEFAULT_IMAGE_FORMAT, label_formats
from accelsurf.settings.mesh_formats import MESH_FORMATS
from accelsurf.settings.registry import by_name
from accelsurf.settings.toml import all_split


@dataclass(frozen=True)
class TrackFormat:
    """A file, or a folder, of tracks; `accelsurf.track.output.outputs` writes it.

    Attributes
    ----------
    name : str
        As it is given to ``--also``.
    help : str
        Description in a few words.
    ending : str
        Of its name, after the name of the sequence.
    mark : str
        A file in it, where it is a folder: by this it is known as one that may be replaced. Empty: it is a file.
    """

    name: str
    help: str
    ending: str
    mark: str = ""


TRACK_FORMATS: dict[str, TrackFormat] = by_name(
    TrackFormat(
        "ctc",
        "folder of the Cell Tracking Challenge: res_track.txt and a TIFF for each frame",
        "RES",
        mark="res_track.txt",
    ),
    TrackFormat(
        "geff",
        "folder of the Graph Exchange File Format",
        "tracks.geff",
        mark=".zattrs",
    ),
    TrackFormat(
        "surfaces",
        "folder of surfaces, prediction beside correction, for accelsurf view --tracks",
        "surfaces",
        mark="surfaces.json",
    ),
    TrackFormat(
        "mp4",
        "movie of slices, prediction beside correction",
        "movie.mp4",
    ),
    TrackFormat("gif", "the same as GIF", "movie.gif"),
    TrackFormat(
        "webp",
        "the same as WebP",
        "movie.webp",
    ),
)


def track_format_help() -> str:
    """Return the formats with their descriptions, for the help of ``--also``."""
    return ", ".join(f"{name} ({entry.help})" for name, entry in TRACK_FORMATS.items())


TRACK = SettingGroup.TRACK
#: Two gains, each from 0 to 1, as they are written.
GAINS = (
    r"^(0|1|0?\.[0-9]{1,9}|1\.0{1,9}|0\.[0-9]{1,9}),(0|1|0?\.[0-9]{1,9}|1\.0{1,9}|0\.[0-9]{1,9})$"
)


def _gains_text(value: Any) -> Any:
    """Two numbers as their text."""
    if isinstance(value, (list, tuple)):
        return ",".join(
            f"{number:g}" if isinstance(number, (int, float)) else str(number) for number in value
        )
    return value.replace(" ", "") if isinstance(value, str) else value


class TrackFields(BaseModel):
    """The fields of `accelsurf.settings.track_config.TrackConfig`, without its methods."""

    # Nobody makes a record of a part of the settings: only the class of all of them gets a validator.
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, defer_build=True
    )

    frame: int = setting(
        0,
        "Frame, from 0, in which the start lies and objects are segmented first. Of a label map (--start label:FILE, "
        "--objects FILE) the objects are kept as they are, unless --correct asks for a change of that frame.",
        entry=SettingEntry(TRACK, metavar="N"),
        ge=0,
    )
    direction: Literal["forward", "backward", "both"] = setting(
        "both",
        "From that frame to the last one, back to the first, or both.",
        entry=SettingEntry(TRACK, metavar="WAY"),
    )
    model: Literal["flowable-mass", "last-displacement", "none"] = setting(
        "flowable-mass",
        "What carries a surface from frame to frame: its momentum as flowable mass (it may travel, turn and "
        "deform); the last displacement of its centroid; or nothing, each frame begins where the last one ended.",
        entry=SettingEntry(TRACK, metavar="NAME"),
    )
    observer: Annotated[Annotated[str, Field(pattern=GAINS)], BeforeValidator(_gains_text)] = (
        setting(
            "1,1",
            "Gains of the correction on each frame, 0 to 1: part of the way from the prediction to what the frame "
            "shows that the surface goes, and part of the missing velocity that is added. Less is steadier in noise, "
            "and slower.",
            entry=SettingEntry(TRACK, metavar="KPSI,KV"),
        )
    )
    friction: Annotated[float, Field(ge=0)] | Literal["auto"] = setting(
        "auto",
        "Friction between frames, per unit of the sequence's time: relative motion within the surface falls by "
        "exp(-A) in a unit. auto is 0.5 per frame.",
        entry=SettingEntry(TRACK, unit="1/time", metavar="A|auto"),
    )
    next_energy: Annotated[Literal["auto"] | EnergyText, Field(union_mode="left_to_right")] = (
        setting(
            "auto",
            "Energy of the frames after the first; auto is that of the first. What it learns it learns anew in each "
            "frame, from the inner half of the prediction. Where its run leaves given labels, the image near them is "
            "learned.",
            entry=SettingEntry(TRACK, metavar="EXPRESSION"),
        )
    )
    max_gap: int = setting(
        5,
        "Number of frames after which an object that is not seen ends; until then it goes on by its momentum, and can "
        "come back.",
        entry=SettingEntry(TRACK, metavar="FRAMES"),
        ge=0,
    )
    divide: Literal["yes", "no"] = setting(
        "yes",
        "Whether parts of a surface that come apart become objects of their own, if they are no crumbs: a fifth of the "
        "largest part.",
        entry=SettingEntry(TRACK, metavar="yes|no"),
    )
    merge: Literal["yes", "no"] = setting(
        "no",
        "Whether objects that touch, without an edge of the image between them, become one. Otherwise they stay apart.",
        entry=SettingEntry(TRACK, metavar="yes|no"),
    )
    enter: Literal["yes", "no"] = setting(
        "no",
        "Whether what appears in later frames, as bright as the tracked objects and about as large, is followed too.",
        entry=SettingEntry(TRACK, metavar="yes|no"),
    )
    correct: FrameCorrections = setting(
        (),
        "Correction of a frame, from which the tracking goes on: 'frame=12 inside=point:X,Y,Z object=2', or with "
        "outside, new, remove, split or merge, as accelsurf refine takes them; may be repeated.",
        entry=SettingEntry(TRACK, metavar="WORDS", repeated=True),
    )
    frame_time: float | None = setting(
        None,
        "Time from one frame to the next, s; by default what the file says, else times are numbers of frames.",
        entry=SettingEntry(SettingGroup.IMAGE, unit="s", metavar="S"),
        gt=0,
    )
    frames_from_slices: bool = setting(
        False,
        "The slices of a volume are frames, as in a TIFF stack that does not name its axis.",
        entry=SettingEntry(SettingGroup.IMAGE),
    )
    format: Annotated[str, OneOf(label_formats)] = setting(
        DEFAULT_IMAGE_FORMAT,
        "Format of the label maps: {}.",
        entry=SettingEntry(
            SettingGroup.FILES, metavar="NAME", listed=lambda: ", ".join(label_formats())
        ),
    )
    per_frame: bool = setting(
        False,
        "Write a label map for each frame in place of one file with time.",
        entry=SettingEntry(SettingGroup.FILES),
    )
    mesh: Annotated[
        tuple[Annotated[str, OneOf(lambda: MESH_FORMATS)], ...], BeforeValidator(all_split)
    ] = setting(
        (),
        "Formats of meshes, separated by commas, of each object in each frame: {}; none by default. The vertices are "
        "the same material points from frame to frame.",
        entry=SettingEntry(
            SettingGroup.FILES,
            metavar="NAMES",
            repeated=True,
            listed=lambda: ", ".join(MESH_FORMATS),
        ),
    )
    mesh_space: Literal["lps", "ras"] = setting(
        "lps",
        "Coordinates of meshes.",
        entry=SettingEntry(SettingGroup.FILES, metavar="lps|ras"),
    )
    also: Annotated[
        tuple[Annotated[str, OneOf(lambda: TRACK_FORMATS)], ...], BeforeValidator(all_split)
    ] = setting(
        (),
        "Further files, separated by commas: {}.",
        entry=SettingEntry(
            SettingGroup.FILES, metavar="NAMES", repeated=True, listed=track_format_help
        ),
    )
