"""Optuna's samplers on a problem of design: for designs with several optima, where derivatives lead to the nearest."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from fieldmap.extras import require
from fieldmap.studies.search import Search
from fieldmap.typing import Array


def require_optuna() -> ModuleType:
    """The module optuna. Raises MissingExtraError with the command that installs it."""
    return require("optuna", "optuna", "fieldmap.studies.optimise", 'choose another method, such as "COBYQA"')


def by_optuna(search: Search, z: Array) -> str:
    """Let Optuna's sampler of tree-structured Parzen estimators choose designs, the first at scaled values z, until as
    many are solved as the problem allows; how it ended. Its seed is the problem's: a run that is resumed asks for the
    same designs."""
    optuna = require_optuna()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    names = [f"z{k}" for k in range(len(z))]

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=search.problem.seed))
    study.enqueue_trial({name: float(value) for name, value in zip(names, z, strict=True)})

    def objective(trial: Any) -> float:
        here = np.array([trial.suggest_float(name, 0.0, 1.0) for name in names])
        for k, room in enumerate(search.limits(here)):
            trial.set_constraint(f"limit {k}", -room)  # a positive number is a violated limit
        return search.objective(here)

    study.optimize(objective, n_trials=search.problem.solves)
    return f"{len(study.trials)} designs were tried"
