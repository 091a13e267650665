"""Whether the files of a case belong together: those of one report, by their checksums."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from pathlib import Path

from accelsurf import io
from accelsurf.errors import AccelsurfError


def fault_of(folder: Path, name: str = "ball", beside: Collection[str] = ()) -> str:
    """What is wrong with the files of a case: empty when they are those of its report, all of them and readable.

    ``beside`` names files of the case that its report does not list.
    """
    try:
        report = json.loads((folder / f"{name}_report.json").read_bytes())
    except FileNotFoundError:
        return "there is no report"
    except ValueError:
        return "broken: the report is no JSON"
    listed = {f"{name}_report.json"}
    for entry in report["outputs"]:
        path = folder / Path(entry["path"]).name
        listed.add(path.name)
        if not path.exists():
            return f"mixed: {path.name} is missing"
        if hashlib.sha256(path.read_bytes()).hexdigest() != entry["sha256"]:
            return f"mixed: {path.name} is not the one of the report"
        if entry["kind"] in ("labels", "sdf"):
            try:
                io.read(path)
            except AccelsurfError as error:
                return f"broken: {error}"
    failed = folder / f"{name}_failed_report.json"
    others = {path.name for path in folder.iterdir() if path.name.startswith(f"{name}_")}
    others -= {*listed, failed.name, *beside}
    return f"mixed: {', '.join(sorted(others))} beside the report" if others else ""
