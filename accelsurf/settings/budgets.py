"""Limits on bytes, counts and lengths that a file or a text may make the program spend, in one place.

A small file can claim, repeat or pack so much that reading it would fill the memory or take hours. Each reader asks
here before it allocates or begins. The reference page of limits is written from these entries.
"""

from __future__ import annotations

from dataclasses import dataclass

from accelsurf.errors import AccelsurfError, InputError

#: Memory for each byte of a mesh file while it is read: text becomes lists of Python's numbers.
MESH_BYTES_PER_FILE_BYTE = 40


@dataclass(frozen=True)
class Budget:
    """One limit.

    Attributes
    ----------
    what : str
        The limited quantity, as in messages and on the reference page.
    limit : int
        The largest number that is accepted.
    unit : str
        Unit of the limit, as ``bytes``.
    hint : str
        Advice where more is needed.
    per : str
        Quantity that the limit is multiplied by; empty where it stands for itself.
    """

    what: str
    limit: int
    unit: str
    hint: str
    per: str = ""

    def check(
        self, needed: int, given: str = "", factor: int = 1, kind: type[AccelsurfError] = InputError
    ) -> None:
        """Refuse a number above the limit.

        Parameters
        ----------
        needed : int
            The number needed.
        given : str
            Subject of the message; the limited quantity by default.
        factor : int
            Times the limit.
        kind : type
            Of the error.

        Raises
        ------
        AccelsurfError
            Of that kind, with both numbers.

        Examples
        --------
        >>> CONFIG.check(1000)
        """
        if needed > self.limit * factor:
            raise kind(
                f"{given or self.what}: {needed} {self.unit}, at most {self.limit * factor} expected",
                self.hint,
            )


CONFIG = Budget(
    "a configuration file",
    1 << 20,
    "bytes",
    "is it the right file? a configuration has a few lines",
)
EXPRESSION = Budget("an energy, a start or an edit", 1 << 14, "characters", "write it shorter")
PATH = Budget(
    "a painted path", 1 << 17, "characters", "take a larger radius, or write it as a stroke:FILE"
)
PATH_VOXELS = Budget(
    "voxels of the boxes around the pieces of a path",
    1 << 32,
    "voxels",
    "take a smaller radius, or fewer places",
)
EDITS = Budget("the edits of a run", 4096, "edits", "leave out those that do not matter")
TABLE = Budget("a table of balls", 1 << 22, "bytes", "give the objects as a label map instead")
CASES = Budget("a table of cases", 1 << 26, "bytes", "split the table")
BALLS = Budget(
    "balls of one id times voxels of the box around them",
    1 << 32,
    "voxels",
    "use fewer balls, or a label map",
)
REPORT = Budget("a report", 1 << 26, "bytes", "is it the report of a run?")
TEXT_HEADER = Budget(
    "the header of an NRRD or MetaImage", 1 << 20, "bytes", "is it the right file?"
)
AXIS = Budget(
    "an axis of an image, or of time",
    1 << 20,
    "places",
    "the header is damaged: copy or export the file again",
)
#: Some writers pad their streams.
SLACK = Budget(
    "packed voxels beyond those that the header announces",
    1 << 20,
    "bytes",
    "the header is damaged or of another file",
)
DEFLATE = Budget(
    "voxels packed by gzip",
    1032,
    "bytes",
    "the file is damaged: copy or export it again",
    "packed byte",
)
LZW = Budget(
    "voxels packed by LZW",
    1400,
    "bytes",
    "the file is damaged: copy or export it again",
    "packed byte",
)
PACKBITS = Budget(
    "voxels packed by PackBits",
    64,
    "bytes",
    "the file is damaged: copy or export it again",
    "packed byte",
)
TIFF_TAGS = Budget(
    "the entries of a TIFF's pages", 1, "bytes", "save it as a plain stack", "byte of the file"
)
TIFF_STRIPS = Budget(
    "the strips of a TIFF together",
    4,
    "bytes",
    "save it as a plain stack, without shared strips",
    "byte of the file",
)
TIFF_PLANES = Budget(
    "the pages that an OME-TIFF or an ImageJ stack announces", 1 << 22, "pages", "is it damaged?"
)
SLICES = Budget(
    "the files of a folder of slices", 1 << 16, "files", "make one stack of them, as OME-Zarr"
)
DICOM_FRAMES = Budget("the frames of a DICOM file", 1 << 16, "frames", "is its header damaged?")
DICOM_PACKED = Budget(
    "a packed frame of a DICOM file",
    4096,
    "bytes",
    "the header is damaged: copy or export it again",
    "packed byte (and 4096)",
)
ZARR_CHUNK = Budget("a chunk of a Zarr, unpacked", 1 << 30, "bytes", "store it in smaller chunks")
ZARR_METADATA = Budget(
    "a file of metadata of a Zarr", 1 << 24, "bytes", "is it damaged? export the image again"
)
ZARR_LEVELS = Budget(
    "the levels of an OME-Zarr", 64, "levels", "is it damaged? export the image again"
)
MESH_FILE = Budget(
    "a mesh in memory while it is read",
    1,
    "bytes",
    "simplify the mesh first",
    "byte of free memory",
)
MESH_ROWS = Budget(
    "rows of voxels that the triangles of a mesh span, over all triangles",
    1 << 27,
    "rows",
    "simplify the mesh, or split its long triangles",
)
OBJECT_VOXELS = Budget(
    "the boxes around all objects together",
    64,
    "voxels",
    "is this an image rather than a label map? give fewer ids with FILE@IDS",
    "voxel of the image (and 16777216)",
)
SMOOTHING = Budget(
    "the sigma of a smoothing", 256, "voxels", "give a smaller length, in mm or with the suffix vox"
)
CLOSING = Budget(
    "the radius of a closing", 24, "voxels", "give a smaller length, in mm or with the suffix vox"
)
SESSION_CLICKS = Budget(
    "the clicks and labels of a session, each with the box around it",
    1 << 28,
    "bytes",
    "clear it, and begin anew",
)
STATE_FILE = Budget("the state of a run", 1 << 34, "bytes", "is it the right file?")
STATE_UNPACKED = Budget(
    "a packed array of the state of a run",
    1032,
    "bytes",
    "the file is damaged: run again",
    "packed byte (and 1024)",
)

POINT_FILE = Budget(
    "a file of points", 1 << 22, "bytes", "is it the right file? a point takes a line"
)
POINTS = Budget(
    "the points of a file", 1000, "points", "paint them as a label map, and give stroke:FILE"
)

#: All of them, in the order of the reference page.
BUDGETS = (
    CONFIG,
    EXPRESSION,
    PATH,
    PATH_VOXELS,
    EDITS,
    TABLE,
    CASES,
    BALLS,
    REPORT,
    TEXT_HEADER,
    AXIS,
    SLACK,
    DEFLATE,
    LZW,
    PACKBITS,
    TIFF_TAGS,
    TIFF_STRIPS,
    TIFF_PLANES,
    SLICES,
    DICOM_FRAMES,
    DICOM_PACKED,
    ZARR_CHUNK,
    ZARR_METADATA,
    ZARR_LEVELS,
    MESH_FILE,
    MESH_ROWS,
    OBJECT_VOXELS,
    SMOOTHING,
    CLOSING,
    SESSION_CLICKS,
    STATE_FILE,
    STATE_UNPACKED,
    POINT_FILE,
    POINTS,
)
