"""The accuracy of a map in words: mesh, interpolation between its nodes, and current model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from fieldmap.constants import GRAVITY
from fieldmap.curves import percent
from fieldmap.device.model import Payload
from fieldmap.io.map_summary import ErrorShares, MapSummary, ReactionOfMap
from fieldmap.store import FieldError
from fieldmap.store.stated_accuracy import GRADIENT, HELD_OUT

TRAINED_ON = "trained on"
"""The kind of tested states that a current model was trained on."""
_KINDS = {"searched for": "found by a search", TRAINED_ON: "of the training"}


def reference_words(summary: MapSummary) -> str:
    """The reference currents of a map in words."""
    currents = summary.info.reference_current
    first, *others = set(currents.tolist())
    if not others:
        return f"{first:.4g} A in every coil"
    return ", ".join(f"{i:.4g}" for i in currents) + " A"


def accuracy_words(summary: MapSummary) -> Iterator[tuple[str, str]]:
    """The errors of a map, one kind after the other.

    Parameters
    ----------
    summary : MapSummary
        What the map file holds.

    Yields
    ------
    tuple of str
        The kind of error, and its size in words. Only a map of saturating iron has a current model.
    """
    of = summary.accuracy
    if of.meshed:
        finer = "not measured; a map with a larger refinement under [iron] shows it"
        yield "mesh error", f"{_shares(of.mesh)} of the largest, estimated" if of.mesh else finer
    yield "interpolation", _interpolation(summary)
    if summary.domain is not None:
        yield "current model", _current_model(summary)
    report = summary.info.provenance.solver_report
    if "linkage_error" in report:
        yield "linkages", _linkages(**report["linkage_error"])
    if "without_linkage" in report:
        yield "linkages", f"none: {report['without_linkage']}"
    if summary.reaction is not None:
        yield "reaction", _reaction(summary.reaction, summary.payload)


def _linkages(share: float, states: int, inductance_share: float = 0.0, inductance_states: int = 0) -> str:
    """Errors of the flux linkages that saturating iron adds, and of inductances if these were tested."""
    said = f"largest error {100 * share:.2g} % of the iron's largest flux linkage, at {states} states"
    if not inductance_states:
        return said
    return f"{said}, {100 * inductance_share:.2g} % of the largest inductance, at {inductance_states} of them"


def _reaction(of: ReactionOfMap, payload: Payload | None) -> str:
    """The iron's reaction to magnets, and its force on the payload."""
    changed = f", changed by up to {100 * of.change:.2g} % at the largest currents" if of.change else ""
    lines = [
        f"of the iron to magnets: {of.fields} fields, largest error {100 * of.error:.2g} %{changed}",
        f"elements of the iron are up to {of.width:.2g} times as wide as they are away from the box",
    ]
    if of.pull is not None and of.at is not None and payload is not None:
        times = of.pull / (payload.mass * GRAVITY)
        drawn = f"{100 * times:.3g} % of" if times < 10 else f"{times:.3g} times"
        place = ", ".join(f"{1e3 * x:.4g}" for x in of.at)
        lines.append(
            f"with all coils off it draws the payload with up to {drawn} its weight, at ({place}) mm"
        )
    return "\n".join(lines)


def _interpolation(summary: MapSummary) -> str:
    """The bound for the default form of `open_map`; without one the sampled error of the Hermite form."""
    of, reference = summary.accuracy, reference_words(summary)
    if of.bound is not None:
        if summary.domain is None:
            return f"certified: lookups within {_sizes(of.bound)} of the solver in the box, up to {reference}"
        return (
            f"certified for the interpolation alone: lookups within {_sizes(of.bound)} of the fields that the map "
            "interpolates, at all currents"
        )
    if of.interpolation is not None:
        found = _sizes(of.interpolation)
        return f"largest found {found}, at sampled points in the Hermite form with {reference}"
    return "not measured"


def _shares(error: ErrorShares) -> str:
    return f"{100 * error.flux_density:.2g} % of B, {100 * error.gradient:.2g} % of the gradient"


def _sizes(error: FieldError) -> str:
    return f"{1e6 * error.flux_density:.2g} uT, {1e3 * error.gradient:.2g} mT/m"


def _current_model(summary: MapSummary) -> str:
    solver, of, error = summary.info.provenance.solver_report, summary.accuracy, summary.info.current_error
    text = "not measured"
    if of.current_model is not None:
        in_units = f" ({_sizes(error)})" if error else ""
        images = " ({} solved, the others mirror images)"
        tried = "; ".join(
            f"{one.states} {_KINDS.get(one.kind, one.kind)}"
            + (images.format(one.solved) if one.solved < one.states else "")
            for one in of.tried
        )
        # Maps of earlier versions were not tested at their training states.
        outside = "" if TRAINED_ON in {one.kind for one in of.tried} else " outside of the training"
        text = (
            f"largest error {_shares(of.current_model)}, relative to the largest of the state{in_units}, at test "
            f"states{outside}: {tried}"
        )
    solved, count = solver["states_trained_on_solved"], solver["states_trained_on"]
    held, before = (
        f"{solver['modes']} modes and {solver['sample_points']} points",
        solver.get("condensed_from"),
    )
    if before and before["points"] > solver["sample_points"]:
        held += f", condensed from {before['modes']} and {before['points']},"
    trained = [f"{held} from {solved} solved states"]
    if solver["corners_trained_on"]:
        which = "extremes of the currents" if solver.get("extremes") else "corners of the domain"
        trained.append(f"{solver['corners_trained_on']} of them {which}")
    if count > solved:
        trained.append(f"{count} with mirror images")
    return "\n".join([text, *_missed(summary), *_corners(solver), ", ".join(trained)])


def _missed(summary: MapSummary) -> Iterator[str]:
    """The accuracy that the recipe asks for, if the model missed it. Older files do not state it."""
    missed = summary.missed_accuracy
    if missed is not None:
        within = HELD_OUT * missed.asked
        yield (
            f"the recipe asks for {percent(within)} of B and {percent(GRADIENT * within)} of the gradient at these "
            "states; its states, modes and points do not reach this: allow more of them under [currents], or make the "
            "domain smaller"
        )


def _corners(solver: Mapping[str, Any]) -> Iterator[str]:
    """The extremes of the currents at which the model was tested; for iron with hysteresis its history. For a map of an
    earlier version: that extremes were not searched, and how the solved corners of the domain were chosen."""
    if "level_of_histories" in solver:
        level = ", ".join(f"{i:.4g}" for i in dict.fromkeys(solver["level_of_histories"]))
        yield f"states lie on paths of the currents; the map opens with the history 'shaken' about {level} A"
        return
    extremes, corners = solver.get("extremes"), solver.get("corners")
    if extremes:
        yield _extremes(extremes)
        return
    yield "extremes of the currents were not searched: the map is of an earlier version"
    if corners and corners["solved"] < corners["different"]:
        alike = (
            ""
            if corners["different"] == corners["looked_at"]
            else f" ({corners['different']} without mirror images)"
        )
        yield (
            f"the model's residual was evaluated at {corners['looked_at']} of {corners['in_all']} corners{alike}; "
            f"{corners['solved']} were solved: those with the largest residuals and some at random"
        )


def _extremes(extremes: Mapping[str, Any]) -> str:
    looked, different, searched = (extremes[name] for name in ("looked_at", "different", "searched"))
    text = f"extremes of the currents (corners, single coils, equal and opposed currents): {looked}"
    if different < looked:
        text += f", {different} without mirror images"
    text += f", {extremes['solved']} solved"
    if extremes["by_residual"]:
        text += ": those with the largest residuals of the model and some at random"
    return f"{text}; search by the residual among {searched} further currents" if searched else text
