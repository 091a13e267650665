"""The settings of a run, one entry each: type, bounds, default, help, unit and more.

The command line, TOML files, the viewer, the JSON schema, ``accelsurf info`` and the reference pages follow from these
entries. Lengths are in mm unless the help says voxels.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from accelsurf.image.grey_window import AUTO, checked_window
from accelsurf.settings.corrections import Refinements
from accelsurf.settings.edits import Edits
from accelsurf.settings.energy_expression import EnergyText
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.entry import OneOf, SettingEntry, SettingGroup, Slider, setting
from accelsurf.settings.file_formats import label_formats, label_help
from accelsurf.settings.flow_specs import AUTO as AUTO_FLOW
from accelsurf.settings.flow_specs import FlowText, flow_names
from accelsurf.settings.labels import checked_colors, checked_names
from accelsurf.settings.mesh_formats import MESH_FORMATS, also_help, also_names, mesh_help
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.reading import ReadOptions, spacing_of
from accelsurf.settings.toml import (
    INTERVAL,
    VOLUME,
    VOXELS,
    all_split,
    checked,
    checked_bounds,
    checked_volume,
    interval_of,
    one_or_many,
    split_commas,
)

RUN = SettingGroup.RUN
IMAGE = SettingGroup.IMAGE
FILES = SettingGroup.FILES
#: Layouts of the files.
Layout = Literal["plain", "bids", "nnunet"]


class SettingFields(BaseModel):
    """The fields of `accelsurf.settings.run_config.RunConfig`, without its methods."""

    # Nobody makes a record of a part of the settings: only the class of all of them gets a validator.
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, defer_build=True
    )

    preset: Annotated[str, OneOf(lambda: PRESETS)] | None = setting(
        None,
        "Settings for a kind of scan: {}. Settings given beside it override it. "
        "accelsurf info presets lists the values of each, and why.",
        entry=SettingEntry(
            RUN,
            viewer="first",
            choice=True,
            metavar="NAME",
            fixed=True,
            listed=lambda: ", ".join(PRESETS),
        ),
    )
    energy: EnergyText = setting(
        "chan-vese",
        "Energy to minimise: terms with weights, as 'local-region:R=8 + 0.3*geodesic' or 'threshold:LO,HI'. "
        "With --inside it is seeded unless given.",
        entry=SettingEntry(
            RUN,
            viewer="first",
            metavar="EXPRESSION",
            choice=True,
            names=lambda: {name: term.help for name, term in TERMS.items()},
        ),
    )
    start: Annotated[tuple[str, ...], BeforeValidator(one_or_many)] = setting(
        ("center",),
        "First surface: ball:X,Y,Z,R, box:X0,Y0,Z0,X1,Y1,Z1, seed:X,Y,Z,R, label:FILE, threshold:LO,HI, "
        "largest:LO,HI, otsu, mesh:FILE, center, or clicks (what --inside says; the default with it). "
        "Coordinates in world mm (LPS), or with an ending: um, ras, vox (voxel indices x,y,z), or grid (the scales of "
        "look). Several are united.",
        entry=SettingEntry(RUN, metavar="WHERE", repeated=True, fixed=True),
        min_length=1,
    )
    inside: Annotated[tuple[str, ...], BeforeValidator(one_or_many)] = setting(
        (),
        "Voxels that are in the object, and stay in it: point:X,Y,Z, path:X,Y,Z,R;..., stroke:FILE, or written as a "
        "start. With --inside and neither --start nor --energy the program chooses everything. Each is a click of its "
        "own.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="WHERE", repeated=True, fixed=True),
    )
    outside: Annotated[tuple[str, ...], BeforeValidator(one_or_many)] = setting(
        (),
        "Voxels that are not in the object, and stay out of it, written as --inside; with --objects in none of them.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="WHERE", repeated=True, fixed=True),
    )
    smoothness: float = setting(
        0.0,
        "Weight of the surface's area, in mm: larger is smoother; 0 keeps corners. "
        "Independent of the image's intensity scale.",
        entry=SettingEntry(
            RUN,
            viewer="first",
            unit="mm",
            metavar="MM",
            scope="energy",
            slider=Slider(0.0, 5.0, voxel_power=1),
        ),
        ge=0,
    )
    presmooth: Annotated[float, Field(ge=0)] | Annotated[str, Field(pattern=VOXELS)] = setting(
        0.0,
        "Sigma of a Gaussian applied to the image before the run, in mm, or in voxels of the smallest "
        "spacing with the suffix vox; 0 for none.",
        entry=SettingEntry(RUN, viewer="first", unit="mm", metavar="MM|Nvox", fixed=True),
    )
    closing: Annotated[float, Field(ge=0)] | Annotated[str, Field(pattern=VOXELS)] = setting(
        0.0,
        "Radius of a ball that the image is closed by before the run, in mm, or in voxels of the smallest spacing with "
        "the suffix vox: dark places narrower than twice that, as marrow in a bone, are filled up. 0 for none.",
        entry=SettingEntry(RUN, unit="mm", metavar="MM|Nvox", fixed=True),
    )
    clip: Annotated[str | None, BeforeValidator(checked_bounds)] = setting(
        None,
        "LOW,HIGH in the image's unit, one of them may be left out: before the run, and before it is closed, values "
        "beyond become these.",
        entry=SettingEntry(RUN, metavar="LOW,HIGH", fixed=True),
    )
    size: Annotated[
        Annotated[str, Field(pattern=VOLUME)] | None, BeforeValidator(checked_volume)
    ] = setting(
        None,
        "About how large the object is, with its unit: 250ml, 3cm3, 4000um3. It helps to choose the start; it does "
        "not bound the result.",
        entry=SettingEntry(RUN, viewer="first", metavar="VOLUME", scope="term", fixed=True),
    )
    answer: Annotated[int, Field(ge=1, le=3)] = setting(
        1,
        "Answer to the first click: 1 the likeliest, 2 a part (of an ambiguous click the larger object), 3 all that is "
        "alike and connected. The likeliest where there is no part; with --size there is "
        "one alone.",
        entry=SettingEntry(RUN, viewer="first", metavar="1|2|3", scope="term", fixed=True),
    )
    max_volume: Annotated[float, Field(gt=0)] | None = setting(
        None,
        "Leak guard: the run ends when the object is larger than this, in mm3.",
        entry=SettingEntry(RUN, viewer="first", unit="mm3", metavar="MM3"),
    )
    levels: Annotated[int, Field(ge=1)] | Literal["auto"] = setting(
        "auto",
        "Number of grids to run on, coarsest first; each has half the voxels of the next along an axis. 1 is the "
        "image's own grid alone; auto is as many as resolve image and start, for several objects 1.",
        entry=SettingEntry(RUN, viewer="first", metavar="N|auto", fixed=True),
    )
    roi: str | None = setting(
        None,
        "Region of interest: box X0,Y0,Z0,X1,Y1,Z1 in world mm, or with an ending as of --start. The run is made in "
        "the box alone; the outputs are on the whole grid.",
        entry=SettingEntry(RUN, viewer="first", unit="mm", metavar="BOX", fixed=True),
    )
    mask: str | None = setting(
        None,
        "Label map on the image's grid: the surface never leaves the voxels above 0.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="FILE", fixed=True),
    )
    box: str | None = setting(
        None,
        "Box around the object, X0,Y0,Z0,X1,Y1,Z1 in world mm, or with an ending as of --start: nothing outside of it "
        "is in the object, which is taken to fill between a quarter and a half of it unless --size says "
        "more, and energies learn from what lies around it.",
        entry=SettingEntry(RUN, unit="mm", metavar="BOX", fixed=True),
    )
    flow: FlowText = setting(
        AUTO_FLOW,
        "How the surface moves: a flow with its settings, as constant-density:rho=2 or sobolev:length=5; "
        "accelsurf info flows lists them.",
        entry=SettingEntry(RUN, metavar="FLOW", choice=True, names=flow_names),
    )
    objects: str | None = setting(
        None,
        "Several objects at once, in place of --start: a label map on the image's grid with the first voxels of each "
        "object (FILE@2,5-9: these ids only), or a table of balls, FILE.csv with columns id,x,y,z,r in world mm "
        "(x_vox: voxel indices; x_grid: as on the scales). They never overlap. With a column side (inside "
        "or outside) its rows are clicks, as --inside; then r may be left out, and id 0 is no object.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="FILE", fixed=True),
    )
    labels: str | None = setting(
        None,
        "Label map on the image's grid that is nearly right, in place of --start: its objects are the result, and "
        "corrections mend them (FILE@2,5-9: those with these ids; the others stay as they are and are not entered). "
        "accelsurf refine --labels mends one in one go.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="FILE[@IDS]", fixed=True),
    )
    foreground: Annotated[tuple[str, ...], BeforeValidator(one_or_many)] = setting(
        (),
        "Voxels of the object that likelihood and learned thresholds learn from, written as a start; several are "
        "united.",
        entry=SettingEntry(RUN, metavar="WHERE", scope="term", repeated=True, fixed=True),
    )
    background: Annotated[tuple[str, ...], BeforeValidator(one_or_many)] = setting(
        (),
        "Voxels around the object that likelihood learns from, written as a start; several are united.",
        entry=SettingEntry(RUN, metavar="WHERE", scope="term", repeated=True, fixed=True),
    )
    channel: Annotated[tuple[str, ...], BeforeValidator(one_or_many)] = setting(
        (),
        "Further channels of the image: files on the same grid, in order after those of the input.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="FILE", repeated=True, fixed=True),
    )
    balance: float = setting(
        1.0,
        "Weight of the fit inside against the fit outside (lambda1/lambda2 of Chan and Vese, no unit): "
        "above 1 the object must be closer to its mean, so a bright object loses its dim rim.",
        entry=SettingEntry(RUN, metavar="RATIO", scope="term"),
        gt=0,
    )
    edge_scale: Annotated[float, Field(gt=0)] | Literal["auto"] = setting(
        "auto",
        "Scale at which the energy geodesic, which rests on edges, sees them: sigma of the Gaussian gradient, in mm; "
        "auto is one voxel (the largest spacing).",
        entry=SettingEntry(RUN, unit="mm", metavar="MM|auto", scope="term"),
    )
    edge_contrast: Annotated[float, Field(gt=0)] | Literal["auto"] = setting(
        "auto",
        "Gradient magnitude that counts as half an edge, in fractions of the image's range per mm; "
        "auto measures it in the image.",
        entry=SettingEntry(
            RUN, unit="fractions of the image's range per mm", metavar="K|auto", scope="term"
        ),
    )
    balloon: float = setting(
        0.0,
        "Pressure away from edges, of the energy geodesic (which rests on edges), per mm: above 0 the surface shrinks, "
        "below 0 it grows.",
        entry=SettingEntry(RUN, unit="1/mm", metavar="C", scope="term"),
    )
    diffusion: Annotated[float, Field(ge=0)] | Literal["auto", "free"] = setting(
        "auto",
        "How fast neighbouring points of the surface take on each other's speed, in mm2 per unit of flow time, which "
        "smooths the motion; 0 for not. free is the largest rate that makes no step shorter, auto is free with "
        "momentum, else 0.",
        entry=SettingEntry(
            unit="mm2 per unit of flow time",
            metavar="D|free|auto",
            scope="flow",
            slider=Slider(0.0, 20.0, voxel_power=2, words=("auto", "free")),
        ),
    )
    noise: float = setting(
        0.0,
        "Strength of random acceleration, smooth in space, in mm per unit of flow time^1.5; 0 for none.",
        entry=SettingEntry(unit="mm per unit of flow time^1.5", metavar="TAU", scope="flow"),
        ge=0,
    )
    friction: Annotated[float, Field(gt=0)] | Literal["t"] = setting(
        "t",
        "Friction of the accelerated flow: t is (k+1)/t, a number is constant, per unit of flow time.",
        entry=SettingEntry(
            unit="per unit of flow time",
            metavar="t|A",
            scope="flow",
            slider=Slider(0.01, 5.0, words=("t",)),
        ),
    )
    restart: Literal["auto", "off"] = setting(
        "auto",
        "auto sets the momentum to zero when the energy rises, after the surface has travelled 3 voxels; off never "
        "does.",
        entry=SettingEntry(choice=True, metavar="auto|off"),
    )
    cfl: float = setting(
        0.5,
        "How far the surface may move in one step, in voxels: larger takes fewer steps and is less exact.",
        entry=SettingEntry(
            unit="voxels",
            metavar="VOXELS",
            slider=Slider(0.05, 1.0, power=1.0, limit=1.0),
        ),
        gt=0,
        le=1,
    )
    max_steps: int = setting(
        1000,
        "The run ends after this many steps, converged or not; 0 leaves the start.",
        entry=SettingEntry(RUN, metavar="N", fixed=True),
        ge=0,
    )
    tolerance: float = setting(
        0.1,
        "The run has converged when the surface lies, on average, within this many voxels of where it lay 20 steps "
        "before, or 6 steps before if coarser levels were run first, and if ten times as many steps more would "
        "not move it by 0.7 of this either, by its trend. Larger ends sooner and is rougher.",
        entry=SettingEntry(unit="voxels"),
        gt=0,
        le=2,
    )
    percentile: float = setting(
        95.0,
        "Limit of the fastest points: the time step follows this percentile of the speeds on the surface, and points "
        "that are faster move by cfl voxels in a step. 100 limits none, and a single fast point makes all steps short.",
        entry=SettingEntry(unit="%", metavar="PERCENT"),
        gt=0,
        le=100,
    )
    epsilon: float = setting(
        1.5,
        "Half width over which the energy goes from inside to outside at the surface, in voxels; 0 is sharp and sees "
        "single voxels.",
        entry=SettingEntry(unit="voxels", metavar="VOXELS", scope="term"),
        ge=0,
        le=2.5,
    )
    half_width: Annotated[int, Field(ge=3, le=32)] | Literal["auto"] = setting(
        "auto",
        "Half width of the narrow band, in voxels; auto is 3, for flowable-mass and region-mass 4.",
        entry=SettingEntry(unit="voxels", metavar="N"),
    )
    seed: Annotated[int, Field(ge=0)] | None = setting(
        None,
        "Seed of everything random in the run; drawn and reported unless given.",
        entry=SettingEntry(RUN, metavar="N", fixed=True),
    )
    reproducible: bool = setting(
        False,
        "Refuse to run anything random without a seed.",
        entry=SettingEntry(RUN, fixed=True),
    )
    threads: Literal["auto"] | Annotated[int, Field(ge=1)] = setting(
        "auto",
        "Number of threads; auto: one for each core. The result does not depend on it.",
        entry=SettingEntry(RUN, metavar="N", fixed=True),
    )
    edit: Edits = setting(
        (),
        "Settings that change while it runs, each before a step: 'step=30 smoothness=0.5'; in TOML tables [[edit]]. "
        "Clicks correct a run that has ended: --refine.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="CHANGE", repeated=True, fixed=True),
    )
    stop_at_rest: bool = setting(
        False,
        "End the run where the surface first nearly stands still, before it breaks through a gap to something else.",
        entry=SettingEntry(RUN, fixed=True),
    )
    refine: Refinements = setting(
        (),
        "Corrections of the finished run, one after another: 'inside=point:X,Y,Z outside=WHERE near=MM' (with "
        "object=ID among several objects), 'new=ID inside=WHERE size=VOLUME' (a further object), 'merge=ID,ID', "
        "'split=point:X,Y,Z' (what is connected to it becomes an object), 'remove=ID'; in TOML tables [[refine]]. "
        "accelsurf refine adds them.",
        entry=SettingEntry(RUN, viewer="elsewhere", metavar="CLICKS", repeated=True, fixed=True),
    )
    extension: Literal["closest-point", "fast-marching"] = setting(
        "closest-point",
        "How voxels near the surface get their distance and speed from it: from the closest point of the surface, or "
        "by fast marching, from voxel to voxel outwards. Both find the same objects.",
        entry=SettingEntry(RUN, choice=True, metavar="NAME", fixed=True),
    )
    end: Literal["lowest", "present"] = setting(
        "lowest",
        "Which state a run that has used up its steps ends with: that of the lowest energy so far, or the present one, "
        "as the viewer saves it.",
        entry=SettingEntry(RUN, choice=True, metavar="lowest|present", fixed=True),
    )
    level: Annotated[int, Field(ge=0)] | Literal["auto"] = setting(
        0,
        "Level of an image that is stored as a pyramid (OME-Zarr); 0 is the finest, auto the finest that fits into the "
        "memory.",
        entry=SettingEntry(IMAGE, metavar="N|auto", fixed=True),
    )
    channel_index: Annotated[int, Field(ge=0)] | None = setting(
        None,
        "Channel of an image that has several, from 0 on.",
        entry=SettingEntry(IMAGE, metavar="N", fixed=True),
    )
    time_index: Annotated[int, Field(ge=0)] | None = setting(
        None,
        "Time point of an image that has several, from 0 on; needed then.",
        entry=SettingEntry(IMAGE, metavar="N", fixed=True),
    )
    channels_from_time: bool = setting(
        False,
        "The time points are channels of one image.",
        entry=SettingEntry(IMAGE, fixed=True),
    )
    series: str | None = setting(
        None,
        "Which series of a DICOM folder: its UID, or its number as accelsurf info FOLDER lists it.",
        entry=SettingEntry(IMAGE, metavar="UID|N", fixed=True),
    )
    spacing: Annotated[
        str | None, BeforeValidator(checked(spacing_of, numbers=(int, float), joined=True))
    ] = setting(
        None,
        "Size of a voxel, X,Y,Z or one number, in mm or with a unit (0.2,0.2,1um), where the file does not say it.",
        entry=SettingEntry(IMAGE, metavar="X,Y,Z", fixed=True),
    )
    mesh: Annotated[
        Annotated[tuple[Annotated[str, OneOf(lambda: MESH_FORMATS)], ...], Field(min_length=1)]
        | Literal["auto"],
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
    mesh_faces: int | None = setting(
        None,
        "Make the written mesh coarser, to this number of triangles.",
        entry=SettingEntry(FILES, metavar="N", fixed=True),
        ge=4,
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
        entry=SettingEntry(FILES, metavar="auto|yes|no", fixed=True),
    )
    checkpoint: Annotated[
        Annotated[str, Field(pattern=INTERVAL)] | None,
        BeforeValidator(checked(interval_of, INTERVAL, int)),
    ] = setting(
        None,
        "How often the state of the run is written while it goes on: 50 (steps), 30s, 5min. A killed run goes on from "
        "it with --resume, and ends with the same bytes; it is removed when the run has ended.",
        entry=SettingEntry(FILES, metavar="STEPS|TIME", fixed=True),
    )
    name: Annotated[tuple[str, ...], BeforeValidator(checked_names)] = setting(
        (),
        "Name of an object in files: ID=NAME, or NAME where there is one object.",
        entry=SettingEntry(FILES, metavar="ID=NAME", repeated=True, fixed=True),
    )
    color: Annotated[tuple[str, ...], BeforeValidator(checked_colors)] = setting(
        (),
        "Colour of an object in files: ID=#rrggbb or ID=R,G,B.",
        entry=SettingEntry(FILES, metavar="ID=COLOUR", repeated=True, fixed=True),
    )
    label_table: str | None = setting(
        None,
        "Names and colours of objects: a file of ITK-SNAP (.txt), 3D Slicer (.ctbl, .seg.nrrd), BIDS (.tsv) or DICOM "
        "(a segmentation, .dcm), or a .csv with columns id, name and color.",
        entry=SettingEntry(FILES, metavar="FILE", fixed=True),
    )
    also: Annotated[tuple[Annotated[str, OneOf(also_names)], ...], BeforeValidator(all_split)] = (
        setting(
            (),
            "Further files of the objects, separated by commas: {}.",
            entry=SettingEntry(FILES, metavar="NAMES", repeated=True, fixed=True, listed=also_help),
        )
    )
    label_group: str | None = setting(
        None,
        "Also write the label map into the labels of the image, an OME-Zarr 0.5, under this name; the image is not "
        "touched.",
        entry=SettingEntry(FILES, metavar="NAME", fixed=True),
    )
    window: Annotated[str, BeforeValidator(checked_window)] = setting(
        AUTO,
        "Values of the image that pictures draw black to white: LEVEL,WIDTH, as 40,400; of a CT soft-tissue, bone, "
        "lung or brain; auto follows from the object and what is around it.",
        entry=SettingEntry(FILES, metavar="NAME|LEVEL,WIDTH", fixed=True),
    )
    layout: Layout = setting(
        "plain",
        "How label maps are named and laid out: plain, bids (derivatives, with sidecars), or nnunet (CASE.nii.gz).",
        entry=SettingEntry(FILES, metavar="NAME", fixed=True),
    )

    @property
    def reading(self) -> ReadOptions:
        """Options of reading the image."""
        return ReadOptions(
            self.level,
            self.channel_index,
            self.time_index,
            self.channels_from_time,
            self.series,
            None if self.spacing is None else spacing_of(self.spacing),
        )
