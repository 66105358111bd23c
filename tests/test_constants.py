"""Constants of the kernels against another table."""

import math

import pytest
import scipy.constants

from fieldmap.constants import GRAVITY, MU0, MU0_OVER_2PI, MU0_OVER_4PI


def test_permeability_of_the_vacuum():
    """4 pi 1e-7 to 1e-9, and the CODATA table in scipy."""
    assert pytest.approx(4e-7 * math.pi, rel=1e-9) == MU0
    assert pytest.approx(scipy.constants.mu_0, rel=2e-9) == MU0
    assert pytest.approx(1e-7, rel=1e-9) == MU0_OVER_4PI
    assert pytest.approx(2e-7, rel=1e-9) == MU0_OVER_2PI


def test_free_fall():
    assert scipy.constants.g == GRAVITY
