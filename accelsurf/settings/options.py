"""Settings as Python gives them, by name: with their types, which an editor completes and a type checker reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from accelsurf.settings.corrections import Correction


class Options(TypedDict, total=False):
    """Settings of `accelsurf.RunConfig` but for the energy, the objects, and what may be an array."""

    # Written by `python -m docs.reference.generate`.
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
    flow: Literal["constant-density", "flowable-mass", "region-mass", "gradient", "sobolev", "momentum"]
    labels: str | None
    channel: str | Sequence[str]
    balance: float
    edge_scale: float | Literal["auto"]
    edge_contrast: float | Literal["auto"]
    balloon: float
    k: float
    t0: float | Literal["auto"]
    lam: float
    rho: float
    gravity: float
    diffusion: float | Literal["auto", "free"]
    noise: float
    noise_length: float | Literal["auto"]
    noise_time: float | Literal["auto"]
    sobolev_length: float | Literal["auto"]
    blend: float
    friction: float | Literal["t"]
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
    edit: str | Sequence[str | Correction | Mapping[str, Any]]
    stop_at_rest: bool
    refine: str | Sequence[str | Correction | Mapping[str, Any]]
    extension: Literal["closest-point", "fast-marching"]
    end: Literal["lowest", "present"]
    level: int | Literal["auto"]
    channel_index: int | None
    time_index: int | None
    channels_from_time: bool
    series: str | None
    resample: bool
    mesh: str | Sequence[str] | Literal["auto"]
    mesh_space: Literal["lps", "ras"]
    mesh_smooth: float
    mesh_faces: int | None
    mesh_error: float | None
    save_sdf: bool
    format: Literal["nii.gz", "nii", "nrrd", "mha", "mhd", "ome.zarr", "png", "tif", "npy"] | None
    keep_state: Literal["auto", "yes", "no"]
    checkpoint: str | None
    name: str | Sequence[str]
    color: str | Sequence[str]
    label_table: str | None
    also: str | Sequence[str]
    label_group: str | None
    window: str
    layout: Literal["plain", "bids", "nnunet"]
