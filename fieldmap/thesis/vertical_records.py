"""S16: steps of the linked machine identified as chapter 5 identified the rig's, and Table 5-2."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.control.identification import (
    Estimate,
    EstimatedRuns,
    Orders,
    generalised_least_squares,
    modified_least_squares,
    modified_least_squares_runs,
    recursive_least_squares,
)
from fieldmap.curves import Curves, Series
from fieldmap.errors import NotConverged
from fieldmap.thesis.linked_runs import DEPTH, Readings, ours, over_time
from fieldmap.thesis.registry import Answers
from fieldmap.thesis.vertical_responses import responses, step_of
from fieldmap.typing import Array

_BEGIN, _SHOWN, _SETTLED = 0.9, 1.5, 1e-2
_ESTIMATORS: dict[str, Callable[..., Estimate]] = {
    "generalised least squares": generalised_least_squares,
    "modified least squares": modified_least_squares,
}
_REDUCED, _FULL = Orders(poles=3, zeros=1), Orders(poles=4, zeros=3)
"""(5-15) and (5-13)."""


def records(inputs: dict[str, Any]) -> Answers:
    """Table 5-2 from steps of the linked machine, and the figures of chapter 5."""
    Ti, Td = inputs["Ti"], inputs["Td"]
    steps = {float(Kc): step_of(inputs, (float(Kc), Ti, Td), 8.0, 1.0) for Kc in inputs["gains"]}
    found = _identified(steps)
    pairs = np.array([_slowest_pair(poles) for poles in found.poles])
    every = tuple(steps.values())
    numbers = {
        "pair_real": ours(pairs.real, *every),
        "pair_imaginary": ours(pairs.imag, *every),
        "zero": ours(found.zeros[: len(inputs["zero_gains"]), 0].real, *every),
    }
    first = next(iter(steps.values()))
    curves = (
        _by_two_estimators(inputs, first),
        _recursive(inputs, first),
        *_of_the_step(steps),
        _poles(inputs, pairs),
        *responses(inputs, steps),
    )
    return Answers(numbers, curves, {"pair_imaginary": _of_less_gain(inputs)})


def _identified(steps: Mapping[float, Readings]) -> EstimatedRuns:
    """(5-15) of each record."""
    seen, wanted = (np.array(signals) for signals in zip(*map(_around, steps.values()), strict=True))
    return modified_least_squares_runs(seen, wanted, _REDUCED)


def _of_less_gain(inputs: dict[str, Any]) -> str:
    """What the calibration at one depth leaves open would do to the poles."""
    share, Ti, Td = inputs["less_gain"], inputs["Ti"], inputs["Td"]
    steps = {float(Kc): step_of(inputs, (float(share * Kc), Ti, Td), 8.0, 1.0) for Kc in inputs["gains"]}
    parts = [f"{_slowest_pair(poles).imag:.3f}" for poles in _identified(steps).poles]
    return f"A gain of {share:g} times ours, which would bring the overshoot of Table 7-1, gives {', '.join(parts)}."


def _slowest_pair(poles: NDArray[np.complex128]) -> complex:
    """The pair nearest to q = 1, or the middle of the two poles nearest to it where all are real."""
    slowest = poles[np.argsort(np.abs(poles - 1.0))][:2]
    return complex(slowest.real.mean(), np.abs(slowest.imag).max())


def _around(run: Readings) -> tuple[Array, Array]:
    """Measured and asked depth from shortly before the step, mm from where it begins."""
    rows = run.during(_BEGIN)
    begin = run.wanted[rows, DEPTH][0]
    return run.seen[rows, DEPTH] - begin, run.wanted[rows, DEPTH] - begin


def _by_two_estimators(inputs: dict[str, Any], run: Readings) -> Curves:
    """Fig. 5-2: what they make of one step in the structure (5-13)."""
    seen, wanted = _around(run)
    time, shown = run.time[run.during(_BEGIN)], slice(0, int(_SHOWN / inputs["Ts_s"]))
    series, remark = [Series("linked machine (ours)", time[shown], seen[shown])], "Structure (5-13)."
    for name, estimator in _ESTIMATORS.items():
        try:
            found = estimator(seen, wanted, _FULL, inputs["Ts_s"], tolerance=_SETTLED)
        except NotConverged:
            remark += f" The {name} do not settle."
        else:
            answer = np.asarray(found.simulate(wanted), dtype=float)
            series.append(Series(name, time[shown], answer[shown]))
            poles = ", ".join(f"{pole:.3f}" for pole in found.poles[:3])
            remark += f" Slowest poles by {name}: {poles}."
    series.append(Series("asked for", time[shown], wanted[shown], "asked"))
    title = "Fig. 5-2: closed-loop models from the step of Fig. 5-4"
    return Curves(title, "time (s)", "depth from 8 mm (mm)", tuple(series), remark)


def _recursive(inputs: dict[str, Any], run: Readings) -> Curves:
    """Fig. 5-3: recursive estimates of the four coefficients of (5-13)'s denominator over time."""
    seen, wanted = _around(run)
    time, shown = run.time[run.during(_BEGIN)], slice(0, int(_SHOWN / inputs["Ts_s"]))
    history = recursive_least_squares(
        seen, wanted, _FULL, noise_order=1, forgetting=float(inputs["forgetting"])
    ).history
    series = tuple(
        Series(f"$a_{k}$", time[shown], np.asarray(history[shown, k], dtype=float))
        for k in range(_FULL.poles)
    )
    title = f"Fig. 5-3: recursive estimates of (5-13), forgetting factor {inputs['forgetting']:g}"
    return Curves(title, "time (s)", "coefficient of the denominator (1)", series)


def _of_the_step(steps: Mapping[float, Readings]) -> tuple[Curves, ...]:
    """Figs 5-4 and 5-5."""
    Kc, run = next(iter(steps.items()))
    rows = run.during(_BEGIN, _BEGIN + _SHOWN)
    signal = Series("output", run.time[rows], run.run.outputs[rows, 0])
    title = f"Fig. 5-4: step from 8 to 9 mm, $K_c$ = {Kc:g} V/mm"
    return (
        over_time(title, DEPTH, {"linked machine (ours)": run}, begin=_BEGIN, end=_BEGIN + _SHOWN),
        Curves("Fig. 5-5: output of the controller meanwhile", "time (s)", "output (V)", (signal,)),
    )


def _poles(inputs: dict[str, Any], pairs: NDArray[np.complex128]) -> Curves:
    """Fig. 5-6: the pair at each gain, from our records and from the rig's."""
    gains = inputs["gains"]
    rig = np.asarray(inputs["measured_real"]), np.asarray(inputs["measured_imaginary"])
    series = (
        Series("from steps of the linked machine", pairs.real, pairs.imag, points=True),
        Series("from the rig, Table 5-2", *rig, "measured", points=True),
    )
    remark = (
        f"$K_c$ from {min(gains):g} to {max(gains):g} V/mm, right to left; imaginary part 0: two real poles, and the "
        "middle between them."
    )
    title = "Fig. 5-6: closed-loop poles by modified least squares, structure (5-15)"
    return Curves(title, "real part (1)", "imaginary part (1)", series, remark)
