"""Currents of least power that carry a body in the field of a map, for the start of simulations and environments.

docs/theory/closed_loop.md (23).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_signal
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.errors import Infeasible, NotConverged, Problem
from fieldmap.levitation.lift import signal_pushes
from fieldmap.lookup import FieldMap
from fieldmap.lookup.actuation import checked_limits
from fieldmap.lookup.demand import Demand, demand_of
from fieldmap.lookup.inverse import fields_of, least_power_currents
from fieldmap.lookup.inverse_problem import Goal, SumOfFields, Variables
from fieldmap.lookup.magnetic_body import reacting_at
from fieldmap.records import Record
from fieldmap.typing import Array

# Currents within this share of the limits are tried first, so that a tenth is left for control. A solution is usually
# not unique, and the smaller limits exclude uneven ones.
_EASIER = 0.9


@dataclass(frozen=True, eq=False, repr=False)
class WeightBalance(Record):
    """Balance between the force of a map's field on an upright body and its weight.

    field: the map; limits: lowest and highest currents (n,), A; scale: calibration factor of the map's field.
    """

    field: FieldMap
    body: RigidBody
    limits: tuple[Array, Array]
    scale: float = 1.0

    @property
    def weight(self) -> float:
        """Weight of the body, N."""
        return self.body.mass * self.body.gravity

    def currents(self, place: ArrayLike) -> Array:
        """Currents of least power whose vertical force is the weight, without force along x and y if possible.

        A tenth of the limits is left for control if the rest suffices to carry the body.

        Parameters
        ----------
        place
            The magnet's centre (3,) in the frame of the map, m.

        Returns
        -------
        Array
            Currents (n,), A.

        Raises
        ------
        Infeasible
            If currents within the limits do not carry the body; share: the part of the weight that they carry.
        OutsideMapError
            If a part of the body is outside the map.
        """
        point = check_signal("WeightBalance.currents(place)", place, columns=3)
        try:
            lifting = self._least_power(point, [np.nan, np.nan])
        except (Infeasible, NotConverged) as error:
            raise self._refused(point, error) from None
        idle = signal_pushes(self.force_per_ampere(point, lifting))[1]
        try:
            return self._least_power(point, [np.nan if axis in idle else 0.0 for axis in "xy"])
        except (Infeasible, NotConverged):
            return lifting

    def force_per_ampere(self, place: ArrayLike, currents: Array) -> Array:
        """Derivatives of the force with respect to the currents.

        Parameters
        ----------
        place
            The magnet's centre (3,) in the frame of the map, m.
        currents
            Currents (n,), A.

        Returns
        -------
        Array
            dF/di (3, n), N/A.
        """
        names, at = self.field.coil_names, np.reshape(place, (1, 3))
        of_body = at + self.body.magnet.all_points
        every = Variables(names, *checked_limits(None, len(names)), np.ones(len(names)))
        there = self._fields().at(np.concatenate([at, of_body]))
        reacts = reacting_at(self.field.reaction, of_body)
        return Goal(self._demand(np.zeros(3)), there, np.eye(3), every, reacts).about(currents)[1]

    def _least_power(self, place: Array, sideways: list[float]) -> Array:
        """Currents (n,) that give these horizontal forces (2,), N, and the weight. Raises Infeasible, NotConverged."""
        demand, (low, high) = self._demand([*sideways, self.weight]), self.limits
        least = partial(least_power_currents, self._fields(), place, demand)
        try:
            return least((_EASIER * low, _EASIER * high), None, None, None)
        except (Infeasible, NotConverged):
            return least((low, high), None, None, None)

    def _demand(self, force: ArrayLike) -> Demand:
        return demand_of(force, self.body.magnet, None, None, None)

    def _fields(self) -> SumOfFields:
        """The map's fields times the scale."""
        fields = fields_of(self.field)
        assert isinstance(fields, SumOfFields)
        of_map = fields.each_field

        def each_field(points: Array, flux: Array, slope: Array) -> None:
            of_map(points, flux, slope)
            flux *= self.scale
            slope *= self.scale

        return replace(fields, each_field=each_field)

    def _refused(self, place: Array, error: Infeasible | NotConverged) -> Infeasible:
        """Make the error of a weight that the limits do not allow."""
        at = ((1e3 * place).round(3) + 0.0).tolist()
        must = f"currents within their limits must carry the weight, {self.weight:.4g} N, of the magnet at {at} mm"
        received = "no currents that lift it"
        reached = error.reachable if isinstance(error, Infeasible) else None
        share = 0.0 if reached is None else float(reached[0]) / self.weight
        if abs(share) > 1e-6:
            received = f"{share:.3g} of the weight"
        if isinstance(error, Infeasible) and error.binding:
            # The signals of a map over a parametrisation have other units.
            unit = dict.fromkeys(self.field.coil_names, " A")
            received += " with "
            received += ", ".join(f"{name} at {v:g}{unit.get(name, '')}" for name, v in error.binding.items())
        remedy = "begin at another place, take a lighter payload, or allow larger currents"
        return Infeasible(Problem("WeightBalance.currents", must, received, remedy), share=share)
