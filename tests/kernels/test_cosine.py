"""Sine and cosine by a polynomial: against numpy."""

import numpy as np
import pytest

from accelsurf.kernels.waves import bump, sine_of_pi

pytestmark = pytest.mark.nojit


def test_sine_and_bump_within_a_few_parts_in_a_hundred_billion():
    for x in np.linspace(-0.5, 0.5, 101):
        assert sine_of_pi(float(x)) == pytest.approx(np.sin(np.pi * x), abs=1e-11)
    for x in np.linspace(0.0, 1.0, 101):
        assert bump(float(x)) == pytest.approx(1.0 + np.cos(np.pi * x), abs=3e-11)
        assert bump(float(x)) >= 0.0
