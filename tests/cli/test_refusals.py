"""Wrong command lines and configuration lines: one line that says what is wrong, a hint, the documented exit code."""

import numpy as np
import pytest

from accelsurf import Volume, cli, io
from accelsurf.cases.interrupts import MAX_ERROR

GARBAGE = "q" * 100_000
NOISE = "".join(chr(c) for c in np.random.default_rng(0).integers(33, 0x2FF, 100_000)).replace(
    "\x7f", ""
)
#: Options of ``segment``, and what message and hint must say of them.
OPTIONS = [
    # Values that are names
    (("--flow", "gradent"), "did you mean gradient?"),
    (("--flow", "constant_density"), "did you mean constant-density?"),
    (("--flow", "MOMENTM"), "did you mean momentum?"),
    (("--flow", "xyz"), "expected"),
    (("--preset", "mri-brian"), "expected"),
    (("--restart", "of"), "did you mean off?"),
    (("--levels", "atuo"), "did you mean auto?"),
    (("--diffusion", "fre"), "did you mean free?"),
    (("--mesh", "ply,slt"), "did you mean stl?"),
    (("--mesh-space", "rsa"), "did you mean ras?"),
    (("--format", "nii.gx"), "did you mean nii.gz?"),
    (("--threads", "Auto"), "did you mean auto?"),
    (("--progress", "jsn"), "json"),
    # Energies
    (("--energy", "chan-vse"), "did you mean chan-vese?"),
    (("--energy", "local_region"), "did you mean local-region?"),
    (("--energy", "local-region:r=8"), "did you mean R?"),
    (("--energy", "local-region:R=eight"), "expected"),
    (("--energy", "threshold:a,b"), "expected"),
    (("--energy", "threshold:lerned,"), "did you mean learned?"),
    (("--energy", "chan-vese+area"), "blank on either side"),
    (("--energy", "area"), "sees the image"),
    (("--energy", "x*geodesic"), "number before the *"),
    (("--energy", "0*geodesic"), "weight"),
    (("--energy", ""), "nothing was given"),
    (("--energy", "geodesic:"), "values after the colon"),
    # Starts
    (("--start", "bal:1,2,3,4"), "did you mean ball?"),
    (("--start", "seeds:1,2,3,4"), "did you mean seed?"),
    (("--start", "ostu"), "did you mean otsu?"),
    (("--start", "ball:1,2,3"), "4 numbers"),
    (("--start", "ball:1,2,3,x"), "4 numbers"),
    (("--start", "ball:1,2,3,-4"), "expected above 0"),
    (("--start", "ball:1,2,3,nan"), "4 numbers"),
    (("--start", "box:5,5,5,1,1,1"), "first corner"),
    (("--start", "label:"), "no file named"),
    (("--start", "label:nothing.nii@x"), "is no label"),
    (("--start", "threshold:5,1"), "low threshold"),
    (("--start", ""), "unknown kind"),
    # Numbers
    (("--smoothness", "rough"), "expected a number at least 0"),
    (("--smoothness", "-1"), "expected a number at least 0"),
    (("--smoothness", "nan"), "expected a number"),
    (("--cfl", "3"), "at most 1"),
    (("--cfl", "0,5"), "expected a number"),
    (("--max-steps", "1.5"), "whole number"),
    (("--max-steps", "many"), "whole number"),
    (("--levels", "0"), "at least 1"),
    (("--half-width", "2"), "at least 3"),
    (("--presmooth", "2 voxels"), "1.5vox"),
    (("--seed", "-1"), "expected"),
    (("--reproducible=perhaps",), "perhaps"),
    # Edits, region of interest
    (("--edit", "smoothness=3"), "no step was given"),
    (("--edit", "step=x"), "whole number"),
    (("--edit", "step=3 smothness=1"), "did you mean smoothness?"),
    (("--edit", "step=3 flow=gradent"), "did you mean gradient?"),
    (("--edit", "step=3 inside=point:1,2,3"), "--max-steps 3"),
    (("--edit", "step=3 levels=2"), "cannot change"),
    (("--edit", "'"), "words like step=30"),
    (("--roi", "1,2,3"), "X0,Y0,Z0,X1,Y1,Z1"),
    # Options
    (("--flwo", "gradient"), "--flow"),
    (("--smothness", "1"), "--smoothness"),
    (("--flow",), "--flow"),
    (("surplus.nii", "more.nii"), "--help"),
]
#: Lines of a configuration file.
LINES = [
    ("flow = 'gradent'", "did you mean gradient?"),
    ("flow = 3", "expected"),
    ("flow = ['gradient']", "expected"),
    ("smothness = 1", "did you mean smoothness?"),
    ("max-step = 1", "did you mean max_steps?"),
    ("zzzzzz = 1", "valid are"),
    ("smoothness = 'rough'", "expected a number"),
    ("smoothness = true", "expected a number"),
    ("smoothness = inf", "expected a number"),
    ("smoothness = {a = 1}", "expected a number"),
    ("levels = 'atuo'", "did you mean auto?"),
    ("mesh = ['ply', 'slt']", "did you mean stl?"),
    ("energy = [{term = 'geodesik'}]", "did you mean geodesic?"),
    ("energy = [{weight = 3}]", "a table with a term"),
    ("energy = [{term = 'geodesic', weight = 'x'}]", "a weight that is a number"),
    ("energy = 5", "expected"),
    ("start = 5", "expected"),
    ("edit = 5", "a step"),
    ("[[edit]]\ncfl = 0.3", "no step"),
    ("smoothness 1", "not a TOML file"),
    ("smoothness = 1\nsmoothness = 2", "not a TOML file"),
]
#: Settings that take a text or a number, to be given garbage.
KEYS = (
    "flow",
    "preset",
    "energy",
    "start",
    "levels",
    "smoothness",
    "mesh",
    "format",
    "roi",
    "edit",
    "threads",
)


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    file = tmp_path_factory.mktemp("refusals") / "image.nii.gz"
    z, y, x = np.indices((12, 13, 14)) - 6
    io.write(Volume.from_array((x**2 + y**2 + z**2 < 16).astype(np.float32)), file)
    return file


def refused(capsys, image, *words, codes=(2,)):
    """The error and the hint of a refused command line."""
    folder = image.parent / "out"
    code = cli.execute(["segment", str(image), "-o", str(folder), "--quiet", *words])
    out, err = capsys.readouterr()
    assert code in codes and code in cli.EXIT_CODES
    lines = err.splitlines()
    assert [line.split(":")[0] for line in lines] == ["error", "hint"]
    assert "\ufffd" not in err and all(c.isprintable() for line in lines for c in line)
    error, hint = lines
    assert len(error) < 400 and 5 < len(hint) <= 1015
    assert not list(folder.glob("*.nii.gz"))
    return error, hint


@pytest.mark.parametrize(
    ("words", "said"),
    OPTIONS,
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_options(capsys, image, words, said):
    assert said in " ".join(refused(capsys, image, *words))


@pytest.mark.sampled(10)
@pytest.mark.parametrize(("line", "said"), LINES, ids=lambda value: value)
def test_wrong_lines_of_a_configuration(capsys, image, tmp_path, line, said):
    file = tmp_path / "run.toml"
    file.write_text(line + "\n")
    assert said in " ".join(refused(capsys, image, "--config", str(file)))


@pytest.mark.sampled(11)
@pytest.mark.parametrize(
    "garbage",
    [GARBAGE, NOISE, "\x1b[31m\x07red\x00", "\u202eabc\x85d"],
    ids=["q", "noise", "esc", "bidi"],
)
@pytest.mark.parametrize("key", KEYS)
def test_garbage_is_not_repeated(capsys, image, key, garbage):
    error, hint = refused(capsys, image, f"--{key}={garbage}", codes=(2, 3))
    assert garbage[:61] not in error or len(garbage) < 61


@pytest.mark.parametrize(
    "words",
    [(f"--{GARBAGE}", "1"), (f"--{GARBAGE}=1",), (GARBAGE, GARBAGE), ("--progress", GARBAGE)],
)
def test_garbage_in_place_of_options(capsys, image, words):
    error, _ = refused(capsys, image, *words)
    assert len(error) <= MAX_ERROR + len("error: ")


def test_commands_that_do_not_exist(capsys):
    for word in ("segmnt", GARBAGE, ""):
        assert cli.execute([word]) == 2
        err = capsys.readouterr().err
        assert len(err.splitlines()) == 2 and len(err) < 800


def test_keys_of_a_configuration_that_are_garbage(capsys, image, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(f"{GARBAGE} = 1\n")
    error, hint = refused(capsys, image, "--config", str(file))
    assert "q" * 61 not in error + hint


#: Other commands: words, what is said.
COMMANDS = [
    (("movie", "IMAGE", "-o", "OUT/a.xyz"), "expected .mp4"),
    (("movie", "IMAGE", "-o", "OUT/a.mp4", "--size", GARBAGE), "expected WIDTHxHEIGHT"),
    (("movie", "IMAGE", "-o", "OUT/a.mp4", "--preview"), "expected .png"),
    (("segment", "IMAGE"), "-o DIR"),
    (("segment",), "--help"),
    (("info", "IMAGE", "surplus"), "accelsurf info: surplus: unexpected argument"),
    (("evaluate", "IMAGE"), "--help"),
]


@pytest.mark.parametrize(("words", "said"), COMMANDS, ids=lambda value: " ".join(value)[:60])
def test_other_commands(capsys, image, words, said):
    folder = image.parent / "other"
    line = [word.replace("IMAGE", str(image)).replace("OUT", str(folder)) for word in words]
    code = cli.execute(line)
    err = capsys.readouterr().err
    assert code == 2 and said in err
    assert [part.split(":")[0] for part in err.splitlines()] == ["error", "hint"]
    assert all(len(part) < 1015 for part in err.splitlines()) and len(err.splitlines()[0]) < 400
