"""``accelsurf fetch``: public scans to try things on, each with its licence, source and checksum; all files or none."""

from __future__ import annotations

import hashlib
import shlex
import tomllib
from pathlib import Path
from typing import Annotated, NamedTuple

from cyclopts import Parameter

from accelsurf.cli.options import FILES, Overwrite, Switch
from accelsurf.errors import InputError, UsageError, check_known
from accelsurf.output import OutputFolder, naming_final

#: The scans that can be fetched.
TABLE = Path(__file__).with_name("samples.toml")
#: Seconds without a byte after which a server is given up.
PATIENCE = 30.0


class SampleFile(NamedTuple):
    """A file of a sample: its name here, its address, its SHA-256 in hexadecimal digits, and its size in bytes."""

    name: str
    url: str
    sha256: str
    size: int

    def is_at(self, folder: Path) -> bool:
        """Test if this very file is in a folder."""
        path = folder / self.name
        if not path.is_file() or path.stat().st_size != self.size:
            return False
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == self.sha256


def fetch(
    name: Annotated[str | None, Parameter(name="NAME")] = None,
    *,
    to: Annotated[
        Path, Parameter(name=("--to", "--output", "-o"), group=FILES, show_default="this folder")
    ] = Path(),
    list: Switch = False,
    overwrite: Overwrite = False,
) -> int:
    """Fetch a public scan with its labels, to try things on.

    Licence, source and checksums are shown first. A file whose checksum is another one is refused, and nothing is left
    of it. Files that are there already are not fetched again.

    Parameters
    ----------
    name
        Which scan; --list shows them.
    to
        Folder for the files; made when missing.
    list
        List the data sets; nothing is fetched.
    overwrite
        Replace other files of the same names.
    """
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    if list:
        for key, sample in table.items():
            size = sum(file["bytes"] for file in sample["files"].values())
            print(f"{key:12} {size / 1e6:4.1f} MB  {sample['licence']:12}  {sample['about']}")
        return 0
    if name is None:
        raise UsageError("fetch: no NAME was given", "accelsurf fetch --list shows them")
    check_known("NAME", name, table)
    sample = table[name]
    files = []
    for key, file in sample["files"].items():
        url = f"{sample['base']}/{file['path']}"
        files.append(SampleFile(key, url, file["sha256"], file["bytes"]))
    print(f"{name}: {sample['about']}\nlicence {sample['licence']}, source {sample['source']}")
    for file in files:
        print(
            f"{file.name} {file.size / 1e6:.2f} MB sha256 {file.sha256}\n  {file.url}", flush=True
        )
    if all(file.is_at(to) for file in files):
        print(f"there already: {to.absolute()}")
    else:
        fetch_all(files, to, name, overwrite)
        print(f"fetched: {to.absolute()}")
    image, out = shlex.quote(str(to / files[0].name)), shlex.quote(str(to / "out"))
    print(f"try: accelsurf segment {image} -o {out} --inside {sample['inside']}")
    return 0


def fetch_all(files: list[SampleFile], folder: Path, name: str, overwrite: bool) -> None:
    """Fetch files into a folder, all or none.

    Raises
    ------
    InputError
        When a server cannot be reached, or sends something else.
    OutputError
        When another file of the same name is there, or none can be written.
    """
    planned = {file.name: folder / file.name for file in files if not file.is_at(folder)}
    with (
        OutputFolder(folder, name, overwrite=overwrite).stage(planned) as staged,
        naming_final(staged),
    ):
        for file in files:
            _fetch_file(file, staged.staging)
        staged.commit()


def _fetch_file(file: SampleFile, folder: Path) -> None:
    """Fetch a file into a folder, and check it."""
    import pooch
    from requests import RequestException

    pooch.get_logger().setLevel("WARNING")
    load = pooch.HTTPDownloader(timeout=PATIENCE)
    try:
        pooch.retrieve(file.url, f"sha256:{file.sha256}", file.name, folder, downloader=load)
    except RequestException as error:
        response = getattr(error, "response", None)
        reason = type(error).__name__ if response is None else f"status {response.status_code}"
        raise InputError(
            f"{file.url}: cannot be fetched ({reason})", "is there a network? Try again later"
        ) from None
    except ValueError:
        raise InputError(
            f"{file.url}: not the file that was expected, its checksum is another one; nothing of it is left",
            "try again; if it stays so, report it",
        ) from None
