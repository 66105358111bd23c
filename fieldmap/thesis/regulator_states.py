"""S18: the regulator's step of 7.4.1 on the linked machine and on the model it was designed on, with its estimates."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.control import (
    Estimator,
    Regulator,
    StateSpace,
    kalmd,
    lqrd,
    simulate_loop,
    steady_gain,
    to_transfer_function,
    with_output_integral,
    zero_order_hold,
)
from fieldmap.curves import Curves, Series
from fieldmap.dynamics.scenario.controller_keys import RegulatorKeys
from fieldmap.thesis.linked_runs import DEPTH, Readings, over_time, with_measured
from fieldmap.typing import Array

_BEGIN, _END = 0.9, 2.0


class _Design(NamedTuple):
    """The model of a regulator as it is written in a scenario, and what follows from it."""

    model: StateSpace
    estimator: Estimator
    regulator: Regulator


def step_and_states(run: Readings, quiet: Readings, rig_peak: ArrayLike) -> list[Curves]:
    """Figs 7-32 to 7-34: run with the sensor's noise, quiet without. rig_peak: s after the step, mm beyond it."""
    design = _design(run)
    reference = run.wanted[:, DEPTH] - run.wanted[0, DEPTH]
    plant = StateSpace(*zero_order_hold(design.model.A, design.model.B, 2e-3), design.model.C, design.model.D)
    loop = simulate_loop(plant, design.regulator, reference)
    position = run.wanted[0, DEPTH] + loop.y[0]
    lines = {"linked machine": run, "without noise": quiet}
    title = "Fig. 7-32: step from 13 to 12.9 mm, regulator"
    remark = "Model: (7-7) with the regulator as it was designed."
    curves = [
        over_time(
            title, DEPTH, lines, begin=_BEGIN, end=_END, remark=remark, models={"design model": position}
        )
    ]
    after, beyond = np.asarray(rig_peak, dtype=float)
    end = float(run.wanted[-1, DEPTH])
    curves = [with_measured(curves[0], "peak of the rig, Table 7-3", [1.0 + after], [end - beyond])]
    weight = design.regulator.equilibrium[1]
    estimates = {
        "ours": _of_the_machine(design, quiet),
        "published": filtered_states(design.estimator, loop.u[0] - weight * loop.y[0], loop.y[0] - reference),
    }
    shown = run.during(_BEGIN, _END)
    for k in (0, 1):
        series = tuple(
            Series(name, run.time[shown], estimates[kind][shown, k], kind)
            for name, kind in (("linked machine, without noise", "ours"), ("design model", "published"))
        )
        title = f"Fig. 7-{33 + k}: estimated state $x_{k + 1}$ meanwhile"
        curves.append(Curves(title, "time (s)", ("$x_1$ (V s)", "$x_2$ (V s²)")[k], series))
    return curves


def filtered_states(estimator: Estimator, control: Array, deviation: Array) -> Array:
    """x[n|n] (samples, n) from the deviations of control and measurement from their equilibrium: (7-15)."""
    A, B, C, D = (np.asarray(matrix) for matrix in estimator)
    predicted, states = np.zeros(len(A)), np.empty((len(control), len(A)))
    for n, (u, y) in enumerate(zip(control, deviation, strict=True)):
        states[n] = C[1:] @ predicted + D[1:, 1] * y
        predicted = A @ predicted + B @ (u, y)
    return states


def _of_the_machine(design: _Design, run: Readings) -> Array:
    keys = _keys(run)
    assert keys.equilibrium is not None
    intercept, slope = keys.equilibrium
    seen = run.seen[:, DEPTH]
    control = run.run.outputs[:, 0] - intercept - slope * seen
    return filtered_states(design.estimator, control, seen - run.wanted[:, DEPTH])


def _keys(run: Readings) -> RegulatorKeys:
    keys = run.run.scenario.contents.control.z
    assert isinstance(keys, RegulatorKeys)
    return keys


def _design(run: Readings) -> _Design:
    """(7-9) to (7-17), (7-20): the thesis's model feeds back x[n-1|n-1]."""
    keys, Ts = _keys(run), 1e-3 * run.run.scenario.contents.control.period_ms
    model = StateSpace(np.array(keys.A), np.array(keys.B)[:, None], np.array(keys.C)[None], np.zeros((1, 1)))
    wide = with_output_integral(model.A, model.B, model.C)
    k = lqrd(wide.A, wide.B, np.array(keys.Q), keys.R, Ts)
    estimator = kalmd(model.A, model.B, model.C, keys.process_noise, keys.measurement_noise, Ts)
    equilibrium = (0.0, 1.0 / steady_gain(to_transfer_function(model)))
    return _Design(model, estimator, Regulator(k, estimator, Ts, equilibrium, "measured", "filtered"))
