"""Saturating disk and core under a coil, against independent axisymmetric finite elements.

tests/reference/axisymmetric_saturated.csv says how the reference was made; its own error is 1e-4 in Bz and 3e-4 in
the gradient. The law there is analytic in B and enters here as a dense table.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.device.model import BHTable, Body, CircularCoil, Cylinder, Device, Part, Placement
from fieldmap.iron import NonlinearSolver

TABLE = Path(__file__).parents[1] / "reference" / "axisymmetric_saturated.csv"


def reference(ampere_turns):
    rows = [row.split(",") for row in TABLE.read_text().splitlines() if row.startswith(f"{ampere_turns},")]
    values = np.array([[float(x) for x in row[1:]] for row in rows])
    points = np.column_stack([values[:, 0], np.zeros(len(values)), values[:, 1]])
    return points, values[:, 2:]


def law():
    b = np.linspace(0.05, 3.5, 400)
    u = b**10.8
    h = (1 / 4000 + (0.5 - 1 / 4000) * u / (u + 1.8e4)) * b / mu_0
    return BHTable("iron", h, b, "straight line to the origin", "slope mu0", b[0] / h[0] / mu_0)


def device(core_size=0.0025, edge=0.0005):
    disk = Body("disk", "iron", (Part(Cylinder(0.066, 0.006)),), 0.008, edge)
    above = Placement(np.array([0.0, 0.0, 0.006]), np.eye(3))
    core = Body("core", "iron", (Part(Cylinder(0.01, 0.04), above),), core_size, edge)
    at = Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
    coil = CircularCoil("coil", 0.011, 0.021, 0.039, 840.0, placement=at)
    # The law falls below the slope of free space, which device files do not allow.
    return Device.unchecked(name="diskcore", coils=(coil,), bodies=(disk, core), materials={"iron": law()})


@pytest.fixture(scope="module")
def coarse():
    return NonlinearSolver(device(0.005, 0.002))


def errors(state, ampere_turns):
    """Largest error of Bz, Br and dBz/dz over the largest value of each."""
    points, exact = reference(ampere_turns)
    field, gradient = state.field(points), state.gradient(points)
    ours = np.column_stack([field[:, 2], field[:, 0], gradient[:, 2, 2]])
    return np.abs(ours - exact).max(axis=0) / np.abs(exact).max(axis=0)


def test_against_finite_elements(coarse):
    """2.0 T, 2.5 T and 2.9 T in the core: within 0.1 % in B and gradient, and worse on a coarser mesh."""
    solver, state = NonlinearSolver(device(0.0035, 0.0008)), None
    for ampere_turns, in_core in ((4200, 2.0), (12600, 2.5), (33600, 2.9)):
        state = solver.solve([ampere_turns / 840], start=state)
        assert (errors(state, ampere_turns) < 1e-3).all()
        assert state.report.largest_flux_density == pytest.approx(in_core, rel=0.05)
    assert errors(coarse.solve([40.0]), 33600).max() > 3 * errors(state, 33600).max()


def test_a_warm_start_reaches_the_same_state(coarse):
    near = coarse.solve([14.0])
    cold, warm = coarse.solve([15.0]), coarse.solve([15.0], start=near)
    x = np.array([[0.01, 0.0, -0.09]])
    assert np.abs(warm.field(x) - cold.field(x)).max() < 1e-5 * np.abs(cold.field(x)).max()
    assert warm.report.iterations < cold.report.iterations


def test_small_current_is_the_linear_solution(coarse):
    """Far below saturation the law is a straight line: half the current gives half the field."""
    x = np.array([[0.01, 0.0, -0.09]])
    one, two = coarse.solve([0.002]).field(x), coarse.solve([0.004]).field(x)
    assert np.abs(two - 2 * one).max() < 1e-4 * np.abs(two).max()


def test_report_says_what_left_the_table():
    short = law()
    cut = replace(short, h=short.h[:200], b=short.b[:200])
    saturated = replace(device(0.005, 0.002), materials={"iron": cut})
    state = NonlinearSolver(saturated).solve([5.0])
    assert state.report.beyond_table > 0
    assert any("1.77" in text for text in state.report.assumptions)
