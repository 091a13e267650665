"""Records of steps with made-up numbers, for what only reads them."""

from accelsurf.evolution.records import StepRecord


def step_record(step, **changes):
    values = {
        **dict(step=step, level=0, t=0.1 * step, dt=0.1, cfl_dt=0.1),
        **dict(potential=100.0 / (step + 1), kinetic=1.0 + step, volume_mm3=10.0),
        **dict(
            area_mm2=5.0,
            speed=1.0,
            motion_voxels=0.5,
            limited_fraction=0.05,
            diffusion=2.0,
            band_cells=99,
        ),
        **dict(
            restarted=False,
            removed_components=0,
            seconds=0.01,
            cells_visited=500,
            clamped_fraction=0.0,
        ),
        **dict(
            mass_potential=0.0, weight=4.0, friction_work=0.5, smoothing_work=0.25, noise_work=0.0
        ),
        **dict(mass=3.0, mass_correction=0.001),
    }
    return StepRecord(**{**values, **changes})
