"""The machine of a scenario, linear about its rest at one height or at several."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.dynamics.linear import (
    ClosedLoop,
    Coupling,
    LinearMachine,
    Margins,
    Mode,
    Reach,
    close_loop,
    coupling,
    linearise,
    margins,
    modes,
    reach,
)
from fieldmap.dynamics.scenario.build import Experiment
from fieldmap.dynamics.scenario.rests import rests_at


@dataclass(frozen=True, eq=False)
class LinearPoint:
    """At one depth, mm: the linear machine, its modes, how they are reached, its coupling at rest, its closed loop, and
    the loop's margins (none where it is unstable)."""

    depth_mm: float
    linear: LinearMachine
    modes: tuple[Mode, ...]
    reach: Reach
    coupling: Coupling
    loop: ClosedLoop
    margins: tuple[Margins, ...]


def linear_points(experiment: Experiment, depths_mm: Sequence[float] | None = None) -> list[LinearPoint]:
    """The machine of a scenario about its rest at the start, or at each of these depths, mm.

    Raises NoEquilibrium, Infeasible or OutsideMapError where it has no rest at a depth.
    """
    scenario, machine = experiment.scenario, experiment.machine
    depths = [scenario.start_depth_mm] if depths_mm is None else list(depths_mm)
    rests = rests_at(scenario, machine, experiment.rest, depths)
    return [
        _point(experiment, depth, linearise(machine, rest)) for depth, rest in zip(depths, rests, strict=True)
    ]


def _point(experiment: Experiment, depth: float, linear: LinearMachine) -> LinearPoint:
    mass, moves = experiment.machine.body.mass, [linear.states.index(name) for name in ("vx", "vy", "vz")]
    block = experiment.controller.at(linear.rest, -mass * linear.A[moves, :3], mass * linear.B[moves])
    sensors = experiment.machine.sensors
    # A body's turn about its magnet's axis is felt by nothing and no mode of the loop.
    felt = linear.only(tuple(name for name in linear.states if name not in ("turn_z", "spin_z")))
    loop = close_loop(felt, block, experiment.schedule, sensors)
    return LinearPoint(
        depth,
        linear,
        tuple(modes(linear)),
        reach(linear, above=-np.inf if experiment.machine.body.upright else 1e-3),
        coupling(linear),
        loop,
        tuple(margins(loop, linear.inputs, sensors)) if loop.stable else (),
    )
