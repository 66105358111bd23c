"""S14: where the magnet floats as the direction signals change, nothing fitted: Tables 6-2 to 6-7, Figs 6-5, 6-6."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series, percent
from fieldmap.errors import OutsideMapError
from fieldmap.field import FieldLike
from fieldmap.levitation import GRAVITY, MagnetModel, equilibrium_at
from fieldmap.records import Record
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.drive_unit import payload, unit_rays
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.typing import Array

Axis = Literal["x", "y"]
Rule = Literal["constant", "held"]
FAR = 0.34
"""Direction signals beyond this are solved as states: the map is off by 0.1 to 0.2 mm there."""


@dataclass(frozen=True, eq=False, repr=False)
class Shift(Record):
    """Places (k, 2), m, of the magnet at signals (k,), counted from `origin` (2,), the place at signal 0; levels (k,),
    A: mean current; largest (k,), A: that of the coil with most; all_stable: whether every one is pushed back."""

    signals: Array
    places: Array
    origin: Array
    levels: Array
    largest: Array
    all_stable: bool

    @property
    def along(self) -> Array:
        """Shift (k,), m, along the axis that moves most."""
        return self.places[:, int(np.ptp(self.places, axis=0).argmax())]


def shift(
    fields: Sequence[FieldLike],
    signals: ArrayLike,
    axis: Axis = "x",
    n: float = 1.25,
    z_s: float = 10.0,
    h: float = 15.0,
    rule: Rule = "held",
    level: float | None = None,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
    far: float = FAR,
) -> Shift:
    """The magnet followed from signal 0 through signals of one sign, in rising size.

    fields: where to take the field from, in order of preference; the next one where currents are beyond a map's
    domain, the last one for signals beyond `far`. z_s, h: mm. level: current in each coil at the origin, A; (7-18)
    unless given. Raises NoEquilibrium, OutsideMapError.
    """
    start_level = thesis_lift_current(z_s) if level is None else level
    wanted = np.concatenate([[0.0], np.asarray(signals, dtype=float)])
    place, height = np.zeros(2), magnet_height(z_s, 1e-3 * h)
    found, scale, u = [], 1.0, start_level
    for signal in wanted:
        held = rule == "held" and signal != 0.0
        about = (place, u if held else start_level, held, scale, moment, lever)
        for field in fields[-1:] if abs(signal) > far else fields:
            try:
                point, u = equilibrium_at(
                    field, payload(), lambda level, s=signal: (divided(level, s, axis, n), height), *about
                )
                break
            except OutsideMapError:
                if field is fields[-1]:
                    raise
        if signal == 0.0:
            scale = payload().mass * GRAVITY / point.lift
        place = point.position[:2]
        found.append((place.copy(), u, np.abs(divided(u, signal, axis, n)).max(), point.kind == "stable"))
    places, levels, largest, stable = map(np.array, zip(*found, strict=True))
    shifts = places[1:] - places[0]
    return Shift(wanted[1:], shifts, places[0], levels[1:], largest[1:], bool(stable.all()))


def divided(level: float, signal: float, axis: str, n: float) -> Array:
    """Currents (6,), A, at a mean level, A, and a signal along one axis."""
    x, y = (signal, 0.0) if axis == "x" else (0.0, signal)
    return LiftAndDirections(n).currents([level, x, y])


AXES: tuple[Axis, ...] = ("x", "y")
BOTH: tuple[Rule, ...] = ("held", "constant")
_HELD: dict[Rule, str] = {"held": "ours, lift held", "constant": "ours, mean current held"}
DRAWN_H = 15.0
"""The h of curves that show one, mm: the device file's assumption."""


def fields_for(n: float, field_map: Any) -> tuple[FieldLike, ...]:
    """The map where n is its own, then solved states."""
    return (field_map, unit_rays()) if n == 1.25 else (unit_rays(),)


_curve = detail.cached(shift)


def curve(
    field_map: Any, signals: Any, axis: Axis = "x", n: float = 1.25, z_s: float = 10.0, h: float = DRAWN_H,
    rule: Rule = "held",
) -> Shift:  # fmt: skip
    """The static curve, followed from signal 0 to either side; kept."""
    return _curve(fields_for(n, field_map), tuple(np.asarray(signals, float).tolist()), axis, n, z_s, h, rule)


def n_table(inputs: dict[str, Any]) -> Answers:
    """Table 6-2: n = 1.25 and 1.5 at z_s = 10 mm; rows are h."""
    hs, zero = inputs["offsets_mm"], inputs["zero_mm"]
    numbers: dict[str, Any] = {}
    drawn = []
    for n, name in ((1.25, "n125"), (1.5, "n150")):
        signals, measured = inputs[f"{name}_signals"], inputs[f"{name}_measured_mm"]
        points = Series("measured, Table 6-2", signals, measured, "measured", points=True)
        for rule in BOTH:
            of_h = [curve(inputs["map"], signals, n=n, z_s=inputs["z_mm"], h=h, rule=rule) for h in hs]
            numbers[f"{name}_{rule}"] = places = [zero + 1e3 * found.along for found in of_h]
            lines = [Series(f"h = {h:g} mm", signals, x) for h, x in zip(hs, places, strict=True)]
            level = "held by the lift" if rule == "held" else "of (7-18) at the origin throughout"
            title = f"Table 6-2, n = {n:g}, level {level}: scan over h"
            drawn.append(Curves(title, *_LABELS, (points, *lines), remark="Nothing is fitted."))
    return Answers(numbers, tuple(drawn))


_LABELS = ("x control signal", "x (mm)")


def height_table(inputs: dict[str, Any]) -> Answers:
    """Table 6-3: z_s = 10 and 11.5 mm at n = 1.25; rows are h."""
    hs, zero, signals, zs = (inputs[name] for name in ("offsets_mm", "zero_mm", "signals", "heights_mm"))
    numbers: dict[str, Any] = {}
    curves = []
    measured = [
        Series(f"measured, z_s = {z:g} mm", signals, inputs[key], "measured", points=True)
        for z, key in zip(zs, ("upper_mm", "lower_mm"), strict=True)
    ]
    for rule, words in zip(BOTH, ("held by the lift", "constant"), strict=True):
        high, low = ([curve(inputs["map"], signals, z_s=z, h=h, rule=rule).along for h in hs] for z in zs)
        numbers[f"lower_{rule}"] = [zero + 1e3 * along for along in low]
        numbers[f"further_{rule}"] = [1e3 * (a[-1] - b[-1]) for a, b in zip(high, low, strict=True)]
        series = [
            Series(f"ours, z_s = {z:g} mm", signals, zero + 1e3 * found[list(hs).index(DRAWN_H)])
            for z, found in zip(zs, (high, low), strict=True)
        ]
        title = f"Table 6-3, h = {DRAWN_H:g} mm, level {words}"
        curves.append(Curves(title, *_LABELS, (*measured, *series)))
    return Answers(numbers, tuple(curves))


def branches(inputs: dict[str, Any]) -> Answers:
    """Each measured branch beside the one static curve, placed where the outward branch begins."""
    z, axis, drawn = inputs["z_mm"], inputs["axis"], []
    numbers: dict[str, Any] = {}
    for side in ("positive", "negative"):
        signals = inputs[f"{side}_signals"]
        out, back = inputs[f"{side}_outward_mm"], inputs[f"{side}_back_mm"]
        found = {rule: curve(inputs["map"], signals[1:], axis, z_s=z, rule=rule) for rule in BOTH}
        for rule, static in found.items():
            places = out[0] + 1e3 * np.append(0.0, static.along)
            numbers[f"{side}_outward_{rule}"] = places
            if rule == "held":
                numbers[f"{side}_back_{rule}"] = places
            drawn.append(Series(_HELD[rule], signals, places))
        drawn += both_ways("measured", signals, out, back, "measured")
    remark = (
        "A static field gives one curve; the measured positions lead on the way back: "
        "at the same signal the magnet lies nearer to the origin, and beyond it at signal 0."
    )
    labels = (inputs["figure"], f"{axis} control signal", f"{axis} (mm)")
    figure = Curves(*labels, tuple(drawn), remark, message=_follows(drawn))
    return Answers(numbers, (figure,), {"drawn_h_mm": DRAWN_H})


def both_ways(name: str, signals: Array, out: Array, back: Array, kind: str = "ours") -> list[Series]:
    """What is drawn of two branches; both in the order of the signals."""
    points = kind == "measured"
    return [
        Series(f"{name}, outward", signals, out, kind, points),
        Series(f"{name}, on the way back", signals, back, kind, points),
    ]


def _follows(drawn: list[Series]) -> str:
    """How far the magnet moves outward, how far it is from there on the way back, and how far the held model is from
    the outward branch; the largest of both directions."""
    names = (_HELD["held"], "measured, outward", "measured, on the way back")
    held, out, back = (np.array([one.y for one in drawn if one.name == name]) for name in names)
    moved, off, lead = (float(np.abs(a).max()) for a in (out - out[:, :1], held - out, back - out))
    return (
        f"Equilibrium moves {moved:.0f} mm at full signal; the model follows within {percent(off / moved)}; "
        f"the way back differs by {lead:.1f} mm"
    )
