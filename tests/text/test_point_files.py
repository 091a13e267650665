"""Points of other programs, as they write them: where they lie, and what is refused."""

import json
import math

import numpy as np
import pytest

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.text.clicks import read_clicks
from accelsurf.text.coordinates import Suffix, box_of, coordinates_of, split_suffix
from accelsurf.text.starts import parse_start

GRID = Geometry((12, 16, 20), (2.0, 1.0, 0.5), (-30.0, 10.0, 5.0))
#: Two voxels (z, y, x) and their places in world mm, LPS.
VOXELS = [[3, 4, 6], [7, 9, 12]]
PLACES = [GRID.index_to_world(np.array(voxel, float)).tolist() for voxel in VOXELS]
FCSV = (
    "# Markups fiducial file version = 4.11\n# CoordinateSystem = {}\n"
    "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
)


def read_points(file, grid=GRID):
    """Voxels of the points of a file, as clicks."""
    clicks = read_clicks([file], "inside", Volume(np.zeros(grid.shape, np.float32), grid))
    return [
        (np.argwhere(click.mask)[0] + [s.start for s in click.box]).tolist() for click in clicks
    ]


def lps(point):
    return point


def ras(point):
    return [-point[0], -point[1], point[2]]


def markups(system, turn, **changes):
    """A file as 3D Slicer 5 writes it."""
    points = [
        {
            "id": str(number),
            "label": f"F-{number}",
            "description": "",
            "associatedNodeID": "vtkMRMLScalarVolumeNode1",
            "position": turn(place),
            "orientation": [-1.0, -0.0, -0.0, -0.0, -1.0, -0.0, 0.0, 0.0, 1.0],
            "selected": True,
            "locked": False,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, place in enumerate(PLACES, 1)
    ]
    schema = (
        "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
        "markups-schema-v1.0.3.json#"
    )
    markup = {
        "type": "Fiducial",
        "coordinateSystem": system,
        "coordinateUnits": "mm",
        "locked": False,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": 2,
        "controlPoints": points,
        "measurements": [],
        "display": {"visibility": False, "opacity": 1.0},
    }
    return {"@schema": schema, "markups": [{**markup, **changes}]}


def fcsv(system, turn):
    rows = [
        f'vtkMRMLMarkupsFiducialNode_{number},{",".join(map(str, turn(place)))},0,0,0,1,1,1,0,"F-{number}, left",,'
        for number, place in enumerate(PLACES)
    ]
    return FCSV.format(system) + "\n".join(rows) + "\n"


def table(head, rows):
    return head + "\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n"


FILES = {
    "lps.mrk.json": json.dumps(markups("LPS", lps)),
    "ras.mrk.json": json.dumps(markups("RAS", ras)),
    "um.mrk.json": json.dumps(
        markups("LPS", lambda p: [1000 * v for v in p], coordinateUnits="um")
    ),
    "coded.mrk.json": json.dumps(markups("LPS", lps, coordinateUnits=["mm", "UCUM", "millimeter"])),
    "curve.mrk.json": json.dumps(markups("LPS", lps, type="Curve")),
    "lps.fcsv": fcsv("LPS", lps),
    "ras.fcsv": fcsv("RAS", ras),
    "zero.fcsv": fcsv("0", ras),
    "one.fcsv": fcsv("1", lps),
    "old.fcsv": "\n".join(line for line in fcsv("0", ras).splitlines() if "System" not in line),
    "slicer_ras.csv": table(
        "label,r,a,s,defined,selected,visible,locked,description",
        [(f"F-{n}", *ras(p), 1, 1, 1, 0, "") for n, p in enumerate(PLACES)],
    ),
    "slicer_lps.csv": table(
        "label,l,p,s,defined,selected,visible,locked,description",
        [(f"F-{n}", *p, 1, 1, 1, 0, "") for n, p in enumerate(PLACES)],
    ),
    "napari.csv": table(
        "index,axis-0,axis-1,axis-2", [(float(n), *map(float, v)) for n, v in enumerate(VOXELS)]
    ),
    "c3d.txt": "".join("{} {} {} 1\n".format(*ras(place)) for place in PLACES),
    "own.csv": table("x,y,z", PLACES),
}


@pytest.mark.parametrize("name", FILES)
def test_points_lie_where_their_program_has_put_them(name, tmp_path):
    (tmp_path / name).write_text(FILES[name])
    volume = Volume(np.zeros(GRID.shape, np.float32), GRID)
    clicks = read_clicks([str(tmp_path / name)], "inside", volume)
    found = sorted(
        (np.argwhere(click.mask) + [s.start for s in click.box]).tolist() for click in clicks
    )
    assert sorted(sum(found, [])) == VOXELS
    assert len(clicks) == (
        1 if name == "own.csv" else 2
    )  # each point is a click; a stroke of its own is one


def test_points_of_one_slice_have_two_numbers(tmp_path):
    flat = Geometry((1, 16, 20), (1.0, 1.0, 0.5))
    (tmp_path / "flat.csv").write_text(table("index,axis-0,axis-1", [(0, 4, 6)]))
    assert read_points(str(tmp_path / "flat.csv"), flat) == [[0, 4, 6]]


def deep(levels):
    return '{"markups": ' + "[" * levels + "]" * levels + "}"


def without(point, **changes):
    document = markups("LPS", lps)
    document["markups"][0]["controlPoints"][0] = {
        **document["markups"][0]["controlPoints"][0],
        **changes,
    }
    return json.dumps(document)


HOSTILE = {
    "deep.mrk.json": (deep(200_000), "not JSON"),
    "list.mrk.json": ("[1, 2]", "no list of markups"),
    "cut.mrk.json": (FILES["lps.mrk.json"][:200], "not JSON"),
    "hfs.mrk.json": (json.dumps(markups("HFS", lps)), "coordinate system HFS"),
    "inch.mrk.json": (
        json.dumps(markups("LPS", lps, coordinateUnits="inch")),
        "coordinates in inch",
    ),
    "roi.mrk.json": (json.dumps(markups("LPS", lps, type="ROI")), "markups of the type ROI"),
    "none.mrk.json": (json.dumps(markups("LPS", lps, controlPoints=[])), "no point"),
    "points.mrk.json": (
        json.dumps(markups("LPS", lps, controlPoints={"a": 1})),
        "no list of points",
    ),
    "text.mrk.json": (without(0, position=["a", 1, 2]), "expected three numbers"),
    "truth.mrk.json": (without(0, position=[True, 1, 2]), "expected three numbers"),
    "two.mrk.json": (without(0, position=[1, 2]), "expected three numbers"),
    "nan.mrk.json": (without(0, position=[math.nan, 1, 2]), "no finite number"),
    "huge.mrk.json": (without(0, position=[10**400, 1, 2]), "too large"),
    "far.mrk.json": (without(0, position=[1e6, 1, 2]), "outside of the volume"),
    "many.mrk.json": (
        json.dumps(markups("LPS", lps, controlPoints=[{"position": PLACES[0]}] * 1001)),
        "at most 1000 expected",
    ),
    "system.fcsv": (fcsv("7", lps), "coordinate system 7"),
    "short.fcsv": (FCSV.format("LPS") + "1,2\n", "point 1 has no 3 numbers"),
    "columns.fcsv": (FCSV.format("LPS").replace("x,y,z", "u,v,w") + "1,2,3,4\n", "without x,y,z"),
    "head.csv": ("a,b,c\n1,2,3\n", "was given as the first line"),
    "shapes.csv": (
        "index,shape-type,vertex-index,axis-0,axis-1,axis-2\n0,polygon,0,1,2,3\n",
        "table of shapes",
    ),
    "four.csv": ("index,axis-0,axis-1,axis-2,axis-3\n0,1,1,2,3\n", "was given as the first line"),
    "words.txt": ("one two three\n", "point 1 has no 3 numbers"),
    "inf.txt": ("inf 1 2 1\n", "no finite number"),
    "bytes.txt": (b"\xff\xfe\x00", "not a file of text"),
    "large.txt": (b"1 2 3 1\n" * (1 << 19) + b"1", "bytes, at most"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_is_no_such_file_is_refused_in_a_line(name, tmp_path):
    content, said = HOSTILE[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=said) as caught:
        read_points(str(tmp_path / name))
    assert "\n" not in str(caught.value.message) and name in caught.value.message


def test_points_that_are_not_placed_are_left_out(tmp_path):
    (tmp_path / "a.mrk.json").write_text(without(0, positionStatus="undefined", position=None))
    assert read_points(str(tmp_path / "a.mrk.json")) == VOXELS[1:]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="missing.fcsv"):
        read_points(str(tmp_path / "missing.fcsv"))


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("{x},{y},{z}", "point:{x},{y},{z}"),
        ("point:{r},{a},{z}ras", "point:{x},{y},{z}"),
        ("point:{x},{y},{z}mm", "point:{x},{y},{z}"),
        ("6,4,3vox", "point:{x},{y},{z}"),
        ("ball:{r},{a},{z},3ras", "ball:{x},{y},{z},3"),
        ("ball:{cx},{cy},{cz},0.3cm", "ball:{x},{y},{z},3"),
        ("ball:{ux},{uy},{uz},3000um", "ball:{x},{y},{z},3"),
        ("path:{r},{a},{z},2;{r},{a},{z1},2ras", "path:{x},{y},{z},2;{x},{y},{z1},2"),
        ("box:{r1},{a1},{z},{r},{a},{z1}ras", "box:{x},{y},{z},{x1},{y1},{z1}"),
    ],
)
def test_places_in_other_units_and_in_ras_are_the_same_voxels(text, same):
    volume = Volume(np.arange(np.prod(GRID.shape), dtype=np.float32).reshape(GRID.shape), GRID)
    x, y, z = PLACES[0]
    words = dict(x=x, y=y, z=z, r=-x, a=-y, x1=x + 2, y1=y + 3, z1=z + 4, r1=-x - 2, a1=-y - 3)
    words |= dict(cx=x / 10, cy=y / 10, cz=z / 10, ux=1000 * x, uy=1000 * y, uz=1000 * z)
    (one,), (other,) = (
        read_clicks([each.format(**words)], "inside", volume) for each in (text, same)
    )
    assert one.box == other.box and np.array_equal(one.mask, other.mask)


def test_the_end_of_a_place():
    assert split_suffix("1,2,3nm") == ("1,2,3", Suffix(unit=1e-6))
    assert coordinates_of("1,2,3µm").numbers == pytest.approx((1e-3, 2e-3, 3e-3))
    assert coordinates_of("1,2,3voxras") is None and coordinates_of("1,2,3km") is None
    assert box_of("0,0,0,1,2,3ras").numbers == (-1.0, -2.0, 0.0, 0.0, 0.0, 3.0)
    assert box_of("0,0,0") is None and box_of("a,0,0,1,1,1") is None


@pytest.mark.parametrize(
    "text", ["ball:1,2,3,4km", "ball:1,2,3vox", "box:0,0,0,1,1ras", "seed:1,2,3,0um"]
)
def test_places_that_are_none_are_refused(text):
    with pytest.raises(UsageError):
        parse_start(text)
    with pytest.raises(UsageError, match="3 numbers separated by commas"):
        read_clicks(["1,2"], "inside", Volume(np.zeros(GRID.shape, np.float32), GRID))
