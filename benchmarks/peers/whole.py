"""A peer as a whole process, as a user would write it: read a scan, presmooth, run, write labels.

python -m benchmarks.peers.whole IMAGE LABELS TASK     TASK: JSON with peer, settings, centre (z, y, x), radius, means
"""

from __future__ import annotations

import json
import sys

import numpy as np


def main(source: str, target: str, task: str) -> None:
    import SimpleITK as sitk

    from benchmarks.peers.baselines import BASELINES
    from benchmarks.peers.programs import PEERS

    given = json.loads(task)
    scan = sitk.ReadImage(source)
    image = sitk.GetArrayViewFromImage(scan).astype(np.float32)
    z, y, x = (
        np.arange(n, dtype=np.float32) - c
        for n, c in zip(image.shape, given["centre"], strict=True)
    )
    far = z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2
    start = np.sqrt(far, out=far) - np.float32(given["radius"])
    labels = {**PEERS, **BASELINES}[given["peer"]].run(
        image, start, tuple(given["means"]), given["settings"]
    )
    out = sitk.GetImageFromArray(labels.astype(np.uint8))
    out.CopyInformation(scan)
    sitk.WriteImage(out, target)


if __name__ == "__main__":
    main(*sys.argv[1:])
