"""``accelsurf --install-completion``: commands, options and names are completed with the TAB key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from accelsurf.errors import OutputError, UsageError

Shell = Literal["bash", "zsh", "fish"]


def install_completion(
    *,
    shell: Annotated[Shell | None, Parameter(show_default="the one that runs this")] = None,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
) -> int:
    """Complete commands, options and names with TAB, in bash, zsh or fish.

    Writes a script for the shell, and for bash and zsh a line into its startup file that loads it, unless the line is
    there. It prints what it wrote. Run it again after an update of accelsurf.

    Parameters
    ----------
    shell
        The shell.
    output
        Write the script to this file, and nothing else.
    """
    from cyclopts.completion.detect import ShellDetectionError, detect_shell
    from cyclopts.completion.install import get_default_completion_path

    from accelsurf.cli import app
    from accelsurf.io.files import write_bytes

    if shell is None:
        try:
            found = detect_shell()
        except ShellDetectionError:
            raise UsageError("--shell: the shell that runs this is not known", "as in --shell bash") from None
        if found == "powershell":
            raise UsageError("--shell: PowerShell is not supported", "use bash, zsh or fish")
        shell = found
    try:
        path = (output or get_default_completion_path(shell, app.name[0])).absolute()
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{error.filename}: {error.strerror}", "name another file with -o") from None
    script = app.generate_completion(shell=shell)
    # Where there is nothing to offer, as behind --mask, bash shall offer names of files.
    script = script.replace("\ncomplete -F ", "\ncomplete -o default -F ")
    if path.is_file() and path.read_bytes() == script.encode():
        print(f"script   {path} (as it was)")
    else:
        write_bytes(path, script.encode())
        print(f"script   {path}")
    if output is not None:
        print(f"to load  source {path}")
    else:
        _load_at_startup(path, shell)
        print("in use   in every new shell" + (", after compinit" if shell == "zsh" else ""))
    return 0


def _load_at_startup(path: Path, shell: Shell) -> None:
    """Let the shell load the script when it starts."""
    from cyclopts.completion.install import add_to_rc_file

    if shell == "fish":  # loads what lies in its folder
        return
    startup = Path.home() / f".{shell}rc"
    try:
        is_new = add_to_rc_file(path, "accelsurf", shell)
    except OSError as error:
        hint = f"load it yourself: source {path}"
        raise OutputError(f"{startup}: cannot be written ({error.strerror})", hint) from None
    if is_new:
        print(f"startup  {startup} loads it (a line was added)")
    else:
        print(f"startup  {startup} loads it already")
