"""Drawn payloads of pieces: each piece where it stands, as large as it is."""

import numpy as np
import pyvista as pv

import fieldmap as fm
from fieldmap.field import Field
from fieldmap.plot.device_drawing import add_payload
from fieldmap.plot.forces import magnetic_force
from fieldmap.plot.solids import payload_surface

PAYLOAD = fm.Payload(
    1e-3,
    pieces=[
        fm.PayloadPiece(
            fm.SoftEllipsoid((2e-3, 2e-3, 6e-3), mu_r=100.0), fm.placed([0, 0, 4e-3], [90.0, 0, 0])
        ),
        fm.PayloadPiece(fm.MagnetCylinder(2e-3, 4e-3, 1.2), fm.placed([0.0, 0.0, -2e-3])),
    ],
)


def test_surfaces_of_pieces():
    surface = payload_surface(PAYLOAD)
    # The ellipsoid lies along y, 3 to 5 mm above the centre; the cylinder stands below it.
    np.testing.assert_allclose(surface.bounds, [-1, 1, -3, 3, -4, 5], atol=0.03)
    assert payload_surface(fm.Payload(1e-3, moment=0.1)) is None
    scene = pv.Plotter(off_screen=True)
    add_payload(scene, PAYLOAD, np.array([0.0, 0.0, -20.0]))
    np.testing.assert_allclose(scene.bounds, [-1, 1, -3, 3, -24, -15], atol=0.03)


class Uniform(Field):
    """B = B0 + G x."""

    coil_names = ()

    def field(self, points, currents):
        return np.array([0.0, 0.0, 0.1]) + np.atleast_2d(points) * [-0.5, -0.5, 1.0]

    def gradient(self, points, currents):
        return np.broadcast_to(np.diag([-0.5, -0.5, 1.0]), (len(np.atleast_2d(points)), 3, 3))


def test_arrows_are_the_force_on_the_pieces():
    sphere = fm.Payload(1e-3, pieces=[fm.SoftSphere(4e-3, mu_r=1e8)])
    force = magnetic_force(Uniform(), np.zeros(0), sphere, np.zeros((1, 3)))
    exact = np.pi * 4e-3**3 / 2 / (4e-7 * np.pi) * 0.1
    np.testing.assert_allclose(force, [[0.0, 0.0, exact]], rtol=1e-6, atol=1e-15)
    assert magnetic_force(Uniform(), np.zeros(0), sphere, np.zeros((2, 3))).shape == (2, 3)
