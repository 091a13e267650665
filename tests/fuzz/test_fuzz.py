"""The fast part of the fuzzer: a hundred mutated inputs, none of which may be a fault; and that it finds faults."""

import argparse
import io as stream
import re
import struct
import subprocess
import sys
import zipfile
from collections import Counter

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from tests.fuzz import __main__ as main
from tests.fuzz import corpus, folders, headers, judges, mutators, verdict, workers
from tests.fuzz.inputs import VALUES, VOLUME, Input

SEED = 15


@pytest.mark.parametrize("count", [100, pytest.param(300, marks=pytest.mark.slow)])
def test_mutated_inputs_are_read_as_they_are_or_refused_in_one_line(count):
    # Runs compile kernels, which takes longer than an input may: they belong to scripts/fuzz.
    inputs = tuple(given for given in corpus.seeds() if given.kind not in workers.COMPILED)
    judged = list(workers.judged(iter(range(count)), SEED, 2, lambda: True, inputs))
    faults = [
        (corpus.input_of(SEED, each.number, inputs)[:1], each)
        for each in judged
        if each.verdict.is_fault
    ]
    assert len(judged) == count and not faults, faults
    outcomes = [each.verdict.outcome for each in judged]
    assert outcomes.count("read") > count // 10 and outcomes.count("refused") > count // 4


#: Valid texts whose files are not there, and an image of several channels.
REFUSED = "there is no such file|4 channels given"


def test_every_valid_input_is_read_and_is_what_the_independent_look_says(tmp_path):
    verified = Counter()
    for number, given in enumerate(corpus.seeds()):
        if given.kind == "run":
            continue
        folder = tmp_path / str(number)
        folder.mkdir()
        found = verdict.judge(given, folder)
        assert found.outcome == "read" or re.search(REFUSED, found.text), (
            given.kind,
            given.case,
            given.suffix,
            found,
        )
        verified[given.kind] += found.text == "verified"
    kinds = {given.kind for given in corpus.seeds()}
    assert set(judges.JUDGES) <= kinds
    least = {"image": 55, "zarr": 40, "dicom": 9, "frames": 10, "paired": 6, "evaluate": 1}
    assert all(verified[kind] >= count for kind, count in least.items()), verified


def test_the_same_number_gives_the_same_input():
    assert [corpus.input_of(3, n) for n in range(20)] == [corpus.input_of(3, n) for n in range(20)]
    assert corpus.input_of(3, 0) != corpus.input_of(4, 0)


def test_a_wrong_grid_is_a_fault(tmp_path, monkeypatch):
    one = next(one for one in corpus.seeds() if (one.kind, one.suffix) == ("image", ".nii"))
    other = Volume.from_array(np.zeros((4, 5, 6), np.uint8), 2.0)
    monkeypatch.setattr(io, "read", lambda path, **options: other)
    assert verdict.judge(one, tmp_path).outcome == "wrong"


def first(kind, case, end):
    return next(
        g for g in corpus.seeds() if (g.kind, g.case) == (kind, case) and g.name.endswith(end)
    )


@pytest.mark.parametrize(
    "case", [case for case in folders.codecs() if case != "3-none" and case != "2-none"]
)
def test_a_chunk_with_other_values_than_its_codec_gives_is_a_fault(tmp_path, monkeypatch, case):
    given = first("zarr", case, "0/0/0")
    damaged = given._replace(content=given.content[:-1])
    for number, values in enumerate((VALUES + 1, np.zeros_like(VALUES))):
        (tmp_path / str(number)).mkdir()
        other = Volume(values, VOLUME.geometry)
        monkeypatch.setattr(io, "read", lambda path, other=other, **options: other)
        monkeypatch.setattr(judges, "check_boxes", lambda path, volume: None)
        assert verdict.judge(damaged, tmp_path / str(number)).outcome == "wrong"


@pytest.mark.parametrize(
    ("keep", "outcome"), [(slice(0, 4), "read"), (slice(0, 3), "wrong"), (slice(1, 4), "wrong")]
)
def test_a_series_that_has_lost_a_slice_without_a_word_is_a_fault(
    tmp_path, monkeypatch, keep, outcome
):
    given = first("dicom", "plain", "003.dcm")
    whole = io.read
    monkeypatch.setattr(io, "read", lambda path, **options: cropped(whole(path, **options), keep))
    assert verdict.judge(given, tmp_path).outcome == outcome


def cropped(volume, keep):
    here = volume.geometry
    origin = here.index_to_world((keep.start, 0, 0))
    array = volume.array[keep]
    return Volume(array, Geometry(array.shape, here.spacing, tuple(origin), here.direction))


def test_dead_late_and_large_processes_are_faults_and_are_replaced():
    """The last of these reserves 2.5 GiB."""
    kinds = ("crash", "sleep", "reserve", "energy")
    inputs = tuple(Input(kind, ".txt", "text", b"x") for kind in kinds)
    limits = workers.Limits(seconds=2.0)
    judged = workers.judged(iter(range(4)), 0, 1, lambda: True, inputs, True, limits)
    found = [each.verdict for each in sorted(judged, key=lambda each: each.number)]
    assert [each.outcome for each in found] == ["crash", "hang", "traceback", "refused"]
    assert (
        found[0].text == "SIGABRT"
        and "MemoryError" in found[2].text
        or "ArrayMemoryError" in found[2].text
    )


@pytest.mark.parametrize("suffix", [".nii", ".tif", ".mgh", ".dcm", ".stl"])
def test_numbers_of_binary_headers_are_found(suffix):
    """Each is within the file, and a change of one is a change of its bytes alone."""
    given = next(g for g in corpus.seeds() if g.suffix == suffix and g.mode != "text")
    found = headers.fields(given.content)
    assert len(found) >= 4
    for number, (at, kind) in enumerate(found):
        size = struct.calcsize(kind)
        changed = mutators.changed_field(
            bytearray(given.content), (at, kind), np.random.default_rng(number)
        )
        assert (
            changed[:at] == given.content[:at]
            and changed[at + size :] == given.content[at + size :]
        )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(20))
def test_archives_stay_archives_when_a_member_is_mutated(seed):
    for given in corpus.seeds():
        if given.mode == "zip":
            packed = mutators._member(given.content, np.random.default_rng(seed), [given.content])
            with zipfile.ZipFile(stream.BytesIO(packed)) as archive:
                assert archive.testzip() is None and packed != given.content


@pytest.mark.sampled(10)
@pytest.mark.parametrize("number", range(40))
def test_a_saved_input_is_judged_again_as_it_was(tmp_path, number):
    kinds = ("zarr", "dicom", "frames", "image", "labels")
    given = corpus.input_of(SEED, number, corpus.seeds_of_name(kinds))
    result = workers.Judged(number, verdict.Verdict("wrong", ""), 0.0)
    saved = main.saved_input(result, given, argparse.Namespace(output=tmp_path, seed=SEED))
    again = main.replayed(tmp_path / saved["input"])
    assert (again.kind, again.case) == (given.kind, given.case)
    assert again.written() == given.written() if given.case else again.content == given.content


@pytest.mark.slow
def test_the_command_line_of_the_fuzzer(tmp_path):
    words = [
        sys.executable,
        "-m",
        "tests.fuzz",
        "--count",
        "50",
        "--seed",
        "1",
        "--output",
        str(tmp_path),
    ]
    assert subprocess.run(words, timeout=200).returncode == 0
    assert (tmp_path / "result.json").is_file()


# ------------------------------------------------------------------------------------- what it found, by name


def nifti(dtype, change):
    import struct

    import nibabel

    content = bytearray(nibabel.Nifti1Image(VALUES.T.astype(dtype), np.eye(4)).to_bytes())
    change(content, struct)
    return bytes(content)


def test_nan_in_a_nifti_stays_nan(tmp_path):
    """ITK made it 0, so that an image with holes was segmented as if they were measured."""
    path = tmp_path / "a.nii"
    path.write_bytes(nifti("float32", lambda c, s: s.pack_into("<f", c, 352, float("nan"))))
    values = io.read(path).array
    assert np.isnan(values[0, 0, 0]) and np.isfinite(values).sum() == values.size - 1


def test_a_tiny_slope_of_a_nifti_counts(tmp_path):
    """ITK took it for none."""
    path = tmp_path / "a.nii"
    path.write_bytes(nifti("int16", lambda c, s: s.pack_into("<f", c, 112, 1e-18)))
    np.testing.assert_allclose(io.read(path).array, VALUES * 1e-18, rtol=1e-6)


def test_a_voxel_offset_below_one_of_a_nifti(tmp_path):
    """ITK read the header as voxels."""
    path = tmp_path / "a.nii"
    path.write_bytes(nifti("int16", lambda c, s: s.pack_into("<f", c, 108, 1e-40)))
    np.testing.assert_array_equal(io.read(path).array, VALUES)


@pytest.mark.parametrize(
    ("kind", "name", "change", "words"),
    [
        (
            "image",
            ".nrrd",
            (b"sizes: 6 5 4", b"sizes: 6 5 4\nkinds: domain domain " + b"1" * 5000),
            "Duplicate header field: kinds",
        ),
        ("image", ".nrrd", (b"spacings: 1 2 3", b"spacings: 1 2_0 3"), "damaged .*1 2_0 3"),
        (
            "image",
            ".mha",
            (b"ElementSpacing = 1 2 3", b"ElementSpacing = 1 2 3\nElementSpacing = 1 1 1"),
            "two values for ElementSpacing",
        ),
        ("image", ".nrrd", (b"spacings: 1 2 3", b"spacings: 1 1e300 3"), "1e-09 to"),
        ("image", ".mha", (b"MSB = False\nElementSp", b"MSB = \nElementSp"), "no value for"),
        (
            "image",
            ".mha",
            (b"MSB = False\nElementSp", b"MSB = False\nCompressedDataSize =\nElementSp"),
            "CompressedDataSize = , finite numbers",
        ),
    ],
)
def test_headers_that_libraries_read_in_another_way(tmp_path, kind, name, change, words):
    """Of keys said twice each library took another; 2_0 is 20 for Python alone."""
    one = next(
        g for g in corpus.seeds() if (g.kind, g.suffix) == (kind, name) and change[0] in g.content
    )
    path = tmp_path / f"a{name}"
    path.write_bytes(one.content.replace(*change))
    with pytest.raises(InputError, match=words):
        io.read(path)


def test_a_triangle_seen_edge_on_makes_no_warning(tmp_path):
    one = next(one for one in corpus.seeds() if one.suffix == ".ply" and one.mode == "text")
    moved = one.content.replace(b"0.69999999 0.69999999 0.69999999", b"0.69999999 0.69999999 -1", 1)
    assert verdict.judge(Input("mesh", ".ply", "text", moved), tmp_path).outcome in (
        "read",
        "refused",
    )


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(60))
def test_a_damaged_frame_of_a_killed_tracking_is_made_again(tmp_path, seed):
    """A member without the mark of numpy, or with a header that does not end, ended the tracking."""
    given = first("store", "frames", "_000000.npz")
    damaged = mutators._member(given.content, np.random.default_rng(seed), [given.content])
    assert verdict.judge(given._replace(content=damaged), tmp_path).outcome == "read"
