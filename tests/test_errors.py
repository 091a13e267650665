import pickle

import pytest

from accelsurf.errors import (
    AccelsurfError,
    EmptyResultError,
    GeometryError,
    InputError,
    OutputError,
    UsageError,
)


@pytest.mark.parametrize(
    ("family", "code", "kind"),
    [
        (AccelsurfError, 1, "internal"),
        (UsageError, 2, "usage"),
        (InputError, 3, "input"),
        (GeometryError, 3, "geometry"),
        (EmptyResultError, 5, "empty-result"),
        (OutputError, 7, "output"),
    ],
)
def test_each_family_has_its_exit_code_and_name(family, code, kind):
    error = family("a given, b expected", hint="do c")
    assert (error.exit_code, error.kind) == (code, kind)
    assert isinstance(error, AccelsurfError)


def test_geometry_errors_are_input_errors():
    assert issubclass(GeometryError, InputError)


def test_message_and_hint_are_one_line_each():
    error = InputError("first\nsecond \t third\r\n", hint=" do\nthis ")
    assert str(error) == error.message == "first second third"
    assert error.hint == "do this"


def test_traceback_shows_the_hint_and_only_when_there_is_one():
    assert InputError("m", hint="h").__notes__ == ["hint: h"]
    assert not hasattr(InputError("m"), "__notes__")


def test_an_error_survives_the_way_out_of_a_worker_process():
    error = pickle.loads(pickle.dumps(OutputError("m", hint="h")))
    assert type(error) is OutputError
    assert (error.message, error.hint) == ("m", "h")
