"""The contents of a device that `fieldmap check` lists: volumes, sizes and axes, against values by hand."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Body, Box, Cylinder, Device, Part, placed
from fieldmap.iron.notes import device_contents

TILT = np.radians(30.0)


def test_axes_sizes_and_volumes():
    lean = placed((0.1, 0, 0), (30.0, 0, 0))
    coil = fm.CircularCoil("coil", 0.01, 0.012, 0.015, 100, placement=placed((0, 0, 0.2), (30.0, 0, 0)))
    rod = Body("rod", "iron", (Part(Cylinder(0.01, 0.03), lean),), 0.004)
    bar = Part(Cylinder(0.005, 0.03), placed((0, 0, 0.01), (0, 90.0, 0)))
    cross = Body("cross", "steel", (Part(Box((0.02, 0.02, 0.02))), bar), 0.005)
    laws = {"iron": fm.LinearMaterial("iron", 1000.0), "steel": fm.Froehlich("steel", 500.0, 2.1)}
    contents = device_contents(Device("some", "", [coil], [rod, cross], laws))
    (one,) = contents.coils
    assert one.axis == pytest.approx([0.0, -np.sin(TILT), np.cos(TILT)], abs=1e-12)
    assert one.centre.tolist() == [0.0, 0.0, 0.2]
    assert (one.height, one.turns) == (0.015, 100)
    first, second = contents.bodies
    assert first.axis == pytest.approx([0.0, -np.sin(TILT), np.cos(TILT)], abs=1e-12)
    assert first.volume == pytest.approx(np.pi * 0.01**2 * 0.03, rel=1e-9)
    # The round bar sticks out of the cube by 20 mm; the parts have no common axis.
    assert second.axis is None
    assert second.volume == pytest.approx(0.02**3 + np.pi * 0.005**2 * 0.02, rel=1e-9)
    assert [body.mesh_size for body in contents.bodies] == [0.004, 0.005]
    (law,) = (words for words in contents.assumptions if "steel" in words)
    assert "500" in law
    assert not any("'iron'" in words for words in contents.assumptions)
