"""Sections of the benchmark can be loaded and set up: cheap, because tests/slow.txt names those that run a section."""

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
    """Ten samples from rest: the magnet stays within the noise of its sensors."""
    machines = dynamics.machines()
    assert len(machines) == 4
    for machine in machines.values():
        run = dynamics.prepared(machine, 0.02)(0)
        assert run.event is None
        assert np.ptp(run.position, axis=0).max() < 1e-4
