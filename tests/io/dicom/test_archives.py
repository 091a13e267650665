"""A zip archive is read within a budget, in memory, and nothing of it comes onto the disk."""

import io as streams
import tempfile
import zipfile

import pytest

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.settings import budgets
from tests.support.dicom_series import Series, check, enhanced, packed_jpeg_ls, save


def contents(count=4, packed=False, rows=24):
    series = Series(rows=rows, columns=20).stacked(count)
    found = []
    for number in range(count):
        stream = streams.BytesIO()
        dataset = series.dataset(number)
        (packed_jpeg_ls(dataset) if packed else dataset).save_as(stream, enforce_file_format=True)
        found.append(stream.getvalue())
    return found


def archive(path, members, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in members:
            file.writestr(zipfile.ZipInfo(name) if method == zipfile.ZIP_STORED else name, content)
    return path


@pytest.fixture
def no_disk(monkeypatch, tmp_path):
    """Nothing is made where temporary files are; so nothing stays there after a kill at any moment."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    for name in ("mkdtemp", "mkstemp", "TemporaryDirectory", "NamedTemporaryFile"):  # one without a name goes by itself
        monkeypatch.setattr(tempfile, name, lambda *args, **more: pytest.fail("a temporary file was made"))
    yield
    assert not list(folder.iterdir())


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_nothing_is_unpacked_onto_the_disk(tmp_path, no_disk, method):
    files = contents()
    names = ["b/1", "../../up/2", "/abs/3", "c\\4.dcm"]
    path = archive(tmp_path / "a.zip", [(name, files[n]) for n, name in enumerate(names)], method)
    check(io.read(path), (4, 24, 20))
    assert {entry.name for entry in tmp_path.iterdir()} == {"a.zip", "temporary"}
    assert path.parent == tmp_path and not (tmp_path.parent / "up").exists()


def test_packed_slices_need_no_folder_either(tmp_path, no_disk):
    pytest.importorskip("jpeg_ls")
    if not hasattr(__import__("os"), "memfd_create"):
        pytest.skip("this system has no files in memory")
    check(io.read(archive(tmp_path / "a.zip", [(f"{n}", c) for n, c in enumerate(contents(packed=True))])), (4, 24, 20))


def test_members_of_one_name_are_several_files(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = archive(tmp_path / "a.zip", [("slice.dcm", content) for content in contents()])
    check(io.read(path), (4, 24, 20))


def test_a_file_of_several_frames(tmp_path):
    save(enhanced(Series().stacked(4)), tmp_path / "all.dcm")
    check(io.read(archive(tmp_path / "a.zip", [("all.dcm", (tmp_path / "all.dcm").read_bytes())])), (4, 5, 7))


def test_archives_within_archives_and_other_files_are_left_out(tmp_path):
    files = contents()
    inner = archive(tmp_path / "inner.zip", [("x.dcm", files[0])]).read_bytes()
    members = [*((f"{n}.dcm", content) for n, content in enumerate(files[1:])), ("more.zip", inner), ("readme", b"x")]
    found = io.read(archive(tmp_path / "a.zip", members))
    check(found, (3, 24, 20))
    assert "1 archive (more.zip)" in found.metadata["warning"]
    with pytest.raises(InputError, match="no DICOM file is in the archive"):
        io.read(archive(tmp_path / "b.zip", [("more.zip", inner)]))


@pytest.mark.parametrize("which", [0, 2, 3])
@pytest.mark.parametrize("kind", ["cut", "flipped"])
def test_a_damaged_member_is_named(tmp_path, which, kind):
    files = contents(rows=300)
    members = [(f"s{n}.dcm", content) for n, content in enumerate(files)]
    if kind == "cut":
        members[which] = (members[which][0], files[which][:-50])
        path = archive(tmp_path / "a.zip", members)
    else:
        path = archive(tmp_path / "a.zip", members, zipfile.ZIP_STORED)
        content = bytearray(path.read_bytes())
        content[content.index(files[which]) + len(files[which]) - 9] ^= 255
        path.write_bytes(content)
    with pytest.raises(InputError, match=f"a slice of the series is lost: .*s{which}.dcm: "):
        io.read(path)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kind", ["members", "bytes", "ratio", "claims", "cut", "link"])
def test_the_budget_of_an_archive(tmp_path, kind, no_disk):
    files = [(f"{n}.dcm", content) for n, content in enumerate(contents())]
    path = tmp_path / "a.zip"
    if kind == "members":
        files += [(f"n{n}", b"") for n in range(budgets.DICOM_ARCHIVE_FILES.limit)]
    elif kind == "ratio":
        files.append(("zeros.dcm", files[0][1] + bytes(150 << 20)))
    elif kind == "link":
        link = zipfile.ZipInfo("link.dcm")
        link.external_attr = 0o120777 << 16
        files.append((link, b"/etc/passwd"))
    if kind in ("members", "ratio"):
        archive(path, files)
    else:
        with zipfile.ZipFile(path, "w") as file:
            for name, content in files:
                file.writestr(name, content)
    content = bytearray(path.read_bytes())
    if kind in ("bytes", "claims"):  # the sizes that the last entry of the directory claims
        entry = content.rindex(b"PK\x01\x02")
        content[entry + 24 : entry + 28] = (0xFFFF_FFF0 if kind == "bytes" else 10_000).to_bytes(4, "little")
    path.write_bytes(content[:-40] if kind == "cut" else content)
    said = {
        "members": "files in an archive", "bytes": "unpacked: |available", "ratio": "unpacked: ", "link": "has a link",
        "claims": "lost: .*3.dcm: its size is not", "cut": "not a DICOM file or an archive",
    }[kind]
    with pytest.raises(InputError, match=said):
        io.read(path)
