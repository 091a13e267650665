"""nibabel for programs that read voxels: without pydicom, which takes longer to import than nibabel itself."""

from __future__ import annotations

import sys
from pathlib import Path

from accelsurf.io.headers import split_name


def import_nibabel_for(path: Path) -> None:
    """Import nibabel for a NIfTI as if pydicom were not installed; nothing where either is loaded already.

    nibabel uses pydicom for data sets in DICOM that the header of a NIfTI may carry, which accelsurf does not look at.
    Where it is installed nibabel imports it at once, and with it requests and urllib3. What imports pydicom afterwards
    finds it. For the program alone: who imports accelsurf has nibabel with all.

    Parameters
    ----------
    path : Path
        What will be read.
    """
    is_nifti = path.is_file() and split_name(path)[1].startswith(".nii")
    if is_nifti and not {"nibabel", "pydicom"} & sys.modules.keys():
        sys.modules["pydicom"] = None  # type: ignore[assignment]  # Python's own word for: there is none
        try:
            import nibabel  # noqa: F401
        finally:
            del sys.modules["pydicom"]
