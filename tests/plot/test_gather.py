"""What is gathered for a picture: the height of a shift, and what currents within a limit reach."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.device.payload import PayloadPiece, SoftSphere
from fieldmap.errors import InputError
from fieldmap.io import FieldSource, find_source
from fieldmap.levitation import reachable
from fieldmap.plot.gather import DEFAULT_LIMIT, floating_height, shown_field
from tests.plot.conftest import harmonic
from tests.refusals import refused


def source_of(field):
    about = ("a.h5", "", "map", field.coil_names, field.bounds, Payload(0.010, 0.8), None, None)
    return FieldSource(*about, make=lambda: field)


def test_the_shift_is_shown_where_the_magnet_floats(harmonic_map):
    """dBz/dz = b + c z per ampere on the axis: the weight is carried at one height."""
    b, c = 0.04, 1.0
    source = source_of(harmonic_map(coil=(0.0, b, c, (0.0, 0.0))))
    height, why = floating_height(source, np.array([3.0]))
    assert height == pytest.approx((0.010 * 9.80665 / (0.8 * 3.0) - b) / c, abs=1e-8)
    assert "nowhere" not in why
    middle = -0.02 + 0.5 * 4 * 0.01
    height, why = floating_height(source, np.array([0.1]))
    assert height == pytest.approx(middle, abs=1e-12)
    assert "nowhere" in why


def test_the_shift_of_a_map_of_four_coils(harmonic_map):
    """Coil k: Bz = 0.1 z + 2 (z^2 - (r - r_k)^2 / 2) per ampere, r_k in the corners of a square of 40 mm.

    The magnet rests at the centroid of the currents, and a signal s along x or y moves it by s times 20 mm.
    """
    corners = 0.02 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    field = harmonic_map(**{name: (0.0, 0.1, 4.0, at) for name, at in zip("abcd", corners, strict=True)})
    shown = shown_field(source_of(field), np.full(4, 2.0), "shift", height=-0.01)
    x, y = np.meshgrid(shown.surface.x_signals, shown.surface.y_signals, indexing="ij")
    np.testing.assert_allclose(shown.surface.positions[..., 0], 0.02 * x, atol=1e-8)
    np.testing.assert_allclose(shown.surface.positions[..., 1], 0.02 * y, atol=1e-8)


def test_a_difference_is_that_of_both_fields_in_the_box_they_share(harmonic_map):
    first, second, points = (0.0, 0.0, 6.0), (1.0, 0.0, 0.0), np.array([[0.005, 0.0, -0.002]])
    one, other = (source_of(harmonic_map(coil=(*abc, (0.0, 0.0)))) for abc in (first, second))
    low, high = one.bounds
    other = replace(other, bounds=(low + 0.01, high + 0.01))
    shown = shown_field(one, np.array([2.0]), "difference", other)
    np.testing.assert_allclose((shown.lower, shown.upper), (low + 0.01, high))
    found = shown.state.field(points), shown.state.gradient(points)
    for of_both, of_one, of_other in zip(
        found, harmonic(points, *first), harmonic(points, *second), strict=True
    ):
        np.testing.assert_allclose(of_both, 2.0 * (of_one - of_other), atol=1e-12)
    for changed in ({"bounds": (high, high + 0.01)}, {"coil_names": ("other",)}):
        with refused(InputError, where="show, --minus"):
            shown_field(one, np.array([2.0]), "difference", replace(other, **changed))


@pytest.fixture
def six(dipole_map, circle_of_six, valid_text, tmp_path):
    """The map of six dipoles, of a device that has all there is."""
    return find_source(dipole_map(circle_of_six, tmp_path / "six.h5", valid_text))


def test_what_a_map_reaches_is_within_the_limit_of_its_driver(six):
    assert six.driver.current_limit != DEFAULT_LIMIT
    found = shown_field(six, np.zeros(6), "reachable", kind="B").reachable
    middle = 0.5 * (six.bounds[0] + six.bounds[1])
    expected = reachable(six.field, middle, six.driver.current_limit)
    assert found.largest_along([0, 0, 1]) == pytest.approx(expected.largest_along([0, 0, 1]), rel=1e-12)


def test_reachable_forces_on_soft_iron_are_searched(six):
    """Within the limit, which some current takes, and said to be a search's."""
    bead = Payload(1e-4, pieces=(PayloadPiece(SoftSphere(1e-3, mu_r=100.0)),))
    one = shown_field(replace(six, payload=bead), np.zeros(6), "reachable", kind="force", limit=0.02)
    assert not one.reachable.exact
    assert one.reachable.moment.soft
    assert any("134 directions" in text for text in one.assumptions)
    assert np.abs(one.reachable.currents).max() == pytest.approx(0.02, rel=1e-9)
    assert np.shape(one.to_dict()["reachable"]["values"]) == (134, 3)
