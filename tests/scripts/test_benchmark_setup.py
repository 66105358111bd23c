"""Sections of the benchmark load and set up; these tests are quick, tests/slow.txt names those that run a section."""

import numpy as np
import pytest


def test_every_section_is_there(program):
    for module in program("benchmark").SECTIONS.values():
        section = program(module)
        assert callable(section.measure)
        assert callable(section.show)


@pytest.fixture(scope="module")
def dynamics(program):
    return program("benchmarks.dynamics")


def test_every_machine_of_dynamics_is_held(dynamics):
    """Over ten samples from rest the magnet stays within the sensor noise."""
    machines = dynamics.machines()
    assert len(machines) == 4
    for machine in machines.values():
        run = dynamics.prepared(machine, 0.02)(0)
        assert run.event is None
        assert np.ptp(run.position, axis=0).max() < 1e-4
