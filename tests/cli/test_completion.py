"""accelsurf --install-completion: what it writes, and what a shell then offers."""

import os
import shutil
import subprocess
import sys

import pytest

from accelsurf import cli
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.presets import PRESETS


@pytest.fixture
def home(tmp_path, monkeypatch):
    """An empty home folder."""
    for name in ("ZSH", "ZSH_CUSTOM", "ZSH_VERSION", "BASH_VERSION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def files_of(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("shell", "script", "startup"),
    [
        ("bash", ".local/share/bash-completion/completions/accelsurf", ".bashrc"),
        ("zsh", ".zsh/completions/_cyclopts_accelsurf", ".zshrc"),
        ("fish", ".config/fish/completions/accelsurf.fish", None),
    ],
)
def test_it_writes_a_script_says_where_and_changes_nothing_the_second_time(
    shell, script, startup, home, capsys
):
    if startup is not None:
        (home / startup).write_text("alias ll='ls -l'")
    assert cli.execute(["--install-completion", "--shell", shell]) == 0
    out, found = capsys.readouterr().out, files_of(home)
    assert set(found) == {script} | ({startup} if startup is not None else set())
    assert str(home / script) in out and b"segment" in found[script]
    if startup is not None:
        assert b"alias ll='ls -l'" in found[startup] and str(home).encode() in found[startup]
    assert cli.execute(["--install-completion", "--shell", shell]) == 0
    assert files_of(home) == found


def test_the_shell_is_that_of_the_user(home, monkeypatch, capsys):
    monkeypatch.setenv("BASH_VERSION", "5.2")
    assert cli.execute(["--install-completion", "-o", str(home / "there" / "script")]) == 0
    assert (
        list(files_of(home)) == ["there/script"]
        and f"source {home}/there/script" in capsys.readouterr().out
    )
    assert b"complete -o default -F _accelsurf accelsurf" in files_of(home)["there/script"]


def test_what_cannot_be_written_is_one_line(home, capsys):
    (home / "file").touch()
    assert (
        cli.execute(["--install-completion", "--shell", "bash", "-o", str(home / "file" / "x")])
        == 7
    )
    assert len(capsys.readouterr().err.splitlines()) == 2
    assert cli.execute(["--install-completion", "--shell", "csh"]) == 2


def test_the_help_of_the_program_names_it(capsys):
    assert cli.execute(["--help"]) == 0
    assert "--install-completion" in capsys.readouterr().out


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_options_and_names(home):
    assert cli.execute(["--install-completion", "--shell", "bash", "-o", str(home / "script")]) == 0
    program = home / "bin" / "accelsurf"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m accelsurf "$@"\n')
    program.chmod(0o755)
    typed = [
        ("seg",),
        ("e",),
        ("segment", "--pres"),
        ("evaluate", "--"),
        ("segment", "x.nii", "--flow", ""),
        ("segment", "x.nii", "--energy", "geo"),
        ("batch", "scans", "--preset", ""),
        ("segment", "x", "--mask", ""),
    ]
    lines = [f". {home}/script"]
    for words in typed:
        quoted = " ".join(f"'{word}'" for word in ("accelsurf", *words))
        lines += [
            f"COMP_WORDS=({quoted}); COMP_CWORD={len(words)}; COMPREPLY=(); _accelsurf",
            'echo "${COMPREPLY[*]}"',
        ]
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "--norc", "-c", "\n".join(lines)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stderr == ""
    offered = [line.split() for line in done.stdout.splitlines()]
    assert offered[:3] == [["segment"], ["evaluate"], ["--preset", "--presmooth"]]
    assert {"--labels", "--pairs", "--tolerance", "--csv"} <= set(offered[3])
    assert (
        offered[4] == ["auto", *FLOWS]
        and offered[5] == ["geodesic"]
        and offered[6] == list(PRESETS)
    )
    assert offered[7] == []  # then bash offers names of files
