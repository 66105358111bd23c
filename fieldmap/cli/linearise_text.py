"""The answer of `fieldmap linearise`, for people and as JSON."""

from typing import Any

import numpy as np

from fieldmap.cli.linearising import Outcome
from fieldmap.cli.printing import assumption_lines, facts, heading, print_page, table
from fieldmap.dynamics.scenario import LinearPoint


def print_points(outcome: Outcome) -> None:
    """Print poles, coupling, loop and margins, a line for each depth or more."""
    title = outcome.experiment.scenario.contents.title
    points = outcome.points
    print_page(
        heading(title, str(outcome.wanted.scenario)),
        table(("depth mm", "pole 1/s", "Hz", "damping", "moves", "reached", "seen"), _modes(points)),
        table(("depth mm", "from", "to x mm", "to y mm", "to z mm", "relative gain"), _coupling(points)),
        table(("depth mm", "loop", "slowest pole 1/s", "least damping", "at Hz"), _loops(points)),
        table(
            ("depth mm", "loop at", "phase deg", "at Hz", "gain up", "gain down", "modulus"), _margins(points)
        ),
        facts(assumption_lines(points[0].linear.assumptions)),
        facts([("written", str(outcome.written))]) if outcome.written else None,
    )


def _modes(points: tuple[LinearPoint, ...]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = []
    for point in points:
        for mode in point.modes:
            # One line for a pair.
            if mode.pole.imag < -1e-9:
                continue
            shares = mode.named_shares(point.linear)
            lines.append(
                (
                    f"{point.depth_mm:g}",
                    _complex(mode.pole),
                    f"{mode.frequency:.3f}",
                    f"{mode.damping:.3f}",
                    ", ".join(sorted(shares, key=lambda name: -shares[name])),
                    f"{mode.input_gains.max():.3g}",
                    f"{mode.output_gains.max():.3g}",
                )
            )
    return lines


def _complex(value: complex) -> str:
    return f"{value.real:.3f}" + (f" ± {abs(value.imag):.3f}i" if abs(value.imag) > 1e-9 else "")


def _coupling(points: tuple[LinearPoint, ...]) -> list[tuple[str, ...]]:
    """Where each signal moves the body, its loops open; and its relative gain with the axis that it belongs to."""
    lines: list[tuple[str, ...]] = []
    for point in points:
        gain, relative = 1e3 * point.coupling.gain, point.coupling.relative
        for k, name in enumerate(signals(point)):
            cells = [f"{value:.4g}" for value in gain[:, k]]
            lines.append((f"{point.depth_mm:g}", name, *cells, f"{relative[k, k]:.3f}"))
    return lines


def signals(point: LinearPoint) -> tuple[str, ...]:
    """Names of the inputs in the order of `coupling`."""
    names = point.linear.inputs
    return (names[1], names[2], names[0]) if names[:1] == ("lift_V",) else names


def _loop_poles(point: LinearPoint) -> Any:
    """Of the closed loop in 1/s, without those of pure delays; the most sluggish or unstable first."""
    poles = point.loop.poles
    there = poles[np.abs(poles) > 1e-6]
    found = np.log(there.astype(complex)) / point.loop.period
    return found[np.argsort(-found.real)]


def _loops(points: tuple[LinearPoint, ...]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = []
    for point in points:
        poles = _loop_poles(point)
        damping = -poles.real / np.maximum(np.abs(poles), 1e-12)
        least = int(np.argmin(damping))
        lines.append(
            (
                f"{point.depth_mm:g}",
                "stable" if point.loop.stable else "UNSTABLE",
                _complex(complex(poles[0])),
                f"{damping[least]:.3f}",
                f"{abs(poles[least].imag) / (2 * np.pi):.3f}",
            )
        )
    return lines


def _margins(points: tuple[LinearPoint, ...]) -> list[tuple[str, ...]]:
    return [
        (
            f"{point.depth_mm:g}",
            found.output,
            f"{found.phase:.1f}",
            f"{found.crossover:.3f}",
            f"{found.gain_up:.3g}",
            f"{found.gain_down:.3g}",
            f"{found.modulus:.3f}",
        )
        for point in points
        for found in point.margins
    ]


def as_json(outcome: Outcome) -> dict[str, Any]:
    """The same as numbers: SI, but for names that end in _mm and for margins in degrees. Poles as [real, imaginary]."""
    first = outcome.experiment
    return {
        "scenario": str(first.scenario.path.name),
        "title": first.scenario.contents.title,
        "states": outcome.points[0].linear.states,
        "inputs": outcome.points[0].linear.inputs,
        "outputs": outcome.points[0].linear.outputs,
        "points": [_point_json(point) for point in outcome.points],
        "assumptions": outcome.points[0].linear.assumptions,
        "written": outcome.written,
    }


def _point_json(point: LinearPoint) -> dict[str, Any]:
    linear, controllability = point.linear, point.controllability
    return {
        "depth_mm": point.depth_mm,
        "rest": {
            "sensed": linear.operating_point.sensed,
            "currents": linear.operating_point.currents,
            "outputs": linear.operating_point.outputs,
        },
        **{name: getattr(linear, name) for name in ("A", "B", "C", "D", "G")},
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
        "controllability": controllability.controllability,
        "observability": controllability.observability,
        "coupling": {
            "signals": signals(point),
            "gain": point.coupling.gain,
            "relative": point.coupling.relative,
        },
        "loop": {
            "stable": point.loop.stable,
            "period_s": point.loop.period,
            "poles": [_pair(pole) for pole in _loop_poles(point)],
            **{name: getattr(point.loop, name) for name in ("A", "B", "C")},
        },
        "margins": point.margins,
    }


def _pair(value: complex) -> list[float]:
    return [float(value.real), float(value.imag)]
