"""Finite magnets and soft spheres against fine sums over closed forms, magpylib, energies and series."""

import magpylib
import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

from fieldmap.device.model import MagnetBlock, MagnetCylinder, MagnetSphere, Payload
from fieldmap.errors import InputError, NotConverged, OutsideMapError
from fieldmap.field import Field
from fieldmap.lookup import (
    MagneticBody,
    finite_magnet,
    interpolate,
    magnetic_body,
    soft_sphere_force,
    volume_rule,
)
from fieldmap.store import Grid, MapData
from tests.lookup.conftest import Loops

MU0 = 4e-7 * np.pi
CYLINDER = MagnetCylinder(diameter=0.010, height=0.008, remanence=1.3)
BLOCK = MagnetBlock(size=(0.008, 0.006, 0.010), remanence=1.2)
SPHERE = MagnetSphere(diameter=0.012, remanence=1.3)
LOOPS = [(0.016, [0.02, 0.0, 0.03]), (0.025, [-0.02, 0.01, 0.035])]
EXACT = Loops(LOOPS, 1e3)
GRID = Grid([-0.015, -0.015, -0.02], [0.00125, 0.00125, 0.00125], (25, 25, 25))


@pytest.fixture(scope="module")
def field():
    points, shape = GRID.points(), (2, *GRID.shape, 3)
    flux, slope = EXACT.unit_field(points).swapaxes(0, 1), EXACT.unit_gradient(points).swapaxes(0, 1)
    about = {"flux_density": flux.reshape(shape), "gradient": slope.reshape(*shape, 3)}
    return interpolate(MapData(GRID, ("a", "b"), [1.0, 1.0], **about))


TURN = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()


def fine_sum(shape, position, turn, currents):
    """Midpoint sum over 40 x 40 x 40 cells of the magnet's own bounding box (cylinder: rings)."""
    if isinstance(shape, MagnetBlock):
        axes = [(np.arange(40) + 0.5) / 40 * side - side / 2 for side in shape.size]
        local = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        share = np.full(len(local), 1 / len(local))
        volume = np.prod(shape.size)
    else:
        edges = np.linspace(0, shape.diameter / 2, 41)
        r = np.sqrt((edges[1:] ** 2 + edges[:-1] ** 2) / 2)
        z = (np.arange(40) + 0.5) / 40 * shape.height - shape.height / 2
        angle = 2 * np.pi * np.arange(40) / 40
        r, ring, z = (part.ravel() for part in np.meshgrid(r, angle, z, indexing="ij"))
        weight = np.repeat(edges[1:] ** 2 - edges[:-1] ** 2, 1600)
        local, share = np.stack([r * np.cos(ring), r * np.sin(ring), z], axis=1), weight / weight.sum()
        volume = np.pi / 4 * shape.diameter**2 * shape.height
    dipole = shape.remanence / MU0 * volume * turn[:, 2]
    arms = local @ turn.T
    flux, slope = EXACT.field_and_gradient(position + arms, currents)
    force = np.einsum("nij,i,n->nj", slope, dipole, share)
    torque = np.cross(dipole, flux) * share[:, None] + np.cross(arms, force)
    return force.sum(axis=0), torque.sum(axis=0)


@pytest.mark.parametrize("shape", [CYLINDER, BLOCK])
def test_chosen_rule_agrees_with_a_fine_sum_over_the_closed_form(field, shape):
    magnet = finite_magnet(shape, field, 1e-5)
    assert magnet.error < 1e-5
    point = volume_rule(shape, 1)
    for position in np.array([[0.002, -0.003, 0.001], [0.004, 0.0, -0.008]]):
        currents = np.array([2.0, -1.0])
        force, torque = fine_sum(shape, position, TURN, currents)
        wrench = magnet.wrench(field, position, currents, TURN)
        # The sum's own error is (1/40)^2 of the second-order part, which a point dipole leaves out.
        missed = point.wrench(field, position, currents, TURN) - np.concatenate([force, torque])
        for part, exact in ((slice(0, 3), force), (slice(3, 6), torque)):
            size = np.linalg.norm(exact)
            assert 1e-3 * size < np.linalg.norm(missed[part])
            assert np.linalg.norm(wrench[part] - exact) < 5e-5 * size


def test_magpylib_finds_the_same_force_and_torque(field):
    position, currents = np.array([0.003, 0.002, -0.004]), np.array([1.0, 1.5])
    sources = [
        magpylib.current.Circle(current=1e3 * i, diameter=2 * r, position=c)
        for i, (r, c) in zip(currents, LOOPS, strict=True)
    ]
    target = magpylib.magnet.Cylinder(
        polarization=(0, 0, CYLINDER.remanence),
        dimension=(CYLINDER.diameter, CYLINDER.height),
        position=position,
    )
    force, torque = np.sum(magpylib.getFT(sources, target, pivot=position, meshing=4000), axis=1)
    wrench = finite_magnet(CYLINDER, field).wrench(field, position, currents)
    np.testing.assert_allclose(wrench[:3], force, rtol=0, atol=1e-3 * np.linalg.norm(force))
    np.testing.assert_allclose(wrench[3:], torque, rtol=0, atol=1e-3 * np.linalg.norm(torque))


def test_a_sphere_is_a_point_dipole(field):
    # Against another rule: Gauss in the radius and in cos(theta), even angles; exact to degree 11.
    nodes, weights = np.polynomial.legendre.leggauss(6)
    r, of_r = (nodes + 1) / 2, weights / 2 * 3 * ((nodes + 1) / 2) ** 2
    angle = 2 * np.pi * np.arange(12) / 12
    r, cosine, ring = (part.ravel() for part in np.meshgrid(r, nodes, angle, indexing="ij"))
    share = np.einsum("i,j,k->ijk", of_r, weights / 2, np.full(12, 1 / 12)).ravel()
    sine = np.sqrt(1 - cosine**2)
    local = SPHERE.diameter / 2 * (r * np.stack([sine * np.cos(ring), sine * np.sin(ring), cosine])).T
    moment = SPHERE.remanence / MU0 * np.pi / 6 * SPHERE.diameter**3
    position, currents = np.array([0.004, -0.002, 0.003]), np.array([1.0, -2.0])
    flux, slope = EXACT.field_and_gradient(position + local, currents)
    force = moment * np.einsum("nj,n->nj", slope[:, 2], share)
    torque = np.cross([0, 0, moment], flux) * share[:, None] + np.cross(local, force)
    magnet = finite_magnet(SPHERE, field)
    assert (len(magnet.points), magnet.error) == (1, 0.0)
    wrench = magnet.wrench(EXACT, position[None], currents)[0]
    np.testing.assert_allclose(wrench[:3], force.sum(axis=0), rtol=0, atol=1e-6 * np.linalg.norm(wrench[:3]))
    np.testing.assert_allclose(wrench[3:], torque.sum(axis=0), rtol=0, atol=1e-6 * np.linalg.norm(wrench[3:]))


def test_a_batch_is_its_rows(field):
    rng, magnet = np.random.default_rng(3), volume_rule(BLOCK, 2)
    positions, currents = rng.uniform(-0.004, 0.004, (5, 3)), rng.normal(size=(5, 2))
    turns = Rotation.from_rotvec(rng.normal(size=(5, 3))).as_matrix()
    together = magnet.wrench(field, positions, currents, turns)
    apart = [magnet.wrench(field, p, i, t) for p, i, t in zip(positions, currents, turns, strict=True)]
    np.testing.assert_allclose(together, apart, rtol=1e-10, atol=1e-14)
    assert magnet.moment == pytest.approx(1.2 / MU0 * 480e-9)


def test_rules_are_exact_to_their_degree():
    # Mean of x^a y^b z^c over the body: closed forms for block and cylinder.
    for level in (1, 2, 3, 4):
        for shape in (BLOCK, CYLINDER):
            rule = volume_rule(shape, level)
            share = rule.moments[:, 2] / rule.moments[:, 2].sum()
            for a, b, c in [(2, 0, 0), (0, 0, 2), (2, 0, 2), (4, 0, 0), (2, 2, 2), (0, 0, 6)]:
                mean = share @ (rule.points ** [a, b, c]).prod(axis=1)
                exact = mean_power(shape, a, b, c)
                if a + b + c <= 2 * level - 1:
                    assert mean == pytest.approx(exact, rel=1e-12)
                elif level == 1:
                    assert mean == 0.0


def mean_power(shape, a, b, c):
    if isinstance(shape, MagnetBlock):
        return np.prod([(side / 2) ** n / (n + 1) for side, n in zip(shape.size, (a, b, c), strict=True)])
    angles = {(0, 0): 1.0, (2, 0): 1 / 2, (4, 0): 3 / 8, (2, 2): 1 / 8}
    radial = (shape.diameter / 2) ** (a + b) * 2 / (a + b + 2)
    return angles[a, b] * radial * (shape.height / 2) ** c / (c + 1)


def test_refusals(field):
    with pytest.raises(InputError) as caught:
        finite_magnet(MagnetBlock((0.02, 0.02, 0.02), 1.0), field)
    assert caught.value.problems[0].where == "finite_magnet, shape"
    assert f"{10 * np.sqrt(3):.6g} mm" in caught.value.problems[0].received
    assert "box, 30, 30, 30 mm" in caught.value.problems[0].must_hold
    with pytest.raises(NotConverged, match="1e-15"):
        finite_magnet(CYLINDER, field, 1e-15)
    with pytest.raises(OutsideMapError):
        volume_rule(CYLINDER, 2).wrench(field, GRID.lower, [1.0, 1.0])
    for wrong in (np.ones((3, 3)), np.eye(2), np.zeros((2, 3, 3))):
        with pytest.raises(InputError, match="orientations"):
            volume_rule(CYLINDER, 2).wrench(field, [0, 0, 0], [1.0, 1.0], wrong)
    for wrong in (
        {"diameter": -1.0},
        {"diameter": 0.0},
        {"diameter": np.inf},
        {"diameter": 0.01, "mu_r": 0.999},
    ):
        with pytest.raises(InputError, match="diameter > 0"):
            soft_sphere_force(field, [0, 0, 0], [1.0, 1.0], **wrong)


def test_a_sphere_without_iron_feels_no_force(field):
    assert not soft_sphere_force(field, [[0.001, 0.002, 0.003]], [1.0, 1.0], 0.01, 1.0).any()


def test_rules_are_tried_where_the_magnet_fits_in_either_coil_and_any_way_up(monkeypatch):
    """Forty places all over the box that the magnet fits in, in random directions; the error is the larger of force and
    torque, each relative to its own largest."""
    lower, upper, radius = np.array([-0.02, -0.01, 0.03]), np.array([0.04, 0.03, 0.06]), 0.5 * np.sqrt(77e-6)
    asked, box = [], MagnetBlock(size=(0.004, 0.005, 0.006), remanence=1.2)

    class Noting(Loops):
        bounds = lower, upper

    def wrench(self, source, places, currents, turns):
        asked.append((places, currents, turns))
        first, size = np.zeros((len(places), 6)), 1.0 + len(self.points) ** -1.0
        first[3, :3], first[7, 3:] = [3.0 * size, 0.0, 4.0], [0.0, 0.2, 0.0]
        first[5, 3:] = [0.0, 0.0, -0.1 * size]
        return first

    monkeypatch.setattr(MagneticBody, "wrench", wrench)
    found = finite_magnet(box, Noting(LOOPS, 1e3), 0.2)
    # From 8 points to 27 the force changes by 3 / 8 - 3 / 27 of about 5, the torque by a smaller share.
    assert (len(found.points), len(asked)) == (8, 3)
    force = 3.0 * (1.0 / 8.0 - 1.0 / 27.0)
    assert found.error == pytest.approx(force / np.hypot(3.0 * (1.0 + 1.0 / 27.0), 4.0))
    places, currents, turns = asked[0]
    assert len(places) == 80
    assert currents.tolist() == [[1.0, 0.0], [0.0, 1.0]] * 40
    np.testing.assert_array_equal(places[::2], places[1::2])
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (80, 1, 1)), atol=1e-12)
    assert np.ptp(turns, axis=0).min() > 0.9
    assert (places > lower + radius).all()
    assert (places < upper - radius).all()
    assert (np.ptp(places, axis=0) > 0.85 * (upper - lower - 2 * radius)).all()


class Pole(Field):
    """A magnetic charge of 1 A m at a distance along z, for which the response of a sphere is a known series."""

    coil_names = ()

    def __init__(self, distance):
        self.source = np.array([0.0, 0.0, distance])

    def field(self, point, _):
        r = np.asarray(point) - self.source
        return MU0 / (4 * np.pi) * r / np.linalg.norm(r) ** 3

    def gradient(self, point, _):
        r = np.asarray(point) - self.source
        d = np.linalg.norm(r)
        return MU0 / (4 * np.pi) * (np.eye(3) - 3 * np.outer(r, r) / d**2) / d**3

    def second_gradient(self, point, _):
        r = np.asarray(point) - self.source
        d, unit = np.linalg.norm(r), np.eye(3)
        mixed = sum(np.einsum(f"{ij},{k}->ijk", unit, r) for ij, k in (("ij", "k"), ("ik", "j"), ("jk", "i")))
        return MU0 / (4 * np.pi) * (15 * np.einsum("i,j,k->ijk", r, r, r) / d**7 - 3 * mixed / d**5)


@pytest.mark.parametrize("mu_r", [2.0, 1000.0, np.inf])
def test_soft_sphere_beside_a_pole(mu_r):
    # Charge and sphere of another permittivity: Stratton, Electromagnetic Theory (1941), section 3.23.
    distance, errors, sizes = 0.05, [], np.array([0.004, 0.008, 0.016])
    for diameter in sizes:
        a = diameter / 2
        answer = [l * (1 - 1 / mu_r) / (l + (l + 1) / mu_r) for l in range(1, 40)]
        series = sum((l + 1) * b * (a / distance) ** (2 * l + 1) for l, b in enumerate(answer, 1))
        exact = MU0 / (4 * np.pi * distance**2) * series
        force = soft_sphere_force(Pole(distance), np.zeros(3), None, diameter, mu_r)
        np.testing.assert_allclose(force[:2], 0, atol=1e-12 * exact)
        errors.append(abs(force[2] - exact) / exact)
    assert errors[-1] < 2e-3
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.1)


def test_soft_sphere_in_a_map(field):
    # For a small sphere: the slope of its energy in the field, (4 pi a^3 / 2 mu0) |B|^2.
    position, currents, step = np.array([0.0031, 0.0027, 0.0019]), np.array([1.0, 2.0]), 1e-5
    force = soft_sphere_force(field, position, currents, 1e-4)
    for j in range(3):
        ahead, behind = (field.field(position + s * step * np.eye(3)[j], currents) for s in (1, -1))
        slope = (ahead @ ahead - behind @ behind) / (2 * step)
        assert force[j] == pytest.approx(2 * np.pi * 0.5e-4**3 / MU0 * slope, rel=1e-4)
    assert soft_sphere_force(field, position[None], currents, 1e-4).shape == (1, 3)


def test_a_moment_that_was_measured_is_that_of_the_dipole():
    """With a shape too; the moment of its remanence counts only where no moment is given."""
    shape = MagnetCylinder(0.01, 0.012, 1.3)
    dipole = magnetic_body(Payload(mass=0.01, moment=0.9, magnet=shape), 1)
    assert dipole.points.tolist() == [[0.0, 0.0, 0.0]]
    assert dipole.moments.tolist() == [[0.0, 0.0, 0.9]]
    volume = np.pi / 4 * 0.01**2 * 0.012
    assert magnetic_body(Payload(mass=0.01, magnet=shape)).moment == pytest.approx(
        1.3 * volume / mu_0, rel=1e-8
    )
    # A moment that follows from the shape leaves the shape's numbers as they are.
    np.testing.assert_array_equal(
        magnetic_body(Payload(mass=0.01, magnet=shape), 2).moments, magnetic_body(shape, 2).moments
    )
    # A finite body has the same moment, spread as the shape is.
    for level in (2, 3):
        finite = magnetic_body(Payload(mass=0.01, moment=0.9, magnet=shape), level)
        assert len(finite.points) > 1
        np.testing.assert_allclose(finite.moments.sum(axis=0), [0.0, 0.0, 0.9], atol=1e-12)
        of_shape = magnetic_body(shape, level)
        np.testing.assert_array_equal(finite.points, of_shape.points)
