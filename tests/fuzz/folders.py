"""Valid inputs of several files: headers with data files, stores of chunks, slices, frames, pairs of label maps."""

import functools
import gzip
import io
import tempfile
import warnings
import zlib
from pathlib import Path

import numpy as np

from accelsurf import io as files
from accelsurf.io import label_tables
from accelsurf.settings.file_formats import image_suffixes
from accelsurf.settings.labels import LabelEntry
from tests.fuzz.inputs import DATA_FILE, FRAMES, SHAPE, VALUES, VOLUME, Input, of_folder
from tests.support import dicom_series

#: The parts along z of the arrays in chunks.
CHUNK = (2, 5, 6)
JSON = {".json": "json", ".zattrs": "json", ".zgroup": "json", ".zarray": "json"}
TEXT = {
    ".csv": "text",
    ".tsv": "text",
    ".txt": "text",
    ".nhdr": "text",
    ".mhd": "text",
    ".toml": "text",
}


def every() -> list[Input]:
    """All of them."""
    return [
        *_paired(),
        *_zarrs(),
        *_dicoms(),
        *_frames(),
        *_label_tables(),
        *_evaluated(),
        *_batches(),
    ]


def _paired():
    """A header and its data file."""
    nrrd = (
        "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: 1 2 3\nendian: little\nencoding: {}\n"
        f"data file: {DATA_FILE}\n"
    )
    meta = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = {}\n"
        f"ElementSpacing = 1 2 3\nDimSize = 6 5 4\nElementType = MET_SHORT\nElementDataFile = {DATA_FILE}\n"
    )
    raw = VALUES.tobytes()
    for case, name, header, data in (
        ("nhdr-raw", "a.nhdr", nrrd.format("raw"), raw),
        ("nhdr-gzip", "a.nhdr", nrrd.format("gzip"), gzip.compress(raw, 1, mtime=0)),
        ("nrrd-raw", "a.nrrd", nrrd.format("raw"), raw),
        ("mhd-raw", "a.mhd", meta.format("False"), raw),
        ("mhd-zlib", "a.mhd", meta.format("True"), zlib.compress(raw)),
    ):
        if name.endswith(image_suffixes()):
            yield from of_folder(
                "paired", case, {name: header.encode(), DATA_FILE: data}, TEXT | {".nrrd": "text"}
            )

    yield from _in_several_files(meta)


def _in_several_files(meta: str):
    """NIfTI as header and voxels, and MetaImages with a list of files."""
    import nibabel

    pair = nibabel.Nifti1Pair(VALUES.T.copy(), np.diag([0.75, 0.5, 3.0, 1.0]))
    with tempfile.TemporaryDirectory() as folder:
        pair.to_filename(Path(folder) / "a.hdr")
        plain = content_of(Path(folder))
    packed = {f"{name}.gz": gzip.compress(content, 1, mtime=0) for name, content in plain.items()}
    yield from of_folder("paired", "hdr", plain)
    yield from of_folder("paired", "hdr-gzip", packed)
    for case, said, parts in (
        ("list-slices", "LIST", list(VALUES)),
        ("list-volumes", "LIST 3D", [VALUES]),
    ):
        names = [f"p{number}.raw" for number in range(len(parts))]
        header = meta.format("False").replace(DATA_FILE, "\n".join([said, *names]))
        files_of = {name: part.tobytes() for name, part in zip(names, parts, strict=True)}
        yield from of_folder("paired", case, {"a.mhd": header.encode(), **files_of}, TEXT)


def content_of(folder: Path) -> dict[str, bytes]:
    """All files in a folder, by their paths."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def codecs() -> dict[str, dict]:
    """Of each codec what an array of zarr is made with; the first letter is the format."""
    import numcodecs
    from zarr import codecs as of_3

    shards = {"chunks": (1, 5, 6), "shards": CHUNK}
    return {
        "3-none": {"compressors": None},
        "3-crc32c": {"compressors": [of_3.Crc32cCodec()]},
        "3-gzip": {"compressors": [of_3.GzipCodec(level=1)]},
        "3-zstd": {"compressors": [of_3.ZstdCodec(level=1)]},
        "3-zstd-checksum": {"compressors": [of_3.ZstdCodec(level=1, checksum=True)]},
        "3-blosc-lz4": {"compressors": [of_3.BloscCodec(cname="lz4", typesize=2)]},
        "3-blosc-zstd": {"compressors": [of_3.BloscCodec(cname="zstd", typesize=2)]},
        "3-shards-crc32c": {"compressors": [of_3.Crc32cCodec()], **shards},
        "3-shards-gzip": {"compressors": [of_3.GzipCodec(level=1)], **shards},
        "2-none": {"compressors": None},
        "2-zlib": {"compressors": numcodecs.Zlib(1)},
        "2-gzip": {"compressors": numcodecs.GZip(1)},
        "2-zstd": {"compressors": numcodecs.Zstd(1)},
        "2-blosc": {"compressors": numcodecs.Blosc("lz4", 1, numcodecs.Blosc.SHUFFLE)},
    }


def _zarrs():
    """An OME-Zarr with each codec, and one with a time axis."""
    with tempfile.TemporaryDirectory() as base:
        template = Path(base) / "template.ome.zarr"
        files.write(VOLUME, template)
        for case, options in codecs().items():
            yield from of_folder("zarr", case, _stored(Path(base) / case, template, options), JSON)
        timed = Path(base) / "timed.ome.zarr"
        with files.SequenceWriter(
            timed, VOLUME.geometry, (0.0, 1.0, 2.0), "s", VALUES.dtype
        ) as writer:
            for number, frame in enumerate(FRAMES):
                writer.write(number, frame)
        found = {
            name: content
            for name, content in content_of(timed).items()
            if name.startswith(("zarr", "0/"))
        }
        yield from of_folder(
            "frames", "a.ome.zarr", {f"a.ome.zarr/{n}": c for n, c in found.items()}, JSON
        )


def _stored(folder: Path, template: Path, options: dict) -> dict[str, bytes]:
    """A store with one level, whose array has a codec."""
    import json

    import zarr

    attributes = json.loads((template / "zarr.json").read_bytes())["attributes"]
    scales = attributes["ome"]["multiscales"][0]
    scales["datasets"] = scales["datasets"][:1]
    form = int(folder.name[0])
    if form == 2:
        attributes = {"multiscales": [{"version": "0.4", **scales}]}
    group = zarr.open_group(folder, mode="w", zarr_format=form, attributes=attributes)
    given = {"chunks": CHUNK, **options}
    if form == 3:
        given["dimension_names"] = ("z", "y", "x")
    else:
        given["chunk_key_encoding"] = {"name": "v2", "separator": "/"}
    array = group.create_array("0", shape=SHAPE, dtype="int16", **given)
    array[...] = VALUES
    return content_of(folder)


def series() -> dicom_series.Series:
    """The slices of the DICOM cases."""
    return dicom_series.Series().stacked(4)


@functools.cache
def _slices() -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Files of the series, plain and packed."""
    from pydicom.uid import RLELossless

    made, plain, packed = series(), {}, {}
    for number in range(len(made.positions)):
        for kind in (plain, packed):
            dataset, content = made.dataset(number), io.BytesIO()
            if kind is packed:
                dataset.compress(RLELossless, generate_instance_uid=False)
            dataset.save_as(content, enforce_file_format=True)
            kind[f"{number:03d}.dcm"] = content.getvalue()
    return plain, packed


def _dicoms():
    """A folder of slices, and one with a segmentation beside them."""
    plain, packed = _slices()
    yield from of_folder("dicom", "plain", plain)
    yield from of_folder("dicom", "packed", packed)
    yield from of_folder(
        "dicom", "segmentation", {**plain, "seg.dcm": _segmentation(plain)}, only=("seg.dcm",)
    )


def _segmentation(slices: dict[str, bytes]) -> bytes:
    """A DICOM segmentation of these slices, by highdicom."""
    import highdicom
    import pydicom
    from pydicom.sr.codedict import codes

    sources = [pydicom.dcmread(io.BytesIO(content)) for content in slices.values()]
    described = highdicom.seg.SegmentDescription(
        1,
        "ball",
        codes.SCT.Tissue,
        codes.SCT.Tissue,
        highdicom.seg.SegmentAlgorithmTypeValues.MANUAL,
    )
    mask = np.zeros((len(sources), sources[0].Rows, sources[0].Columns), np.uint8)
    mask[1:3, 1:3, 2:4] = 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the patient has one name only
        made = highdicom.seg.Segmentation(
            sources,
            mask,
            highdicom.seg.SegmentationTypeValues.BINARY,
            [described],
            "1.2.3.77",
            7,
            "1.2.3.78",
            1,
            "accelsurf",
            "fuzz",
            "0",
            "0",
        )
    content = io.BytesIO()
    made.save_as(content)
    return content.getvalue()


def _frames():
    """Sequences: in one file with a time axis, and in a folder."""
    import nibabel
    import tifffile

    four = nibabel.Nifti1Image(FRAMES.T.copy(), np.diag([0.75, 0.5, 3.0, 1.0]))
    four.header.set_xyzt_units("mm", "sec")
    yield Input("frames", ".nii", "binary", four.to_bytes())
    yield Input("frames", ".nii.gz", "binary", gzip.compress(four.to_bytes(), 1, mtime=0))
    head = "NRRD0005\ntype: short\ndimension: 4\nspace: left-posterior-superior{}\nsizes: {}\nkinds: {}\n"
    head += "space directions: {}\nspace origin: {}\nendian: little\nencoding: raw\n{}\n"
    turns = "(1,0,0,0) (0,2,0,0) (0,0,3,0) (0,0,0,1)"
    last = head.format(
        "-time", "6 5 4 3", "domain domain domain time", turns, "(0,0,0,0)", ""
    ).encode()
    turns = "none (1,0,0) (0,2,0) (0,0,3)"
    time = "axis 0 index type:=time\n"
    first = head.format("", "3 6 5 4", "list domain domain domain", turns, "(0,0,0)", time).encode()
    yield Input("frames", ".nrrd", "mixed", last + FRAMES.tobytes())
    yield Input("frames", ".seq.nrrd", "mixed", first + np.moveaxis(FRAMES, 0, -1).tobytes())
    meta = (
        "ObjectType = Image\nNDims = 4\nBinaryData = True\nBinaryDataByteOrderMSB = False\nElementSpacing = 1 2 3 1\n"
        "DimSize = 6 5 4 3\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    )
    yield Input("frames", ".mha", "mixed", meta.encode() + FRAMES.tobytes())
    stream = io.BytesIO()
    np.save(stream, FRAMES)
    yield Input("frames", ".npy", "mixed", stream.getvalue())
    for options in (
        {"ome": True, "metadata": {"axes": "TZYX"}},
        {"imagej": True, "metadata": {"axes": "TZYX"}},
    ):
        stream = io.BytesIO()
        tifffile.imwrite(stream, FRAMES.astype(np.uint16), photometric="minisblack", **options)
        yield Input("frames", ".tif", "mixed", stream.getvalue())
    nifti = {
        f"t{n}.nii": nibabel.Nifti1Image(frame.T.copy(), np.eye(4)).to_bytes()
        for n, frame in enumerate(FRAMES)
    }
    yield from of_folder(
        "frames", "nifti", {f"nifti/{name}": content for name, content in nifti.items()}
    )
    pages = {}
    for number, frame in enumerate(FRAMES):
        stream = io.BytesIO()
        tifffile.imwrite(
            stream, frame.astype(np.uint16), photometric="minisblack", compression="zlib"
        )
        pages[f"tiff/t{number}.tif"] = stream.getvalue()
    yield from of_folder("frames", "tiff", pages)


def _label_tables():
    """Tables of labels in each form."""
    entries = [
        LabelEntry(1, "liver", (200, 60, 60)),
        LabelEntry(7, 'left "big" kidney', (0, 128, 255)),
    ]
    yield Input("labels", ".txt", "text", label_tables.itk_snap_text(entries).encode())
    yield Input("labels", ".ctbl", "text", label_tables.color_table_text(entries).encode())
    yield Input("labels", ".tsv", "text", label_tables.bids_text(entries).encode())
    yield Input("labels", ".csv", "text", b"id,name,r,g,b\n1,liver,200,60,60\n7,kidney,0,128,255\n")
    yield Input("labels", ".csv", "text", b"name,color,label\nliver,#c83c3c,1\n")
    head = (
        "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 1 1 1\nencoding: raw\nSegment0_Name:=liver\n"
    )
    head += "Segment0_LabelValue:=1\nSegment0_Color:=0.8 0.2 0.2\nSegment0_ID:=a\n\n"
    yield Input("labels", ".seg.nrrd", "mixed", head.encode() + b"\1")
    import nibabel

    image = nibabel.Nifti1Image((VALUES > 60).T.astype(np.uint8), np.eye(4))
    text = '<CaretExtension><VolumeInformation Index="0"><LabelTable><Label Key="1" Red="0.8" Green="0.2" Blue="0.2" '
    text += 'Alpha="1">liver</Label></LabelTable></VolumeInformation></CaretExtension>'
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension(30, text.encode()))
    yield Input("labels", ".nii", "mixed", image.to_bytes())


def _evaluated():
    """What ``evaluate`` reads: two label maps, a table of pairs, tracks."""
    import nibabel
    import tifffile

    maps = {}
    for name, low in (("pred.nii.gz", 50), ("ref.nii.gz", 60)):
        labels = (VALUES > low).astype(np.uint8) + (VALUES > 100)
        image = nibabel.Nifti1Image(labels.T.astype(np.uint8), np.diag([-0.5, -0.5, 3.0, 1.0]))
        maps[name] = gzip.compress(image.to_bytes(), 1, mtime=0)
    yield from of_folder("evaluate", "pair", maps, only=("pred.nii.gz",))
    table = b'case,pred,ref\na,pred.nii.gz,"ref.nii.gz@1,2-3"\nb,pred.nii.gz@2,ref.nii.gz\n'
    yield from of_folder(
        "evaluate", "table", {"pairs.csv": table, **maps}, TEXT, only=("pairs.csv",)
    )
    tracks = "frame,id,parent,seen\n0,1,,1\n1,1,,1\n1,2,1,1\n2,2,1,0\n"
    labels = np.stack([(VALUES > 60), (VALUES > 60) + 1 * (VALUES > 100), (VALUES > 60)]).astype(
        np.uint8
    )
    four = nibabel.Nifti1Image(labels.T.copy(), np.eye(4)).to_bytes()
    found = {"a_labels.nii": four, "a_tracks.csv": tracks.encode()}
    yield from of_folder("tracks", "labels", found, TEXT)
    folder = {"res_track.txt": b"1 0 2 0\n2 1 1 1\n"}
    for number, frame in enumerate(labels):
        stream = io.BytesIO()
        tifffile.imwrite(stream, frame.astype(np.uint16), photometric="minisblack")
        folder[f"mask{number:03d}.tif"] = stream.getvalue()
    yield from of_folder("tracks", "challenge", folder, TEXT)


def _batches():
    """Tables of cases, of images and of sequences."""
    image = b'image,id,preset,start,smoothness,mask\na.nii,first,mr-brain,"ball:1,2,3,4; ball:5,5,5,2",0.5,\n'
    image += b"c.nii.gz,,,otsu,1,m.nii@2\n"
    words = b'image,id,start,max_gap,correct\na.nii,cell,"ball:1,2,3,4",2,"frame=1 inside=point:1,2,3 object=1"\n'
    for suffix, table in (
        (".csv", image),
        (".tsv", b"image\tid\tpreset\na.nii\tx\tmr-brain\nb.nii\ty\t\n"),
    ):
        yield Input("cases", suffix, "text", table)
    yield Input("sequences", ".csv", "text", words)
