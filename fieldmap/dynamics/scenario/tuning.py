"""PID controllers of a scenario's axes, tuned on its linear machine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.arguments import check_choice
from fieldmap.control import PID, StateSpace
from fieldmap.control.tuning import TunedPID, tune_pid
from fieldmap.device import Device
from fieldmap.dynamics.linear_loop import sampled_machine, shares_of_the_past
from fieldmap.dynamics.linearisation import MOTION, linearise
from fieldmap.dynamics.scenario.experiment import Experiment, prepare
from fieldmap.dynamics.scenario.linear_points import LinearPoint, linear_points
from fieldmap.dynamics.scenario.schema import read_scenario
from fieldmap.errors import Infeasible
from fieldmap.field import Field
from fieldmap.inputs.document import AtKey
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import PathLike

# For each axis: index of its output, readings per metre, and the rotation that couples with it.
_AXES = {"z": (0, -1e3, ()), "x": (1, 1e3, ("turn_y",)), "y": (2, 1e3, ("turn_x",))}


@dataclass(frozen=True, eq=False, repr=False)
class Tuning(Record):
    """PID controllers of a scenario.

    axes: the controllers by axis, with their margins while the other axes are held. keys: the keys of the scenario
    that the tuning sets. changes: these and the given keys, for `simulate`. point: the whole machine with all
    controllers, linearised about the start, with its margins. assumptions: of the machine, and the given changes.
    """

    axes: Mapping[str, TunedPID]
    keys: Mapping[str, Any]
    changes: Mapping[str, Any]
    point: LinearPoint
    assumptions: tuple[str, ...]

    def to_dict(self) -> dict[str, Plain]:
        """The tuning as plain Python."""
        axes = {axis: tuned.margins for axis, tuned in self.axes.items()}
        loop = {"stable": self.point.loop.stable, "margins": self.point.margins}
        return plain_items(keys=self.keys, margins_alone=axes, loop=loop, assumptions=self.assumptions)


def tune_axes(
    scenario: PathLike,
    axes: Sequence[str] = ("z", "x", "y"),
    changes: Mapping[str, Any] | None = None,
    *,
    field_map: Field | None = None,
    device: Device | None = None,
    **asked: Any,
) -> Tuning:
    """Tune a PID controller for each of these axes, on the scenario's machine about its start.

    Each axis is tuned alone, with the delay of the control task and the sensors' scans, while the other axes are
    held. A body that may turn rotates about y for x, and about x for y. Tuning changes the gains and times of a PID
    controller in the scenario and keeps its other keys; it replaces another controller and keeps its limits.

    Parameters
    ----------
    scenario
        Path of the file, or the name of a shipped scenario. Controllers of the axes replace a coupled controller;
        axes that are not tuned are then constant.
    axes
        Among "z" (the depth), "x" and "y".
    changes
        Values by dotted key that replace those of the file.
    field_map, device
        As in `simulate`.
    **asked
        Margins, crossover, N and integration, as for `fieldmap.control.tune_pid`.

    Returns
    -------
    Tuning
        The controllers, the keys of a scenario with them, and the loop of the whole machine.

    Raises
    ------
    Infeasible
        For margins that are not possible, as from `tune_pid`; the problem names the axis.
    ScenarioError, MapFileError, InputError, NoEquilibrium
        As in `prepare`.

    Examples
    --------
    >>> found = tune_axes("hold", field_map=m, phase_margin=40, crossover=10.0)      # doctest: +SKIP
    >>> run = simulate("hold", found.changes, field_map=m)                           # doctest: +SKIP
    """
    for axis in axes:
        check_choice("tune_axes(axes)", axis, tuple(_AXES))
    given = dict(changes or {})
    read = read_scenario(scenario, given)
    control, keys = read.contents.control, dict[str, Any]()
    if control.coupled is not None:
        stated = control.model_dump(exclude_unset=True, exclude={"coupled"})
        keys = {"control": stated | {axis: {"kind": "constant"} for axis in _AXES}}
        given = {key: value for key, value in given.items() if key.split(".")[0] != "control"}
    plants, period = _plants(prepare(read_scenario(scenario, given | keys), field_map, device))
    found: dict[str, TunedPID] = {}
    for axis in axes:
        try:
            found[axis] = tune_pid(plants(axis), period, **asked)
        except Infeasible as error:
            (problem,) = error.problems
            at = AtKey(f"control.{axis}", problem.must_hold, problem.received, problem.remedy)
            with read.document.placing():
                raise Infeasible(at, reachable=error.reachable) from error
        table, before = pid_table(axis, found[axis].pid), getattr(control, axis)
        if control.coupled is not None:
            keys["control"][axis] = table
        else:
            keys |= _changed(f"control.{axis}", table, before)
    changes = given | keys
    (point,) = linear_points(prepare(read_scenario(scenario, changes), field_map, device))
    return Tuning(found, keys, changes, point, (*point.linear.assumptions, *read.changed()))


def pid_table(axis: str, pid: PID) -> dict[str, Any]:
    """The controller of an axis as a table of a scenario. The controller of the depth acts on minus the error."""
    sign = 1.0 if pid.acts_on_minus_error == (axis == "z") else -1.0
    times = {"Ti_s": pid.Ti, "Td_s": pid.Td, "Tf_s": pid.Tf}
    return {"kind": "pid", "Kc": sign * pid.Kc, **times, "c": pid.c, "integration": pid.integration}


def _changed(key: str, table: dict[str, Any], before: Any) -> dict[str, Any]:
    """Changes of keys that replace the controller of the scenario at a key by this table."""
    if before.kind == "pid":
        differs = (name for name, value in table.items() if getattr(before, name) != value)
        return {f"{key}.{name}": table[name] for name in differs}
    limits = {name: getattr(before, name, None) for name in ("lower", "upper")}
    return {key: table | {name: limit for name, limit in limits.items() if limit is not None}}


def _plants(experiment: Experiment) -> tuple[Callable[[str], StateSpace], float]:
    """The sampled plant of each axis, from its output to its reading in mm, and its sampling time, s."""
    linear = linearise(experiment.machine, experiment.operating_point)
    schedule = experiment.schedule
    shares = shares_of_the_past(experiment.machine.sensors, schedule.period)

    def plant(axis: str) -> StateSpace:
        output, factor, turns = _AXES[axis]
        moved = [name for one in (axis, *turns) for name in (one, _velocity_of(one))]
        names = tuple(name for name in linear.states if name in moved or name not in MOTION)
        sampled = sampled_machine(linear.only(names), schedule.period, schedule.delay)
        place, u = "xyz".index(axis), slice(output, output + 1)
        order, late = len(sampled.A), len(shares) - 1
        A = np.zeros((order + 1 + late, order + 1 + late))
        A[:order, : order + 1] = np.hstack([sampled.A, sampled.before[:, u]])
        now = np.append(sampled.C[place], 0.0)
        # A reading is a sum over earlier samples, latest first.
        A[order + 1 :, order + 1 :] = np.eye(late, k=-1)
        A[order + 1 : order + 2, : order + 1] = now
        B = np.concatenate([sampled.B[:, u], [[1.0]], np.zeros((late, 1))])
        weights = shares[:, place, place]
        C = factor * np.concatenate([weights[0] * now, weights[1:]])
        return StateSpace(A, B, C[None], np.zeros((1, 1)))

    return plant, schedule.period


def _velocity_of(state: str) -> str:
    return f"velocity_{state}" if state in "xyz" else f"angular_velocity_{state[-1]}"
