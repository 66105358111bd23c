"""Former names of packages, attributes and defaults of the dynamics work and warn."""

from importlib import import_module

import numpy as np
import pytest

from fieldmap import dynamics
from fieldmap.device import symmetry
from fieldmap.dynamics import Sensors
from fieldmap.dynamics.linearisation import Mode
from fieldmap.instruments import Amplifier, Converter, Micrometer, Rig
from fieldmap.iron.symmetry import find_symmetry


def test_former_names_are_the_new_objects():
    for old, new in (
        ("Trim", "OperatingPoint"),
        ("Mixing", "MatrixAllocation"),
        ("reach", "controllability"),
    ):
        with pytest.warns(DeprecationWarning, match=new):
            assert getattr(dynamics, old) is getattr(dynamics, new)


def test_former_modules_are_imported_by_name():
    for module, old, new in (
        ("linked", "GaussianWeights", dynamics.coupled.LqgWeights),
        ("linear", "Reach", dynamics.linearisation.Controllability),
        ("linear", "modes", dynamics.linearisation.modes),
    ):
        with pytest.warns(DeprecationWarning, match=new.__name__):
            assert getattr(import_module(f"fieldmap.dynamics.{module}"), old) is new
    with pytest.warns(DeprecationWarning, match="find_symmetry"):
        assert symmetry.find_symmetry is find_symmetry


def test_former_names_of_a_mode():
    mode = Mode(-1.0 + 0.0j, np.ones(1), np.array([2.0]), np.array([3.0]))
    with pytest.warns(DeprecationWarning, match="input_gains"):
        assert mode.reached is mode.input_gains
    with pytest.warns(DeprecationWarning, match="output_gains"):
        assert mode.seen is mode.output_gains


def test_the_zero_of_rigs_is_to_be_given():
    converter = Converter(10.0, 16)
    rig = Rig(Micrometer(0.0, 2e-3), converter, converter, Amplifier(1.0))
    with pytest.warns(FutureWarning, match="zero_depth"):
        assert Sensors(rigs=(rig, rig, rig)).zero_depth == 0.077
    assert Sensors(zero_depth=0.0, rigs=(rig, rig, rig)).zero_depth == 0.0
    assert Sensors().zero_depth == 0.077
