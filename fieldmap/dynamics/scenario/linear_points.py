"""The machine of a scenario, linearised about its operating points at one height or at several."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fieldmap.control.blocks import Controller
from fieldmap.control.function_controller import FunctionController
from fieldmap.dynamics import linearisation
from fieldmap.dynamics.linear_loop import ClosedLoop, Margins, close_loop, margins
from fieldmap.dynamics.scenario.experiment import Experiment
from fieldmap.dynamics.scenario.metrics import reading_mm
from fieldmap.dynamics.scenario.start import floating_at
from fieldmap.errors import ScenarioError
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.store import whole_file
from fieldmap.typing import PathLike

_REST = ("sensed", "currents", "outputs")


@dataclass(frozen=True, eq=False, repr=False)
class LinearPoint(Record):
    """The linear machine at one depth.

    Attributes
    ----------
    depth_mm : reading of the vertical sensor.
    linear : the linear machine.
    modes : of the machine without controller.
    controllability : of the modes, and their observability.
    coupling : of the axes.
    loop : the closed loop.
    margins : at each output.
    """

    depth_mm: float
    linear: linearisation.LinearMachine
    modes: tuple[linearisation.Mode, ...]
    controllability: linearisation.Controllability
    coupling: linearisation.Coupling
    loop: ClosedLoop
    margins: tuple[Margins, ...]


def linear_points(experiment: Experiment, depths_mm: Sequence[float] | None = None) -> list[LinearPoint]:
    """Linearise the machine of a scenario, at the start or at several depths.

    Parameters
    ----------
    experiment
        The scenario, ready to run.
    depths_mm
        Readings of the vertical sensor, mm; by default the reading at the start.

    Raises
    ------
    NoEquilibrium, Infeasible, OutsideMapError
        For a depth at which the machine has no equilibrium.
    ScenarioError
        For a controller that is a function, whose derivatives are not known. `linearise` gives the machine without it.
    """
    scenario, machine, start = experiment.scenario, experiment.machine, experiment.operating_point
    controller = experiment.controller
    if controller is None or isinstance(controller, FunctionController):
        must, received = "must be a controller with a model", "a function of one's own"
        remedy = "take a shipped one, or fieldmap.dynamics.linearise"
        raise ScenarioError(scenario.document.problem("control.coupled", must, received, remedy))
    begin = round(float(reading_mm(scenario, start.sensed)[2]), 9)
    depths = [begin] if depths_mm is None else list(depths_mm)
    heights = [scenario.settings.height(1e-3 * depth) for depth in depths]
    with scenario.document.placing():
        points = floating_at(machine, scenario.settings.held(), start, heights)
    return [
        _point(experiment, controller, depth, linearisation.linearise(machine, operating_point))
        for depth, operating_point in zip(depths, points, strict=True)
    ]


def _point(
    experiment: Experiment, controller: Controller, depth: float, linear: linearisation.LinearMachine
) -> LinearPoint:
    by_place, by_output = linear.forces
    block = controller.at(linear.operating_point.sensed, -by_place, by_output)
    sensors = experiment.machine.sensors
    # The rotation of the body about its magnet's axis has no effect on the field, so it is left out of the loop.
    felt = linear.only(tuple(name for name in linear.states if name not in linearisation.ABOUT_Z))
    loop = close_loop(felt, block, experiment.schedule, sensors)
    return LinearPoint(
        depth,
        linear,
        tuple(linearisation.modes(linear)),
        linearisation.controllability(linear, above=-np.inf if experiment.machine.body.upright else 1e-3),
        linearisation.coupling(linear),
        loop,
        tuple(margins(loop, linear.inputs, sensors)),
    )


@dataclass(frozen=True, eq=False, repr=False)
class Linearisation(Record):
    """The linear machine of a scenario at one depth or several."""

    experiment: Experiment
    points: tuple[LinearPoint, ...]

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable at every depth."""
        return all(point.loop.stable for point in self.points)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Those of the machine, and the keys of the scenario that were changed."""
        return (*self.points[0].linear.assumptions, *self.experiment.scenario.changed())

    def to_dict(self) -> dict[str, Plain]:
        """The linearisation as plain Python, in SI units except for names that end in _mm and margins in degrees. A
        pole is [real, imaginary]."""
        first, scenario = self.points[0].linear, self.experiment.scenario
        return plain_items(
            scenario=scenario.path.name,
            title=scenario.contents.title,
            states=first.states,
            inputs=first.inputs,
            outputs=first.outputs,
            points=[_point_items(point) for point in self.points],
            assumptions=self.assumptions,
        )

    def write(self, path: PathLike) -> Path:
        """Write the models.

        Parameters
        ----------
        path
            A file .json, the same as `to_dict`, or .npz, stacks over the depths.

        Returns
        -------
        Path
            The path.
        """
        path = Path(path)
        found = self.to_dict() | {"written": str(path)}
        with whole_file(path, "linear models") as partial:
            if path.suffix == ".npz":
                np.savez(partial, **_arrays(self.points))  # type: ignore[arg-type]
            else:
                partial.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        return path


def loop_poles(point: LinearPoint) -> NDArray[np.complex128]:
    """Poles of the closed loop, without those of pure delays.

    Parameters
    ----------
    point
        The machine at an operating point.

    Returns
    -------
    NDArray[np.complex128]
        Poles, 1/s; the slowest or unstable first.
    """
    poles = point.loop.poles
    there = poles[np.abs(poles) > 1e-6]
    found = np.asarray(np.log(there.astype(complex)) / point.loop.period, np.complex128)
    return found[np.argsort(-found.real)]


def coupling_signals(point: LinearPoint) -> tuple[str, ...]:
    """Names of the inputs in the order of `LinearPoint.coupling`.

    Parameters
    ----------
    point
        The machine at an operating point.

    Returns
    -------
    tuple[str, ...]
        The names.
    """
    names = point.linear.inputs
    return (names[1], names[2], names[0]) if names[:1] == ("lift_V",) else names


def _point_items(point: LinearPoint) -> dict[str, object]:
    linear, reach = point.linear, point.controllability
    return {
        "depth_mm": point.depth_mm,
        "rest": {name: getattr(linear.operating_point, name) for name in _REST},
        **{name: getattr(linear, name) for name in "ABCDG"},
        "modes": [
            {
                "pole": _pair(mode.pole),
                "frequency_Hz": mode.frequency,
                "damping": mode.damping,
                "moves": mode.named_shares(linear),
                "reached": mode.input_gains,
                "seen": mode.output_gains,
            }
            for mode in point.modes
        ],
        "controllability": reach.controllability,
        "observability": reach.observability,
        "coupling": {
            "signals": coupling_signals(point),
            "gain": point.coupling.gain,
            "relative": point.coupling.relative,
        },
        "loop": {
            "stable": point.loop.stable,
            "period_s": point.loop.period,
            "poles": [_pair(pole) for pole in loop_poles(point)],
            **{name: getattr(point.loop, name) for name in "ABC"},
        },
        "margins": point.margins,
    }


def _pair(value: complex) -> list[float]:
    return [float(value.real), float(value.imag)]


def _arrays(points: tuple[LinearPoint, ...]) -> dict[str, object]:
    """Stacks over k depths: A (k, n, n), B, C, D, G of the machine; loop_A, loop_B, loop_C of the loop; and names."""
    first = points[0].linear

    def stacks(prefix: str, names: Sequence[str], of: Sequence[object]) -> dict[str, object]:
        return {f"{prefix}{name}": np.stack([getattr(one, name) for one in of]) for name in names}

    return {
        "depth_mm": np.array([p.depth_mm for p in points]),
        "period_s": points[0].loop.period,
        **stacks("", "ABCDG", [p.linear for p in points]),
        **stacks("loop_", "ABC", [p.loop for p in points]),
        **stacks("rest_", (*_REST, "state"), [p.linear.operating_point for p in points]),
        **{name: np.array(getattr(first, name)) for name in ("states", "inputs", "outputs")},
    }
