"""Effect of fewer modes and points on the drive unit's map: docs/theory/current_training.md, "Fewer modes".

    python scripts/studies/condensation_study.py [RECIPE]

Makes the map of a recipe (maps/workspace.toml by default) in a temporary folder. Prints errors at held-out states, of
the trained model and of models condensed from it, and errors of the map's derivatives by its signals and by single
coils against the solver.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import fieldmap as fm
from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training import condensation, training
from fieldmap.maps.training.model_error import Trial
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.typing import Array

STATES, SEED = 12, 41
# Bounds of the condensation, as multiples of the shipped bounds.
SHARES = {"as shipped": 1.0, "with half the change allowed": 0.5, "with twice": 2.0}


def main(recipe: str) -> None:
    """Make the map and print both tables."""
    known: dict[str, Any] = {}

    def noting(place: Any, name: str, take: Callable[..., None]) -> Any:
        real = getattr(place, name)

        def called(*given: Any) -> Any:
            found = real(*given)
            take(given, found)
            return found

        return mock.patch.object(place, name, called)

    def note_condensed(given: Any, found: Any) -> None:
        known["condensed"] = given

    def note_tried(given: Any, found: Any) -> None:
        known[given[4]] = found

    with (
        tempfile.TemporaryDirectory() as folder,
        noting(training, "condense", note_condensed),
        noting(training.Training, "solve_tried", note_tried),
    ):
        opened = fm.open_map(fm.generate(recipe, Path(folder) / "studied.h5"))
        print("| model | modes, points | at random: B, gradient | median: B, gradient |\n|---|---|---|---|")
        reduction, domain, combination, output, accuracy = known["condensed"]
        of_trained = np.eye(reduction.sampled.modes)
        print(
            _line(f"trained with {reduction.sampled.modes} modes", reduction.sampled, of_trained, known),
            flush=True,
        )
        for text, share in SHARES.items():
            bounds = {"_OF_MODES": condensation._OF_MODES * share, "_IN_ALL": condensation._IN_ALL * share}
            with mock.patch.multiple(condensation, **bounds):
                few = training.condense(reduction, domain, combination, output, accuracy)
            print(_line(text, few.model, few.basis, known), flush=True)
        _derivatives(opened, reduction.fields.trial, reduction.solver, domain)


def _line(text: str, model: GalerkinModel, basis: Array, known: dict[str, Any]) -> str:
    """Errors of a model on combinations (r, q) of the trained modes at the states held out."""
    reduction, _, combination, output, _ = known["condensed"]
    tried = known["at random"]
    weights = training.weights(model, output @ basis, tried.currents)
    charge = weights @ (combination @ reduction.charge)
    change = reduction.solver.charge_density(tried.potentials) - charge
    shares = 100 * reduction.fields.trial.shares(tried.currents, charge + change, change)
    most, middle = (f"{of[0]:.2g} %, {of[1]:.2g} %" for of in (shares.max(axis=0), np.median(shares, axis=0)))
    return f"| {text} | {model.modes}, {len(model.weights)} | {most} | {middle} |"


def _derivatives(opened: Any, trial: Trial, solver: NonlinearSolver, domain: CurrentDomain) -> None:
    """Largest differences of derivatives at states drawn at random, over the largest value of the same derivative."""
    of, points = domain.parametrisation, trial._points
    span = domain.upper - domain.lower
    shares = np.random.default_rng(SEED).random((STATES, len(span)))
    signals = of.within(domain.lower, domain.upper, shares)
    bare = [unit_flux_density_and_gradient(coil, points) for coil in solver.device.coils]
    off = []
    for values in signals:
        currents = of.currents(values[None])[0]
        directions = np.hstack([of.derivative(values), np.eye(of.coil_count)])
        potential = solver.solve(currents, 1e-5).state.potential[:, 0]
        change = solver.sensitivities(currents, potential, directions, 1e-5)
        iron = trial.fields(solver.charge_density(change))
        ours = opened.by_currents(points, currents)[2:]
        rows = []
        for j in range(2):
            own = np.array([pair[j] for pair in bare])
            theirs = iron[j] + np.tensordot(directions.T, own, 1)
            mine = np.tensordot(directions.T, np.moveaxis(ours[j], 1, 0), 1)
            away, sizes = _largest(mine - theirs), _largest(theirs)
            rows += [away / sizes, away / sizes[len(span) :].max()]
        off.append(rows)
    shares, of_largest = 100 * np.array(off)[:, ::2], 100 * np.array(off)[:, 1::2]
    print(
        f"\n{STATES} states, {len(points)} places: derivatives off by, % of their largest, field and gradient"
    )
    for k in range(len(span)):
        print(f"  signal {k + 1}: at most {shares[..., k].max():.2g}, median {np.median(shares[..., k]):.2g}")
    coils, shared = shares[..., len(span) :], of_largest[..., len(span) :]
    print(
        f"  coils: at most {coils.max():.2g}, median {np.median(coils):.2g}; over the coil with the largest: "
        f"at most {shared.max():.2g}"
    )


def _largest(values: Array) -> Array:
    """Largest norms (d,) over the places of values (d, n, ...)."""
    return np.linalg.norm(values.reshape(*values.shape[:2], -1), axis=2).max(axis=1)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "maps/workspace.toml")
