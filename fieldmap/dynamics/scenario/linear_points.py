"""The machine of a scenario, linear about its operating point at one height or at several."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.dynamics.linearisation import (
    ClosedLoop,
    Controllability,
    Coupling,
    LinearMachine,
    Margins,
    Mode,
    close_loop,
    controllability,
    coupling,
    linearise,
    margins,
    modes,
)
from fieldmap.dynamics.scenario.experiment import Experiment
from fieldmap.dynamics.scenario.start import operating_points_at


@dataclass(frozen=True, eq=False)
class LinearPoint:
    """At one depth, mm: the linear machine, its modes, their controllability, the coupling of its axes, its closed
    loop, and the loop's margins (none where it is unstable)."""

    depth_mm: float
    linear: LinearMachine
    modes: tuple[Mode, ...]
    controllability: Controllability
    coupling: Coupling
    loop: ClosedLoop
    margins: tuple[Margins, ...]


def linear_points(experiment: Experiment, depths_mm: Sequence[float] | None = None) -> list[LinearPoint]:
    """The machine of a scenario about its operating point at the start, or at each of these depths, mm.

    Raises NoEquilibrium, Infeasible or OutsideMapError where it has no equilibrium at a depth.
    """
    scenario, machine = experiment.scenario, experiment.machine
    depths = [scenario.start_depth_mm] if depths_mm is None else list(depths_mm)
    points = operating_points_at(scenario, machine, experiment.operating_point, depths)
    return [
        _point(experiment, depth, linearise(machine, operating_point))
        for depth, operating_point in zip(depths, points, strict=True)
    ]


def _point(experiment: Experiment, depth: float, linear: LinearMachine) -> LinearPoint:
    mass, moves = experiment.machine.body.mass, [linear.states.index(name) for name in ("vx", "vy", "vz")]
    block = experiment.controller.at(
        linear.operating_point.sensed, -mass * linear.A[moves, :3], mass * linear.B[moves]
    )
    sensors = experiment.machine.sensors
    # A body's turn about its magnet's axis is felt by nothing and no mode of the loop.
    felt = linear.only(tuple(name for name in linear.states if name not in ("turn_z", "wz")))
    loop = close_loop(felt, block, experiment.schedule, sensors)
    return LinearPoint(
        depth,
        linear,
        tuple(modes(linear)),
        controllability(linear, above=-np.inf if experiment.machine.body.upright else 1e-3),
        coupling(linear),
        loop,
        tuple(margins(loop, linear.inputs, sensors)) if loop.stable else (),
    )
