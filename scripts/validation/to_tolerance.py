"""Twenty devices refined to a tolerance: true errors must be within the tolerance, or the run must state the cost of
further refinement."""

from collections.abc import Iterator
from dataclasses import dataclass

import fieldmap as fm
from fieldmap.errors import ToleranceNotReached
from fieldmap.iron.error import ErrorEstimate, ToleranceReport
from validation.row import Row, timed
from validation.tolerance_devices import Known, all_devices

GRADIENT = 3.0
"""Tolerance of the gradient over the tolerance of B."""


@dataclass(frozen=True, eq=False)
class Run:
    """One device: outcome of its run, estimated and true errors (B, gradient), and cost."""

    known: Known
    report: ToleranceReport
    estimate: ErrorEstimate
    true: tuple[float, float]
    said: str
    seconds: float
    cpu_seconds: float


def run(known: Known) -> Run:
    """Refine, and compare with the reference; of an unfinished run the best solution."""

    def refined():
        try:
            solution = fm.solve_to_tolerance(
                known.device, known.asked, known.mu_r, most_meshes=known.most_meshes
            )
        except ToleranceNotReached as error:
            return error.solution, error.report, str(error.problems[0].received)
        return solution, solution.report.tolerance, str(solution.report.tolerance)

    (solution, report, said), wall, cpu = timed(refined)
    return Run(known, report, solution.report.error, known.errors(solution), said, wall, cpu)


def to_tolerance() -> Iterator[Row]:
    """True errors of B and of the gradient, with the tolerance as a bound for runs that report to have reached it."""
    for known in all_devices():
        one = run(known)
        pairs = zip(("B", "gradient"), one.true, (1.0, GRADIENT), strict=True)
        for what, value, factor in pairs:
            bound = factor * known.asked if one.report.reached else None
            estimate = getattr(one.estimate, "flux_density" if what == "B" else "gradient")
            note = (
                f"estimate {estimate:.2g}, {len(one.report.steps)} meshes, {one.report.ended}; {known.truth}"
            )
            faces = one.report.steps[-1].faces
            cost = (faces, len(one.report.steps), one.seconds, one.cpu_seconds)
            yield Row(known.name, f"true error of {what}", value, bound, known.truth, *cost, note)
        yield stated(one)


def stated(one: Run) -> Row:
    """1 if a run reached the tolerance, or names body, place and cost of further refinement; otherwise 0."""
    report = one.report
    says = report.reached or (
        bool(report.shares) and report.next_mesh is not None and report.worst is not None
    )
    return Row(
        one.known.name, "ends without a statement", 0.0 if says else 1.0, 0.0, "its report", note=one.said
    )
