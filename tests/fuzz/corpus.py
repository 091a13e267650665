"""Small valid inputs of every kind, and the input of a number: one of them, mutated."""

import functools
import gzip
import io
import json
import struct
import tempfile
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydicom.uid import RLELossless

from accelsurf import io as files
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.formats import surface_files
from accelsurf.settings.file_formats import written_suffixes
from accelsurf.settings.run_config import RunConfig
from tests.fuzz import folders, mutators, runs
from tests.fuzz.inputs import DATA_FILE, SHAPE, VALUES, Input
from tests.support import dicom_series


@functools.cache
def seeds() -> tuple[Input, ...]:
    with tempfile.TemporaryDirectory() as folder:
        return (
            *_images(Path(folder)),
            *_meshes(),
            *_texts(),
            *_runs(),
            *_states(),
            *folders.every(),
            *runs.every(),
        )


def seeds_of_name(kinds: Iterable[str] = ()) -> tuple[Input, ...]:
    """The valid inputs of some kinds; of all without any."""
    wanted = set(kinds)
    return tuple(given for given in seeds() if not wanted or given.kind in wanted)


def input_of(seed: int, number: int, among: tuple[Input, ...] = ()) -> Input:
    """The input of a number, the same for the same seed and the same valid inputs; by default `seeds`."""
    rng = np.random.default_rng([seed, number])
    among = among or seeds()
    kinds = sorted({given.kind for given in among})
    # Images first: they have the most ways to be wrong.
    is_image = "image" in kinds and rng.random() < 0.3
    kind = "image" if is_image else kinds[int(rng.integers(len(kinds)))]
    some = [given for given in among if given.kind == kind]
    selected = some[int(rng.integers(len(some)))]
    others = [given.content for given in some if given.suffix == selected.suffix]
    content = selected.content
    # A packed chunk is the input itself; of a packed file rather what is in it.
    if (inner := _unpacked(content)) is not None and rng.random() < (
        0.2 if kind == "zarr" else 0.8
    ):
        unpacked = [found for other in others if (found := _unpacked(other)) is not None]
        inner = mutators.mutated(inner, selected.mode, rng, unpacked)
        return selected._replace(content=gzip.compress(inner, 1, mtime=0))
    content = mutators.mutated(content, selected.mode, rng, others)
    if selected.suffix == ".png" and rng.random() < 0.8:
        content = _png_with_checksums(content)
    return selected._replace(content=content)


def _unpacked(content: bytes) -> bytes | None:
    """What is packed by gzip; None where nothing is."""
    try:
        return gzip.decompress(content) if content[:2] == b"\x1f\x8b" else None
    except (OSError, EOFError, zlib.error):  # several, as in a shard
        return None


def _slices():
    """DICOM: one slice, plain and packed, and a file of several."""
    series = dicom_series.Series().stacked(3)
    packed = series.dataset(0)
    packed.compress(RLELossless, generate_instance_uid=False)
    for one in (series.dataset(0), packed, dicom_series.enhanced(series)):
        content = io.BytesIO()
        one.save_as(content, enforce_file_format=True)
        yield Input("image", ".dcm", "binary", content.getvalue())


def _images(folder: Path):
    turned, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turned *= np.sign(np.linalg.det(turned))
    grids = [
        Geometry(SHAPE, (1.0, 1.0, 1.0)),
        Geometry(SHAPE, (3.0, 0.5, 0.75), (-12.5, 4.0, 100.25), turned),
    ]
    for suffix in written_suffixes():
        if suffix in (".tiff", ".ome.zarr", ".zarr", ".npy", ".npz"):
            continue
        for grid in grids:
            for dtype in (
                ("uint8", "int16", "float32") if suffix not in (".png",) else ("uint8", "uint16")
            ):
                values = VALUES.astype(dtype)[: 1 if suffix == ".png" else None]
                here = Geometry(values.shape, grid.spacing, grid.origin, grid.direction)
                path = folder / f"a{suffix}"
                files.write(Volume(values, here), path)
                mode = "mixed" if suffix in (".nrrd", ".mha", ".mhd") else "binary"
                if suffix != ".mhd":
                    yield Input("image", suffix, mode, path.read_bytes())
    yield from _slices()
    big = _nifti2()
    yield Input("image", ".nii", "binary", big)
    yield Input("image", ".nii.gz", "binary", gzip.compress(big, 1, mtime=0))
    nrrd = "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: 1 2 3\nendian: little\nencoding: {}\n{}\n"
    yield Input("image", ".nrrd", "mixed", nrrd.format("raw", "").encode() + VALUES.tobytes())
    yield Input("image", ".nhdr", "text", nrrd.format("raw", f"data file: {DATA_FILE}\n").encode())
    meta = (
        "ObjectType = Image\nNDims = 3\nBinaryData = {}\nBinaryDataByteOrderMSB = False\nElementSpacing = 1 2 3\n"
        "DimSize = 6 5 4\nElementType = MET_SHORT\nElementDataFile = {}\n"
    )
    yield Input("image", ".mha", "mixed", meta.format("True", "LOCAL").encode() + VALUES.tobytes())
    yield Input("image", ".mhd", "text", meta.format("True", DATA_FILE).encode())
    yield from _tiffs()
    yield from _hyperstacks()
    yield from _arrays()
    yield from _read_only()
    import nibabel

    four = nibabel.Nifti1Image(np.stack([VALUES.T, VALUES.T], axis=-1), np.eye(4))
    yield Input("channels", ".nii", "binary", four.to_bytes())
    yield Input("channels", ".nii.gz", "binary", gzip.compress(four.to_bytes(), 1, mtime=0))
    vector = nrrd.replace("dimension: 3\nsizes: 6", "dimension: 4\nsizes: 2 6").replace(
        "1 2 3", "nan 1 2 3"
    )
    kinds = "kinds: vector domain domain domain\n"
    yield Input(
        "channels", ".nrrd", "mixed", vector.format("raw", kinds).encode() + VALUES.tobytes() * 2
    )


def _nifti2() -> bytes:
    import nibabel

    image = nibabel.Nifti2Image(VALUES.T.copy(), np.diag([0.75, 0.5, 3.0, 1.0]))
    return image.to_bytes()


def _tiffs():
    import tifffile

    for options in (
        {},
        {"compression": "zlib"},
        {"compression": "lzw"},
        {"compression": "packbits"},
        {"bigtiff": True},
        {"imagej": True},
        {"tile": (16, 16)},
        {"byteorder": ">"},
        {"ome": True, "metadata": {"axes": "ZYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5}},
    ):
        stream = io.BytesIO()
        values = VALUES.astype("uint8" if "tile" in options else "uint16")
        values = np.resize(values, (2, 32, 32)) if "tile" in options else values
        try:
            tifffile.imwrite(stream, values, photometric="minisblack", **options)
        except (ImportError, ValueError, RuntimeError, KeyError):  # LZW needs a package
            continue
        yield Input("image", ".tif", "binary", stream.getvalue())
    from PIL import Image

    for compression in ("tiff_lzw", "packbits", "tiff_adobe_deflate"):
        stream = io.BytesIO()
        Image.fromarray(VALUES[0].astype(np.uint8)).save(stream, "TIFF", compression=compression)
        yield Input("image", ".tif", "binary", stream.getvalue())


def _hyperstacks():
    """TIFF of several channels, with levels, and in kinds that tifffile unpacks."""
    import tifffile

    full = np.resize(VALUES.astype("uint16"), (2, 3, 4, 5, 6))
    for options in (
        {"ome": True, "metadata": {"axes": "TCZYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5}},
        {"imagej": True, "metadata": {"axes": "TZCYX"}},
        {"metadata": {"axes": "TCZYX"}},
    ):
        stream = io.BytesIO()
        values = full.transpose(0, 2, 1, 3, 4) if "imagej" in options else full
        tifffile.imwrite(stream, values, photometric="minisblack", **options)
        yield Input("sequence", ".tif", "mixed", stream.getvalue())
    for dtype, options in (
        ("u2", {"tile": (16, 16)}),
        ("f8", {}),
        ("u2", {"tile": (16, 16), "compression": "zlib"}),
    ):
        stream = io.BytesIO()
        tifffile.imwrite(
            stream,
            np.resize(VALUES, (2, 20, 30)).astype(dtype),
            photometric="minisblack",
            **options,
        )
        yield Input("sequence", ".tif", "binary", stream.getvalue())
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as out:
        out.write(np.zeros((32, 32), np.uint8), subifds=1, photometric="minisblack", metadata=None)
        out.write(
            np.ones((16, 16), np.uint8), subfiletype=1, photometric="minisblack", metadata=None
        )
    yield Input("sequence", ".tif", "binary", stream.getvalue())


def _arrays():
    for values in (VALUES, np.asfortranarray(VALUES.astype(">f8"))):
        stream = io.BytesIO()
        np.save(stream, values)
        yield Input("sequence", ".npy", "mixed", stream.getvalue())
        yield Input("image", ".npy", "mixed", stream.getvalue())


def _read_only():
    """MGH and MGZ."""
    import nibabel

    for kind in ("uint8", "int16", "int32", "float32"):
        content = nibabel.MGHImage(VALUES.T.astype(kind), np.diag([0.75, 0.5, 3.0, 1.0])).to_bytes()
        yield Input("image", ".mgh", "binary", content)
        yield Input("image", ".mgz", "binary", gzip.compress(content, 1, mtime=0))


def _png_with_checksums(content: bytes) -> bytes:
    """The same chunks with right checksums, so that what is in them is read."""
    out, at = [content[:8]], 8
    while at + 12 <= len(content):
        length = struct.unpack(">I", content[at : at + 4])[0]
        body = content[at + 4 : at + 8 + length]
        if len(body) < 4 + length:
            break
        out.append(content[at : at + 4] + body + struct.pack(">I", zlib.crc32(body)))
        at += 12 + length
    return b"".join([*out, content[at:]])


def _meshes():
    points = np.array([[x, y, z] for z in (0, 3) for y in (0, 3) for x in (0, 3)], np.float64) + 0.7
    quads = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    for name in ("ply", "stl", "obj"):
        content = getattr(surface_files, f"{name}_bytes")(points, triangles, "LPS")
        yield Input(
            "mesh", f".{name}", {"obj": "text", "ply": "mixed"}.get(name, "binary"), content
        )
    import trimesh

    cube = trimesh.Trimesh(points, triangles, process=False)
    yield Input("mesh", ".ply", "text", cube.export(file_type="ply", encoding="ascii"))
    yield Input("mesh", ".stl", "text", cube.export(file_type="stl_ascii").encode())


def _texts():
    energies = (
        "chan-vese",
        "local-region:R=8 + 0.3*geodesic + 0.1*area",
        "threshold:-50,auto - 0.1*balloon",
        "likelihood:model=histogram,update=no",
        "threshold:half:120,80%",
        "2*chan-vese:balance=2,epsilon=1.5",
    )
    starts = (
        "ball:2,2,2,1.5",
        "ball:2,2,2,1.5vox",
        "box:0,0,0,3,3,2",
        "seed:2,2,2,1",
        "threshold:10,50",
        "largest:otsu:dark",
        "otsu",
        "center",
        f"label:{DATA_FILE}@2,5-9",
        "mesh:a@b.ply@ras",
        "threshold:,50",
    )
    edits = (
        "step=30 smoothness=0.5 cfl=0.3",
        "step=3 flow=gradient",
        "step=0 energy=geodesic balloon=-0.2",
    )
    config = RunConfig(
        smoothness=0.5, start=["ball:2,2,2,1"], edit=["step=3 cfl=0.4"], mesh="ply,stl"
    ).to_toml()
    short = "energy = [{term = 'local-region', R = 8}, {term = 'geodesic', weight = 0.3}]\nsmoothness = 1\nseed = 3\n"
    tables = (
        "id,x,y,z,r\n1,1,1,1,1\n2,4,3,3,1\n",
        "# a\nid,x_vox,y_vox,z_vox,r_vox\n7,1,1,1,1.5\n7,2,2,2,1\n",
    )
    for kind, suffix, some in (
        ("energy", ".txt", energies),
        ("start", ".txt", starts),
        ("edit", ".txt", edits),
        ("toml", ".toml", (config, short)),
        ("table", ".csv", tables),
        ("argv", ".txt", _command_lines()),
    ):
        for text in some:
            yield Input(kind, suffix, "text", text.encode())
    for suffix, text in (
        (
            ".mrk.json",
            '{"markups": [{"type": "Fiducial", "coordinateSystem": "RAS", "coordinateUnits": ["mm", "UCUM"], '
            '"controlPoints": [{"position": [1, -2.5, 3e1], "positionStatus": "defined"}]}]}',
        ),
        (".fcsv", "# CoordinateSystem = 0\n# columns = id,x,y,z,ow\nF_1,1,2,3,0\nF_2,-4.5,5,6,0\n"),
        (".csv", "label,r,a,s,defined\nF-1,1,2,3,1\n"),
        (".csv", "index,axis-0,axis-1,axis-2\n0.0,1.0,2.0,3.0\n"),
        (".txt", "1 2 3 1\n-4.5 5 6 2\n"),
    ):
        yield Input("points", suffix, "text", text.encode())


def _command_lines():
    """Words of a command line, one a line."""
    for words in (
        "--smoothness 0.5 --flow constant-density:k=2 --start ball:2,2,2,1 --roi 0,0,0,5,5,5",
        "--energy threshold:10,50 --levels 2 --mesh ply",
        "--presmooth 1.5vox --seed 4 --noise 0.1 --half-width 4",
        "--objects a.csv --format nrrd --mesh-space ras --threads 2",
        "--edit step=3 --channel b.nii --mask c.nii --max-volume 100 --preset mr-brain --restart off --friction 0.5",
    ):
        yield "\n".join(words.split())


def _runs():
    """Settings of a run of a few steps as JSON, with the values of its image."""
    for settings in (
        {
            "flow": "constant-density:k=2,lam=1,rho=1",
            "smoothness": 0.5,
            "presmooth": 0.5,
            "cfl": 0.5,
        },
        {
            "flow": "flowable-mass:k=2,t0=1,gravity=0.1",
            "diffusion": 1.0,
            "friction": 0.5,
        },
        {
            "flow": "sobolev:length=3",
            "tolerance": 0.1,
            "percentile": 95,
            "epsilon": 1.5,
        },
        {"flow": "momentum:blend=0.8", "balance": 1.0, "max_volume": 1000, "half_width": 4},
        {
            "energy": "0.5*geodesic:scale=1,contrast=0.5,balloon=-0.1 + chan-vese",
            "edge_scale": 1,
            "edge_contrast": 1,
        },
        {
            "energy": "local-region:R=3,epsilon=1 + 0.1*balloon",
            "noise": 0.1,
            "flow": "constant-density:noise_length=3,noise_time=3",
            "seed": 1,
        },
        {"energy": "threshold:20,80,soft=5", "start": "ball:5,5,5,3", "roi": "0,0,0,9,9,9"},
        {"energy": "likelihood:model=histogram", "start": "seed:5,5,5,2", "levels": 1},
    ):
        for image in ("plain", "scaled"):
            for scale, offset, one in (("1", "0", "0"), ("1e-3", "100", "5")):
                values = {
                    "image": image,
                    "scale": scale,
                    "offset": offset,
                    "voxel": one,
                    "spacing": "1.5",
                }
                text = json.dumps(
                    {"values": values, "settings": {k: str(v) for k, v in settings.items()}},
                    indent=0,
                )
                yield Input("run", ".json", "text", text.encode())


def _states():
    from accelsurf.io.states import packed_state
    from tests.fuzz.verdict import CHECKPOINT_TYPES, Point

    state = (
        {"accelsurf": "0", "run": "x"},
        Point(np.arange(6.0), (1, 2.5, None, "text", [np.float32(2), True])),
    )
    yield Input("checkpoint", ".npz", "binary", packed_state(state, CHECKPOINT_TYPES))
