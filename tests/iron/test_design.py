"""Design figures of a machine: windings against hand calculation, inductances and forces against the solver."""

import json

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron.summary import copper_resistance, design_figures, winding_length

TURNS, CURRENT = 500.0, 2.0
ROUND = fm.CircularCoil("round", 0.02, 0.03, 0.04, TURNS, resistance=8.0)
SQUARE = fm.RoundedRectangleCoil("square", 0.02, 0.02, 0.01, 0.01, 0.04, TURNS).moved([0.2, 0, 0])
AIR = fm.Device("air", "", [ROUND, SQUARE])


def test_windings_against_hand_calculation():
    figures = design_figures(AIR, CURRENT, thermal_resistance=3.0)
    first, second = figures.windings
    assert (first.resistance, first.resistance_is_stated) == (8.0, True)
    assert (first.voltage, first.power) == (16.0, 32.0)
    assert first.temperature_rise == 96.0
    assert first.current_density == pytest.approx(1000.0 / (0.01 * 0.04))
    # Sides of 40 mm with corners of 10 mm: four straight pieces of 20 mm and a circle of 10 mm.
    length = 4 * 0.02 + 2 * np.pi * 0.01
    assert winding_length(SQUARE.winding()) == pytest.approx(length, rel=1e-12)
    expected = 1.724e-8 * TURNS * length / (0.6 * 0.01 * 0.04 / TURNS)
    assert second.resistance == pytest.approx(expected)
    assert not second.resistance_is_stated
    assert copper_resistance(SQUARE, fill=0.3) == pytest.approx(2 * expected)
    assert second.time_constant == pytest.approx(figures.inductance[1, 1] / expected)
    assert figures.power == pytest.approx(32.0 + 4.0 * expected)
    assert f"resistance of {SQUARE.name}: copper in 60 % of the section" in figures.assumptions
    # Two coils alone: equal and opposite forces, no iron.
    assert figures.coil_forces[0].force == pytest.approx(-figures.coil_forces[1].force, rel=1e-3, abs=1e-9)
    assert not figures.bodies
    assert not figures.iron_forces
    assert json.loads(json.dumps(figures.to_dict()))["windings"][0]["power"] == 32.0
    assert len(repr(figures)) <= 400


def test_saturating_iron_has_the_inductance_of_its_state():
    coil = fm.CircularCoil("coil", 0.011, 0.021, 0.04, 800.0, placement=fm.placed([0, 0, 0.02]))
    core = fm.Body("core", "steel", fm.Cylinder(0.01, 0.04), mesh_size=0.01)
    cap = fm.Body("cap", "steel", fm.Cylinder(0.01, 0.005), mesh_size=0.01).moved([0, 0, 0.04])
    far = fm.Body("far", "steel", fm.Cylinder(0.01, 0.005), mesh_size=0.01).moved([0, 0, 0.07])
    device = fm.Device("core", "", [coil], [core, cap, far], {"steel": fm.material("steel_a3")})
    solver = fm.iron.NonlinearSolver(device)
    low, high = (design_figures(device, current, solver) for current in (0.5, 20.0))
    assert high.inductance[0, 0] < 0.8 * low.inductance[0, 0]
    step = 1e-3
    linkages = [solver.solve([20.0 + sign * step], 1e-6).flux_linkage()[0] for sign in (1, -1)]
    assert high.inductance[0, 0] == pytest.approx((linkages[0] - linkages[1]) / (2 * step), rel=2e-3)
    assert [group.names for group in high.iron_forces] == [("core", "cap"), ("far",)]
    total = high.coil_forces[0].force + sum(group.force for group in high.iron_forces)
    assert total == pytest.approx(0.0, abs=2e-2 * np.abs(high.iron_forces[1].force).max())
    assert {body.body for body in high.bodies} == {"core", "cap", "far"}
    assert high.bodies[0].largest_magnitude > 1.5


def test_what_is_no_figure():
    for given in ({"thermal_resistance": -1.0}, {"fill": 0.0}):
        with pytest.raises(InputError):
            design_figures(AIR, 1.0, **given)
    with pytest.raises(InputError):
        design_figures(AIR, [1.0, 2.0, 3.0])
