"""Acceptance of a current model: whether it reaches the accuracy of its recipe, and which part of it falls short."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldmap.curves import percent
from fieldmap.errors import MapErrorTooLarge
from fieldmap.inputs.document import AtKey
from fieldmap.maps.forecast import states_needed
from fieldmap.maps.training.plan import MOST_STATES, Plan
from fieldmap.records import Record
from fieldmap.store.stated_accuracy import (
    GRADIENT,
    HELD_OUT,
    MissedAccuracy,
    largest_share,
    missed_accuracy,
)

# The next number of states is extrapolated from the errors of the rounds, up to `_BELIEVED` times the present number.
# If that fails, it is `_MORE` times the present number.
_MORE, _BELIEVED = 2, 8
# For each part of the error: words for its size, words for the shortfall, and the recipe keys that reduce it. Only the
# limit of the states is strict; the training exceeds the limits of modes, points and fields if it must.
_PARTS = {
    "states": ("states and modes leave", "the states fall short", ("states", "modes")),
    "modes": ("", "the modes fall short", ()),
    "points": ("sample points change", "the sample points fall short", ("points",)),
    "condensation": (
        "fewer modes and points change",
        "fewer modes and points than were trained fall short",
        (),
    ),
    "fields": ("the fields of the map leave", "the fields of the map fall short", ("fields",)),
    "": ("", "no part is known to fall short", ()),
}


@dataclass(frozen=True, repr=False)
class Shortfall(Record):
    """Why a current model is less accurate than the recipe asks.

    Attributes
    ----------
    part : the part with the largest error: "states", "modes", "points", "fields" or "condensation"; "" if not known.
    text : the same in words, with the error of each part and the limits that were reached.
    states : number of states that the recipe should allow; None if more states do not help.
    seconds : estimated time to make the map with them, from the time of the states solved so far; None if not known.
    """

    part: str
    text: str
    states: int | None
    seconds: float | None


def require_accuracy(
    about: Mapping[str, Any], plan: Plan | None, target: Path, accept_error: bool
) -> MissedAccuracy | None:
    """Check the accuracy of a map against its plan.

    Parameters
    ----------
    about
        Report of the map, or of its training with `generation_seconds`.
    plan
        Plan of the training; None for a map of linear iron.
    target
        Path of the map, for the message.
    accept_error
        Return a missed accuracy instead of raising an error.

    Returns
    -------
    MissedAccuracy | None
        The missed accuracy; None if the map is accurate enough.

    Raises
    ------
    MapErrorTooLarge
        If the accuracy is missed and `accept_error` is false.
    """
    missed = missed_accuracy(about)
    if missed is not None and plan is not None and not accept_error:
        raise _error_too_large(missed, about, plan, target)
    return missed


def _error_too_large(
    missed: MissedAccuracy, about: Mapping[str, Any], plan: Plan, target: Path
) -> MapErrorTooLarge:
    """The exception for a map that is not written, or that was written earlier because its error was accepted."""
    found, within = shortfall(about, plan), HELD_OUT * missed.asked
    must_hold = (
        "the largest error found must be at most twice the accuracy, "
        f"{percent(within)} of B and {percent(GRADIENT * within)} of the gradient, at every state tried"
    )
    received = (
        f"{percent(missed.flux_density_share)} of B and {percent(missed.gradient_share)} of the gradient at "
        f"{missed.states} states, against the solver on the same mesh; {found.text}"
    )
    remedy = f"{_remedy(found, missed, plan)}; {_acceptance(target, 'accepted_error' in about)}"
    problem = AtKey("currents.accuracy", must_hold, received, remedy)
    return MapErrorTooLarge(problem, reached=missed, part=found.part)


def shortfall(about: Mapping[str, Any], plan: Plan) -> Shortfall:
    """Find the part of a current model with the largest error.

    Parameters
    ----------
    about
        Report of the map or of its training; its `error_parts` are used if present.
    plan
        Plan of the training.
    """
    parts: Mapping[str, Any] = about.get("error_parts") or {}
    shares = {name: float(parts[name]) for name in _PARTS if name in parts}
    limits, taken = parts.get("limits", ()), parts.get("taken", {})
    reached = missed_accuracy(about)
    if shares and reached is not None and "fields" in limits:
        # The fields cause the rest of the error.
        rest = reached.largest_share - sum(shares.values())
        shares |= {"fields": rest} if rest > 0.0 else {}
    largest = max(shares, key=lambda name: shares[name]) if shares else ""
    used = [key for key in _PARTS[largest][2] if key in limits]
    part = "modes" if parts.get("in_vain") else used[0] if used else largest
    states = _states(about, plan) if part == "states" and used else None
    words = [_PARTS[part][1]]
    if part == "modes":
        words.append(
            f"the solved states differ so much that modes leave {percent(parts['modes_leave'])} of one"
        )
    words += [f"{_PARTS[name][0]} {percent(share)}" for name, share in shares.items()]
    if limits:
        words.append("used up: " + ", ".join(f"all {taken[key]} {key}" for key in limits))
    return Shortfall(part, ", ".join(words), states, _seconds(about, plan, states))


def _states(about: Mapping[str, Any], plan: Plan) -> int | None:
    """Number of states to suggest: extrapolated from the errors of the rounds if possible, otherwise twice as many.

    None if the recipe allows the largest number already.
    """
    wanted, rounds = _MORE * plan.states, about.get("rounds", ())
    if len(rounds) > 1:
        errors = [found["errors"] for found in rounds]
        shares = [largest_share(found["flux_density_share"], found["gradient_share"]) for found in errors]
        believed = _BELIEVED * plan.states
        needed = states_needed(shares, [found["solved"] for found in rounds], believed, plan.accuracy)
        wanted = needed if plan.states < needed < believed else wanted
    return min(wanted, MOST_STATES) if plan.states < MOST_STATES else None


def _seconds(about: Mapping[str, Any], plan: Plan, states: int | None) -> float | None:
    """Estimated time to make the map, from the time per state. A changed recipe solves all states again."""
    solved, seconds = about.get("states_solved"), about.get("generation_seconds")
    if not solved or seconds is None:
        return None
    return float(seconds * (1.0 + ((states or plan.states) - plan.states) / solved))


def _remedy(found: Shortfall, missed: MissedAccuracy, plan: Plan) -> str:
    smaller = "make the range of the currents smaller"
    if found.states is None:
        reached = _rounded_up(missed.largest_share / HELD_OUT)
        return f"ask for less, accuracy = {reached:g}, or {smaller}" if reached < 1.0 else smaller
    cost = "all states are solved anew"
    if found.seconds is not None:
        cost = f"about {_duration(found.seconds)}, as {cost}"
    return f"raise currents.states from {plan.states} to {found.states} ({cost}), or {smaller}"


def _acceptance(target: Path, written: bool) -> str:
    if written:
        return (
            f"{target} is there, its error accepted: with --accept-error the same command takes it as it is"
        )
    return (
        f"{target} is not written: with --accept-error (accept_error=True) the same command continues from here, "
        "solves nothing again, and writes it with its error among its assumptions"
    )


def _rounded_up(value: float) -> float:
    """A value rounded up to two digits.

    >>> _rounded_up(0.0061), _rounded_up(0.14201)
    (0.0061, 0.15)
    """
    if not math.isfinite(value):
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.2g}")


def _duration(seconds: float) -> str:
    """A duration in words, in a rough unit.

    >>> _duration(42.0), _duration(754.0), _duration(9000.0)
    ('42 s', '13 minutes', '2.5 hours')
    """
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} minutes" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} hours"
