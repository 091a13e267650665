"""``accelsurf --install-completion``: commands, options and names are completed with the TAB key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from accelsurf.errors import OutputError, UsageError
from accelsurf.io import write_bytes

Shell = Literal["bash", "zsh", "fish", "powershell"]


def install_completion(
    *,
    shell: Annotated[Shell | None, Parameter(show_default="the one that runs this")] = None,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
) -> int:
    """Complete commands, options and names with TAB, in bash, zsh, fish or PowerShell.

    Writes a script for the shell, and for bash and zsh a line into its startup file that loads it, unless the line is
    there. It prints what it wrote. Run it again after an update of accelsurf.

    Parameters
    ----------
    shell
        The shell.
    output
        Write the script to this file, and nothing else.
    """
    from cyclopts.completion.detect import ShellDetectionError

    from accelsurf.cli import made_app

    try:
        path = made_app().install_completion(
            shell=shell, output=output, add_to_startup=output is None
        )
    except ShellDetectionError:
        raise UsageError(
            "--shell: the shell that runs this is not known", "as in --shell bash"
        ) from None
    except OSError as error:
        raise OutputError(
            f"{error.filename}: {error.strerror}", "name another file with -o"
        ) from None
    # Where there is nothing to offer, as behind --mask, bash shall offer names of files.
    script = path.read_text(encoding="utf-8").replace("\ncomplete -F ", "\ncomplete -o default -F ")
    write_bytes(path, script.encode())
    print(f"script   {path}")
    print("in use   in every new shell" if output is None else f"to load  source {path}")
    return 0
