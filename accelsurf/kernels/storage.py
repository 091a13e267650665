"""Where compiled kernels are stored, so that they are compiled once."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path


def _storage() -> Path | None:
    """Folder of the compiled kernels, named by the source of all of them; None where nothing can be written.

    Numba compares only the file of a kernel to decide whether its compiled form is current, not at the kernels
    that it calls and that were compiled into it: after a change in one of those it would run the old code.
    """
    here = Path(__file__).parent
    source = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(here.rglob("*.py")))).hexdigest()[:12]
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = os.path.expanduser("~")  # as it is for a user who has none
    others = () if home == "~" else (Path(home) / ".cache" / "accelsurf",)
    for base in (Path(given),) if given else (here / "__pycache__", *others):
        folder = base / f"kernels-{source}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


#: The folder, or None.
STORAGE = _storage()


def stored() -> set[str]:
    """Names of the compiled kernels there, one for each kernel and types of its arguments."""
    return set() if STORAGE is None else {path.name for path in STORAGE.rglob("*.nbc")}
