"""Sixty machines without any tuning: maps with the defaults of a recipe against fully solved states.

    python scripts/validate.py --only saturating_machines
    cd scripts && python -m validation.saturating_machines [--list] [NAME ...]

A map passes if its error at states outside the training is within 1.5 times its largest stated error and within twice
the accuracy (four times for the gradient, whose accuracy is twice that of the flux density); or if it was refused. A
written map that breaks one of these bounds is a silent error. Fields are compared at the nodes on the surface of the
box with the solver on the same mesh, so that the comparison tests the model of the currents, not the interpolant or the
mesh.
"""

import argparse
import statistics
import sys
from collections.abc import Iterator, Sequence

from validation.row import Row
from validation.saturating.combinations import COMBINATIONS, Combination
from validation.saturating.trial import ASKED_BOUND, GRADIENT_BOUND, STATED_BOUND, Trial, tried

MOST_SECONDS = 180.0
SOLVED = "solved states"


def saturating_machines() -> Iterator[Row]:
    """Rows of all machines, and their summary."""
    yield from rows_of(COMBINATIONS)


def rows_of(combinations: Sequence[Combination]) -> Iterator[Row]:
    """Rows of each machine, and then the summary. A machine that fails by any error gives a row with the error, and the
    others continue."""
    found = []
    for combination in combinations:
        try:
            found.append(tried(combination))
        except Exception as error:
            note = f"{type(error).__name__}: {error}"
            yield Row(combination.case, "the machine", float("nan"), None, "-", note=note)
        else:
            yield from _rows(found[-1])
    if found:
        yield from _summary(found)


def _rows(trial: Trial) -> Iterator[Row]:
    """Rows of one machine."""
    cost, case = (trial.faces, 0, trial.seconds, trial.cpu_seconds), trial.combination.case
    if trial.refusal:
        yield Row(case, "refused", 1.0, 1.0, SOLVED, *cost, trial.refusal, figures=_figures(trial))
        return
    flux, gradient = trial.by_asked
    note = f"{trial.size}; worst of {trial.states} states {trial.worst}"
    figures = _figures(trial)
    stated = "true by stated error of B"
    yield Row(case, stated, trial.by_stated, STATED_BOUND, SOLVED, *cost, note, figures=figures)
    yield Row(case, "true error of B by accuracy", flux, ASKED_BOUND, SOLVED, *cost, note)
    yield Row(case, "true error of gradient by accuracy", gradient, GRADIENT_BOUND, SOLVED, *cost, note)


def _figures(trial: Trial) -> dict[str, str]:
    """Cells of one line in the table of all machines."""
    shares = [*trial.true, *trial.stated]
    errors = ["-"] * 4 if trial.refusal else [f"{share:.1e}" for share in shares]
    headings = ("B, true", "gradient, true", "B, stated", "gradient, stated")
    return {
        "machine": trial.combination.name,
        "verdict": trial.verdict,
        **dict(zip(headings, errors, strict=True)),
        "s": f"{trial.seconds:.1f}",
        "cpu s": f"{trial.cpu_seconds:.1f}",
    }


def _summary(found: Sequence[Trial]) -> Iterator[Row]:
    """Seconds, refusals and silent errors of all machines."""
    case = f"{len(found)} saturating machines"
    seconds = [trial.seconds for trial in found]
    slowest = max(found, key=lambda trial: trial.seconds).combination.name
    refused, wrong = (
        [one.combination.name for one in found if one.verdict == of] for of in ("refused", "wrong")
    )
    two = "two quiet cores"
    yield Row(case, "seconds of a map, median", statistics.median(seconds), None, two)
    yield Row(case, "seconds of a map, most", max(seconds), MOST_SECONDS, two, note=slowest)
    yield Row(case, "refused", float(len(refused)), None, SOLVED, note=", ".join(refused))
    yield Row(case, "wrong in silence", float(len(wrong)), 0.0, SOLVED, note=", ".join(wrong))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print rows of the named machines, or of all, as they are computed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="DEVICE-STEEL, or DEVICE for all of its steels"
    )
    parser.add_argument(
        "--list", action="store_true", help="names and currents of the machines, without a map"
    )
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if not _named([name])]
    if unknown:
        parser.error(f"no machine is called {', '.join(unknown)}; --list names them")
    chosen = _named(options.names) if options.names else COMBINATIONS
    if options.list:
        for one in chosen:
            print(f"{one.name:42} {one.range:26} {one.steel.title}")
        return 0
    verdicts = []
    for row in rows_of(chosen):
        verdicts.append(row.verdict)
        bound = "" if row.bound is None else f" (bound {row.bound:g})"
        cost = f"  {row.seconds:.1f} s ({row.cpu_seconds:.1f} cpu s)" if row.seconds else ""
        print(
            f"{row.case}: {row.quantity} {row.value:.3g}{bound} {row.verdict}{cost}  {row.note}", flush=True
        )
    return int(any(verdict in ("FAIL", "NOT RUN") for verdict in verdicts))


def _named(names: Sequence[str]) -> tuple[Combination, ...]:
    """Machines by full name, or all machines of a device."""
    return tuple(one for one in COMBINATIONS if one.name in names or one.device_name in names)


if __name__ == "__main__":
    sys.exit(main())
