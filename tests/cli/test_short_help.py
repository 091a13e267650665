"""Help on one screen, values that begin with a minus sign, and a scan in place of a command."""

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.cli.short_help import COMMANDS
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.settings.catalogue import entry


def helped(capsys, *words):
    assert cli.execute(list(words)) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_one_screen_and_all_of_it_is_there_when_asked_for(capsys, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "80")
    short, full = (helped(capsys, command, word) for word in ("--help", "--help-all"))
    assert len(short.splitlines()) <= 55 and "--help-all" in short and "--out" in short
    options = {word for word in full.split() if word.startswith("--")}
    assert (
        len(options) > 3 * len({word for word in short.split() if word.startswith("--")})
        or command == "refine"
    )
    assert helped(capsys, command, "-h") == short


def test_no_option_of_help_is_lost(capsys):
    full = helped(capsys, "segment", "--help-all")
    assert (
        "--half-width" in full
        and "--checkpoint" in full
        and "--inside" in helped(capsys, "segment", "--help")
    )


@pytest.mark.parametrize(
    ("typed", "parsed"),
    [
        (["look", "a.nii", "--at", "-1,2,3"], ["look", "a.nii", "--at=-1,2,3"]),
        (["segment", "--balloon", "-.5", "-o", "x"], ["segment", "--balloon=-.5", "-o", "x"]),
        (["segment", "--start=ball:1,1,1,2", "-5"], ["segment", "--start=ball:1,1,1,2", "-5"]),
        (
            ["segment", "--inside", "-1,-2,-3", "--box", "-4,5"],
            ["segment", "--inside=-1,-2,-3", "--box=-4,5"],
        ),
        (["look", "--", "-1"], ["look", "--", "-1"]),
        (["look", "--help-all"], ["look", "--help"]),
        (["no such file"], ["no such file"]),
        ([], []),
    ],
)
def test_arguments_as_the_parser_takes_them(typed, parsed):
    assert cli.as_parsed(typed) == parsed


def test_every_option_with_a_number_takes_a_minus_sign(capsys):
    for name in ("balance", "balloon", "roi", "clip", "edge_scale"):
        assert entry(name) is not None
        cli.execute(["segment", "--dump-config", "--" + name.replace("_", "-"), "-1,-2,-3,4,5,6"])
        said = capsys.readouterr()
        assert "requires an argument" not in said.err and "nknown option" not in said.err


def test_a_negative_place_is_looked_at(tmp_path, capsys):
    scan = tmp_path / "scan.nii"
    io.write(
        Volume(
            np.zeros((4, 5, 6), np.float32),
            Geometry((4, 5, 6), (1.0, 1.0, 1.0), (-6.0, -5.0, -4.0)),
        ),
        scan,
    )
    assert cli.execute(["look", str(scan), "--at", "-3,-2,-1", "-o", str(tmp_path / "a.png")]) == 0


def test_a_scan_in_place_of_a_command_is_viewed(tmp_path, monkeypatch):
    scan = tmp_path / "scan.nii"
    scan.write_bytes(b"")
    assert cli.as_parsed([str(scan), "--theme", "dark"]) == ["view", str(scan), "--theme", "dark"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "look").write_bytes(b"")
    assert cli.as_parsed(["look"]) == ["look"]  # a command's name stays one
