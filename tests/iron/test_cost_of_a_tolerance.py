"""What a mesh within a tolerance would cost, by the course of the meshes so far: against powers that are known."""

from types import SimpleNamespace

import pytest

from fieldmap.iron.error.tolerance import expected_cost, faces_within


def steps(power, *faces):
    """Meshes whose error over the tolerance is 4 at 1000 faces and falls with a power of their number."""
    return [
        SimpleNamespace(faces=n, excess=4.0 * (n / 1000.0) ** -power, seconds=2.0 * (n / 1000.0) ** 1.5)
        for n in faces
    ]


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_faces_at_which_the_error_is_the_tolerance(power):
    expected = 1000.0 * 4.0 ** (1.0 / power)
    assert faces_within(steps(power, 1000.0, 1500.0)) == pytest.approx(expected, rel=1e-9)
    assert faces_within(steps(power, 1000.0, 1500.0, 6000.0)) == pytest.approx(expected, rel=1e-9)


def test_nothing_is_said_of_what_hardly_falls():
    assert faces_within(steps(1.0, 1000.0)) is None
    assert faces_within(steps(1.0, 1000.0, 1100.0)) is None
    assert faces_within(steps(0.2, 1000.0, 4000.0)) is None


def test_time_goes_with_the_power_that_was_measured():
    known = expected_cost(steps(1.0, 1000.0, 2000.0), 8000.0, 1.0, 1.0)
    assert known.seconds == pytest.approx(2.0 * 8.0**1.5, rel=1e-9)
    # Of one mesh alone the square.
    assert expected_cost(steps(1.0, 1000.0), 3000.0, 1.0, 1.0).seconds == pytest.approx(18.0, rel=1e-9)
