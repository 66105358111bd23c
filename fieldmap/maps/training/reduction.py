"""The iron on modes of solved states, with the law at sample points: its states, and how far they are off."""

from dataclasses import dataclass

import numpy as np

from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.model_error import ModeFields, larger
from fieldmap.maps.training.modes import SolvedModes, solved_from
from fieldmap.maps.training.sampling import Sampled
from fieldmap.maps.training.states import Snapshots
from fieldmap.records import Record
from fieldmap.typing import Array

# Currents whose residuals are computed at a time: so many nodal potentials are in memory.
_RANKED = 64


@dataclass(frozen=True, eq=False, repr=False)
class Reduction(Record):
    """The iron on modes of solved states, with the law at all points (`modes`) and at sample `points`;
    charge (r, faces): density of the modes on the solver's surface faces, T; fields: of the modes in the workspace;
    in_vain: whether no choice of modes and points can hold the states. How far something is off is `larger`
    everywhere, a share of the state's own field."""

    solver: NonlinearSolver
    modes: SolvedModes
    points: Sampled
    charge: Array
    fields: ModeFields
    in_vain: bool

    @property
    def sampled(self) -> GalerkinModel:
        """The model at the sample points."""
        return self.points.model

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (s, r) at currents (s, c), by the sample points."""
        return solved_from(self.sampled, (self.modes.currents, self.modes.amplitudes), currents)

    def potential(self, currents: Array) -> Array:
        """Nodal potential (n,) at currents (c,)."""
        return np.asarray(self.modes.basis @ self.amplitudes(currents[None])[0])

    def shortfall(self, currents: Array) -> Array:
        """How far the model looks to be off at currents (s, c): by the correction that its residual, with the law at
        all points, asks for in unsaturated iron. A measure to compare currents by, not an error."""
        parts = []
        for first in range(0, len(currents), _RANKED):
            some = currents[first : first + _RANKED]
            amplitudes = self.amplitudes(some)
            potential, air = self.modes.basis @ amplitudes.T, self.modes.air @ amplitudes.T
            change = self.solver.charge_density(self.solver.corrections(some, potential, air))
            parts.append(larger(self.fields.trial.shares(some, amplitudes @ self.charge, change)))
        return np.concatenate(parts)

    def off(self, tried: Snapshots) -> Array:
        """Errors (s,) on solved states."""
        if not tried.solved:
            return np.zeros(0)
        charge = self.amplitudes(tried.currents) @ self.charge
        change = self.solver.charge_density(tried.potentials) - charge
        return larger(self.fields.trial.shares(tried.currents, charge + change, change))
