"""The trained model: the iron on modes of solved states, with the law at sample points."""

from dataclasses import dataclass

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.model_error import ModeFields, larger
from fieldmap.maps.training.modes import SolvedModes, solved_from
from fieldmap.maps.training.sampling import Sampled
from fieldmap.maps.training.states import Snapshots
from fieldmap.parallel import results_of
from fieldmap.records import Record
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

# Number of currents whose residuals one thread computes at a time, and so of nodal potentials in its memory.
_RANKED = 16


@dataclass(frozen=True, eq=False, repr=False)
class Reduction(Record):
    """The iron on modes of solved states. All errors are relative to the state's own field, as `larger` gives them.

    Attributes
    ----------
    solver : of the whole iron.
    modes : the modes, and the model with the law at all points.
    points : the model with the law at sample points.
    charge : (r, faces), surface charge density of each mode, T.
    fields : fields of the modes in the workspace.
    in_vain : whether even the most modes represent the states too badly for any choice of points.
    """

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
        """Amplitudes (s, r) at currents (s, c) of the model with the law at sample points."""
        return solved_from(self.sampled, (self.modes.currents, self.modes.amplitudes), currents)

    def potential(self, currents: Array) -> Array:
        """Nodal potential (n,) at currents (c,)."""
        return np.asarray(self.modes.basis @ self.amplitudes(currents[None])[0])

    def shortfall(self, currents: Array) -> Array:
        """Error indicator (s,) at currents (s, c).

        It is the relative change of the field by one Newton step of the whole iron, with the residual at all points and
        the tangent of unsaturated iron. It compares currents with each other; it is no estimate of the error.
        """
        amplitudes = self.amplitudes(currents)

        def of(first: int) -> Array:
            some, own = currents[first : first + _RANKED], amplitudes[first : first + _RANKED]
            potential, air = self.modes.basis @ own.T, self.modes.air @ own.T
            change = self.solver.charge_density(self.solver.corrections(some, potential, air))
            return larger(self.fields.trial.shares(some, own @ self.charge, change))

        return np.concatenate(list(results_of(of, range(0, len(currents), _RANKED))))

    def off(self, tried: Snapshots) -> Array:
        """Errors (s,) at solved states."""
        if not tried.solved:
            return np.zeros(0)
        charge = self.amplitudes(tried.currents) @ self.charge
        change = self.solver.charge_density(tried.potentials) - charge
        return larger(self.fields.trial.shares(tried.currents, charge + change, change))


def model_of_map(
    model: GalerkinModel,
    output: Array,
    currents: Array,
    amplitudes: Array,
    domain: CurrentDomain,
    reference_weights: Array,
) -> ReducedModel:
    """A model as data of a map. output (k, r): weights of the map's fields per amplitude; reference_weights (k,): at
    its reference currents; currents (s, c) and amplitudes (s, r): of known states."""
    offset, knots, coefficients = model.tables.arrays
    return ReducedModel(
        gradients=model.gradients,
        source=model.source,
        weights=model.weights,
        law=model.law,
        law_offset=offset,
        law_knots=knots,
        law_coefficients=coefficients,
        air=model.air,
        constant=model.constant,
        output=output,
        known_currents=currents,
        known_amplitudes=amplitudes,
        lower=domain.lower,
        upper=domain.upper,
        parametrisation=domain.parametrisation,
        reference_weights=reference_weights,
        fixed=np.zeros(0) if model.fixed is None else model.fixed,
        pinning=model.pinning,
        shares=model.shares,
    )
