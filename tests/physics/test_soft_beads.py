"""A bead of soft iron as a payload against the same bead meshed as a body of the device, iron saturating."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.field import Field
from fieldmap.lookup import magnetic_body

STEEL = fm.material("steel_a3")


def meshed(diameter, at):
    return fm.Body("bead", "steel", fm.Sphere(diameter / 2), mesh_size=diameter / 8).moved(at)


def test_a_bead_below_a_core():
    """The response to the gradient and the image in the core are left out: of the order (radius / distance)^2."""
    coil = fm.CircularCoil("coil", 0.012, 0.02, 0.03, turns=800, placement=fm.placed([0.0, 0.0, 0.025]))
    core = fm.Body("core", "steel", fm.Cylinder(0.01, 0.04), mesh_size=5e-3, edge_size=2e-3)
    core, at = core.moved([0.0, 0.0, 0.005]), np.array([0.004, 0.0, -0.012])
    alone = fm.solve(fm.Device("alone", "", (coil,), (core,), {"steel": STEEL}), [4.0])
    sizes, off, finer = np.array([3e-3, 6e-3]), [], []
    for diameter in sizes:
        device = fm.Device("bead", "", (coil,), (core, meshed(diameter, at)), {"steel": STEEL})
        exact = fm.solve(device, [4.0]).force_on("bead")
        for level, errors in ((1, off), (2, finer)):
            bead = fm.Payload(1e-3, pieces=[fm.SoftSphere(diameter, STEEL)], soft_level=level)
            found = alone.wrench(at, magnetic_body(bead))
            errors.append(np.linalg.norm(found[:3] - exact) / np.linalg.norm(exact))
    assert (np.array(off) < (sizes / 2 / 0.017) ** 2).all()
    assert np.polyfit(np.log(sizes), np.log(off), 1)[0] == pytest.approx(2.0, abs=0.3)
    assert finer[1] < 0.1 * off[1]


SLOPE = np.array([[-2.0, 0.5, 0.3], [0.5, -2.5, 0.2], [0.3, 0.2, 4.5]])


class Background(Field):
    """A field of uniform gradient."""

    coil_names = ()

    def __init__(self, flux):
        self.flux = np.array(flux)

    def field(self, points, currents):
        return self.flux + np.atleast_2d(points) @ SLOPE.T

    def gradient(self, points, currents):
        return np.broadcast_to(SLOPE, (len(np.atleast_2d(points)), 3, 3))


@pytest.mark.parametrize("size", [0.3, 0.75, 1.5])
def test_a_bead_from_linear_to_saturated(size):
    """Over the radius the field changes by 3, 1 and 0.6 %."""
    flux = size * np.array([0.2, 0.0, 1.0])
    background = fm.Background(flux_density=flux, gradient=[-2.0, 0.5, 0.3, -2.5, 0.2])
    bodies = (meshed(4e-3, [0.0, 0.0, 0.0]),)
    device = fm.Device("bead", "", (), bodies, {"steel": STEEL}, background=background)
    exact = fm.solve(device, []).force_on("bead")
    body = magnetic_body(fm.SoftSphere(4e-3, STEEL))
    found = body.wrench(Background(flux), np.zeros(3), np.zeros(0))[:3]
    np.testing.assert_allclose(found, exact, atol=2e-3 * np.linalg.norm(exact))
    saturation = STEEL.largest_polarisation
    share = np.linalg.norm(body.induced_moment(Background(flux), np.zeros(3), np.zeros(0)))
    share *= 4e-7 * np.pi / (fm.SoftSphere(4e-3).volume * saturation)
    # From 3 b0 of the demagnetising factor up to full saturation.
    assert share == pytest.approx(min(1.0, 3 * np.linalg.norm(flux) / saturation), rel=0.08)


def test_the_torque_of_a_meshed_ellipsoid():
    """A revolved half ellipse of 2 to 1, at 40 degrees in a uniform field."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 25)
    outline = np.column_stack([2e-3 * np.cos(angle), 4e-3 * np.sin(angle)])
    outline[[0, -1], 0] = 0.0
    turn = fm.placed([0.0, 0.0, 0.0], [0.0, 40.0, 0.0])
    body = fm.Body("needle", "steel", [fm.Part(fm.RevolvedProfile(outline), turn)], mesh_size=0.8e-3)
    flux = np.array([0.0, 0.0, 0.2])
    device = fm.Device("needle", "", (), (body,), {"steel": STEEL}, background=fm.Background(flux))
    exact = fm.solve(device, []).torque_on("needle", about=[0.0, 0.0, 0.0])
    needle = magnetic_body(fm.SoftEllipsoid((4e-3, 4e-3, 8e-3), STEEL))
    uniform = Background(flux)
    found = needle.wrench(uniform, np.zeros(3), np.zeros(0), np.asarray(turn.rotation))[3:]
    # The polygon's volume is 0.6 % less.
    np.testing.assert_allclose(found, exact, atol=2e-2 * np.linalg.norm(exact))
