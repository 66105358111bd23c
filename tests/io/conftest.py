"""A closed-form field with a name: an axisymmetric harmonic polynomial of two coils."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device.model import Driver, Payload
from fieldmap.field import Field, coil_currents
from fieldmap.io import FieldSource

# On the axis Bz = s (B0 + B1 z + B2 z^2 / 2), where s is the sum of the currents with these shares.
B0, B1, B2, SHARES = 0.01, 0.5, 2.0, np.array([1.0, 0.5])
LOWER, UPPER = np.array([-0.01, -0.01, -0.1]), np.array([0.01, 0.01, -0.02])
PAYLOAD = Payload(0.010, 0.8, magnet_offset=0.015)


class Polynomial(Field):
    """The gradient of solid harmonics of degree 1 to 3."""

    coil_names, proportional, assumptions = ("left", "right"), True, ("a polynomial",)
    bounds = (LOWER, UPPER)

    def strength(self, currents):
        return float(coil_currents(currents, self.coil_names) @ SHARES)

    def field(self, points, currents):
        x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
        radial = -0.5 * (B1 + B2 * z)
        along = B0 + B1 * z + 0.5 * B2 * (z**2 - 0.5 * (x**2 + y**2))
        return self.strength(currents) * np.stack([radial * x, radial * y, along], axis=-1)

    def gradient(self, points, currents):
        x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
        slope = np.zeros((*np.shape(x), 3, 3))
        slope[..., 0, 0] = slope[..., 1, 1] = -0.5 * (B1 + B2 * z)
        slope[..., 2, 2] = B1 + B2 * z
        slope[..., 0, 2] = slope[..., 2, 0] = -0.5 * B2 * x
        slope[..., 1, 2] = slope[..., 2, 1] = -0.5 * B2 * y
        return self.strength(currents) * slope

    def second_gradient(self, points, currents):
        bend = np.zeros((*np.shape(points)[:-1], 3, 3, 3))
        bend[..., 2, 2, 2] = B2
        for i in (0, 1):
            bend[..., i, i, 2] = bend[..., i, 2, i] = bend[..., 2, i, i] = -0.5 * B2
        return self.strength(currents) * bend


@pytest.fixture
def polynomial():
    """field, payload, the constants, and source(**changes): the field as a named source."""

    def source(**changes):
        field = changes.pop("field", Polynomial())
        about = {
            "name": "poly.h5",
            "device_name": "rig",
            "kind": "map",
            "coil_names": field.coil_names,
            "bounds": (LOWER, UPPER),
            "payload": PAYLOAD,
            "driver": Driver(0.355, 3.5),
            "device": None,
            "make": lambda: field,
        }
        return FieldSource(**(about | changes))

    return SimpleNamespace(
        field=Polynomial(), source=source, payload=PAYLOAD, b0=B0, b1=B1, b2=B2, shares=SHARES
    )
