"""The fast part of the fuzzer: some hundred mutated inputs, none of which may be a fault; and that it finds faults."""

import itertools
import subprocess
import sys

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.volume import Volume
from tests.fuzz import corpus, verdict, workers
from tests.fuzz.corpus import Input

SEED, COUNT = 15, 300


def test_mutated_inputs_are_read_as_they_are_or_refused_in_one_line():
    # Runs compile kernels, which takes longer than an input may: they belong to scripts/fuzz.
    numbers = (n for n in itertools.count() if corpus.input_of(SEED, n).kind != "run")
    judged = list(workers.judged(itertools.islice(numbers, COUNT), SEED, 2, lambda: True))
    faults = [one for one in judged if one.verdict.is_fault]
    assert len(judged) == COUNT and not faults, faults
    outcomes = [one.verdict.outcome for one in judged]
    assert outcomes.count("read") > COUNT // 10 and outcomes.count("refused") > COUNT // 4


def test_every_valid_input_is_what_the_independent_look_says(tmp_path):
    verified = 0
    for number, one in enumerate(corpus.seeds()):
        if one.kind == "image":
            folder = tmp_path / str(number)
            folder.mkdir()
            found = verdict.judge(one, folder)
            assert found.outcome == "read" or "4 channels given" in found.text, (one.suffix, found)
            verified += found.text == "verified"
    assert verified > 40


def test_the_same_number_gives_the_same_input():
    assert [corpus.input_of(3, n) for n in range(20)] == [corpus.input_of(3, n) for n in range(20)]
    assert corpus.input_of(3, 0) != corpus.input_of(4, 0)


def test_a_wrong_grid_is_a_fault(tmp_path, monkeypatch):
    one = next(one for one in corpus.seeds() if one.suffix == ".nii")
    other = Volume.from_array(np.zeros((4, 5, 6), np.uint8), 2.0)
    monkeypatch.setattr(io, "read", lambda path, **options: other)
    assert verdict.judge(one, tmp_path).outcome == "wrong"


def test_dead_and_late_processes_are_faults_and_are_replaced():
    replays = (
        Input("crash", ".txt", "text", b""),
        Input("sleep", ".txt", "text", b""),
        Input("energy", ".txt", "text", b"x"),
    )
    found = {
        one.number: one.verdict for one in workers.judged(iter((0, 1, 2)), 0, 1, lambda: True, replays, seconds=1.0)
    }
    assert [found[n].outcome for n in range(3)] == ["crash", "hang", "refused"] and found[0].text == "SIGABRT"


@pytest.mark.slow
def test_the_command_line_of_the_fuzzer(tmp_path):
    words = [sys.executable, "-m", "tests.fuzz", "--count", "50", "--seed", "1", "--output", str(tmp_path)]
    assert subprocess.run(words, timeout=200).returncode == 0
    assert (tmp_path / "result.json").is_file()


# ------------------------------------------------------------------------------------- what it found, by name


def nifti(dtype, change):
    import struct

    import nibabel

    content = bytearray(nibabel.Nifti1Image(corpus.VALUES.T.astype(dtype), np.eye(4)).to_bytes())
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
    np.testing.assert_allclose(io.read(path).array, corpus.VALUES * 1e-18, rtol=1e-6)


def test_a_voxel_offset_below_one_of_a_nifti(tmp_path):
    """ITK read the header as voxels."""
    path = tmp_path / "a.nii"
    path.write_bytes(nifti("int16", lambda c, s: s.pack_into("<f", c, 108, 1e-40)))
    np.testing.assert_array_equal(io.read(path).array, corpus.VALUES)


@pytest.mark.parametrize(
    ("kind", "name", "change", "words"),
    [
        ("image", ".nrrd", (b"sizes: 6 5 4", b"sizes: 6 5 4\nkinds: domain domain " + b"1" * 5000), "field of 50"),
        ("image", ".nrrd", (b"type: short", b"type: short" + b" " * 5000), "field of 50"),
        ("image", ".nrrd", (b"spacings: 1 2 3", b"spacings: 1 2_0 3"), "3 finite numbers"),
        ("image", ".mha", (b"ElementSpacing = 1 2 3", b"ElementSpacing = 1 2 3\nElementSpacing = 1 1 1"), "twice"),
        ("image", ".nrrd", (b"spacings: 1 2 3", b"spacings: 1 1e300 3"), "at most"),
        ("image", ".mha", (b"MSB = False\nElementSp", b"MSB = \nElementSp"), "no value for"),
        ("image", ".mha", (b"MSB = False\nElementSp", b"MSB = False\nCompressedDataSize =\nElementSp"), "damaged"),
    ],
)
def test_headers_that_libraries_read_in_another_way(tmp_path, kind, name, change, words):
    """Long fields ended the process; of keys said twice each library took another; 2_0 is 20 for Python alone."""
    one = next(one for one in corpus.seeds() if (one.kind, one.suffix) == (kind, name) and change[0] in one.content)
    path = tmp_path / f"a{name}"
    path.write_bytes(one.content.replace(*change))
    with pytest.raises(InputError, match=words):
        io.read(path)


def test_a_triangle_seen_edge_on_makes_no_warning(tmp_path):
    one = next(one for one in corpus.seeds() if one.suffix == ".ply" and one.mode == "text")
    moved = one.content.replace(b"0.69999999 0.69999999 0.69999999", b"0.69999999 0.69999999 -1", 1)
    assert verdict.judge(Input("mesh", ".ply", "text", moved), tmp_path).outcome in ("read", "refused")
