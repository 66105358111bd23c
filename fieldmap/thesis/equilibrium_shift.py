"""S14: equilibrium positions of the magnet over the direction signals, without fitting: Tables 6-2 to 6-7, Figs 6-5,
6-6. Further studies of these curves: polynomial fits, current limit, convergence, magnet models, effect of current
noise on the position, and calibrations of the model to these curves and to the lift of S12."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from fieldmap import levitation
from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series, percent
from fieldmap.errors import OutsideMapError
from fieldmap.field import FieldLike
from fieldmap.levitation import LiftReadings, MagnetModel, PositionReadings, stationary_points
from fieldmap.records import Record
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers, Ours
from fieldmap.thesis.drive_unit import UnitRays, UnitStates, lift_share, payload, unit_rays, unit_states
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.typing import Array

Axis = Literal["x", "y"]
Rule = Literal["constant", "held"]
FAR = 0.34
"""Direction signals beyond this are solved as states, because the error of the map there is 0.1 to 0.2 mm."""
DRAWN_H = 15.0
"""The value of h, mm, in curves with a single h: the device file's assumption."""


@dataclass(frozen=True, eq=False, repr=False)
class Shift(Record):
    """Positions `places` (k, 2), m, of the magnet at signals (k,), relative to `origin` (2,), the position at signal 0;
    levels (k,), A: mean current; largest (k,), A: largest coil current; all_stable: whether all are stable."""

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
    h: float = DRAWN_H,
    rule: Rule = "held",
    level: float | None = None,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
    far: float = FAR,
) -> Shift:
    """Follow the magnet from signal 0 through signals of one sign, in rising size.

    fields: sources of the field, in order of preference. The next one is used if currents are beyond a map's domain,
    the last one for signals beyond `far`. z_s, h: mm. level: current in each coil at the origin, A; (7-18) by default.
    Raises NoEquilibrium, OutsideMapError.
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
                point, u = levitation.equilibrium_at(
                    field, payload(), lambda level, s=signal: (divided(level, s, axis, n), height), *about
                )
                break
            except OutsideMapError:
                if field is fields[-1]:
                    raise
        if signal == 0.0:
            scale = payload().mass * levitation.GRAVITY / point.lift
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


def fields_for(n: float, field_map: Any) -> tuple[FieldLike, ...]:
    """The map, if it has this n, then solved states."""
    return (field_map, unit_rays()) if n == 1.25 else (unit_rays(),)


_curve = detail.cached(shift)


def curve(
    field_map: Any, signals: Any, axis: Axis = "x", n: float = 1.25, z_s: float = 10.0, h: float = DRAWN_H,
    rule: Rule = "held",
) -> Shift:  # fmt: skip
    """The static curve, followed from signal 0; cached."""
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
    """Compare each measured branch with the single static curve, shifted to the beginning of the outward branch."""
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
    """Series of two branches, both in the order of the signals."""
    points = kind == "measured"
    return [
        Series(f"{name}, outward", signals, out, kind, points),
        Series(f"{name}, on the way back", signals, back, kind, points),
    ]


def _follows(drawn: list[Series]) -> str:
    """One line: largest outward motion, error of the model with held lift, and distance between the two branches."""
    names = (_HELD["held"], "measured, outward", "measured, on the way back")
    held, out, back = (np.array([one.y for one in drawn if one.name == name]) for name in names)
    moved, off, lead = (float(np.abs(a).max()) for a in (out - out[:, :1], held - out, back - out))
    return (
        f"Equilibrium moves {moved:.0f} mm at full signal; the model follows within {percent(off / moved)}; "
        f"the way back differs by {lead:.1f} mm"
    )


def fits(inputs: dict[str, Any]) -> Answers:
    """(6-4), (6-5): the printed polynomials against the printed tables, and the same fit to our curves."""
    numbers: dict[str, Any] = {}
    drawn = []
    for axis, number in zip(AXES, ("(6-4)", "(6-5)"), strict=True):
        signals, measured = inputs[f"{axis}_signals"], inputs[f"{axis}_mm"]
        held = curve(inputs["map"], signals[1:], axis)
        places = measured[0] + 1e3 * np.append(0.0, held.along)
        ours, again = (Polynomial.fit(signals, mm, 4).convert() for mm in (places, measured))
        printed = Polynomial(inputs[f"{axis}_polynomial"][::-1])
        roots = (ours - measured[0] - 1.0).roots()
        forward = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
        numbers[f"{axis}_polynomial"] = ours.coef[::-1]
        numbers[f"{axis}_table_again"] = again.coef[::-1]
        numbers[f"{axis}_at_step"] = float(printed(inputs[f"{axis}_step_signal"]))
        numbers[f"{axis}_step_signal"] = forward.min() if len(forward) else np.nan
        fine = np.linspace(0.0, signals[-1], 81)
        series = (
            Series(f"measured, {axis}", signals, measured, "measured", points=True),
            Series(f"printed polynomial, {axis}", fine, printed(fine), "published"),
            Series(f"ours, {axis}", fine, ours(fine)),
        )
        drawn.append(Curves(f"{number} and the same fit to ours", "control signal", "position (mm)", series))
    return Answers(numbers, tuple(drawn), {"drawn_h_mm": DRAWN_H})


def limits(inputs: dict[str, Any]) -> Answers:
    """The signal at which the largest coil current reaches the amplifier's limit, with the lift held."""
    limit, numbers, series = inputs["current_limit_A"], {}, []
    for n, name in ((1.25, "n125"), (1.5, "n150")):
        signals = inputs[f"{name}_signals"]
        found = [curve(inputs["map"], signals, n=n, h=h) for h in inputs["offsets_mm"]]
        numbers[f"{name}_last_signal"] = [_crossing(signals, of_h.largest, limit) for of_h in found]
        series.append(Series(f"n = {n:g}", signals, found[1].largest))
    end = max(float(inputs[f"{name}_signals"][-1]) for name in ("n125", "n150"))
    series.append(Series("limit of the amplifier", np.array([0.0, end]), np.full(2, limit), "published"))
    title = f"Largest coil current while the lift is held, z_s = 10 mm, h = {inputs['offsets_mm'][1]:g} mm"
    return Answers(numbers, (Curves(title, "x control signal", "current (A)", tuple(series)),))


def _crossing(signals: Array, largest: Array, limit: float) -> float:
    """Signal at which the largest current passes the limit; extrapolated from the last two signals beyond the last."""
    k = int(np.clip(np.searchsorted(largest, limit), 1, len(signals) - 1))
    share = (limit - largest[k - 1]) / (largest[k] - largest[k - 1])
    return float(signals[k - 1] + share * (signals[k] - signals[k - 1]))


FINER = 1.3
"""Mesh sizes of the device file are divided by this."""


@detail.cached
def finer_unit() -> UnitStates:
    """The unit on a finer mesh."""
    return UnitStates(refinement=detail.refinement(FINER))


def convergence(inputs: dict[str, Any]) -> Answers:
    """Positions at a constant level on the shipped mesh, on a finer mesh, and from the map; h = 15 mm."""
    signals, z_s = inputs["signals"], inputs["z_mm"]
    sources = (unit_rays(), UnitRays(finer_unit()), inputs["map"])
    of = [shift((source,), signals, h=DRAWN_H, z_s=z_s, rule="constant") for source in sources]
    places = np.array([1e3 * (found.along + found.origin[0]) for found in of])
    mesh, by_map = np.abs(places[0] - places[1]).max(), np.abs(places[0] - places[2]).max()
    facts = {"refinement": detail.refinement(FINER), "mesh_mm": mesh, "map_mm": by_map, "drawn_h_mm": DRAWN_H}
    return Answers({"constant": places}, facts=facts)


MODELS: tuple[tuple[MagnetModel, float], ...] = (
    ("fixed", 0.0),
    ("aligned", 0.0),
    ("rigid upright", 0.0),
    ("rigid", 0.0),
    ("rigid", 5e-3),
)


def magnet_models(inputs: dict[str, Any]) -> Answers:
    """Table 6-2 for each model of the magnet, and the field's stiffness at the origin."""
    signals, z_s, zero = inputs["signals"], inputs["z_mm"], inputs["zero_mm"]
    fields = fields_for(1.25, inputs["map"])
    found = [
        shift(fields, signals, h=DRAWN_H, z_s=z_s, moment=moment, lever=lever) for moment, lever in MODELS
    ]
    names = [f"{moment}, lever {1e3 * lever:g} mm" if lever else moment for moment, lever in MODELS]
    places = [zero + 1e3 * of.along for of in found]
    numbers = {"x": Ours(places, levitation.model_assumptions("rigid", 5e-3))}
    series = [Series(name, signals, x) for name, x in zip(names, places, strict=True)]
    points = Series("measured", signals, inputs["measured_mm"], "measured", points=True)
    figure = Curves("Models of the magnet", "x control signal", "x (mm)", (points, *series))
    # Stationary points of the map's box at the origin's currents, and the stiffness and its trace (Earnshaw) there.
    currents = np.full(6, thesis_lift_current(z_s))
    rest = stationary_points(inputs["map"], currents, payload(), magnet_height(z_s, 1e-3 * DRAWN_H))
    point = rest.points[0]
    facts = {
        "models": "; ".join(names),
        "drawn_h_mm": DRAWN_H,
        "current_A": currents[0],
        "points": len(rest.points),
        "kind": point.kind,
        "turns": rest.boundary_index,
        "eigenvalues": np.linalg.eigvalsh(0.5 * (point.stiffness + point.stiffness.T)),
        "trace": abs(point.trace),
    }
    return Answers(numbers, (figure,), facts)


def own_current(inputs: dict[str, Any]) -> Answers:
    """The shift near the level at which the model itself carries the weight, so that no force is scaled."""
    signals, level = inputs["signals"], inputs["level_A"]
    found = shift((unit_rays(),), signals, rule="constant", h=DRAWN_H, z_s=inputs["z_mm"], level=level)
    at_measured = curve(inputs["map"], signals, rule="constant")
    facts = {
        "share": lift_share(unit_rays(), inputs["z_mm"], DRAWN_H, level),
        "ratio": at_measured.along / found.along,
        "measured_level_A": thesis_lift_current(10.0),
        "drawn_h_mm": DRAWN_H,
    }
    return Answers({"x": inputs["zero_mm"] + 1e3 * found.along}, facts=facts)


@detail.cached
def sensitivity_at_origin() -> levitation.Sensitivity:
    """Sensitivity at the current of (7-18), z_s = 10 mm, h = 15 mm, from twelve states with +-0.035 A in one coil."""
    states, currents = unit_states(), np.full(6, thesis_lift_current(10.0))
    height = magnet_height(10.0, 1e-3 * DRAWN_H)
    (point,) = stationary_points(states, currents, payload(), height, samples=10).points
    return levitation.equilibrium_sensitivity(states, currents, payload(), point.position, step=0.035)


def noise(inputs: dict[str, Any]) -> Answers:
    """RMS position by independent current noise of Table 3-10, and the noise that would explain the measured RMS."""
    found = sensitivity_at_origin()
    deviation = float(np.mean(inputs["deviation_A"]))
    rms = {held: 1e3 * np.sqrt(np.diag(found.noise(deviation, held))) for held in (False, True)}
    explained = float(inputs["seen_rms_mm"]) / float(np.sqrt(np.mean(rms[True] ** 2))) * deviation
    per_coil = ", ".join(
        f"{name}: ({1e3 * x:+.2f}, {1e3 * y:+.2f})"
        for name, (x, y) in zip(unit_states().coil_names, found.at_held_height.T, strict=True)
    )
    facts = {
        "drawn_h_mm": DRAWN_H,
        "mean_deviation_A": deviation,
        "per_coil": per_coil,
        "rms_mm": rms[True],
        "explained_mA": 1e3 * explained,
        "weight_mN": 1e3 * payload().mass * levitation.GRAVITY,
    }
    return Answers({"rms_height_held": rms[False], "rms_lift_held": rms[True]}, facts=facts)


FITS: dict[str, tuple[tuple[str, ...], str]] = {
    "scale": (("field_scale",), ""),
    "scale_and_h": (("field_scale", "magnet_offset"), ""),
    "with_x": (("field_scale", "magnet_offset", "current_scale"), "x"),
    "with_x_and_y": (("field_scale", "magnet_offset", "current_scale"), "xy"),
}
"""Name -> free parameters, and axes whose positions are fitted besides (7-18). Fixed values: h = 15 mm, scales 1."""
OFFSET_LIMITS = (5e-3, 30e-3)
"""Limits, m: the magnet is 10 mm tall and lies inside the body."""


def calibrations(inputs: dict[str, Any]) -> Answers:
    """(7-18) and Tables 6-4, 6-6 before and after each fit."""
    field, depths = detail.available_map("division", outside_currents="evaluate"), inputs["depths_mm"]
    tables: dict[str, tuple[Array, Array]] = {
        axis: (inputs[f"{axis}_signals"], inputs[f"{axis}_mm"]) for axis in AXES
    }
    deviation, mm = inputs["lift_deviation"], inputs["position_deviation_mm"]
    law = np.array([thesis_lift_current(z) for z in depths])
    heights, amperes = [magnet_height(z) for z in depths], np.outer(law, np.ones(6))
    lift = LiftReadings(heights, amperes, deviation)
    lines = {"lift": [Series("measured, (7-18)", depths, np.ones(len(depths)), "measured")]}
    lines |= {of: [Series("measured, rising", *one, "measured", points=True)] for of, one in tables.items()}
    numbers: dict[str, Any] = {}
    said = {}
    for name, (free, axes) in FITS.items():
        fit = levitation.calibrate(
            field,
            payload(),
            lift=lift,
            positions=_position_readings({axis: tables[axis] for axis in axes}, 1e-3 * mm) if axes else None,
            fit=free,
            limits={"magnet_offset": OFFSET_LIMITS},
        )
        # Values of all readings with the fitted parameters: all lifts, and all positions except at signal 0.
        every = levitation.calibrate(
            field,
            payload(),
            lift=lift,
            positions=_position_readings(tables, 1e-3 * mm),
            fit=("field_scale",),
            given=fit.values,
        )
        before = np.array([row.before for row in every.table])
        lifts, _, *ways = np.split(before, np.cumsum([len(depths), 2, len(tables["x"][0]) - 1]))
        found = {"lift": lifts}
        for (axis, (_, places)), way in zip(tables.items(), ways, strict=True):
            found[axis] = places[0] + np.append(0.0, 1e3 * way)
        v, deviations = fit.values, fit.deviations
        fitted = ", ".join(f"{key} = {v[key]:.4g} +- {deviations[key]:.1g}" for key in fit.fitted)
        rests_on = (
            *fit.assumptions,
            f"fit `{name}`: {fitted} (magnet_offset in m)",
            f"misfit {fit.misfit:.2f} deviations, {fit.misfit_before:.1f} with nothing fitted; deviations assumed: "
            f"{percent(deviation)} of a current, {mm:g} mm",
        )
        answers = {"current": law / lifts, "x": found["x"], "y": found["y"]}
        numbers |= {f"{of}_{name}": Ours(values, rests_on) for of, values in answers.items()}
        for of, drawn in lines.items():
            drawn.append(Series(f"fit `{name}`", drawn[0].x, found[of]))
        said[name] = (
            f"force times {v['field_scale']:.2f}, h = {1e3 * v['magnet_offset']:.1f} mm, currents times "
            f"{v['current_scale']:.2f}, misfit {fit.misfit:.1f} deviations"
        )
    title, x = "Lift at the measured currents, after each fit", "sensor depth z_s (mm)"
    curves = [Curves(title, x, "lift over weight", tuple(lines["lift"]))]
    for axis in AXES:
        title, x = f"Shift along {axis} after each fit", f"{axis} control signal"
        curves.append(Curves(title, x, f"{axis} (mm)", tuple(lines[axis])))
    return Answers(numbers, tuple(curves), said)


def _position_readings(tables: Mapping[str, tuple[Array, Array]], deviation: float) -> PositionReadings:
    """Readings of rising branches, mm over signals; positions are relative to the first reading, at signal 0."""
    level = thesis_lift_current(10.0)
    currents, places = [np.full(6, level)], [[0.0, 0.0]]
    for axis, (signals, mm) in tables.items():
        for signal, moved in zip(signals[1:], 1e-3 * (mm[1:] - mm[0]), strict=True):
            currents.append(divided(level, signal, axis, 1.25))
            places.append([moved, np.nan] if axis == "x" else [np.nan, moved])
    sensed = np.full(len(places), magnet_height(10.0))
    return PositionReadings(sensed, currents, places, deviation, height_held=True, from_first=True)
