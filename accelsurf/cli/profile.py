"""Where the seconds of a run went, stage by stage: what ``accelsurf segment --profile`` prints."""

from __future__ import annotations

from collections.abc import Mapping

#: The stages of a step, and the kernels that work in them.
STAGES: dict[str, tuple[str, ...]] = {
    "closest points": ("find_feet", "review_feet", "spread", "pull_feet", "take_feet", "polish_feet"),
    "band": (
        "keep_mask", "merged_order", "gather_band", "drop_cells", "store_band", "front_mask", "find_peaks",
        "small_components",
    ),
    "extension": ("sample_at_feet", "outward_table", "extend_outwards", "carry_fields"),
    "advance": ("upwind_norms", "drift", "carry_psi"),
    "energy and force": (
        "measure_band", "smear_band", "weighted_sums", "inside_sums", "mean_across", "sample_image", "outward_normals",
        "value_and_slope",
    ),
    "flow": (
        "voxel_rates", "kick", "products", "normals", "area_stretch", "surface_gradient", "sum_of_waves", "tube_weight",
        "tube_diagonal", "tube_product",
    ),
    "diffusion": ("neighbour_slots", "diffusion_stage"),
}


def spent(seconds: Mapping[str, float], kernels: Mapping[str, float]) -> list[tuple[str, float]]:
    """Seconds by stage.

    Parameters
    ----------
    seconds : mapping of str to float
        Of the whole run, as in the report: load, start, evolve, mesh, write, total.
    kernels : mapping of str to float
        Seconds in each kernel while it evolved.

    Returns
    -------
    list of (str, float)
        Stages in the order of a run. ``evolve: other`` is what is done between the kernels; ``other`` the rest of the
        whole. They add up to the total.

    Examples
    --------
    >>> spent({"load": 1.0, "evolve": 5.0, "total": 7.0}, {"find_feet": 3.0, "kick": 1.0})
    [('load', 1.0), ('closest points', 3.0), ('flow', 1.0), ('evolve: other', 1.0), ('other', 1.0)]
    """
    stages = [(part, seconds[part]) for part in ("load", "start") if part in seconds]
    inside = [(stage, sum(kernels.get(name, 0.0) for name in names)) for stage, names in STAGES.items()]
    known = {name for names in STAGES.values() for name in names}
    inside.append(("other kernels", sum(value for name, value in kernels.items() if name not in known)))
    inside = [(stage, value) for stage, value in inside if value > 0]
    stages += inside
    if "evolve" in seconds:
        stages.append(("evolve: other", seconds["evolve"] - sum(value for _, value in inside)))
    stages += [(part, seconds[part]) for part in ("mesh", "write") if part in seconds]
    rest = seconds["total"] - sum(value for _, value in stages)
    return [*stages, ("other", rest)]


def lines(seconds: Mapping[str, float], kernels: Mapping[str, float]) -> list[str]:
    """`spent` as lines of text: stage, seconds, share."""
    total = max(seconds["total"], 1e-9)
    return [f"  {stage:18} {value:8.2f} s {value / total:6.1%}" for stage, value in spent(seconds, kernels)]
