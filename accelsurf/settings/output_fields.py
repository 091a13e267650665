"""The settings of the files that a run writes, one entry each; see `accelsurf.settings.fields`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from accelsurf.grid.grey_window import AUTO, checked_window
from accelsurf.settings.entry import SettingEntry, SettingGroup, setting
from accelsurf.settings.file_formats import label_formats, label_help
from accelsurf.settings.image_fields import ImageFields
from accelsurf.settings.intervals import INTERVAL
from accelsurf.settings.known_names import OneOf
from accelsurf.settings.label_outputs import also_help, also_names
from accelsurf.settings.labels import checked_colors, checked_names
from accelsurf.settings.mesh_formats import MESH_FORMATS, mesh_help
from accelsurf.settings.mesh_sizes import MESH_SIZE, checked_mesh_size
from accelsurf.settings.written_values import all_split, checked_interval, split_commas

FILES = SettingGroup.FILES
#: How files are named and laid out.
Layout = Literal["plain", "bids", "nnunet"]


class OutputFields(ImageFields):
    """Which files a run writes, and how."""

    mesh: Annotated[
        Annotated[tuple[Annotated[str, OneOf(lambda: MESH_FORMATS)], ...], Field(min_length=1)] | Literal["auto"],
        BeforeValidator(split_commas),
    ] = setting(
        "auto",
        "Formats, separated by commas, {}",
        entry=SettingEntry(FILES, metavar="NAMES", fixed=True, listed=mesh_help),
    )
    mesh_space: Literal["lps", "ras"] = setting(
        "lps",
        "World axes of the mesh or contours, in mm: lps as ITK, or ras as NIfTI.",
        entry=SettingEntry(FILES, metavar="NAME", fixed=True),
    )
    mesh_smooth: float = setting(
        0.0,
        "Flatten bumps of the written mesh that are shorter than this, mm; of those of this length half remains, and "
        "the volume stays. The surface is smooth below a voxel already: for steps of thick slices, and for prints.",
        entry=SettingEntry(FILES, unit="mm", metavar="MM", fixed=True),
        ge=0,
    )
    mesh_faces: Annotated[
        Annotated[str, Field(pattern=f"^{MESH_SIZE}$")] | None, BeforeValidator(checked_mesh_size)
    ] = setting(
        None,
        "Make the written mesh coarser, to a number of triangles: 20000; or remesh it with sides of a length: 2mm.",
        entry=SettingEntry(FILES, metavar="N|LENGTH", fixed=True),
    )
    mesh_walls: Literal["own", "shared"] = setting(
        "own",
        "Walls between objects that touch: each mesh has its own, or both have the same triangles, without gap or "
        "overlap.",
        entry=SettingEntry(FILES, metavar="own|shared", fixed=True),
    )
    mesh_error: float | None = setting(
        None,
        "Largest distance allowed between the written mesh and the surface, mm. Alone it makes the mesh as coarse as "
        "it allows; with mesh-faces or mesh-smooth a mesh beyond it stays as it was, with a warning.",
        entry=SettingEntry(FILES, unit="mm", metavar="MM", fixed=True),
        gt=0,
    )
    save_sdf: bool = setting(
        False,
        "Also write the signed distance (mm, negative inside) as a volume.",
        entry=SettingEntry(FILES, fixed=True),
    )
    format: Annotated[str, OneOf(label_formats)] | None = setting(
        None,
        "Format of the label map: {}. Follows the input unless given.",
        entry=SettingEntry(FILES, metavar="NAME", fixed=True, listed=label_help),
    )
    keep_state: Literal["auto", "yes", "no"] = setting(
        "auto",
        "Also write the state of the run, from which accelsurf refine goes on; auto does with clicks.",
        entry=SettingEntry(FILES, metavar="auto|yes|no", fixed=True, viewer="elsewhere"),
    )
    checkpoint: Annotated[Annotated[str, Field(pattern=INTERVAL)] | None, BeforeValidator(checked_interval)] = setting(
        None,
        "How often the state of the run is written while it goes on: 50 (steps), 30s, 5min. A killed run goes on from "
        "it with --resume, and ends with the same bytes; it is removed when the run has ended.",
        entry=SettingEntry(FILES, metavar="STEPS|TIME", fixed=True, viewer="elsewhere"),
    )
    name: Annotated[tuple[str, ...], BeforeValidator(checked_names)] = setting(
        (),
        "Name of an object in files: ID=NAME, or NAME where there is one object.",
        entry=SettingEntry(FILES, metavar="ID=NAME", repeated=True, fixed=True, viewer="elsewhere"),
    )
    color: Annotated[tuple[str, ...], BeforeValidator(checked_colors)] = setting(
        (),
        "Colour of an object in files: ID=#rrggbb or ID=R,G,B.",
        entry=SettingEntry(FILES, metavar="ID=COLOUR", repeated=True, fixed=True, viewer="elsewhere"),
    )
    label_table: str | None = setting(
        None,
        "Names and colours of objects: a file of ITK-SNAP (.txt), 3D Slicer (.ctbl, .seg.nrrd), BIDS (.tsv) or DICOM "
        "(a segmentation, .dcm), or a .csv with columns id, name and color.",
        entry=SettingEntry(FILES, metavar="FILE", fixed=True, viewer="elsewhere"),
    )
    also: Annotated[tuple[Annotated[str, OneOf(also_names)], ...], BeforeValidator(all_split)] = setting(
        (),
        "Further files of the objects, separated by commas: {}.",
        entry=SettingEntry(FILES, metavar="NAMES", repeated=True, fixed=True, listed=also_help),
    )
    label_group: str | None = setting(
        None,
        "Also write the label map into the labels of the image, an OME-Zarr 0.5, under this name; the image is not "
        "touched.",
        entry=SettingEntry(FILES, metavar="NAME", fixed=True, viewer="elsewhere"),
    )
    window: Annotated[str, BeforeValidator(checked_window)] = setting(
        AUTO,
        "Values of the image that pictures draw black to white: LEVEL,WIDTH, as 40,400; of a CT soft-tissue, bone, "
        "lung or brain; auto follows from the object and what is around it.",
        entry=SettingEntry(FILES, metavar="NAME|LEVEL,WIDTH", fixed=True, viewer="elsewhere"),
    )
    layout: Layout = setting(
        "plain",
        "How label maps are named and laid out: plain, bids (derivatives, with sidecars), or nnunet (CASE.nii.gz).",
        entry=SettingEntry(FILES, metavar="NAME", fixed=True),
    )
