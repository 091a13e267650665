"""Games of the click benchmark: what counts, what is kept, what the figures say; the peers on a ball."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelsurf.errors import UsageError
from accelsurf.image.volume import Volume
from benchmarks.clicks import __main__ as program
from benchmarks.clicks import games, methods, objects, peers, tables
from benchmarks.clicks.domain import CroppedSession, crop, outer_faces, restricted_seeds
from benchmarks.clicks.games import Hints, play, summary
from benchmarks.clicks.measures import surfaces
from benchmarks.clicks.objects import ClickObject, Scene
from benchmarks.clicks.person import PersonClick, ball_voxels
from benchmarks.clicks.store import Store


def ball_scan(noise: float = 0.0, spacing: Any = (2.0, 1.0, 1.0)) -> tuple[Volume, np.ndarray]:
    """A bright ball of 8 mm in the middle of 24 x 40 x 40 voxels."""
    at = np.indices((24, 40, 40)) - np.array([11, 19, 21])[:, None, None, None]
    z, y, x = at * np.reshape(spacing, (3, 1, 1, 1))
    truth = z**2 + y**2 + x**2 < 8.0**2
    values = 100.0 * truth + np.random.default_rng(0).normal(0.0, max(noise, 1e-9), truth.shape)
    return Volume.from_array(values.astype(np.float32), spacing), truth


class Painter:
    """A session that labels the clicked balls alone, and refuses the click whose number is given."""

    def __init__(self, image: Volume, hints: Hints, refused: int = 0) -> None:
        self.image, self.hints, self.refused, self.count = image, hints, refused, 0
        self.labels = np.zeros(image.array.shape, bool)

    def click(self, click: PersonClick) -> np.ndarray:
        self.count += 1
        if self.count == self.refused:
            raise UsageError("not this one")
        box, ball = ball_voxels(click, self.image.geometry)
        self.labels[box][ball] = click.side == "inside"
        return self.labels.copy()


def game_of(*dices: float, wall: float = 1.0) -> dict[str, Any]:
    clicks = [
        {"dice": dice, "wall_s": wall * k, "cpu_s": 0.5 * wall * k}
        for k, dice in enumerate(dices, 1)
    ]
    return {"clicks": clicks, "perfect": dices[-1] == 1.0}


def test_a_game_corrects_until_its_clicks_are_spent() -> None:
    image, truth = ball_scan()
    game = play(Painter, Scene(image, truth), 6)
    dices = [one["dice"] for one in game["clicks"]]
    assert len(dices) == 6 and dices == sorted(dices) and dices[0] > 0.1 and not game["perfect"]
    assert all(
        one["side"] == "inside" and one["wall_s"] >= 0 and one["cpu_s"] >= 0
        for one in game["clicks"]
    )
    # Each click is at the deepest point of what the ones before left.
    assert game["clicks"][0]["index"] == [11, 19, 21]
    assert len({tuple(one["index"]) for one in game["clicks"]}) == 6


def test_a_game_ends_when_nothing_is_wrong() -> None:
    image, truth = ball_scan()

    class Oracle(Painter):
        def click(self, click: PersonClick) -> np.ndarray:
            return truth.copy()

    game = play(Oracle, Scene(image, truth), 6)
    assert game["perfect"] and [one["dice"] for one in game["clicks"]] == [1.0]
    assert [games.dice_after(game, n) for n in games.BUDGETS] == [1.0] * 5


def test_a_refused_click_leaves_the_labels_before_and_says_why() -> None:
    image, truth = ball_scan()
    game = play(lambda image, hints: Painter(image, hints, refused=2), Scene(image, truth), 3)
    first, second, third = game["clicks"]
    assert "not this one" in second["error"] and second["dice"] == first["dice"] < third["dice"]
    assert summary([game])["refused"] == 1
    # It asks again at the same place.
    assert third["index"] == second["index"]


def test_the_stated_size_is_given_only_to_the_variant_with_a_size() -> None:
    image, truth = ball_scan()
    given: list[Hints] = []

    def segmenter(image: Volume, hints: Hints) -> Painter:
        given.append(hints)
        return Painter(image, hints)

    for variant in ("plain", "size", "jitter3", "box", "cvpr", "cvpr-box"):
        play(segmenter, Scene(image, truth), 1, variant, 1.25)
    assert [hints.size_mm3 for hints in given] == [
        None,
        pytest.approx(1.25 * truth.sum() * 2.0),
        *[None] * 4,
    ]
    box = (slice(8, 15), slice(12, 27), slice(14, 29))
    assert [hints.box for hints in given] == [None, None, None, box, None, box]
    assert [hints.points for hints in given] == [False] * 4 + [True] * 2


def test_jittered_games_differ_by_seed_and_repeat() -> None:
    image, truth = ball_scan()
    first, again, other = (
        [one["index"] for one in play(Painter, Scene(image, truth), 3, variant)["clicks"]]
        for variant in ("jitter0", "jitter0", "jitter1")
    )
    assert first == again != other


def test_outside_of_the_region_nothing_is_compared() -> None:
    image, truth = ball_scan()
    region = (slice(0, 24), slice(0, 40), slice(0, 30))

    class Beyond(Painter):
        def click(self, click: PersonClick) -> np.ndarray:
            out = truth.copy()
            out[:, :, 35:] = True
            return out

    assert play(Beyond, Scene(image, truth, region), 3)["perfect"]
    found = play(Beyond, Scene(image, truth), 2)
    assert [each["side"] for each in found["clicks"]] == ["inside", "outside"]


def test_surfaces_are_measured_at_the_budgets_and_in_the_challenge_always() -> None:
    image, truth = ball_scan()
    exact = play(Painter, Scene(image, truth), 4)["clicks"]
    assert ["nsd" in each for each in exact] == [True, True, True, False]
    assert exact[2]["nsd"] > exact[0]["nsd"] and exact[2]["mean_mm"] < exact[0]["mean_mm"]
    assert all(
        "nsd" not in each for each in play(Painter, Scene(image, truth), 2, surface=False)["clicks"]
    )
    challenge = play(Painter, Scene(image, truth), 20, "cvpr")["clicks"]
    assert len(challenge) == 6 and all("nsd" in each for each in challenge)


def test_distances_are_in_mm_and_in_voxels_of_the_same_volume() -> None:
    truth = np.zeros((12, 12, 20), bool)
    truth[2:10, 2:10, 4:12] = True
    moved = np.roll(truth, 2, axis=2)
    found = surfaces(moved, truth, (4.0, 2.0, 1.0))
    # A voxel is the cube root of 8 mm3; most of the surface is moved along itself.
    assert found["p95_mm"] == 2.0 and found["p95_voxels"] == 1.0 and found["nsd"] == 1.0
    assert found["mean_voxels"] == pytest.approx(0.5 * found["mean_mm"])
    nothing = surfaces(np.zeros_like(truth), truth, (1.0, 1.0, 1.0))
    assert nothing["nsd"] == 0.0 and nothing["p95_mm"] is None


def test_the_probability_of_the_method_is_kept() -> None:
    image, truth = ball_scan()

    class Confident(Painter):
        confidence = 0.75

    assert play(Confident, Scene(image, truth), 1)["clicks"][0]["sureness"] == 0.75
    assert play(Painter, Scene(image, truth), 1)["clicks"][0]["sureness"] is None


def test_figures_of_games() -> None:
    falling = game_of(0.9, 0.88, 0.879, 0.87, 0.86)
    found = summary(
        [game_of(0.5, 0.81, 0.86, 0.83, 0.91), falling, game_of(0.2, 0.3, 0.3, 0.3, 0.3)]
    )
    assert found["played"] == 5 and found["objects"] == 3
    assert found["dice"] == {1: 0.5, 2: 0.81, 3: 0.86, 5: 0.86}
    # .80: 2, 1, never; .85: 3, 1, never; .90: 5, 1, never.
    assert found["noc"] == {0.80: 2, 0.85: 3, 0.90: 5} and found["never"] == {
        0.80: 1,
        0.85: 1,
        0.90: 1,
    }
    assert found["within5"] == pytest.approx(2 / 3)
    # Only .86 to .83 of twelve later clicks is a fall of more than .02.
    assert found["fell"] == pytest.approx(1 / 12)
    assert (
        found["first_wall_s"] == 1.0
        and found["later_wall_s"] == 3.5
        and found["later_cpu_s"] == 1.75
    )


def test_figures_count_as_many_clicks_as_all_games_have() -> None:
    found = summary([game_of(0.5, 0.9, 0.9), game_of(0.6, 0.7), game_of(0.7, 1.0)])
    assert found["played"] == 2 and found["dice"] == {1: 0.6, 2: 0.9}
    assert found["noc"][0.85] == 2 and found["never"][0.85] == 1 and found["within5"] is None
    assert summary([game_of(0.1, 0.1), game_of(0.2, 0.2), game_of(0.9, 1.0)])["noc"][0.85] == 3
    assert tables.noc_text(3, 2) == "2+"


def test_settings_are_chosen_by_the_mean_over_the_first_clicks() -> None:
    early, late = game_of(0.6, 0.7, 0.7, 0.7, 0.7), game_of(0.1, 0.2, 0.9, 0.9, 0.9)
    assert games.score([early]) == pytest.approx(0.675) and games.score([late]) == pytest.approx(
        0.525
    )


# -- what is kept ------------------------------------------------------------------------------------------


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Three objects of two folds on the ball's scan instead of the list; the calls of a peer that only paints."""
    image, truth = ball_scan()
    scans = ("mra_aorta", "mra_aorta", "ct_tooth")
    three = tuple(
        ClickObject(name, scan, (1,)) for name, scan in zip(("a", "b", "c"), scans, strict=True)
    )
    monkeypatch.setattr(objects, "objects", lambda: three)
    monkeypatch.setattr(program, "load", lambda which, folder: Scene(image, truth))
    played: list[str] = []

    def solver(domain: Any, settings: Any) -> np.ndarray:
        played.append(settings["reach"])
        return np.where(domain.values > -settings["cut"], 0.5, -0.5)

    peer = peers.ClickPeer(
        "made-up", solver, [{"reach": 2.0, "cut": 5.0}, {"reach": 3.0, "cut": -99.0}]
    )
    monkeypatch.setattr(
        methods, "METHODS", {"made-up": methods.Method("made-up", peer.grid, peer=peer)}
    )
    monkeypatch.setattr(tables, "METHODS", methods.METHODS)
    monkeypatch.setattr(tables, "write", lambda folder, page: [])
    return played


def test_a_stopped_run_goes_on_where_it_was(small: list[str], tmp_path: Path) -> None:
    call = ["--grid", "--results", str(tmp_path), "--threads", "1"]
    assert program.main([*call, "--objects", "a"]) == 0
    before, kept = len(small), json.loads((tmp_path / "clicks_made-up.json").read_text())["games"]
    assert len(kept) == 2 and before > 0
    assert program.main([*call, "--objects", "a"]) == 0 and len(small) == before
    assert program.main(call) == 0 and len(small) > before
    after = json.loads((tmp_path / "clicks_made-up.json").read_text())["games"]
    assert len(after) == 6 and all(after[key] == kept[key] for key in kept)
    assert program.main([*call, "--again", "--objects", "a"]) == 0
    assert (
        len(small) > before + 1
        and len(json.loads((tmp_path / "clicks_made-up.json").read_text())["games"]) == 6
    )


def test_a_fold_is_played_with_the_best_settings_of_the_others(
    small: list[str], tmp_path: Path
) -> None:
    # Fold 3 has a and b, fold 4 has c.
    store = Store(tmp_path, "made-up")
    for name, first, second in (("a", 0.9, 0.8), ("b", 0.9, 0.8), ("c", 0.1, 0.7)):
        for reach, cut, level in ((2.0, 5.0, first), (3.0, -99.0, second)):
            store.put(f"{name}/plain/cut={cut},reach={reach}", game_of(*[level] * 5))
    method = methods.METHODS["made-up"]
    assert method.settings(store, "3") == {"reach": 3.0, "cut": -99.0}
    assert method.settings(store, "4") == {"reach": 2.0, "cut": 5.0}
    # A fold that is left out is not asked; one that is not there is.
    store.forget({"c/plain/cut=5.0,reach=2.0"})
    assert (
        method.settings(store, "4") == {"reach": 2.0, "cut": 5.0}
        and method.settings(store, "3") is None
    )


def test_folds_without_chosen_settings_are_left_out_or_played_with_the_default(
    small: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["--folds", "4", "--results", str(tmp_path), "--threads", "1", "--clicks", "2"]
    assert program.main(call) == 0 and small == []
    assert "fold 4 skipped" in capsys.readouterr().out
    assert program.main([*call, "--default"]) == 0
    # The default is the last of the grid.
    assert set(small) == {3.0}
    assert {key.split("/")[0] for key in Store(tmp_path, "made-up").results["games"]} == {"c"}


def test_a_game_with_more_clicks_serves_for_fewer_and_not_the_other_way(tmp_path: Path) -> None:
    store = Store(tmp_path, "any")
    store.put("k", game_of(0.5, 0.6, 0.7))
    again = Store(tmp_path, "any")
    two = again.get("k", 2)
    assert two is not None and [one["dice"] for one in two["clicks"]] == [0.5, 0.6]
    assert again.get("k", 4) is None and again.get("other", 1) is None
    store.put("p", game_of(0.5, 1.0))
    assert store.get("p", 20) is not None
    one = store.get("p", 1)
    assert one is not None and not one["perfect"]
    assert not list(tmp_path.glob("*.draft"))


def test_methods_that_do_not_exist_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        program.main(["--methods", "magic"])
    assert "magic: no such method" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        program.main(["--folds", "7"])


# -- the peers ---------------------------------------------------------------------------------------------


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", list(peers.PEERS))
def test_peers_find_a_ball_in_some_noise(name: str) -> None:
    image, truth = ball_scan(noise=10.0)
    peer = peers.PEERS[name]
    dices = []
    for settings in (one for one in peer.grid if one["reach"] == 4.0):
        made = lambda image, hints, s=settings: CroppedSession(image, peer.solver, s, peer.cap)  # noqa: E731
        game = play(made, Scene(image, truth), 3)
        dices.append(game["clicks"][-1]["dice"])
    assert max(dices) > 0.93


@pytest.mark.parametrize("name", list(peers.PEERS))
def test_peers_keep_what_was_clicked(name: str) -> None:
    image, truth = ball_scan(noise=10.0)
    peer = peers.PEERS[name]
    session = CroppedSession(image, peer.solver, peer.grid[0], peer.cap)
    session.click(PersonClick("inside", (11, 19, 21), (21.0, 19.0, 22.0), 4.0))
    labels = session.click(PersonClick("outside", (11, 19, 26), (26.0, 19.0, 22.0), 0.5))
    assert labels[11, 19, 21] and not labels[11, 19, 26]


def test_the_outside_is_the_faces_that_are_far_from_the_click() -> None:
    image, _ = ball_scan()
    click = PersonClick("inside", (2, 19, 21), (21.0, 19.0, 4.0), 3.0)
    box, margin = crop([click], image.geometry, 2.0)
    assert margin == 12.0 and box == (slice(0, 9), slice(7, 32), slice(9, 34))
    # The scan ends 4 mm below the click, less than half the margin.
    assert sorted(outer_faces([click], image.geometry, box, margin)) == [
        (0, 1),
        (1, 0),
        (1, 1),
        (2, 0),
        (2, 1),
    ]
    # Where the scan is small on all sides the farthest face counts.
    assert (
        len(outer_faces([click], image.geometry, (slice(0, 5), slice(15, 22), slice(18, 24)), 99.0))
        == 1
    )


def test_what_lies_beyond_a_drawn_box_is_outside() -> None:
    image, truth = ball_scan(noise=10.0)
    click = PersonClick("inside", (11, 19, 21), (21.0, 19.0, 22.0), 4.0)
    peer = peers.PEERS["watershed"]
    # Of the ball a half is in the box.
    box = (slice(7, 16), slice(11, 28), slice(13, 22))
    labels = CroppedSession(image, peer.solver, {"reach": 2.0, "sigma": 1.0}, peer.cap, box).click(
        click._replace(index=(11, 19, 17), radius=3.0)
    )
    beyond = np.ones(labels.shape, bool)
    beyond[box] = False
    assert labels.any() and not labels[beyond].any()
    assert (labels[box] & truth[box]).sum() > 0.6 * truth[box].sum()
    # Points say nothing of a width: without a box all of the scan is the crop.
    seen: list[tuple[int, ...]] = []

    def solver(domain: Any, settings: Any) -> np.ndarray:
        seen.append(domain.values.shape)
        return domain.values

    for points in (False, True):
        CroppedSession(image, solver, {"reach": 2.0}, 10**6, None, points).click(
            click._replace(radius=0.5)
        )
    assert seen == [(13, 25, 25), (24, 40, 40)]


def test_coarse_grids_lose_no_seed() -> None:
    seeds = np.zeros((1, 7, 4), np.uint8)
    seeds[0, 6, 3], seeds[0, 0, 0] = 1, 2
    assert (
        restricted_seeds(seeds, (1, 3, 2))[0, 2, 1] == 1
        and restricted_seeds(seeds, (1, 3, 2))[0, 0, 0] == 2
    )
    seeds[0, 1, 1] = 1
    assert restricted_seeds(seeds, (1, 3, 2))[0, 0, 0] == 0


def test_the_shortest_path_goes_around_a_wall() -> None:
    values = np.zeros((1, 5, 9), np.float32)
    values[0, :4, 4] = 10.0
    seeds = np.zeros(values.shape, np.uint8)
    seeds[0, 0, 3], seeds[0, 4, 8] = 1, 2
    from benchmarks.clicks.compiled import nearest_seed

    label = nearest_seed(values, seeds, *peers.neighbours((1.0, 1.0, 1.0), False), 10.0, True)
    # Straight across it is 2 steps to the first seed; around the wall and up, 7 from the second.
    assert label[0, 0, 5] == 2 and label[0, 0, 2] == 1 and (label > 0).all()
    open_field = nearest_seed(
        np.zeros_like(values), seeds, *peers.neighbours((1.0, 1.0, 1.0), False), 10.0, True
    )
    assert open_field[0, 0, 5] == 1


# -- tables ------------------------------------------------------------------------------------------------


def test_tables_and_picture_are_made_of_the_games(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = (
        ("liver", "ct_abdomen_hires", "organs"),
        ("tumour", "mri_tumour_thick2", "lesions"),
        ("phantom-blob", "phantom", "other"),
    )
    held = tuple(ClickObject(name, scan, (1,), family) for name, scan, family in kinds)
    monkeypatch.setattr(objects, "objects", lambda: held)
    peer = peers.ClickPeer("watershed", peers.watershed, [{"reach": 2.0}])
    monkeypatch.setattr(
        tables,
        "METHODS",
        {
            "accelsurf": methods.Method("accelsurf", takes_size=True),
            "watershed": methods.Method("watershed", peer.grid, peer=peer),
        },
    )
    for name, dices in (
        ("accelsurf", (0.8, 0.9, 0.9, 0.9, 0.95)),
        ("watershed", (0.6, 0.7, 0.8, 0.86, 0.9)),
    ):
        for which in held:
            settings, store = "reach=2.0" if name == "watershed" else "", Store(tmp_path, name)
            more = 0.0 if which.name == "liver" else 0.1 if which.fold == "phantoms" else 0.04
            store.put(f"{which.name}/plain/{settings}", game_of(*(dice - more for dice in dices)))
            challenge = [
                {"dice": dice, "nsd": dice - 0.5, "wall_s": 1, "cpu_s": 1}
                for dice in (*dices, 0.95)
            ]
            store.put(f"{which.name}/cvpr/{settings}", {"clicks": challenge, "perfect": False})
    page = tmp_path / "page.md"
    comments = "<!-- scripts/benchmark clicks writes this table -->", "<!-- end of the table -->"
    page.write_text(f"before\n{comments[0]}\n\nreplaced\n{comments[1]}\nafter\n")
    written = tables.write(tmp_path, page)
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "replaced" not in text
    # Medians and means of the two objects of scans; phantoms are a fold of their own.
    assert (
        "| accelsurf | 0.780 (0.780) | 0.880 (0.880) | 0.880 (0.880) | 0.930 (0.930) |  | 1.5 | 2 | 3.5 |"
        in text
    )
    assert "| fold phantoms | 1 | accelsurf | 0.700 | 0.800 | 0.800 | 0.850 |  |" in text
    assert "| lesions | 1 | watershed | 0.560 | 0.660 | 0.760 | 0.860 |  |" in text
    assert (
        "| median Dice after one click, as the best peer's | at least 0.58 | 0.78 | yes |" in text
    )
    # 5 intervals: half of the first and the last value, and all between.
    assert "| accelsurf | 4.525 | 2.025 | 0.950 | 0.450 |" in text
    assert (
        "| liver | 1 | organs | 0.800 | 0.900 | 0.900 | 0.950 |  | 2 | 0.900 (watershed) |" in text
    )
    assert (tmp_path / "clicks.md").read_text() in text
    description = json.loads((tmp_path / "clicks.json").read_text())
    assert description["figures"]["plain"]["watershed"]["all"]["noc"]["0.85"] == 4.5
    assert [path.name for path in written] == ["clicks.json", "clicks.md", "page.md", "clicks.png"]
    assert written[-1].stat().st_size > 5000
    rows = tables.flat(tmp_path)
    assert [(row["method"], row["object"], row["fold"], row["family"]) for row in rows[:2]] == [
        ("accelsurf", "liver", "1", "organs"),
        ("accelsurf", "tumour", "6", "lesions"),
    ]


def test_an_album_has_the_slice_through_each_click(tmp_path: Path) -> None:
    from benchmarks.clicks.pictures import Album

    image, truth = ball_scan()
    album = Album("any", "ball", "plain")
    game = play(Painter, Scene(image, truth), 3, watch=album.watcher(image, truth))
    assert len(album.frames) == 3
    for frame, one in zip(album.frames, game["clicks"], strict=True):
        # Slices are 2 mm thick: they are across z, and the click is where its value says.
        column, row = (int(value) for value in frame.at)
        assert frame.values[row, column] == image.array[tuple(one["index"])]
        assert frame.found[row, column] and frame.truth[row, column]
        assert f"{one['dice']:.3f}" in frame.text
    assert album.aspect == 1.0 and album.write(tmp_path).stat().st_size > 5000
