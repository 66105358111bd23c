"""Whether a current model is as accurate as its recipe asks; if not, which part falls short, and what would help."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fieldmap.errors import MapErrorTooLarge
from fieldmap.inputs.document import Document
from fieldmap.maps.recipe import Plan, Recipe
from fieldmap.maps.training.expected import states_needed
from fieldmap.records import Record
from fieldmap.store.stated_accuracy import GRADIENT, HELD_OUT, MissedAccuracy, missed_accuracy, percent

# The most that a recipe can ask for (`fieldmap.maps.recipe.CurrentKeys`).
_MOST = {"states": 4096, "modes": 200, "points": 5000, "fields": 100}
# Where the rounds do not tell how many states are needed: so many times as many. They are believed up to so many times.
_MORE, _BELIEVED = 2, 8
# What each part of the error is called.
_LEFT = {
    "states": "states and modes leave",
    "points": "sample points change",
    "condensation": "fewer modes and points change",
    "fields": "the fields of the map leave",
}
_SHORT = {
    "states": "the states fall short",
    "modes": "the modes fall short",
    "points": "the sample points fall short",
    "condensation": "fewer modes and points than were trained fall short",
    "fields": "the fields of the map fall short",
    "": "no part is known to fall short",
}
# Keys of a recipe that lessen each part.
_KEYS = {"states": ("states", "modes"), "points": ("points",), "condensation": (), "fields": ("fields",)}


@dataclass(frozen=True, repr=False)
class Shortfall(Record):
    """Why a current model is less accurate than was asked for.

    part: "states", "modes", "points", "fields" or "condensation", "" where that is not known; text: that in words, with
    what each part leaves, and what was used up; raised: keys of [currents] that would have to be raised, and to what;
    seconds: what making the map would take then, by the states solved so far, None where that is not known.
    """

    part: str
    text: str
    raised: Mapping[str, int]
    seconds: float | None


def require_accuracy(
    about: Mapping[str, Any], recipe: Recipe, target: Path, accept_error: bool
) -> MissedAccuracy | None:
    """What a map misses of the accuracy of its recipe. about: its report, or what was found in training, with
    `generation_seconds`. Raises MapErrorTooLarge unless that is nothing, or accepted."""
    missed = missed_accuracy(about)
    if missed is not None and recipe.currents is not None and not accept_error:
        raise _error_too_large(missed, about, recipe, recipe.currents.training, target)
    return missed


def record_of_acceptance(accepted: MissedAccuracy | None) -> dict[str, Any]:
    """What the report of a map says of an error that was accepted."""
    if accepted is None:
        return {}
    names = ("flux_density_share", "gradient_share", "asked")
    return {"accepted_error": {name: getattr(accepted, name) for name in names}}


def assumption_of_acceptance(accepted: MissedAccuracy | None) -> tuple[str, ...]:
    """What a map rests on whose error was accepted: one sentence."""
    return () if accepted is None else (f"{accepted.text}: accepted with --accept-error",)


def _error_too_large(
    missed: MissedAccuracy, about: Mapping[str, Any], recipe: Recipe, plan: Plan, target: Path
) -> MapErrorTooLarge:
    """The error of a map that is not written, or of one that was because its error was accepted."""
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
    document = Document(recipe.path, recipe.text, {})
    problem = document.problem("currents.accuracy", must_hold, received, remedy)
    return MapErrorTooLarge(problem, reached=missed, part=found.part)


def shortfall(about: Mapping[str, Any], plan: Plan) -> Shortfall:
    """Which part of a current model falls short, by what was found in training: `error_parts`, where they are there,
    with the errors that states, points and condensation leave and the keys of the plan that were used up; otherwise by
    what was used up."""
    parts: Mapping[str, Any] = about.get("error_parts") or {}
    shares = {name: float(parts[name]) for name in _LEFT if name in parts}
    used = tuple(parts["limits"]) if "limits" in parts else _used_up(about, plan)
    reached = missed_accuracy(about)
    if shares and reached is not None and "fields" in used:
        # What none of the others accounts for.
        rest = reached.largest_share - sum(shares.values())
        shares |= {"fields": rest} if rest > 0.0 else {}
    largest = max(shares, key=lambda name: shares[name]) if shares else ""
    # Without shares what was used up first is the likeliest.
    keys = [key for key in _KEYS.get(largest, _MOST) if key in used][: None if shares else 1]
    part = keys[0] if keys else largest
    enough = {key: _enough(key, about, plan) for key in keys}
    raised = {key: value for key, value in enough.items() if value > getattr(plan, key)}
    words = [_SHORT[part], *(f"{_LEFT[name]} {percent(share)}" for name, share in shares.items())]
    if used:
        words.append("used up: " + ", ".join(f"all {getattr(plan, key)} {key}" for key in used))
    return Shortfall(part, ", ".join(words), raised, _seconds(about, plan, raised))


def _used_up(about: Mapping[str, Any], plan: Plan) -> tuple[str, ...]:
    """Keys of a plan of which a training took all that they allow, for reports that do not say."""
    in_sequence = about.get("states_trained_on_solved", 0) - about.get("corners_trained_on", 0)
    before: Mapping[str, int] = about.get("condensed_from") or {}
    taken = {
        "states": in_sequence + len(about.get("states_failed", {})),
        "modes": before.get("modes", 0),
        "points": before.get("points", 0),
    }
    return tuple(key for key, count in taken.items() if count >= getattr(plan, key))


def _enough(key: str, about: Mapping[str, Any], plan: Plan) -> int:
    """How many states, modes or points to try next: of states as many as the errors of the rounds lead to, if they do;
    otherwise twice as many."""
    now = getattr(plan, key)
    wanted, rounds = _MORE * now, about.get("rounds", ())
    if key == "states" and len(rounds) > 1:
        errors = [found["errors"] for found in rounds]
        shares = [max(e["flux_density_share"], e["gradient_share"] / GRADIENT) for e in errors]
        believed = replace(plan, states=_BELIEVED * now)
        needed = states_needed(shares, [found["solved"] for found in rounds], believed)
        wanted = needed if now < needed < believed.states else wanted
    return int(min(wanted, _MOST[key]))


def _seconds(about: Mapping[str, Any], plan: Plan, raised: Mapping[str, int]) -> float | None:
    """What making the map would take, by the seconds of a state: another recipe begins from nothing."""
    solved, seconds = about.get("states_solved"), about.get("generation_seconds")
    if not solved or seconds is None:
        return None
    return float(seconds * (1.0 + (raised.get("states", plan.states) - plan.states) / solved))


def _remedy(found: Shortfall, missed: MissedAccuracy, plan: Plan) -> str:
    smaller = "make the range of the currents smaller"
    if not found.raised:
        reached = _rounded_up(missed.largest_share / HELD_OUT)
        return f"ask for less, accuracy = {reached:g}, or {smaller}" if reached < 1.0 else smaller
    keys = [f"currents.{key} from {getattr(plan, key)} to {value}" for key, value in found.raised.items()]
    costs = []
    if found.seconds is not None:
        costs.append(f"about {_duration(found.seconds)}, as all states are solved anew")
    if found.raised.keys() & {"modes", "points", "fields"}:
        costs.append("lookups at new currents take longer")
    cost = f" ({'; '.join(costs)})" if costs else ""
    return f"raise {' and '.join(keys)}{cost}, or {smaller}"


def _acceptance(target: Path, written: bool) -> str:
    if written:
        return (
            f"{target} is there, its error accepted: with --accept-error the same command takes it as it is"
        )
    return (
        f"{target} is not written: with --accept-error (accept_error=True) the same command goes on from here, solves "
        "nothing again, and writes it with its error among its assumptions"
    )


def _rounded_up(value: float) -> float:
    """To two digits.

    >>> _rounded_up(0.0061), _rounded_up(0.14201)
    (0.0061, 0.15)
    """
    if not math.isfinite(value):
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.2g}")


def _duration(seconds: float) -> str:
    """Roughly.

    >>> _duration(42.0), _duration(754.0), _duration(9000.0)
    ('42 s', '13 minutes', '2.5 hours')
    """
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} minutes" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} hours"
