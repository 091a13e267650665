"""Several clicks at once are the same clicks one after the other: labels, psi, and what is refined from then on."""

import shutil

import numpy as np
import pytest

import accelsurf
from accelsurf import cli, io
from accelsurf.errors import AccelsurfError
from accelsurf.image.volume import Volume
from accelsurf.interact.refine import refine
from accelsurf.interact.refiner import Refiner
from accelsurf.interact.restored import restored
from accelsurf.interact.state_file import read_state, state_bytes, surface_of
from accelsurf.settings.corrections import corrections_of

SHAPE, SPACING = (14, 22, 40), (1.5, 1.0, 1.0)
MIDDLES = ((7, 11, 11), (7, 11, 29))


def scene():
    """Two bright balls in noise, with a bridge."""
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    inside = (abs(x - 20) < 8) & (abs(y - 11) < 2) & (abs(z - 10.5) < 2)
    for k, j, i in MIDDLES:
        inside |= (z - 1.5 * k) ** 2 + (y - j) ** 2 + (x - i) ** 2 < 7**2
    noise = np.random.default_rng(2).normal(0, 12, SHAPE)
    return Volume.from_array((100.0 * inside + noise).astype(np.float32), SPACING)


def drawn(seed, apart):
    """Side and place of clicks; ``apart``: no voxel is on both sides."""
    random, clicks, taken = np.random.default_rng(seed), [], np.zeros(SHAPE, int)
    z, y, x = np.indices(SHAPE)
    while len(clicks) < 3 + seed % 2:
        k, j, i = (int(random.integers(2, n - 2)) for n in SHAPE)
        radius, side = int(random.integers(1, 4)), ("inside", "outside")[random.integers(2)]
        mask = (z - k) ** 2 + (y - j) ** 2 + (x - i) ** 2 <= radius**2
        number = 1 if side == "inside" else 2
        if apart and (taken[mask] == 3 - number).any():
            continue
        taken[mask] = number
        clicks.append((side, f"ball:{i},{j},{k},{radius}vox"))
    return clicks


def first(energy, volume):
    words = {"seed": 1, "threads": 1, "keep_state": "yes"}
    if energy == "seeded":
        return accelsurf.segment(volume, inside="ball:11,11,7,3vox", **words)
    return accelsurf.segment(
        volume, energy=energy, start="ball:11,11,7,5vox", smoothness=0.3, **words
    )


@pytest.fixture(scope="module", params=["chan-vese", "seeded"])
def result(request):
    return first(request.param, scene())


def same(a, b):
    assert [s.id for s in a.objects] == [s.id for s in b.objects]
    for one, other in zip(a.objects, b.objects, strict=True):
        assert one.box == other.box and one.psi.tobytes() == other.psi.tobytes()
    assert a.labels.tobytes() == b.labels.tobytes()


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(6))
def test_a_call_with_several_clicks_is_a_call_for_each(result, seed):
    clicks = sorted(drawn(seed, apart=True))  # those inside come first
    sides = {side: [at for of, at in clicks if of == side] for side in ("inside", "outside")}
    apart = result
    try:
        for side, at in clicks:
            apart = refine(apart, **{side: at})
    except AccelsurfError as error:  # nothing would be left inside: neither way
        with pytest.raises(type(error)):
            refine(result, **sides)
        return
    together = refine(result, **sides)
    same(together, apart)
    # From its file, too, it goes on as the others do.
    content = state_bytes(together, "")
    refiner = Refiner(together)
    refiner.apply(corrections_of({"outside": "ball:24,11,7,1vox"})[0])
    again = refine(apart, outside="ball:24,11,7,1vox")
    same(refiner.result(), again)
    refiner.undo()
    same(refiner.result(), apart)
    assert len(content) > 0


@pytest.mark.parametrize("seed", [1, 4])
def test_a_state_of_clicks_together_goes_on_as_of_clicks_apart(result, seed, tmp_path):
    clicks = sorted(drawn(seed, apart=True))
    sides = {side: [at for of, at in clicks if of == side] for side in ("inside", "outside")}
    together = refine(result, **sides)
    (tmp_path / "a_state.npz").write_bytes(state_bytes(together, ""))
    found = restored(read_state(tmp_path / "a_state.npz"), result.volume)
    same(refine(found, inside="ball:20,11,7,2vox"), refine(together, inside="ball:20,11,7,2vox"))


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Two objects, and their image; and one object."""
    folder = tmp_path_factory.mktemp("finished")
    io.write(scene(), folder / "a.nii.gz")
    table = folder / "balls.csv"
    table.write_text("id,x,y,z,r\n2,11,11,10.5,4\n5,29,11,10.5,4\n")
    common = ("--keep-state", "yes", "--threads", "1", "--seed", "1", "--quiet")
    assert (
        run("segment", folder / "a.nii.gz", "-o", folder / "two", "--objects", table, *common) == 0
    )
    start = ("--start", "ball:11,11,7,5vox")
    assert run("segment", folder / "a.nii.gz", "-o", folder / "one", *start, *common) == 0
    return folder


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["one", "two"])
def test_a_command_with_several_clicks_is_a_command_for_each(
    finished, tmp_path, seed, kind, capsys
):
    """Also where a later click takes voxels from an earlier one; in the order in which they are typed."""
    clicks, more = drawn(100 + seed, apart=False), ("--quiet",)
    more += ("--object", "5") if kind == "two" else ()
    apart, together = (shutil.copytree(finished / kind, tmp_path / name) for name in ("s", "t"))
    codes = [run("refine", apart, f"--{side}", at, *more) for side, at in clicks]
    words = [word for side, at in clicks for word in (f"--{side}", at)]
    code = run("refine", together, *words, *more)
    if set(codes) != {0}:
        assert code == next(one for one in codes if one)
        return
    assert code == 0
    for name in ("a_seg.nii.gz", "a_run.toml"):
        assert (apart / name).read_bytes() == (together / name).read_bytes()
    states = [read_state(folder / "a_state.npz") for folder in (apart, together)]
    for one, other in zip(states[0].objects, states[1].objects, strict=True):
        assert surface_of(one).tobytes() == surface_of(other).tobytes()


def test_the_order_matters_and_each_click_has_a_line(finished, capsys, tmp_path):
    clicks = ("--outside", "ball:16,11,7,2vox"), ("--inside", "ball:14,11,7,2vox")
    for name, words in (("ab", clicks), ("ba", clicks[::-1])):
        folder = shutil.copytree(finished / "one", tmp_path / name)
        assert run("refine", folder, *words[0], *words[1]) == 0
        said = capsys.readouterr().out
        assert said.index(words[0][1]) < said.index(words[1][1])
    labels = [io.read(tmp_path / name / "a_seg.nii.gz").array for name in ("ab", "ba")]
    assert labels[0][7, 11, 15] and not labels[1][7, 11, 15]
