"""Signals at the places where Python cannot raise their exception, and what is said about them."""

import signal
import sys
import time

import pytest

from accelsurf.cases.interrupts import Interrupts, default_handling


@pytest.fixture
def interrupts():
    made = Interrupts()
    made.install()
    yield made
    made.uninstall()


def send(number=signal.SIGINT):
    signal.raise_signal(number)


def test_a_signal_raises_and_decides_the_exit_code(interrupts, capsys):
    assert interrupts.exit_code(5) == 5
    with pytest.raises(KeyboardInterrupt):
        send(signal.SIGTERM)
    assert interrupts.exit_code(0) == 143
    interrupts.report("error: ")
    interrupts.report()
    assert (
        capsys.readouterr().err
        == "error: interrupted: no result is written; what was there before is as it was\n"
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_first_signal_only_asks_while_there_is_something_to_save(interrupts, capsys, number):
    with interrupts.patience("finishing the files"):
        send(number)
    assert (
        "finishing the files (" in capsys.readouterr().err
        and interrupts.exit_code(0) == 128 + number
    )
    with pytest.raises(KeyboardInterrupt), interrupts.patience("finishing the files"):
        send()


def test_an_exception_that_was_swallowed_is_raised_again(interrupts):
    try:
        send()
    except KeyboardInterrupt:
        pass  # as a library may
    with pytest.raises(KeyboardInterrupt), interrupts.patience("going on"):
        pytest.fail("the signal was forgotten")


def test_an_exception_that_python_cannot_raise_comes_a_little_later(interrupts, capsys):
    class Dying:
        def __del__(self):
            send()

    with pytest.raises(KeyboardInterrupt):
        Dying()
        time.sleep(5)
    assert capsys.readouterr().err == ""


def test_handlers_are_given_back(monkeypatch):
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    before = signal.getsignal(signal.SIGINT)
    made = Interrupts()
    made.install()
    assert Interrupts.current() is made
    with default_handling():
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    made.install()  # as when the program has installed it before a command does
    made.uninstall()
    assert Interrupts.current() is made
    signal.signal(signal.SIGINT, before)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
