"""S16: what the linked machine does where chapter 5 shows the rig, and the thesis's models beside it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fieldmap.control import PID, TransferFunction, from_roots
from fieldmap.curves import Curves, Series
from fieldmap.thesis.linked_runs import DEPTH, Readings, answer_of, over_time, run_of, with_measured
from fieldmap.thesis.vertical import identified_plant

_MACHINE = "linked machine"
_SIGNAL = "Gains of the three steps above; a bit lasts 250 ms: neither is printed."
_ORDINALS = ("first", "second", "third", "fourth")
Gains = tuple[float, float, float]
"""Kc in V/mm, Ti and Td as the thesis prints them: seconds to its models, minutes to the machine."""


def changes_of(gains: Gains) -> dict[str, float]:
    """Of a scenario, for a controller."""
    Kc, Ti, Td = gains
    return {"control.z.Kc": Kc, "control.z.Ti_s": 60.0 * Ti, "control.z.Td_s": 60.0 * Td}


def step_of(inputs: Mapping[str, Any], gains: Gains, depth_mm: float, by_mm: float) -> Readings:
    """A step of the linked machine's height."""
    changes = {**changes_of(gains), "start.depth_mm": depth_mm, "reference.0.by_mm": by_mm}
    return run_of(inputs, "vertical_step", changes)


def responses(inputs: dict[str, Any], steps: Mapping[float, Readings]) -> tuple[Curves, ...]:
    """Figs 5-9 to 5-22 but for 5-11; steps: those of 8 mm, by gain."""
    controllers = [(float(Kc), float(Ti), float(Td)) for Kc, Ti, Td in inputs["controllers"]]
    return (
        *_first_models(inputs, steps),
        *_binary_signals(inputs, controllers[:3]),
        *_steps(inputs, controllers),
        *_signs(inputs, controllers),
        *_ramps(inputs, controllers[:2]),
    )


def _plants(inputs: dict[str, Any]) -> dict[str, TransferFunction]:
    """Tables 5-3 and 5-4, and the last one of 5.7."""
    pole, gain, zero = inputs["plant_poles"], inputs["adjusted_gain"], inputs["adjusted_zero"]
    return {
        "preliminary model": from_roots(
            inputs["plant_gain"], inputs["preliminary_zeros"], inputs["preliminary_poles"]
        ),
        "final model": identified_plant(inputs),
        "adjusted model": from_roots(gain, [zero], pole),
    }


def _models(inputs: dict[str, Any], run: Readings, gains: Gains, *names: str) -> dict[str, np.ndarray]:
    """What models make of the reference of a run, mm."""
    pid = PID(*gains, inputs["Ts_s"], integration="trapezoidal", acts_on_minus_error=True)
    plants = _plants(inputs)
    return {name: answer_of(plants[name], pid, run, DEPTH) for name in names}


def _first_models(inputs: dict[str, Any], steps: Mapping[float, Readings]) -> list[Curves]:
    """Figs 5-9 and 5-10: the preliminary model at two gains."""
    curves = []
    for number, Kc in (("5-9", 0.5), ("5-10", 0.334)):
        gains, run = (Kc, inputs["Ti"], inputs["Td"]), steps[Kc]
        models = _models(inputs, run, gains, "preliminary model")
        title = f"Fig. {number}: step at $K_c$ = {Kc:g} V/mm"
        remark = (
            "" if number == "5-9" else "The gain of Fig. 5-10 is not printed; 0.334 is the next of Table 5-2."
        )
        curves.append(
            over_time(title, DEPTH, {_MACHINE: run}, begin=0.9, end=2.5, remark=remark, models=models)
        )
    return curves


def _binary_signals(inputs: dict[str, Any], controllers: list[Gains]) -> list[Curves]:
    """Figs 5-12 to 5-14."""
    curves = []
    for k, gains in enumerate(controllers):
        run = run_of(inputs, "vertical_prbs", changes_of(gains))
        models = _models(inputs, run, gains, "final model")
        title = f"Fig. 5-{12 + k}: pseudo-random binary signal, {_ORDINALS[k]} controller"
        curves.append(
            over_time(title, DEPTH, {_MACHINE: run}, begin=1.0, end=6.0, remark=_SIGNAL, models=models)
        )
    return curves


def _steps(inputs: dict[str, Any], controllers: list[Gains]) -> list[Curves]:
    """Figs 5-15, 5-16, 5-17 and 5-20."""
    curves = []
    for number, ordinal, gains in zip(("15", "16", "17", "20"), _ORDINALS, controllers, strict=True):
        run = step_of(inputs, gains, 10.0, 1.0)
        names = ["preliminary model", "final model"]
        if number == "20":
            names.append("adjusted model")
        models = _models(inputs, run, gains, *names)
        title = f"Fig. 5-{number}: step of 1 mm, {ordinal} controller"
        curves.append(over_time(title, DEPTH, {_MACHINE: run}, begin=0.9, end=2.5, models=models))
    after, overshoot = inputs["rig_peak"]
    curves[0] = with_measured(curves[0], "peak of the rig, Table 7-1", [1.0 + after], [11.0 + overshoot])
    return curves


def _signs(inputs: dict[str, Any], controllers: list[Gains]) -> list[Curves]:
    """Figs 5-18 and 5-19: steps towards the pole piece."""
    up = step_of(inputs, controllers[2], 10.0, -2.0)
    models = _models(inputs, up, controllers[2], "preliminary model", "final model")
    both = {by: step_of(inputs, controllers[0], 10.0, by) for by in (1.0, -1.0)}
    series = []
    for by, run in both.items():
        rows = run.during(0.9, 2.5)
        name = "down by 1 mm" if by > 0 else "up by 1 mm"
        series.append(Series(name, run.time[rows], np.sign(by) * (run.seen[rows, DEPTH] - 10.0)))
    title = "Fig. 5-19: steps up and down laid on each other, first controller"
    return [
        over_time(
            "Fig. 5-18: step of -2 mm, third controller",
            DEPTH,
            {_MACHINE: up},
            begin=0.9,
            end=2.5,
            models=models,
        ),
        Curves(title, "time (s)", "way along the step (mm)", tuple(series)),
    ]


def _ramps(inputs: dict[str, Any], controllers: list[Gains]) -> list[Curves]:
    """Figs 5-21 and 5-22."""
    curves = []
    for k, gains in enumerate(controllers):
        run = run_of(inputs, "vertical_ramp", changes_of(gains))
        models = _models(inputs, run, gains, "final model")
        title = f"Fig. 5-{21 + k}: ramp of 5 mm/s, {_ORDINALS[k]} controller"
        remark = "" if k == 0 else "Its gains are not printed; those of Fig. 5-16 are taken."
        curves.append(
            over_time(title, DEPTH, {_MACHINE: run}, begin=0.9, end=2.5, remark=remark, models=models)
        )
    return curves
