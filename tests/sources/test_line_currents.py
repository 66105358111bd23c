"""Inductances of loops and polylines against published formulas, Maxwell's integral and fluxes by quadrature."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.special import ellipe, ellipk

import fieldmap as fm
from fieldmap.device.air_sources import AirSource
from fieldmap.errors import InputError
from fieldmap.sources.inductance import background_linkage, bare_inductance
from fieldmap.sources.line_currents import flux_elements_of_lines, line_elements, vector_potential
from fieldmap.sources.winding_rules import current_elements

RADIUS, WIRE = 0.02, 2e-5


def circle(radius=RADIUS, z=0.0, current=1.0):
    return AirSource("Circle", fm.placed([0, 0, z]), current=current, diameter=2 * radius)


def polyline(corners, current=1.0):
    return AirSource("Polyline", current=current, vertices=np.asarray(corners, float))


def square(side):
    h = side / 2
    return polyline([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0], [-h, -h, 0]])


def coil(*sources, wire=WIRE, turns=1.0, name="coil"):
    return fm.MagpylibCoil(name, sources, turns=turns, wire_diameter=wire)


def maxwell(one, other, apart):
    """Mutual inductance of coaxial loops (Maxwell, Treatise, art. 701)."""
    m = 4 * one * other / ((one + other) ** 2 + apart**2)
    return mu_0 * np.sqrt(one * other) * ((2 - m) * ellipk(m) - 2 * ellipe(m)) / np.sqrt(m)


def test_loop_of_round_wire():
    """Rosa (1908), p. 301: L = mu0 R (ln(8 R / a) - 7/4) for uniform current in the wire."""
    exact = mu_0 * RADIUS * (np.log(8 * RADIUS / (WIRE / 2)) - 1.75)
    assert bare_inductance([coil(circle())])[0, 0] == pytest.approx(exact, rel=1e-6)
    assert bare_inductance([coil(circle(), turns=10.0)])[0, 0] == pytest.approx(100 * exact, rel=1e-6)


def test_square_of_round_wire():
    """Grover (1946), eq. 58: L = (2 mu0 s / pi) (ln(s / a) - 0.52401)."""
    exact = 2 * mu_0 * RADIUS / np.pi * (np.log(RADIUS / (WIRE / 2)) - 0.52401)
    assert bare_inductance([coil(square(RADIUS))])[0, 0] == pytest.approx(exact, rel=2e-4)


def test_many_corners_are_a_loop():
    wanted = bare_inductance([coil(circle())])[0, 0]
    off = []
    for count in (24, 48):
        angle = 2 * np.pi * np.arange(count + 1) / count
        corners = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        off.append(wanted - bare_inductance([coil(polyline(corners))])[0, 0])
    assert 0 < off[1] < 0.3 * off[0] < 0.003 * wanted


def test_a_stack_of_loops():
    """Two loops in series 1 mm apart, one with twice the current: self and mutual parts of each."""
    pair = coil(circle(), circle(z=0.001, current=2.0))
    alone, mutual = bare_inductance([coil(circle())])[0, 0], maxwell(RADIUS, RADIUS, 0.001)
    assert bare_inductance([pair])[0, 0] == pytest.approx(5 * alone + 4 * mutual, rel=1e-9)
    apart = [coil(circle(), name="a"), coil(circle(z=0.001, current=2.0), name="b")]
    assert bare_inductance(apart)[0, 1] == pytest.approx(2 * mutual, rel=1e-9)


def test_mutual_inductance_with_a_winding_and_a_square():
    """It is symmetric, and equals the flux of the other coil's field through the lines."""
    winding = fm.CircularCoil("w", 0.01, 0.013, 0.004, 50.0).moved([0.002, 0, 0.006])
    lines = [coil(circle(), turns=3.0, name="a"), coil(square(0.05), name="b").moved([0, 0.004, -0.005])]
    matrix = bare_inductance([winding, *lines])
    assert matrix == pytest.approx(matrix.T, rel=1e-12)
    assert np.linalg.eigvalsh(matrix).min() > 0
    elements = current_elements(winding)
    for k, one in enumerate(lines):
        assert matrix[0, k + 1] == pytest.approx(
            np.sum(vector_potential(one, elements.points) * elements.vectors), rel=1e-9
        )
    rule = flux_elements_of_lines(lines[0])
    for other, number in ((winding, 0), (lines[1], 2)):
        field = fm.open_field(fm.Device("d", "", (other,))).field(rule.points, [1.0])
        assert matrix[1, number] == pytest.approx(np.sum(field * rule.vectors), rel=2e-4)


@pytest.mark.parametrize(("source", "length"), [(circle(current=2.0), np.pi), (square(2 * RADIUS), 4.0)])
def test_elements_of_a_line_are_its_length_and_moment(source, length):
    """The elements close, and half the sum of r x dl is the area times the current, along the normal."""
    rule = line_elements(coil(source, turns=3.0).moved([0.1, 0.2, -0.3]))
    amperes = 3.0 * source.amperes
    assert np.abs(rule.vectors.sum(axis=0)).max() < 1e-12
    assert np.linalg.norm(rule.vectors, axis=1).sum() == pytest.approx(
        2 * length * RADIUS * amperes, rel=1e-9
    )
    moment = 0.5 * np.cross(rule.points, rule.vectors).sum(axis=0)
    assert moment == pytest.approx([0.0, 0.0, length * RADIUS**2 * amperes], abs=1e-12)


def test_the_potential_on_a_straight_wire_stays_finite():
    """mu0 I / (2 pi) arsinh(L / 2d) beside the middle; on the wire d is 1e-12 of its length."""
    wire = coil(polyline([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]))
    distance = np.array([0.1, 1e-3, 1e-9, 0.0])
    points = np.column_stack([np.full(4, 0.2), distance, np.zeros(4)])
    expected = mu_0 / (2 * np.pi) * np.arcsinh(0.2 / np.maximum(distance, 0.4e-12))
    found = vector_potential(wire, points)
    assert found[:, 0] == pytest.approx(expected, rel=1e-9)
    assert np.abs(found[:, 1:]).max() == 0.0


@pytest.mark.parametrize(
    "source", [circle(), square(0.03), polyline([[0, 0, 0], [0.01, 0, 0.02], [0.03, 0.01, 0]])]
)
def test_the_curl_of_the_potential_is_the_field(source):
    one = coil(source, turns=2.0).turned("x", 20.0).moved([0.001, 0.002, 0.0])
    points = np.random.default_rng(0).normal(size=(20, 3)) * 0.02 + [0, 0, 0.01]
    step = 1e-6 * np.eye(3)
    slope = np.stack(
        [(vector_potential(one, points + d) - vector_potential(one, points - d)) / 2e-6 for d in step], axis=2
    )
    curl = np.stack(
        [slope[:, 2, 1] - slope[:, 1, 2], slope[:, 0, 2] - slope[:, 2, 0], slope[:, 1, 0] - slope[:, 0, 1]], 1
    )
    field = fm.open_field(fm.Device("d", "", (one,))).field(points, [1.0])
    assert np.abs(curl - field).max() < 1e-6 * np.abs(field).max()
    on_axis = vector_potential(coil(circle()), np.array([[0, 0, 0.01], [1e-9, 0, 0.01], [0, 1e-5, 0.01]]))
    assert np.abs(on_axis[0]).max() == 0
    bz = mu_0 * RADIUS**2 / 2 / (RADIUS**2 + 0.01**2) ** 1.5
    assert [on_axis[1, 1] / 1e-9, -on_axis[2, 0] / 1e-5] == pytest.approx([bz / 2, bz / 2], rel=1e-5)


def test_flux_of_a_background():
    """Area times the normal component of a uniform field, for a turned loop and an L of wire."""
    field = fm.Background([0.1, 0.2, 0.3])
    corners = [
        [0, 0, 0],
        [0.06, 0, 0],
        [0.06, 0.03, 0],
        [0.03, 0.03, 0],
        [0.03, 0.06, 0],
        [0, 0.06, 0],
        [0, 0, 0],
    ]
    coils = [coil(circle(), turns=5.0).turned("x", 90.0), coil(polyline(corners))]
    assert background_linkage(coils, field) == pytest.approx([-5 * np.pi * RADIUS**2 * 0.2, 0.0027 * 0.3])


def test_in_a_device_with_iron_and_in_a_file():
    """From the energy, L = 2 W / I^2, for a loop around a ball."""
    ball = fm.Body("ball", "iron", fm.Sphere(0.008), 0.004)
    device = fm.Device("d", "", (coil(circle()),), (ball,), {"iron": fm.LinearMaterial("iron", 1000.0)})
    unit = fm.solve_linear(fm.read_device(device.to_toml()))
    bare = bare_inductance(device.coils)[0, 0]
    # The ball's dipole adds m . B / I^2 with m = 4 pi R^3 (mu_r - 1) / (mu_r + 2) B / mu0; higher moments add little.
    b = mu_0 / (2 * RADIUS)
    added = 4 * np.pi * 0.008**3 * 999 / 1002 * b**2 / mu_0
    assert unit.inductance()[0, 0] - bare == pytest.approx(added, rel=0.1)
    assert unit.at([2.0]).flux_linkage()[0] == pytest.approx(2 * unit.inductance()[0, 0])


def test_what_has_no_inductance_is_told():
    strip = AirSource(
        "TriangleStrip",
        current=1.0,
        vertices=np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.01, 0.01, 0.0]]),
    )
    for one in (coil(circle(), wire=None), coil(strip)):
        with pytest.raises(InputError) as caught:
            bare_inductance([one])
        assert caught.value.problems[0].where == "coil 'coil'"
    with pytest.raises(InputError):
        background_linkage(
            [coil(polyline([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]))], fm.Background([0, 0, 1.0])
        )
