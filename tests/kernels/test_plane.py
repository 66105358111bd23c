import numpy as np
import pytest

from fieldmap.kernels.iron.plane import mutual_segments, polygon_derivatives, segment_derivatives

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
SEGMENTS = {
    "apart": (0.1 + 0.2j, 0.3 - 0.1j, 0.7 + 0.4j, 0.5 + 0.1j),
    "corner": (0.0 + 0.0j, 0.3 + 0.0j, 0.3 + 0.0j, 0.3 + 0.2j),
    "sharp corner": (0.0 + 0.0j, 0.3 + 0.0j, 0.3 + 0.0j, 0.05 + 0.02j),
    "in line": (0.0 + 0.0j, 0.2 + 0.1j, 0.2 + 0.1j, 0.6 + 0.3j),
    "small beside large": (0.0 + 0.0j, 1e-4 + 0.0j, 1e-4 + 0.0j, 0.1 + 0.1j),
    "far": (0.0 + 0.0j, 0.01 + 0.0j, 0.3 + 0.2j, 0.31 + 0.19j),
}


def arrays(*points):
    return [np.array([point]) for point in points]


def places_on(z, q1, q2):
    """Gauss points on a segment and weights, as shares of its length, concentrated at the foot of z."""
    share = (z - q1) / (q2 - q1)
    foot, height = share.real, max(abs(share.imag), 1e-16)
    low, high = np.arcsinh(-foot / height), np.arcsinh((1 - foot) / height)
    u = 0.5 * (low + high) + 0.5 * (high - low) * NODES
    return foot + height * np.sinh(u), 0.5 * (high - low) * WEIGHTS * height * np.cosh(u)


def inner_log(z, q1, q2):
    """Integral of log|z - w| over a segment."""
    t, w = places_on(z, q1, q2)
    return abs(q2 - q1) * float(np.sum(w * np.log(np.abs(q1 + t * (q2 - q1) - z))))


def inner_double(z, q1, q2, hat):
    """Integral of a hat function times d(log r)/dn over a segment, with n to its right."""
    t, w = places_on(z, q1, q2)
    normal = -1j * (q2 - q1)
    return float(np.sum(w * hat(t) * (normal / (q1 + t * (q2 - q1) - z)).real))


@pytest.mark.parametrize("name", SEGMENTS)
def test_potentials_are_those_of_quadrature(name):
    p1, p2, q1, q2 = SEGMENTS[name]
    single, first, last = (m[0, 0] for m in mutual_segments(*arrays(p1, p2, q1, q2)))
    # Gauss points concentrated at both ends of p, where p may touch q.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    t = 0.5 + 0.5 * np.sin(0.5 * np.pi * nodes)
    w = 0.25 * np.pi * np.cos(0.5 * np.pi * nodes) * weights * abs(p2 - p1)
    z = p1 + t * (p2 - p1)
    expected = sum(a * inner_log(x, q1, q2) for a, x in zip(w, z, strict=True))
    assert single == pytest.approx(-expected / (2 * np.pi), rel=2e-6)
    for value, hat in ((first, lambda t: 1 - t), (last, lambda t: t)):
        expected = sum(a * inner_double(x, q1, q2, hat) for a, x in zip(w, z, strict=True))
        assert value == pytest.approx(-expected / (2 * np.pi), rel=1e-6, abs=1e-10)


def test_a_segment_on_itself():
    p1, p2 = 0.1 + 0.7j, 0.4 + 0.3j
    single, first, last = (m[0, 0] for m in mutual_segments(*arrays(p1, p2, p1, p2)))
    length = abs(p2 - p1)
    assert single == pytest.approx(-(length**2) * (np.log(length) - 1.5) / (2 * np.pi), rel=1e-14)
    assert first == last == 0


def test_near_and_far_rules_agree():
    p1, p2 = 0.0j, 0.01 + 0.0j
    offsets = 0.04 + np.array([-1e-9, 1e-9])
    values = [mutual_segments(*arrays(p1, p2, p1 + 1j * d, p2 + 1j * d)) for d in offsets]
    for near, far in zip(*values, strict=True):
        assert far[0, 0] == pytest.approx(near[0, 0], rel=1e-6)


def test_closed_ring_sees_itself_at_half_a_turn():
    """Gauss: a double layer of constant strength gives -1/2 on the ring itself."""
    corners = np.array([0, 1, 1 + 1j, 0.5 + 0.2j, 0.3 + 1j, 1j])
    ends = np.roll(corners, -1)
    _, first, last = mutual_segments(corners, ends, corners, ends)
    np.testing.assert_allclose((first + last).sum(axis=1) / abs(ends - corners), -0.5, rtol=1e-12)


def test_field_of_a_segment_is_that_of_quadrature_and_derivatives_follow():
    start, end, density = 0.1 + 0.1j, 0.4 - 0.2j, 0.7 - 0.3j
    z = np.array([0.3 + 0.2j, -0.5j, 0.26 + 0.0j])

    def at(points):
        return segment_derivatives(points, *arrays(start, end), np.array([density]))

    nodes, weights = np.polynomial.legendre.leggauss(60)
    w = start + 0.5 * (1 + nodes) * (end - start)
    expected = density * abs(end - start) / (4 * np.pi) * (weights / (z[:, None] - w)).sum(axis=1)
    np.testing.assert_allclose(at(z)[0], expected, rtol=1e-10)
    for order in (0, 1):
        for direction in (1, 1j):
            slopes = []
            for h in (1e-3, 5e-4):
                difference = at(z + h * direction)[order] - at(z)[order] - h * direction * at(z)[order + 1]
                slopes.append(np.abs(difference))
            np.testing.assert_allclose(np.log2(slopes[0] / slopes[1]), 2.0, atol=0.05)


def test_field_of_a_polygon_is_that_of_quadrature_and_derivatives_follow():
    corners = np.array([0.1, 0.4 + 0.1j, 0.4 + 0.3j, 0.1 + 0.2j])
    z = np.array([0.6 + 0.1j, -0.1 - 0.2j, 0.2 + 0.5j])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x = 0.25 + 0.15 * nodes
    expected = np.zeros(3, dtype=complex)
    for a, weight in zip(x, weights, strict=True):
        low = 0.1 * (a - 0.1) / 0.3
        high = 0.2 + 0.1 * (a - 0.1) / 0.3
        y = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        w = 0.15 * weight * 0.5 * (high - low) * weights
        expected += (w / (z[:, None] - a - 1j * y)).sum(axis=1)
    np.testing.assert_allclose(polygon_derivatives(z, corners)[0], expected, rtol=1e-9)
    for order in (0, 1):
        h = 1e-5
        difference = polygon_derivatives(z + h, corners)[order] - polygon_derivatives(z - h, corners)[order]
        np.testing.assert_allclose(
            polygon_derivatives(z, corners)[order + 1], difference / (2 * h), rtol=1e-6
        )
