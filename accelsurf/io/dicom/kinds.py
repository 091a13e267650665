"""Kinds of DICOM objects that are no slices of a volume."""

from __future__ import annotations

from typing import Any

from accelsurf.io.dicom.elements import listed, text
from accelsurf.io.dicom.library import library

SEGMENTATION, WHOLE_SLIDE, PROJECTION = "segmentation", "whole-slide image", "projection of a tomograph"
#: Elements that say it, beside class, modality and type of image.
TAGS = ("TotalPixelMatrixRows", "TotalPixelMatrixColumns", "DimensionOrganizationType")
_CLASSES = {
    "1.2.840.10008.5.1.4.1.1.66.4": SEGMENTATION,
    "1.2.840.10008.5.1.4.1.1.66.7": SEGMENTATION,
    "1.2.840.10008.5.1.4.1.1.481.2": "dose",
    "1.2.840.10008.5.1.4.1.1.77.1.6": WHOLE_SLIDE,
}
_MODALITIES = {
    "SR": "report", "DOC": "report", "PR": "display state", "KO": "selection", "RTSTRUCT": "structure set",
    "RTPLAN": "plan", "RTDOSE": "dose", "SEG": SEGMENTATION, "REG": "registration", "FID": "fiducials",
    "SM": WHOLE_SLIDE,
}
#: What to do about those of them that somebody may take for a volume.
HINTS = {
    WHOLE_SLIDE: "its frames are tiles of one plane: export a region as TIFF or OME-Zarr, by Bio-Formats or QuPath",
    PROJECTION: "its frames are views from several sides: give the reconstructed series",
}


def kind_of(dataset: Any) -> str:
    """Name the kind; empty for an image that may be a slice of a volume, and where nothing is said."""
    known = _CLASSES.get(text(dataset, "SOPClassUID")) or _MODALITIES.get(text(dataset, "Modality"))
    if known is not None:
        return known
    whole, part = (
        [int(dataset.get(name) or 0) for name in names]
        for names in (("TotalPixelMatrixRows", "TotalPixelMatrixColumns"), ("Rows", "Columns"))
    )
    if text(dataset, "DimensionOrganizationType").startswith("TILED") or whole[0] > part[0] or whole[1] > part[1]:
        return WHOLE_SLIDE
    image_type = listed(dataset.get("ImageType"))
    if "LOCALIZER" in image_type:
        return "localizer"
    return PROJECTION if text(dataset, "Modality") == "NM" and {"TOMO", "GATED TOMO"} & set(image_type) else ""


def is_image(dataset: Any) -> bool:
    """Test if it is of a class of images; where it does not say its class, of a modality of them."""
    uid = text(dataset, "SOPClassUID")
    if not uid:
        return text(dataset, "Modality") in ("CT", "MR", "PT", "NM", "US", "XA")
    name = str(library("pydicom.uid").UID(uid).name)
    return "Image Storage" in name and "Non-Image" not in name
