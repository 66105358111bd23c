"""Solves that share the parts of equal iron give the bits of solves that share nothing."""

import magpylib
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.iron.solvers import linear
from fieldmap.iron.solvers.linear import solve_linear_and_reaction
from fieldmap.iron.solvers.shared import SharedSolves

DEVICE = """
format = 1
name = "bar"
title = "A magnet and a bar of iron beside a coil, in a field, with a sensor"

[background]
flux_density_mT = [1.0, 2.0, 3.0]

[material.iron]
kind = "linear"
mu_r = 500.0

[material.magnet]
kind = "permanent_magnet"
remanence_T = [0.1, 0.2, 0.3]
mu_r = 1.05

[[body]]
name = "bar"
material = "iron"
shape = "box"
size_mm = [10.0, 14.0, 20.0]
mesh_size_mm = 8.0

[[body]]
name = "magnet"
material = "magnet"
shape = "box"
size_mm = [6.0, 6.0, 6.0]
position_mm = [20.0, 3.0, 10.0]
mesh_size_mm = 6.0

[[coil]]
name = "coil"
kind = "circular"
inner_radius_mm = 10.0
outer_radius_mm = 12.0
height_mm = 8.0
turns = 100
polarity = 1
position_mm = [1.0, 2.0, 32.0]

[workspace]
shape = "box"
lower_mm = [-4.0, -4.0, -24.0]
upper_mm = [4.0, 4.0, -16.0]

[[sensor]]
name = "hall"
position_mm = [3.0, 0.0, -14.0]
axis = [0.0, 0.0, 1.0]
"""
# Key: another value, and the steps that must run again: iron operators, solution, reaction, the sensors' answers.
CHANGES = {
    "body.bar.size_mm.1": (11.0, "assemble solved_in_form reaction_fields answers_to_sensors"),
    "body.magnet.position_mm.1": (21.0, "assemble solved_in_form reaction_fields answers_to_sensors"),
    "body.bar.mesh_size_mm": (6.0, "assemble solved_in_form reaction_fields answers_to_sensors"),
    "material.iron.mu_r": (300.0, "solved_in_form reaction_fields answers_to_sensors"),
    "material.magnet.remanence_T.2": (0.5, "solved_in_form reaction_fields answers_to_sensors"),
    "background.flux_density_mT.1": (4.0, "solved_in_form"),
    "coil.coil.inner_radius_mm": (9.0, "solved_in_form"),
    "coil.coil.height_mm": (7.0, "solved_in_form"),
    "coil.coil.turns": (200, "solved_in_form"),
    "coil.coil.polarity": (-1, "solved_in_form"),
    "coil.coil.position_mm.1": (2.0, "solved_in_form"),
    "workspace.lower_mm.3": (-23.0, "reaction_fields"),
    "sensor.hall.position_mm.1": (2.0, "answers_to_sensors"),
}
STEPS = ("assemble", "solved_in_form", "reaction_fields", "answers_to_sensors")


def arrays_of(solved):
    solution, reaction, answers = solved
    return (
        solution.state.faces.centres,
        solution.state.density,
        solution.iron_linkage,
        *(part for one in (reaction, answers) for part in (one.faces.centres, one.charge)),
    )


def solved(device, shared=None):
    return arrays_of(solve_linear_and_reaction(device, box=device.bounds, shared=shared))


@pytest.fixture(scope="module")
def base():
    return solved(fm.read_device(DEVICE))


@pytest.mark.parametrize("key", CHANGES)
def test_a_change_is_seen_and_no_more_is_solved_again(key, base, monkeypatch):
    value, again = CHANGES[key]
    device = fm.read_device(DEVICE, {key: value})
    shared = SharedSolves()
    first = solved(fm.read_device(DEVICE), shared)
    ran = []
    for name in STEPS:
        step = getattr(linear, name)

        def counted(*arguments, step=step, name=name, **named):
            ran.append(name)
            return step(*arguments, **named)

        monkeypatch.setattr(linear, name, counted)
    ours = solved(device, shared)
    assert ran == again.split()
    monkeypatch.undo()
    alone = solved(device)
    assert all(np.array_equal(one, other) for one, other in zip(ours, alone, strict=True))
    assert all(np.array_equal(one, other) for one, other in zip(first, base, strict=True))
    # The change is one that the solve depends on.
    assert not all(np.array_equal(one, other) for one, other in zip(ours, base, strict=True))


def test_names_and_copper_change_nothing():
    shared = SharedSolves()
    device = fm.read_device(DEVICE)
    kept = solve_linear_and_reaction(device, box=device.bounds, shared=shared)
    text = DEVICE.replace('name = "coil"', 'name = "other"\nresistance_ohm = 3.0')
    other = solve_linear_and_reaction(fm.read_device(text), box=device.bounds, shared=shared)
    assert other[0].state is kept[0].state
    assert other[0].report.assumptions == kept[0].report.assumptions == fm.solve_linear(device).assumptions
    assert other[0].coil_names == ("other",)
    assert other[1] is kept[1]


def test_a_local_function_is_not_shared():
    def field(field, observers):
        return np.tile([1e-3, 2e-3, 3e-3], (len(observers), 1))

    uniform = fm.read_device(DEVICE)
    source = fm.Device.from_magpylib(magpylib.misc.CustomSource(field_func=field))
    shared = SharedSolves()
    found = [
        solve_linear_and_reaction(device, shared=shared)[0].field([0.0, 0.0, -0.02], [0.0])
        for device in (uniform, uniform.replace(background=source.background))
    ]
    np.testing.assert_allclose(*found, rtol=1e-6)
