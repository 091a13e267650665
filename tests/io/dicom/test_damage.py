"""A damaged file is named: what says it is of the series is refused, another is left out with a warning."""

import io as streams

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.uid import RLELossless

from accelsurf import cli, io
from accelsurf.errors import AccelsurfError, InputError
from tests.support.dicom_series import Series, check, save

COUNT = 6


def content_of(dataset):
    stream = streams.BytesIO()
    dataset.save_as(stream, enforce_file_format=True)
    return stream.getvalue()


def series_of(seed, sequence=False):
    """A series whose files have names in no order; with ``sequence`` each has one before the series' UID."""
    rng = np.random.default_rng(seed)
    series = Series(rows=8, columns=9, uid="1.2.840.4711.20.30").stacked(COUNT)
    names = [f"IM{n:03d}{('', '.dcm', '.7')[seed % 3]}" for n in rng.permutation(50)[:COUNT]]
    files = {}
    for number, name in enumerate(names):
        dataset = series.dataset(number)
        if sequence:
            inner = Dataset()
            inner.CodeValue, inner.CodeMeaning = "1", "a code"
            dataset.ProcedureCodeSequence = [inner]
            dataset["ProcedureCodeSequence"].is_undefined_length = True
        files[name] = content_of(dataset)
    return series, names, files


def write(folder, files):
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


def ends(content):
    """Where a file may be cut: by what of it remains."""
    series, pixels = content.index(b"\x20\x00\x0e\x00UI"), content.rindex(b"\xe0\x7f\x10\x00OW")
    return {
        "pixels": len(content) - 3,
        "first pixel": pixels + 14,
        "header": pixels,
        "geometry": pixels - 60,
        "series": series + 30,
        "within the series": series + 17,
        "study": series,
        "class": 400,
        "mark": 132,
        "less than a mark": 90,
        "nothing": 0,
    }


KNOWN = ("pixels", "first pixel", "header", "geometry", "series", "within the series")
UNKNOWN = ("study", "class", "mark", "less than a mark", "nothing")


@pytest.mark.sampled
@pytest.mark.parametrize("where", [0, 2, COUNT - 1])
@pytest.mark.parametrize("left", KNOWN)
def test_a_file_of_the_series_that_is_cut_is_refused_by_name(tmp_path, left, where):
    seed = KNOWN.index(left)
    series, names, files = series_of(seed)
    files[names[where]] = files[names[where]][: ends(files[names[where]])[left]]
    folder = write(tmp_path / "scan", files)
    for path in (folder, folder / names[(where + 1) % COUNT]):
        with pytest.raises(InputError, match=f"a slice of the series is lost: .*{names[where]}: "):
            io.read(path)
    with pytest.raises(InputError, match="cut short|damaged|bytes of its pixels"):
        io.read(folder / names[where])


@pytest.mark.sampled
@pytest.mark.parametrize("left", UNKNOWN)
@pytest.mark.parametrize("where", [0, COUNT - 1])
def test_a_file_that_says_nothing_of_its_series_is_named_in_a_warning(tmp_path, left, where):
    seed = UNKNOWN.index(left)
    series, names, files = series_of(seed)
    files[names[where]] = files[names[where]][: ends(files[names[where]])[left]]
    folder = write(tmp_path / "scan", files)
    for path in (folder, folder / names[2]):
        found = io.read(path)
        check(found, (COUNT - 1, 8, 9))
        assert f"{names[where]}: " in found.metadata["warning"]


@pytest.mark.parametrize("seed", range(3))
def test_a_sequence_that_does_not_end_makes_nothing_else_unreadable(tmp_path, seed, capfd):
    series, names, files = series_of(seed, sequence=True)
    content = files[names[-1]]
    files[names[-1]] = content[: content.index(b"a code") + (-9, 2, 6)[seed]]
    folder = write(tmp_path / "scan", files)
    for path in (folder, folder / names[0]):
        found = io.read(path)
        check(found, (COUNT - 1, 8, 9))
        assert f"{names[-1]}: " in found.metadata["warning"]
    with pytest.raises(InputError, match="no DICOM, or damaged"):
        io.read(folder / names[-1])
    assert cli.execute(["info", str(folder / names[0])]) == 0
    out, err = capfd.readouterr()
    assert names[-1] in out and err == ""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("seed", "zeros"), [(0, False), (1, False), (2, True)])
def test_wherever_a_file_is_cut_it_is_never_left_out_in_silence(tmp_path, seed, zeros):
    """In steps over all of a file; what was lost may also be zeros, as after a copy that broke off."""
    series, names, files = series_of(seed, sequence=seed == 1)
    whole = files[names[-1]]
    folder = write(tmp_path / "scan", files)
    last = whole.rindex(b"\xe0\x7f\x10\x00OW") if zeros else len(whole)
    for size in range(seed, last, 23):
        (folder / names[-1]).write_bytes(whole[:size] + bytes(len(whole) - size if zeros else 0))
        try:
            found = io.read(folder)
        except AccelsurfError as error:
            assert names[-1] in error.message, size
        else:
            assert found.array.shape[0] == COUNT - 1 and names[-1] in found.metadata["warning"], (
                size
            )


@pytest.mark.parametrize(
    "what", ["no pixels", "no rows", "another transfer syntax", "packed, without an end"]
)
def test_a_whole_file_without_its_image(tmp_path, what):
    series, names, files = series_of(4)
    dataset = series.dataset(COUNT - 1)
    if what == "no pixels":
        del dataset.PixelData
    elif what == "no rows":
        del dataset.Rows
    elif what == "packed, without an end":
        dataset.compress(RLELossless)
    content = content_of(dataset)
    if what == "another transfer syntax":
        content = content.replace(b"1.2.840.10008.1.2.1\0", b"1.2.840.10008.1.2.5\0")
    if what == "packed, without an end":
        content = content[: content.rindex(b"\xfe\xff\xdd\xe0")]
    files[names[-1]] = content
    folder = write(tmp_path / "scan", files)
    with pytest.raises(InputError, match=f"a slice of the series is lost: .*{names[-1]}"):
        io.read(folder)


def test_a_damaged_file_of_another_series_is_named_and_no_more(tmp_path):
    series, names, files = series_of(5)
    other = content_of(Series(rows=8, columns=9, uid="1.2.840.4711.20.3").stacked(1).dataset(0))
    files["other"] = other[:-20]
    found = io.read(write(tmp_path / "scan", files))
    check(found, (COUNT, 8, 9))
    assert "other: " in found.metadata["warning"]
    assert "warning" not in io.read(tmp_path / "scan" / names[0]).metadata


def test_files_of_other_kinds_are_not_named(tmp_path):
    series, names, files = series_of(1)
    found = io.read(write(tmp_path / "scan", {**files, "notes.txt": b"text", "README": b"text"}))
    assert "warning" not in found.metadata


def test_a_sequence_that_has_lost_a_slice(tmp_path):
    for n in range(3):
        series = Series().stacked(3)
        for z in range(3):
            dataset = series.dataset(z)
            dataset.SOPInstanceUID, dataset.TemporalPositionIdentifier = f"1.2.3.{n}.{z}", n + 1
            save(dataset, tmp_path / f"{n}{z}.dcm")
    assert len(io.read_sequence(tmp_path)) == 3
    for z in range(3):  # all of the same time, so that no number differs
        content = (tmp_path / f"2{z}.dcm").read_bytes()
        (tmp_path / f"2{z}.dcm").write_bytes(content[:-8])
    with pytest.raises(InputError, match="lost: 3 files that cannot be read"):
        io.read_sequence(tmp_path)
