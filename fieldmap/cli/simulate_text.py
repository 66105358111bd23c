"""The answer of `fieldmap simulate`, for people and as JSON."""

from typing import Any

import numpy as np

from fieldmap.cli.printing import assumption_lines, count_of, facts, heading, print_page, table
from fieldmap.cli.simulating import Batch, Outcome
from fieldmap.dynamics.scenario import RunMetrics


def print_runs(outcome: Outcome) -> None:
    """Print what came out, batch by batch."""
    first = outcome.batches[0].experiment.scenario
    sections: list[Any] = [heading(first.contents.title, str(outcome.wanted.scenario))]
    for batch in outcome.batches:
        sections += [_facts(batch), _axes(batch)]
    steps = [_steps(batch) for batch in outcome.batches]
    sections += [step for step in steps if step is not None]
    machine = outcome.batches[0].experiment.machine
    sections.append(facts(assumption_lines(machine.assumptions)))
    if outcome.written:
        sections.append(facts([("written", str(path)) for path in outcome.written]))
    print_page(*sections)


def _facts(batch: Batch) -> Any:
    rest, contents = batch.experiment.operating_point, batch.experiment.scenario.contents
    amperes = ", ".join(f"{value:.4g}" for value in rest.currents)
    # A force that steps between cells of a coarse map has no zero.
    left = f"; {rest.residual:.0e} of the weight left" if rest.residual > 1e-6 else ""
    x, y, depth = _reading(batch)
    simulated = sum(result.metrics.end_s for result in batch.results)
    rows = [("value", batch.label)] if batch.label else []
    rows += [
        ("at rest", f"x {x:.3f}, y {y:.3f}, depth {depth:.3f} mm; currents {amperes} A{left}"),
        (
            "simulated",
            f"{count_of(len(batch.results), 'run', 'runs')} of {contents.duration_s:g} s in {batch.seconds:.2f} s of "
            f"one processor: {simulated / max(batch.seconds, 1e-9):.0f} times as fast as it happens",
        ),
    ]
    rows += [("events", text) for text in _events(batch)]
    lean = max(result.metrics.largest_lean_deg for result in batch.results)
    current = max(result.metrics.largest_current_A for result in batch.results)
    rows.append(("largest", f"lean {lean:.2f} degrees, current {current:.3f} A"))
    return facts(rows)


def _reading(batch: Batch) -> Any:
    from fieldmap.dynamics.scenario import reading_mm

    return reading_mm(batch.experiment.scenario, batch.experiment.operating_point.sensed)


def _events(batch: Batch) -> list[str]:
    names: dict[str, list[RunMetrics]] = {}
    for result in batch.results:
        if result.metrics.event:
            names.setdefault(result.metrics.event, []).append(result.metrics)
    lines = [f"{name}: {len(ended)}, {_first(ended)}" for name, ended in names.items()] or ["none"]
    touched = sorted({name for result in batch.results for name in result.metrics.touched})
    words = {"currents": "currents beyond the table of the iron, which was extrapolated"}
    return lines + [words.get(name, f"touched the {name}") for name in touched]


def _first(ended: list[RunMetrics]) -> str:
    """When, where, how fast and with which currents the first of them ended."""
    first = min(ended, key=lambda metrics: metrics.end_s)
    x, y, depth = first.end_mm
    amperes = ", ".join(f"{value:.3g}" for value in first.end_A)
    return (
        f"first at {first.end_s:.3f} s: x {x:.2f}, y {y:.2f}, depth {depth:.2f} mm, "
        f"{np.linalg.norm(first.end_mm_per_s):.3g} mm/s; currents {amperes} A"
    )


def _axes(batch: Batch) -> Any:
    columns = ("axis", "RMS error mm", "of what is seen mm", "largest mm", "travel mm")
    lines = []
    for k, axis in enumerate(("x", "y", "depth")):
        parts = [result.metrics.axes[k] for result in batch.results]
        rms = float(np.mean([part.rms_error_mm for part in parts]))
        seen = float(np.mean([part.rms_seen_mm for part in parts]))
        worst = max(part.largest_error_mm for part in parts)
        lines.append(
            (axis, f"{rms:.5f}", f"{seen:.5f}", f"{worst:.4f}", f"{max(p.travel_mm for p in parts):.4f}")
        )
    return table(columns, lines)


def _steps(batch: Batch) -> Any:
    """Mean over the runs of the metrics of every axis with a step."""
    lines = []
    for k, axis in enumerate(("x", "y", "depth")):
        steps = [result.metrics.axes[k].step for result in batch.results]
        found = [step for step in steps if step is not None]
        if found:
            mean = [
                float(np.mean([getattr(step, name) for step in found]))
                for name in ("rise_time", "peak_time", "settling_time", "overshoot", "steady_rms")
            ]
            cells = (
                f"{mean[0]:.4f}",
                f"{mean[1]:.4f}",
                f"{mean[2]:.4f}",
                f"{100 * mean[3]:.1f}",
                f"{mean[4]:.5f}",
            )
            lines.append((f"{axis} {batch.label}".strip(), *cells))
    if not lines:
        return None
    return table(("step of", "rise s", "peak s", "settling s", "overshoot %", "steady RMS mm"), lines)


def as_json(outcome: Outcome) -> dict[str, Any]:
    """The same as numbers; SI but for names that end in _mm and _deg."""
    batches = []
    for batch in outcome.batches:
        rest = batch.experiment.operating_point
        batches.append(
            {
                "value": batch.label,
                "rest": {
                    "sensed": rest.sensed,
                    "currents": rest.currents,
                    "outputs": rest.outputs,
                    "residual": rest.residual,
                },
                "seconds": batch.seconds,
                "runs": [result.metrics for result in batch.results],
            }
        )
    first = outcome.batches[0].experiment
    return {
        "scenario": str(first.scenario.path.name),
        "title": first.scenario.contents.title,
        "batches": batches,
        "assumptions": first.machine.assumptions,
        "written": outcome.written,
    }
