"""Energies as they are written: what they mean, and one clear line for what they cannot."""

import pytest

from accelsurf.errors import UsageError
from accelsurf.settings.energy_expression import EnergyText, from_tables, written
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.run_config import RunConfig


def terms_of(text):
    return EnergyText(text).terms


def test_terms_weights_and_settings():
    one, two, three, four = terms_of(
        " 2e-1*local-region:R=8 +  geodesic:scale=1.5,contrast=.2 - 0.5*balloon + 3 * area"
    )
    assert (one.name, one.weight, one.settings) == ("local-region", 0.2, {"R": 8.0})
    assert (two.name, two.weight, two.settings) == (
        "geodesic",
        1.0,
        {"scale": 1.5, "contrast": 0.2},
    )
    assert (three.name, three.weight, three.settings) == ("balloon", -0.5, {})
    assert (four.name, four.weight) == ("area", 3.0)


@pytest.mark.parametrize(
    ("text", "settings"),
    [
        ("threshold:-50,300", {"LO": -50.0, "HI": 300.0}),
        ("threshold:1e-3,", {"LO": 1e-3, "HI": ""}),
        ("threshold:,80%", {"LO": "", "HI": "80%"}),
        ("threshold:auto", {"LO": "auto"}),
        ("threshold:HI=auto,soft=5", {"HI": "auto", "soft": 5.0}),
        ("local-region:12", {"R": 12.0}),
        ("likelihood:histogram,no", {"model": "histogram", "update": "no"}),
        ("chan-vese:2,epsilon=0", {"balance": 2.0, "epsilon": 0.0}),
    ],
)
def test_values_by_place_or_by_key(text, settings):
    assert dict(terms_of(text)[0].settings) == settings


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "nothing was given"),
        ("edges", "chan-vese, local-region"),
        ("geodesic+area", "a blank on either side"),
        ("geodesic +", "in place of"),
        ("0*geodesic", "a weight greater than 0 for geodesic"),
        ("chan-vese - 0.3*geodesic", "a weight greater than 0 for geodesic"),
        ("chan-vese + 0*balloon", "other than 0 for balloon"),
        ("x*geodesic", "a number before the *"),
        ("1e999*geodesic", "a weight"),
        ("area + balloon", "a term that sees the image"),
        ("local-region:R=0", "a number above 0 for R of local-region"),
        ("local-region:R=", "not 'nothing'"),
        ("local-region:radius=8", "one of R, epsilon"),
        ("local-region:8,0,1,9", "one of R, epsilon"),
        ("chan-vese:", "values after the colon"),
        ("area:3", "none: it has no settings"),
        ("chan-vese:epsilon=3", "at least 0 and at most 2.5"),
        ("chan-vese:balance=1,balance=2", "balance of chan-vese once"),
        ("likelihood:model=student", "gauss or histogram"),
        ("likelihood:model=gauss,update=maybe", "yes or no"),
        ("threshold", "at least one bound"),
        ("threshold:,", "at least one bound"),
        ("threshold:9,5", "a low threshold below the high one"),
        ("threshold:120%", "a percentile"),
        ("threshold:nan", "a number"),
        ("threshold:auto,auto", "auto for one"),
        ("threshold:inf", "a number"),
    ],
)
def test_what_is_no_energy_is_told_in_one_line(text, words):
    with pytest.raises(UsageError) as caught:
        RunConfig(energy=text)
    message = str(caught.value)
    assert message.startswith("energy: ") and words in message and "\n" not in message
    assert caught.value.hint and caught.value.exit_code == 2


def test_a_list_of_tables_is_the_same(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(
        'energy = [{term = "threshold", LO = -50, HI = "auto"}, {term = "geodesic", weight = 0.3, scale = 2}, '
        '{term = "balloon", weight = -0.1}]\n'
    )
    config = RunConfig.from_toml(path)
    assert terms_of(config.energy) == terms_of(
        "threshold:-50,auto + 0.3*geodesic:scale=2 - 0.1*balloon"
    )
    path.write_text(config.to_toml())
    assert RunConfig.from_toml(path) == config


@pytest.mark.parametrize(
    "table",
    [
        5,
        {},
        {"term": 3},
        {"term": "area", "weight": "big"},
        {"term": "area", "weight": True},
        {"term": "x", "y": []},
    ],
)
def test_bad_tables_are_told(table):
    with pytest.raises(UsageError, match="^energy: "):
        RunConfig(energy=[{"term": "chan-vese"}, table])


def test_every_term_is_known_by_name_and_text_is_kept():
    for name in TERMS:
        text = f"chan-vese + {name}" if name != "threshold" else "chan-vese + threshold:1"
        assert RunConfig(energy=f"  {text} ").energy == text
    assert from_tables([{"term": "local-region", "R": 8.5}]) == "local-region:R=8.5"


def test_settings_of_terms_that_are_not_there_are_named():
    assert RunConfig(energy="local-region + 0.2*geodesic", balance=2, edge_scale=1).unused() == [
        "balance"
    ]
    assert RunConfig(energy="threshold:1", foreground="center", epsilon=1).unused() == [
        "foreground",
        "epsilon",
    ]


@pytest.mark.parametrize(
    "text",
    [
        "chan-vese",
        "threshold:-50.25,300",
        "threshold:,auto",
        "threshold:half:50,learned",
        "threshold:20%,80%",
        "0.5*local-region:R=8 + 0.3*geodesic:contrast=1e-09 - 0.1*balloon",
        "likelihood:histogram,no",
        "-2*balloon + geodesic",
        "threshold:123456.789",
        "1e-07*area + partition:0",
    ],
)
def test_what_is_written_reads_the_same(text):
    once = terms_of(text)
    again = terms_of(written(once))
    assert [(term.name, term.weight) for term in again] == [
        (term.name, term.weight) for term in once
    ]
    for one, other in zip(once, again, strict=True):
        assert other.settings == {key: value for key, value in one.settings.items() if value != ""}


def test_a_setting_of_a_term_is_changed_in_place_and_what_is_wrong_is_refused():
    assert (
        EnergyText("2*threshold:,auto - balloon").with_setting(0, "LO", " -20 ")
        == "2*threshold:LO=-20,HI=auto - balloon"
    )
    assert EnergyText("threshold:10,20").with_setting(0, "HI", "") == "threshold:LO=10"
    for place, key, value in (
        (1, "LO", "3"),
        (-1, "LO", "3"),
        (0, "R", "3"),
        (0, "LO", "30"),
        (0, "LO", "x,HI=3"),
    ):
        with pytest.raises(UsageError, match="energy"):
            EnergyText("threshold:10,20").with_setting(place, key, value)
    with pytest.raises(UsageError, match="at least one bound"):
        EnergyText("threshold:10").with_setting(0, "LO", "")
