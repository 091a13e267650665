"""Options of the functions of accelsurf, by name: with their types, which an editor completes and a type checker reads.

For type checkers alone: the values are checked by `accelsurf.settings`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol, TypedDict

from accelsurf.io.library_images import ImageLike
from accelsurf.settings.corrections import Correction
from accelsurf.settings.edits import Edit

class Mesh(Protocol):
    """A mesh: vertices (n, 3) and faces (m, 3), mm, LPS."""

    @property
    def vertices(self) -> Any: ...
    @property
    def faces(self) -> Any: ...

Given = ImageLike | Mesh | Sequence[ImageLike | Mesh]
Texts = str | Sequence[str]

class GivenTexts(TypedDict, total=False):
    """Starts, masks and clicks as texts."""

    start: Texts
    inside: Texts
    outside: Texts
    foreground: Texts
    background: Texts
    mask: str

class ManyOptions(Options, GivenTexts, total=False):
    """Settings of all cases of `segment_many`."""

    energy: str
    objects: str
    spacing: str | float

class GivenOptions(Options, total=False):
    """Options of a run: a start, mask or click may also be an array, an image, a mesh, points or balls."""

    start: Given
    inside: Given
    outside: Given
    foreground: Given
    background: Given
    mask: Given

class SegmentOptions(GivenOptions, total=False):
    """Options of `segment`; ``max_memory`` is of a LazyVolume alone."""

    objects: str
    max_memory: str

# Written by `python -m docs.reference.generate`.
class Shared(TypedDict, total=False):
    """Settings of a run and of a tracking, where they are the same."""

    preset: Literal["ct-skeleton", "mr-brain", "mr-white-matter", "membrane-cells", "fluorescence-nucleus"] | None
    smoothness: float
    presmooth: float | str
    closing: float | str
    clip: str | None
    size: str | None
    answer: int
    max_volume: float | None
    levels: int | Literal["auto"]
    roi: str | None
    box: str | None
    flow: str
    labels: str | None
    channel: str | Sequence[str]
    balance: float
    edge_scale: float | Literal["auto"]
    edge_contrast: float | Literal["auto"]
    balloon: float
    diffusion: float | Literal["auto", "free"]
    noise: float
    restart: Literal["auto", "off"]
    cfl: float
    max_steps: int
    tolerance: float
    percentile: float
    epsilon: float
    half_width: int | Literal["auto"]
    seed: int | None
    reproducible: bool
    threads: Literal["auto"] | int
    edit: str | Sequence[str | Edit | Mapping[str, Any]]
    stop_at_rest: bool
    refine: str | Sequence[str | Correction | Mapping[str, Any]]
    extension: Literal["closest-point", "fast-marching"]
    end: Literal["lowest", "present"]
    level: int | Literal["auto"]
    channel_index: int | None
    time_index: int | None
    channels_from_time: bool
    series: str | None
    mesh_smooth: float
    mesh_faces: int | None
    mesh_error: float | None
    save_sdf: bool
    keep_state: Literal["auto", "yes", "no"]
    checkpoint: str | None
    name: str | Sequence[str]
    color: str | Sequence[str]
    label_table: str | None
    label_group: str | None
    window: str
    layout: Literal["plain", "bids", "nnunet"]

class Options(Shared, total=False):
    """Settings of `RunConfig` but for the energy, the objects, and what may be an array."""

    friction: float | Literal["t"]
    mesh: str | Sequence[str] | Literal["auto"]
    mesh_space: Literal["lps", "ras"]
    format: Literal["nii.gz", "nii", "nrrd", "mha", "mhd", "ome.zarr", "png", "tif", "npy"] | None
    also: str | Sequence[str]

class TrackOptions(Shared, GivenTexts, total=False):
    """Settings of `track`."""

    frame: int
    direction: Literal["forward", "backward", "both"]
    model: Literal["flowable-mass", "last-displacement", "none"]
    observer: str
    friction: float | Literal["auto"]
    next_energy: Literal["auto"] | str
    max_gap: int
    divide: Literal["yes", "no"]
    merge: Literal["yes", "no"]
    enter: Literal["yes", "no"]
    correct: str | Sequence[str | Correction | Mapping[str, Any]]
    frame_time: float | None
    frames_from_slices: bool
    format: Literal["nii.gz", "nii", "nrrd", "mha", "mhd", "ome.zarr", "png", "tif", "npy"]
    per_frame: bool
    mesh: str | Sequence[str]
    mesh_space: Literal["lps", "ras"]
    also: str | Sequence[str]
