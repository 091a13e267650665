"""Small meshes that claim, repeat or pack too much: refused by name, or read, with little memory and in little time.

All are read in one process, whose address space is limited, and which says for each what it took.
"""

import io
import json
import resource
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

MAX_SECONDS, MAX_MB = 5.0, 1000
CORNERS = np.array([[10.0, 20, 30], [11, 20, 30], [10, 22, 30], [10, 20, 33]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
VERTICES = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
LISTS = "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES)
BIG = (10**9, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64)


# ------------------------------------------------------------------------------------------------------- the files


def plys():
    def header(form, vertices=4, faces=4, vertex="", face="", more=""):
        return (
            f"ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
            f"{vertex}element face {faces}\nproperty list uchar int vertex_indices\n{face}{more}end_header\n"
        ).encode()

    rows = b"".join(struct.pack("<B3i", 3, *face) for face in FACES.tolist())
    body = CORNERS.astype("<f4").tobytes() + rows
    for count in (*BIG, -1, -(10**9)):
        yield f"ply vertices {count}", "ply", header("binary_little_endian", vertices=count) + body
        yield f"ply faces {count}", "ply", header("binary_little_endian", faces=count) + body
        yield f"ply text vertices {count}", "ply", header("ascii", vertices=count) + (VERTICES + LISTS).encode()
        yield f"ply text faces {count}", "ply", header("ascii", faces=count) + (VERTICES + LISTS).encode()
        more = f"element edge {count}\nproperty int vertex1\nproperty int vertex2\n"
        yield f"ply edges {count}", "ply", header("ascii", more=more) + (VERTICES + LISTS + "0 1\n" * 9).encode()
        more = f"element extra {count}\n"
        yield f"ply nothing {count}", "ply", header("binary_little_endian", more=more) + body
        counted = header("binary_little_endian").replace(b"list uchar int", b"list uint int")
        long = struct.pack("<I3i", count % 2**32, 0, 1, 2)
        yield f"ply list of {count}", "ply", counted + CORNERS.astype("<f4").tobytes() + long * 4
        text = VERTICES + LISTS.replace("3 ", f"{count} ", 1)
        yield f"ply text list of {count}", "ply", header("ascii") + text.encode()
        text = VERTICES + LISTS.replace("2", str(count))
        yield f"ply point {count}", "ply", header("ascii") + text.encode()
    yield "ply many properties", "ply", header("ascii", vertex="".join(f"property float p{n}\n" for n in range(50_000)))
    yield "ply many elements", "ply", header("ascii", more="".join(f"element e{n} 999999999\n" for n in range(50_000)))
    empty = "element e 99999999999\nproperty list uchar int a\n"
    yield "ply empty lists", "ply", header("binary_little_endian", more=empty) + body + bytes(1000)
    yield "ply texture", "ply", header("ascii", more="comment TextureFile /etc/passwd\n") + (VERTICES + LISTS).encode()
    yield "ply long line", "ply", header("ascii") + b"1 " * 1_000_000
    yield "ply no end", "ply", b"ply\nformat ascii 1.0\ncomment " + b"a" * 1_000_000


def stls():
    from accelsurf.io.formats import surface_files

    good = surface_files.stl_bytes(CORNERS, FACES, "LPS")
    for count in BIG[:3]:
        yield f"stl {count}", "stl", good[:80] + struct.pack("<I", count) + good[84:]
        yield f"stl zeros {count}", "stl", bytes(80) + struct.pack("<I", count)
    yield "stl solids", "stl", b"solid a\nendsolid a\n" * 50_000
    yield "stl no end", "stl", b"solid " * 200_000
    yield "stl ends", "stl", b"endsolid " * 200_000
    yield "stl vertices", "stl", b"solid a\n" + b"vertex " * 300_000 + b"\nendsolid"
    yield "stl spaces", "stl", b"solid " + b"SPACE" * 200_000 + b"\nendsolid"
    yield "stl equals", "stl", b"solid " + b"SPACE=" * 200_000 + b"\nendsolid"
    yield "stl blanks", "stl", b"solid SPACE" + b" " * 1_000_000 + b"\nendsolid"
    yield "stl blank lines", "stl", b"\n" * 1_000_000
    yield "stl huge numbers", "stl", b"solid a\nvertex 1e308 1e308 1e999\n" + b"vertex 1 2 3\n" * 2 + b"endsolid a\n"


def objs():
    vertices = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
    faces = [" ".join(str(n + 1) for n in face) for face in FACES]
    lines = "".join(f"f {face}\n" for face in faces)
    for number in (*BIG, -5, -(10**9), 0, -(2**63)):
        for name, face in (
            ("", f"f 1 2 {number}\n"),
            (" texture", f"f 1/{number} 2/1 3/1\n"),
            (" normal", f"f 1//{number} 2//1 3//1\n"),
            (" all", f"f {number}/{number}/{number} 2/1/1 3/1/1\n"),
            (" mixed", f"f 1 2 3 {number}\nf 1 2 3\n"),
        ):
            text = f"{vertices}vt 0 0\nvn 0 0 1\n{lines if not name else ''}{face}"
            yield f"obj{name} {number}", "obj", text.encode()
    yield "obj materials", "obj", (vertices + "mtllib /etc/passwd\nusemtl a\n" + lines).encode()
    for kind in ("usemtl", "o", "g"):
        names = "".join(f"{kind} m{n}\nf 1 2 3\n" for n in range(20_000))
        yield f"obj many {kind}", "obj", (vertices * 5000 + names).encode()
    yield "obj long face", "obj", (vertices + "f " + "1 2 3 " * 200_000 + "\n").encode()
    yield "obj remarks", "obj", (vertices + "#" * 1_000_000 + "\n" + "# SPACE\n" * 50_000).encode()
    yield "obj lines joined", "obj", ("v 0 0 \\\n" * 100_000).encode()


def vtps():
    from accelsurf.io.formats import surface_files

    good = surface_files.vtp_bytes(CORNERS, FACES, "LPS")
    head, _, data = good.partition(b"<AppendedData")
    for count in (*BIG, -1):
        yield f"vtp points {count}", "vtp", good.replace(b'NumberOfPoints="4"', f'NumberOfPoints="{count}"'.encode())
        yield f"vtp polygons {count}", "vtp", good.replace(b'NumberOfPolys="4"', f'NumberOfPolys="{count}"'.encode())
        for offset in (b"0", b"104"):
            new = f'offset="{count}"'.encode()
            yield f"vtp offset {offset} {count}", "vtp", good.replace(b'offset="%s"' % offset, new)
        eight = struct.pack("<Q", count % 2**64)
        begin = good.index(b"_", len(head)) + 1
        yield f"vtp length {count}", "vtp", good[:begin] + eight + good[begin + 8 :]
        packed = head.replace(b"<VTKFile", b'<VTKFile compressor="vtkZLibDataCompressor"')
        body = zlib.compress(bytes(1 << 20))
        for blocks, block, last in ((count, 96, 0), (1, count, 0), (1, 96, count), (2, count, count)):
            sizes = struct.pack("<4Q", *(n % 2**64 for n in (blocks, block, last, len(body))))
            mark = b'<AppendedData encoding="raw">_'
            yield f"vtp blocks {blocks} {block} {last}", "vtp", packed + mark + sizes + body
        tail = b'<AppendedData encoding="base64">_' + b"////" * 40
        yield f"vtp base64 {count}", "vtp", head.replace(b'offset="0"', f'offset="{count}"'.encode()) + tail
        text = good.replace(b'format="ascii">83', f'format="ascii">{count}'.encode(), 1)
        yield f"vtp space {count}", "vtp", text
    zeros = zlib.compress(bytes(1 << 28), 9)
    sizes = struct.pack("<4Q", 1, 1 << 28, 0, len(zeros))
    packed = head.replace(b"<VTKFile", b'<VTKFile compressor="vtkZLibDataCompressor"')
    yield "vtp packed zeros", "vtp", packed + b'<AppendedData encoding="raw">_' + sizes + zeros
    for encoding in ("utf-8", "utf-16"):
        yield f"vtp entities {encoding}", "vtp", entities("<VTKFile type='PolyData'>&j;</VTKFile>", encoding)
        system = "<!DOCTYPE a [<!ENTITY j SYSTEM 'file:///etc/passwd'>]><VTKFile type='PolyData'>&j;</VTKFile>"
        yield f"vtp file entity {encoding}", "vtp", system.encode(encoding)
    yield "vtp deep", "vtp", b"<VTKFile type='PolyData'>" + b"<a>" * 300_000
    yield "vtp wide", "vtp", b"<VTKFile type='PolyData'>" + b"<a/>" * 500_000 + b"</VTKFile>"
    pieces = b"<Piece NumberOfPoints='0'><Points><DataArray type='Int8'/></Points></Piece>" * 10_000
    yield "vtp pieces", "vtp", b"<VTKFile type='PolyData'><PolyData>" + pieces + b"</PolyData></VTKFile>"
    fields = b"<Array type='String' Name='SPACE' format='appended' offset='0'/>" * 20_000
    yield "vtp fields", "vtp", good.replace(b"<FieldData>", b"<FieldData>" + fields)
    yield "vtp comments", "vtp", good.replace(b"<PolyData>", b"<!--SPACE-->" * 100_000 + b"<PolyData>")


def entities(root, encoding="utf-8"):
    lines = "".join(f"<!ENTITY {b} '{f'&{a};' * 10}'>" for a, b in zip("abcdefghi", "bcdefghij", strict=True))
    return f"<!DOCTYPE x [<!ENTITY a '{'a' * 1000}'>{lines}]>{root}".encode(encoding)


def three_mfs():
    from accelsurf.io.formats import three_mf

    with zipfile.ZipFile(io.BytesIO(three_mf.write(CORNERS, FACES, "LPS"))) as archive:
        model = archive.read("3D/3dmodel.model").decode()

    def packed(text, name="3D/3dmodel.model", method=zipfile.ZIP_DEFLATED):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", method) as archive:
            archive.writestr(name, text)
        return stream.getvalue()

    item = '<item objectid="1"/>'
    ball = "".join(f'<vertex x="{n}" y="{n % 7}" z="{n % 3}"/>' for n in range(5000))
    for count in (1000, 200_000):
        yield f"3mf {count} items", "3mf", packed(model.replace(item, item * count))
        moved = item.replace("/>", ' transform="1 0 0 0 1 0 0 0 1 5 5 5"/>')
        yield f"3mf {count} items moved", "3mf", packed(model.replace(item, moved * count))
        yield f"3mf {count} items of a large mesh", "3mf", packed(
            model.replace("<vertices>", f"<vertices>{ball}").replace(item, item * count)
        )
        empty = "<object id='2'><mesh/></object>"
        others = item + '<item objectid="2"/>' * count
        text = model.replace("</resources>", f"{empty}</resources>").replace(item, others)
        yield f"3mf {count} empty items", "3mf", packed(text)
    parts = "".join(
        f'<object id="{n + 1}"><components>{f"""<component objectid="{n}"/>""" * 10}</components></object>'
        for n in range(1, 30)
    )
    text = model.replace("</resources>", f"{parts}</resources>").replace(item, '<item objectid="30"/>')
    yield "3mf components", "3mf", packed(text)
    itself = '<object id="2"><components><component objectid="2"/></components></object>'
    text = model.replace("</resources>", f"{itself}</resources>").replace(item, '<item objectid="2"/>')
    yield "3mf of itself", "3mf", packed(text)
    for encoding in ("utf-8", "utf-16"):
        yield f"3mf entities {encoding}", "3mf", packed(entities(model[model.index("<model") :], encoding))
    for method in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        yield f"3mf zeros {method}", "3mf", packed(bytes(1 << 28), method=method)
        yield f"3mf elements {method}", "3mf", packed(b"<a>" + b"<b/>" * 3_900_000 + b"</a>", method=method)
        yield f"3mf blanks {method}", "3mf", packed(b"<a>" + b" " * 60_000_000 + b"</a>", method=method)
    yield "3mf deep", "3mf", packed(b"<a>" * 1_000_000)
    yield "3mf other model", "3mf", packed(model, "../../etc/a.model")
    lies = bytearray(packed(model))
    at = lies.index(b"PK\x01\x02")
    for count in (0, 1, 2**31, 2**32 - 2):
        struct.pack_into("<I", lies, at + 24, count)  # the unpacked size
        yield f"3mf size {count}", "3mf", bytes(lies)
    for number in (*BIG, -1):
        yield f"3mf point {number}", "3mf", packed(model.replace('v1="1"', f'v1="{number}"'))
        yield f"3mf place {number}", "3mf", packed(model.replace('x="11.000000"', f'x="{number}e300"'))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for n in range(20_000):
            archive.writestr(f"{n}.model", "")
    yield "3mf many files", "3mf", stream.getvalue()


def glbs():
    from accelsurf.io.formats import glb

    content = glb.write(CORNERS, FACES, "LPS")
    length = struct.unpack_from("<I", content, 12)[0]
    plain = content[20 : 20 + length].decode()

    def changed(change, data=None):
        contents = json.loads(plain)
        change(contents)
        text = json.dumps(contents).encode()
        rest = content[20 + length :] if data is None else struct.pack("<II", len(data), 0x004E4942) + data
        return content[:8] + struct.pack("<III", 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest

    for count in (*BIG, -1, 1e300, float("inf"), "9" * 5000):
        for part, key in (("accessors", "count"), ("accessors", "byteOffset"), ("bufferViews", "byteOffset"),
                          ("bufferViews", "byteStride"), ("bufferViews", "byteLength"), ("buffers", "byteLength"),
                          ("accessors", "bufferView"), ("accessors", "componentType")):
            for which in (0, -1):
                name = f"glb {part} {key} {which} {str(count)[:20]}"
                yield name, "glb", changed(lambda c, p=part, k=key, w=which, n=count: c[p][w].update({k: n}))
    sparse = {"count": 10**9, "indices": {"bufferView": 0}, "values": {"bufferView": 0}}
    yield "glb sparse", "glb", changed(lambda c: c["accessors"][0].update(sparse=sparse))
    bare = {"count": 10**9, "componentType": 5126, "type": "VEC3", "sparse": sparse}
    yield "glb only sparse", "glb", changed(lambda c: c["accessors"].__setitem__(0, bare))
    for uri in ("/etc/passwd", "file:///etc/passwd", "http://localhost:1/a.bin", "data:,aaaa", "../a.bin"):
        yield f"glb uri {uri}", "glb", changed(lambda c, u=uri: c["buffers"][0].update(uri=u))
        yield f"glb image {uri}", "glb", changed(lambda c, u=uri: c.update(images=[{"uri": u}]))
    many = 50_000
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    points = np.tile(CORNERS, (20_000, 1)).astype("<f4").tobytes()

    def heavy(contents):
        contents["accessors"][0].update(count=80_000)
        contents["bufferViews"] = [{"buffer": 0, "byteLength": len(points)}] * 2
        contents["accessors"][1].update(count=12, componentType=5121)
        contents["meshes"][0]["primitives"] = [primitive] * many

    yield "glb primitives of large data", "glb", changed(heavy, points)
    yield "glb many primitives", "glb", changed(lambda c: c["meshes"][0].update(primitives=[primitive] * many))
    yield "glb many nodes", "glb", changed(
        lambda c: c.update(nodes=[{"mesh": 0}] * many, scenes=[{"nodes": list(range(many))}])
    )
    yield "glb the same node", "glb", changed(lambda c: c.update(scenes=[{"nodes": [0] * 300_000}]))
    twice = [{"children": [n + 1, n + 1]} for n in range(40)]
    yield "glb nodes twice", "glb", changed(lambda c: c.update(nodes=[*twice, {"mesh": 0}]))
    chain = [{"children": [n + 1]} for n in range(20_000)]
    yield "glb deep nodes", "glb", changed(lambda c: c.update(nodes=[*chain, {"mesh": 0}]))
    for text in ("[" * 500_000, '{"a":' * 200_000, '{"asset":' + "9" * 500_000 + "}", "[" + "{}," * 300_000 + "{}]"):
        raw = text.encode() + b" " * (-len(text) % 4)
        head = content[:8] + struct.pack("<III", 20 + len(raw), len(raw), 0x4E4F534A)
        yield f"glb text {text[:10]}", "glb", head + raw
    for at in (8, 12):
        for count in BIG[:3]:
            yield f"glb chunk at {at} {count}", "glb", content[:at] + struct.pack("<I", count) + content[at + 4 :]


def files():
    for made in (plys, stls, objs, vtps, three_mfs, glbs):
        yield from made()


# ------------------------------------------------------------------------------------------------------- the tests


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    words = [sys.executable, __file__, str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=500, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    return dict(json.loads(line) for line in done.stdout.splitlines())


def test_each_is_refused_or_read_in_time(told):
    faults = {
        name: (kind, message, hint, seconds, megabytes)
        for name, (kind, message, hint, seconds, megabytes) in told.items()
        if kind not in ("InputError", "read") or seconds > MAX_SECONDS or megabytes > MAX_MB
        or (kind != "read" and (not hint or "\n" in message or len(message) > 1000 or "memory" in message))
    }
    assert len(told) > 400 and not faults, json.dumps(faults, indent=1)


@pytest.mark.parametrize("word", ["entities", "items of a large mesh", "uri", "zeros", "components", "stl 4294967295"])
def test_these_are_refused(told, word):
    found = {name: kind for name, (kind, *_) in told.items() if word in name}
    assert found and set(found.values()) == {"InputError"}, found


@pytest.mark.parametrize("name", ["obj materials", "glb image /etc/passwd", "3mf 1000 items", "3mf other model"])
def test_these_are_read(told, name):
    assert told[name][0] == "read", told[name]


def test_nothing_outside_is_opened(told):
    assert not {name: said[:2] for name, said in told.items() if "opened" in said[1]}


def read_all(folder):
    import resource as limits

    from accelsurf.errors import AccelsurfError
    from accelsurf.io import meshes

    opened = []
    sys.addaudithook(lambda event, words: opened.append(words[0]) if event in ("open", "socket.connect") else None)
    for suffix in ("ply", "stl", "obj", "3mf", "glb", "vtp"):  # what is imported is not of a file
        (folder / f"a.{suffix}").write_bytes(b"")
        try:
            meshes.read(folder / f"a.{suffix}")
        except AccelsurfError:
            pass
    for name, suffix, content in files():
        path = folder / f"a.{suffix}"
        path.write_bytes(content)
        del content
        # The largest memory since now.
        Path("/proc/self/clear_refs").write_text("5")
        before = peak_mb()
        limits.setrlimit(limits.RLIMIT_AS, (3 << 30, -1))
        opened.clear()
        began = time.process_time()  # a busy machine does not count
        try:
            found = "read", str(len(meshes.read(path)[1])), ""
        except AccelsurfError as error:
            found = type(error).__name__, error.message, error.hint
        except BaseException as error:
            found = "fault", f"{type(error).__name__}: {error}"[:500], ""
        seconds = time.process_time() - began
        others = {str(file) for file in opened} - {str(path), "/proc/meminfo"}
        if others := [file for file in others if not file.endswith((".py", ".pyc", ".so"))]:
            found = "opened", f"opened {others[:3]}", ""
        yield name, (*found, seconds, peak_mb() - before)


def peak_mb():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024


if __name__ == "__main__":
    assert resource
    for told_name, of_it in read_all(Path(sys.argv[1])):
        print(json.dumps([told_name, of_it]), flush=True)
