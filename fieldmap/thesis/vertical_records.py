"""S16: steps, binary signals and ramps of the coupled machine instead of the rig, and Table 5-2 from these records."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.control import TransferFunction, from_roots, identification
from fieldmap.control.identification import Orders
from fieldmap.curves import Curves, Series
from fieldmap.errors import NotConverged
from fieldmap.thesis import coupled_runs as coupled
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import DEPTH, Readings, ours, over_time, run_of
from fieldmap.thesis.vertical import identified_plant, printed_pid
from fieldmap.typing import Array

_ORDINALS = ("first", "second", "third", "fourth")
Gains = tuple[float, float, float]
"""Kc in V/mm, Ti and Td as the thesis prints them: seconds to its models, minutes to the machine."""


def changes_of(gains: Gains) -> dict[str, float]:
    """Changes of a scenario for a controller."""
    Kc, Ti, Td = gains
    return {"control.z.Kc": Kc, "control.z.Ti_s": 60.0 * Ti, "control.z.Td_s": 60.0 * Td}


def step_of(inputs: Mapping[str, Any], gains: Gains, depth_mm: float, by_mm: float) -> Readings:
    """A step of the coupled machine's height."""
    changes = {**changes_of(gains), "start.depth_mm": depth_mm, "reference.0.by_mm": by_mm}
    return run_of(inputs, "vertical_step", changes)


def responses(inputs: dict[str, Any], steps: Mapping[float, Readings]) -> list[Curves]:
    """Figs 5-9 to 5-22 except 5-11; steps: runs from 8 mm, by gain."""
    controllers: list[Gains] = [(float(Kc), float(Ti), float(Td)) for Kc, Ti, Td in inputs["controllers"]]
    before, after, both = ("preliminary model",), ("final model",), ("preliminary model", "final model")

    # Models of Tables 5-3 and 5-4, and the last model of 5.7.
    first = (inputs[name] for name in ("plant_gain", "preliminary_zeros", "preliminary_poles"))
    plants: dict[str, TransferFunction] = {
        "preliminary model": from_roots(*first),
        "final model": identified_plant(inputs),
        "adjusted model": from_roots(
            inputs["adjusted_gain"], [inputs["adjusted_zero"]], inputs["plant_poles"]
        ),
    }
    curves: list[Curves] = []

    def draw(
        figure: str, run: Readings, gains: Gains, models: tuple[str, ...], remark: str = "", end: float = 2.5
    ) -> None:
        loops = {name: (plants[name], printed_pid(*gains, inputs["Ts_s"])) for name in models}
        begin = 1.0 if end > 2.5 else _BEGIN
        shown = {"begin": begin, "end": end, "remark": remark}
        curves.append(coupled.beside_models(f"Fig. 5-{figure}", DEPTH, run, loops, **shown))

    remark = "The gain of Fig. 5-10 is not printed; 0.334 is the next of Table 5-2."
    for number, Kc, said in ((9, 0.5, ""), (10, 0.334, remark)):
        gains = (Kc, inputs["Ti"], inputs["Td"])
        draw(f"{number}: step at $K_c$ = {Kc:g} V/mm", steps[Kc], gains, before, said)
    remark = "Gains of the three steps above; a bit lasts 250 ms: neither is printed."
    for number, ordinal, gains in zip((12, 13, 14), _ORDINALS, controllers, strict=False):
        run = run_of(inputs, "vertical_prbs", changes_of(gains))
        title = f"{number}: pseudo-random binary signal, {ordinal} controller"
        draw(title, run, gains, after, remark, end=6.0)
    down = [step_of(inputs, gains, 10.0, 1.0) for gains in controllers]
    for number, ordinal, gains, run in zip((15, 16, 17, 20), _ORDINALS, controllers, down, strict=True):
        models = (*both, "adjusted model") if number == 20 else both
        draw(f"{number}: step of 1 mm, {ordinal} controller", run, gains, models)
        if number == 15:
            peak = [1.0 + inputs["rig_peak_time_s"]], [11.0 + 0.01 * inputs["rig_overshoot_percent"]]
            curves[-1] = coupled.with_measured(curves[-1], "peak of the rig, Table 7-1", *peak)
    up = step_of(inputs, controllers[2], 10.0, -2.0)
    draw("18: step of -2 mm, third controller", up, controllers[2], both)
    back, series = step_of(inputs, controllers[0], 10.0, -1.0), []
    for name, sign, run in (("down by 1 mm", 1.0, down[0]), ("up by 1 mm", -1.0, back)):
        rows = run.during(_BEGIN, 2.5)
        series.append(Series(name, run.time[rows], sign * (run.seen[rows, DEPTH] - 10.0)))
    title = "Fig. 5-19: steps up and down laid on each other, first controller"
    curves.append(Curves(title, "time (s)", "way along the step (mm)", tuple(series)))
    remarks = ("", "Its gains are not printed; those of Fig. 5-16 are taken.")
    for number, ordinal, gains, said in zip((21, 22), _ORDINALS, controllers, remarks, strict=False):
        run = run_of(inputs, "vertical_ramp", changes_of(gains))
        draw(f"{number}: ramp of 5 mm/s, {ordinal} controller", run, gains, after, said)
    return curves


_BEGIN, _SHOWN, _SETTLED = 0.9, 1.5, 1e-2
_REDUCED, _FULL = Orders(poles=3, zeros=1), Orders(poles=4, zeros=3)
"""Structures (5-15) and (5-13)."""


def records(inputs: dict[str, Any]) -> Answers:
    """Table 5-2 from steps of the coupled machine, and the figures of chapter 5."""
    steps, pairs, zeros = identified(inputs)
    found = {
        "pair_real": pairs.real,
        "pair_imaginary": pairs.imag,
        "zero": zeros[: len(inputs["zero_gains"])],
    }
    one = _of_one_step(inputs, *next(iter(steps.items())))
    curves = (*one, _poles(inputs, pairs), *responses(inputs, steps))
    # A smaller gain, which the calibration at one depth does not exclude.
    less = identified(inputs, inputs["less_gain"])[1].imag.tolist()
    numbers = {name: ours(value, *steps.values()) for name, value in found.items()}
    return Answers(numbers, curves, {"pair_of_less_gain": less})


def identified(
    inputs: dict[str, Any], share: float = 1.0
) -> tuple[dict[float, Readings], NDArray[np.complex128], Array]:
    """Steps at a share of the gains of Table 5-2, and the slowest pair and the zero of (5-15) from each record."""
    steps = {
        float(Kc): step_of(inputs, (float(share * Kc), inputs["Ti"], inputs["Td"]), 8.0, 1.0)
        for Kc in inputs["gains"]
    }
    seen, wanted = (np.array(signals) for signals in zip(*map(_around, steps.values()), strict=True))
    found = identification.modified_least_squares_runs(seen, wanted, _REDUCED)
    return steps, np.array([_slowest_pair(poles) for poles in found.poles]), found.zeros[:, 0].real


def _slowest_pair(poles: NDArray[np.complex128]) -> complex:
    """The pair of poles nearest to q = 1; for two real poles their mean."""
    slowest = poles[np.argsort(np.abs(poles - 1.0))][:2]
    return complex(slowest.real.mean(), np.abs(slowest.imag).max())


def _around(run: Readings) -> tuple[Array, Array]:
    """Measured and reference depth from shortly before the step, mm, relative to the first reference."""
    rows = run.during(_BEGIN)
    begin = run.wanted[rows, DEPTH][0]
    return run.seen[rows, DEPTH] - begin, run.wanted[rows, DEPTH] - begin


def _of_one_step(inputs: dict[str, Any], Kc: float, run: Readings) -> list[Curves]:
    """Figs 5-2 to 5-5: models of one step by two estimators in the structure (5-13), recursive estimates of the four
    coefficients of the denominator over time, the step itself, and the output of the controller."""
    seen, wanted = _around(run)
    time, shown = run.time[run.during(_BEGIN)], slice(0, int(_SHOWN / inputs["Ts_s"]))
    models, remark = [Series("coupled machine (ours)", time[shown], seen[shown])], "Structure (5-13)."
    for name in ("generalised least squares", "modified least squares"):
        estimator = getattr(identification, name.replace(" ", "_"))
        try:
            found = estimator(seen, wanted, _FULL, inputs["Ts_s"], tolerance=_SETTLED)
        except NotConverged:
            remark += f" The {name} do not settle."
        else:
            answer = np.asarray(found.simulate(wanted), dtype=float)
            models.append(Series(name, time[shown], answer[shown]))
            poles = ", ".join(f"{pole:.3f}" for pole in found.poles[:3])
            remark += f" Slowest poles by {name}: {poles}."
    models.append(Series("asked for", time[shown], wanted[shown], "asked"))
    forgetting = float(inputs["forgetting"])
    estimates = identification.recursive_least_squares(
        seen, wanted, _FULL, noise_order=1, forgetting=forgetting
    )
    lines = estimates.history[shown, : _FULL.poles].T
    recursive = tuple(Series(f"$a_{k}$", time[shown], line) for k, line in enumerate(lines))
    rows = run.during(_BEGIN, _BEGIN + _SHOWN)
    signal = Series("output", run.time[rows], run.run.outputs[rows, 0])
    titles = (
        "Fig. 5-2: closed-loop models from the step of Fig. 5-4",
        f"Fig. 5-3: recursive estimates of (5-13), forgetting factor {forgetting:g}",
        f"Fig. 5-4: step from 8 to 9 mm, $K_c$ = {Kc:g} V/mm",
        "Fig. 5-5: output of the controller meanwhile",
    )
    machine, end = {"coupled machine (ours)": run}, _BEGIN + _SHOWN
    return [
        Curves(titles[0], "time (s)", "depth from 8 mm (mm)", tuple(models), remark),
        Curves(titles[1], "time (s)", "coefficient of the denominator", recursive),
        over_time(titles[2], DEPTH, machine, begin=_BEGIN, end=end),
        Curves(titles[3], "time (s)", "output (V)", (signal,)),
    ]


def _poles(inputs: dict[str, Any], pairs: NDArray[np.complex128]) -> Curves:
    """Fig. 5-6: the pair at each gain, from our records and from the rig's."""
    gains = inputs["gains"]
    rig = np.asarray(inputs["measured_real"]), np.asarray(inputs["measured_imaginary"])
    series = (
        Series("from steps of the coupled machine", pairs.real, pairs.imag, points=True),
        Series("from the rig, Table 5-2", *rig, "measured", points=True),
    )
    remark = (
        f"$K_c$ from {min(gains):g} to {max(gains):g} V/mm, right to left; imaginary part 0: two real poles, and the "
        "middle between them."
    )
    title = "Fig. 5-6: closed-loop poles by modified least squares, structure (5-15)"
    return Curves(title, "real part", "imaginary part", series, remark)
