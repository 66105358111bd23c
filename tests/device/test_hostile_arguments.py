"""Arguments in Python of types that nobody expects: told at their place, never by an error of numpy or Python."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError

COIL = fm.CircularCoil("c", 0.02, 0.03, 0.01, 100)
BODY = fm.Body("b", "steel", fm.Cylinder(0.01, 0.02), mesh_size=0.005)


@pytest.mark.parametrize("axis", [np.zeros(3), np.zeros(0), "xy", "", None, 1])
def test_an_axis(axis):
    for call in (lambda: COIL.turned(axis, 30.0), lambda: COIL.mirrored(axis), lambda: COIL.around(axis, 3)):
        with pytest.raises(InputError):
            call()


@pytest.mark.parametrize("path", [3, 1.5, [], object, b"steel_a3"])
def test_a_file(path):
    with pytest.raises(InputError):
        fm.material(path)


def test_names_of_materials():
    with pytest.raises(InputError):
        fm.material("steel_a3", name=np.ones((3, 3)))
    odd = fm.LinearMaterial(np.ones((3, 3)), 100.0)
    device = fm.Device("d", "a", [COIL], [BODY], materials={"steel": odd})
    assert device.materials["steel"].name == "steel"
