import numpy as np
import pytest

from fieldmap.kernels.coils.elementary import atan2, exp, log


@pytest.mark.parametrize(
    "x", np.concatenate([10.0 ** np.linspace(-300, 300, 41), 1 + 10.0 ** np.linspace(-15, 0, 16)])
)
def test_log_equals_the_library(x):
    assert log(x) == pytest.approx(np.log(x), rel=5e-16, abs=3e-16)


@pytest.mark.parametrize("x", np.linspace(-700, 700, 57))
def test_exp_equals_the_library(x):
    assert exp(x) == pytest.approx(np.exp(x), rel=1e-15)


@pytest.mark.parametrize("angle", np.linspace(-np.pi, np.pi, 73)[1:])
@pytest.mark.parametrize("size", [1e-12, 1.0, 1e9])
def test_atan2_equals_the_library(angle, size):
    y, x = size * np.sin(angle), size * np.cos(angle)
    assert atan2(y, x) == pytest.approx(np.arctan2(y, x), abs=1e-15)


def test_limits_are_finite():
    assert atan2(0.0, 0.0) == 0.0
    assert atan2(0.0, -1.0) == pytest.approx(np.pi, rel=1e-15)
    assert 700 < -log(0.0) < 720
    assert 700 < log(np.inf) < 720
