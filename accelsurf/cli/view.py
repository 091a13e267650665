"""``accelsurf view``: a segmentation that a person watches and steers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, Overwrite, Settings, required, run_config


def view(
    input: Annotated[Path | None, Parameter(name=("--input", "-i"), group=FILES)] = None,
    *,
    result: Annotated[Path | None, Parameter(group=FILES)] = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    reference: Annotated[Path | None, Parameter(group=FILES)] = None,
    overwrite: Overwrite = False,
    theme: Annotated[Literal["dark", "light"], Parameter(group=SHOW)] = "dark",
    keep: Annotated[float, Parameter(group=SHOW)] = 512.0,
    settings: Settings | None = None,  # type: ignore[valid-type]
) -> int:
    """Watch and steer a segmentation in a window.

    Place a start, run, change settings while it runs, go back, push the surface, save. What is saved is what segment
    writes, and run.toml, with which segment makes the same bytes. F1 in the window shows keys and mouse.

    Needs a screen and the packages of the viewer: pip install "accelsurf[viewer]". Runs on one level unless --levels
    asks for more.

    Parameters
    ----------
    input
        The image: .nii, .nii.gz, .nrrd, .mha, .mhd, .png or .tif.
    result
        Folder to save in; asked for when it is needed otherwise.
    config
        TOML file with settings, as run.toml of an earlier session; options given here beat it.
    reference
        Label map of the true object, on the same grid: drawn too, with Dice.
    overwrite
        Replace files in the folder that this session has not written.
    theme
        Dark or light.
    keep
        Memory for the steps that can be gone back to, MB.
    """
    source = required(input, "INPUT")
    made = run_config(settings, config)
    from accelsurf import io
    from accelsurf.viewer.display import require_display

    require_display()
    volume = io.read(source)
    truth = None if reference is None else io.read_labels(reference)
    from accelsurf.viewer.desktop import show
    from accelsurf.viewer.session import Session

    with Session(volume, made, name=io.split_name(source)[0], source=source, kept_mb=keep) as session:
        session.ready.result()
        show(session, truth, result, theme, overwrite)
    return 0
