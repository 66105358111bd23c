"""Signals of a scenario: references, outputs in open loop, disturbances, one row per control period."""

from pathlib import Path

import numpy as np

from fieldmap.control import compensated_reference
from fieldmap.control.identification import pseudo_random_binary
from fieldmap.dynamics.scenario.reading import Scenario
from fieldmap.dynamics.scenario.schema import (
    BinaryKeys,
    CircleKeys,
    RampKeys,
    SineKeys,
    StepKeys,
    TableKeys,
)
from fieldmap.typing import Array

AXES = ("x", "y", "depth")
OUTPUTS = ("lift_V", "x", "y")


def references(scenario: Scenario, start_mm: Array) -> Array:
    """(p, 3) x, y, depth in mm of the sensed point, from the start's (3,) on."""
    contents = scenario.contents
    time = control_times(scenario)
    wanted: Array = np.tile(np.asarray(start_mm, float), (len(time), 1))
    for number, piece in enumerate(contents.reference):
        if isinstance(piece, CircleKeys):
            wanted[:, :2] += _circle(piece, time)
        elif isinstance(piece, TableKeys):
            wanted = _table(scenario, piece, f"reference.{number}.file", time)
        else:
            wanted[:, AXES.index(piece.axis)] += _one(piece, time)
    push = contents.control.compensator
    if push is not None:
        depth, aside = 1e-3 * wanted[:, 2], 1e-3 * wanted[:, AXES.index(push.axis)]
        period = 1e-3 * contents.control.period_ms
        lifted = compensated_reference(depth, aside, period, 1e-3 * push.push_mm, 1e-3 * push.duration_ms)
        wanted[:, 2] = 1e3 * lifted
    return wanted


def control_times(scenario: Scenario) -> Array:
    """Times (p,) of the control task, s."""
    period = 1e-3 * scenario.contents.control.period_ms
    return period * np.arange(max(1, round(scenario.contents.duration_s / period)), dtype=np.float64)


def _since(time: Array, at: float) -> Array:
    """Time since `at`, with the first sample at or after it counted as its beginning; negative before."""
    return time - at + 1e-9


def _one(piece: StepKeys | RampKeys | SineKeys | BinaryKeys, time: Array) -> Array:
    since = _since(time, piece.at_s)
    if isinstance(piece, StepKeys):
        made = np.floor(since / piece.every_s + 1e-9) + 1.0
        return piece.by_mm * np.clip(made, 0.0, piece.times)
    if isinstance(piece, RampKeys):
        gone = np.clip(since, 0.0, None) * piece.rate_mm_per_s
        return np.sign(piece.by_mm) * np.minimum(gone, abs(piece.by_mm))
    if isinstance(piece, SineKeys):
        phase = 2.0 * np.pi * piece.frequency_Hz * since
        return np.where(since >= 0.0, piece.amplitude_mm * np.sin(phase), 0.0)
    bits = pseudo_random_binary(piece.order)
    index = np.floor(np.clip(since, 0.0, None) / (1e-3 * piece.bit_ms)).astype(int) % len(bits)
    return np.where(since >= 0.0, piece.amplitude_mm * (bits[index] > 0), 0.0)


def _circle(piece: CircleKeys, time: Array) -> Array:
    """Out along x to the radius, then the angle grows by rate Ts every period."""
    since = _since(time, piece.at_s)
    angle = piece.rate_rad_per_s * np.clip(since - 1e-9, 0.0, None)
    on = (since >= 0.0)[:, None]
    path: Array = piece.radius_mm * on * np.column_stack([np.cos(angle), np.sin(angle)])
    if piece.out_at_s is not None:
        gone = piece.out_mm_per_s * np.clip(time - piece.out_at_s, 0.0, None)
        path[:, 0] += np.where(on[:, 0], 0.0, np.minimum(gone, piece.radius_mm))
    return path


def _table(scenario: Scenario, piece: TableKeys, key: str, time: Array) -> Array:
    path = Path(scenario.path).parent / piece.file
    must = "must be a CSV file of time in s and x, y, depth in mm, with a line of names"
    try:
        rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise scenario.error(key, must, str(error), "correct the path or the file") from None
    if rows.shape[1] != 4 or not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
        received = f"{rows.shape[0]} rows of {rows.shape[1]} numbers"
        raise scenario.error(key, f"{must}, time rising", received, "correct the file")
    return np.column_stack([np.interp(time, rows[:, 0], column) for column in rows[:, 1:].T])


def open_loop_signals(scenario: Scenario) -> Array:
    """(p, 3): what is added to the outputs."""
    time = control_times(scenario)
    added = np.zeros((len(time), 3))
    for piece in scenario.contents.signal:
        added[:, OUTPUTS.index(piece.output)] += np.where(_since(time, piece.at_s) >= 0.0, piece.by, 0.0)
    return added


def disturbances(scenario: Scenario) -> Array:
    """(p, 6) force in N and torque; (1, 6) zeros where there is none."""
    pieces = scenario.contents.disturbance
    if not pieces:
        return np.zeros((1, 6))
    time = control_times(scenario)
    loads = np.zeros((len(time), 6))
    for piece in pieces:
        on = (_since(time, piece.from_s) >= 0.0) & (_since(time, piece.until_s) < 0.0)
        loads[on, :3] += 1e-3 * np.asarray(piece.force_mN)
    return loads
