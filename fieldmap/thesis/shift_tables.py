"""S14: Tables 6-2 to 6-7 and Figs 6-5, 6-6 beside the static curve of the unit."""

from functools import cache
from typing import Any, Literal

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.levitation import LevitationField
from fieldmap.thesis.registry import Answers, Ours
from fieldmap.thesis.shifts import COMMON, MAP_WORDS, RULES, Rule, Shift, shift, unit_rays
from fieldmap.thesis.unit_rays import WORDS
from fieldmap.typing import Array

Axis = Literal["x", "y"]
AXES: tuple[Axis, ...] = ("x", "y")
BOTH: tuple[Rule, ...] = ("held", "constant")
DRAWN_H = 15.0
"""The h of curves that show one, mm: the device file's assumption."""


def fields_for(n: float, field_map: Any) -> tuple[LevitationField, ...]:
    """The map where n is its own, then solved states."""
    return (field_map, unit_rays()) if n == 1.25 else (unit_rays(),)


@cache
def _curve(
    field_map: Any, signals: tuple[float, ...], axis: Axis, n: float, z_s: float, h: float, rule: Rule
) -> Shift:
    return shift(fields_for(n, field_map), signals, axis, n, z_s, h, rule)


def curve(
    field_map: Any, signals: Any, axis: Axis = "x", n: float = 1.25, z_s: float = 10.0, h: float = DRAWN_H,
    rule: Rule = "held",
) -> Shift:  # fmt: skip
    """The static curve, followed from signal 0 to either side; kept."""
    return _curve(field_map, tuple(float(s) for s in np.asarray(signals)), axis, n, z_s, h, rule)


def words(rule: Rule, *more: str) -> tuple[str, ...]:
    """What a table of shifts rests on."""
    return (*COMMON, RULES[rule], MAP_WORDS, WORDS, *more)


def n_table(inputs: dict[str, Any]) -> Answers:
    """Table 6-2: n = 1.25 and 1.5 at z_s = 10 mm; rows are h."""
    hs, zero = inputs["offsets_mm"], inputs["zero_mm"]
    origin = f"the sensor's zero is set so that signal 0 reads {zero:g} mm, as in Table 6-4"
    numbers, drawn = {}, []
    for n, name in ((1.25, "n125"), (1.5, "n150")):
        signals, measured = inputs[f"{name}_signals"], inputs[f"{name}_measured_mm"]
        for rule in BOTH:
            of_h = [curve(inputs["map"], signals, n=n, z_s=inputs["z_mm"], h=h, rule=rule) for h in hs]
            numbers[f"{name}_{rule}"] = Ours(
                [zero + 1e3 * found.along for found in of_h],
                words(rule, origin, f"rows: h = {', '.join(f'{h:g}' for h in hs)} mm"),
            )
            drawn.append(_scan(name, n, rule, hs, of_h, signals, measured, zero))
    return Answers(numbers, tuple(drawn))


def _scan(
    name: str, n: float, rule: str, hs: Any, of_h: list[Shift], signals: Array, measured: Array, zero: float
) -> Curves:
    lines = [
        Series(f"h = {h:g} mm", found.signals, zero + 1e3 * found.along)
        for h, found in zip(hs, of_h, strict=True)
    ]
    points = Series("measured, Table 6-2", signals, measured, "measured", points=True)
    level = "level held by the lift" if rule == "held" else "level of (7-18) at the origin throughout"
    remark = "Nothing is fitted. " + RULES[rule][0].upper() + RULES[rule][1:] + "."
    return Curves(
        f"Table 6-2, n = {n:g}, {level}: scan over h",
        "x control signal (1)",
        "x (mm)",
        (points, *lines),
        remark=remark,
    )


def height_table(inputs: dict[str, Any]) -> Answers:
    """Table 6-3: z_s = 10 and 11.5 mm at n = 1.25; rows are h."""
    hs, zero, signals = inputs["offsets_mm"], inputs["zero_mm"], inputs["signals"]
    origin = f"signal 0 reads {zero:g} mm at both heights; rows: h = {', '.join(f'{h:g}' for h in hs)} mm"
    numbers: dict[str, Any] = {}
    curves = []
    for rule in BOTH:
        high, low = (
            [curve(inputs["map"], signals, z_s=z, h=h, rule=rule) for h in hs] for z in inputs["heights_mm"]
        )
        about = words(rule, origin)
        numbers[f"lower_{rule}"] = Ours([zero + 1e3 * found.along for found in low], about)
        further = [1e3 * (a.along[-1] - b.along[-1]) for a, b in zip(high, low, strict=True)]
        numbers[f"further_{rule}"] = Ours(further, about)
        series = [
            Series(f"ours, z_s = {z:g} mm", signals, zero + 1e3 * found[list(hs).index(DRAWN_H)].along)
            for z, found in zip(inputs["heights_mm"], (high, low), strict=True)
        ]
        measured = [
            Series(f"measured, z_s = {z:g} mm", signals, inputs[key], "measured", points=True)
            for z, key in zip(inputs["heights_mm"], ("upper_mm", "lower_mm"), strict=True)
        ]
        title = f"Table 6-3, h = {DRAWN_H:g} mm, level {'held by the lift' if rule == 'held' else 'constant'}"
        curves.append(Curves(title, "x control signal (1)", "x (mm)", (*measured, *series)))
    return Answers(numbers, tuple(curves))


def x_branches(inputs: dict[str, Any]) -> Answers:
    """Tables 6-4, 6-5 and Fig. 6-5."""
    return _branches(inputs, "x", "Fig. 6-5: Tables 6-4 and 6-5")


def y_branches(inputs: dict[str, Any]) -> Answers:
    """Tables 6-6, 6-7 and Fig. 6-6."""
    return _branches(inputs, "y", "Fig. 6-6: Tables 6-6 and 6-7")


def _branches(inputs: dict[str, Any], axis: Axis, title: str) -> Answers:
    """Each measured branch beside the one static curve, placed where the outward branch begins."""
    z, numbers, drawn = inputs["z_mm"], {}, []
    for side in ("positive", "negative"):
        signals = inputs[f"{side}_signals"]
        out, back = inputs[f"{side}_outward_mm"], inputs[f"{side}_back_mm"]
        found = {rule: curve(inputs["map"], signals[1:], axis, z_s=z, rule=rule) for rule in BOTH}
        for rule, static in found.items():
            places = out[0] + 1e3 * np.append(0.0, static.along)
            about = words(rule, f"h = {DRAWN_H:g} mm", f"signal 0 reads {out[0]:g} mm, as the branch begins")
            numbers[f"{side}_outward_{rule}"] = Ours(places, about)
            if rule == "held":
                numbers[f"{side}_back_{rule}"] = Ours(places, about)
            drawn.append(Series(f"ours, {rule} level", signals, places))
        drawn.append(Series("measured, outward", signals, out, "measured", points=True))
        drawn.append(Series("measured, on the way back", signals, back, "measured", points=True))
    remark = (
        "A static field gives one curve; the measured positions lead on the way back: "
        "at the same signal the magnet lies nearer to the origin, and beyond it at signal 0."
    )
    figure = Curves(title, f"{axis} control signal (1)", f"{axis} (mm)", tuple(drawn), remark=remark)
    return Answers(numbers, (figure,))
