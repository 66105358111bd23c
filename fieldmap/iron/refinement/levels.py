"""One mesh of an adaptive refinement: solved in both forms, estimated, and the element sizes of the next."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Device
from fieldmap.iron.forms.permeability import BodyProperties
from fieldmap.iron.forms.potential_form import ConvexForm
from fieldmap.iron.forms.state import IronState
from fieldmap.iron.linear import chosen_form, form_on, solved_in_form
from fieldmap.iron.meshing.local_sizes import LocalSizes
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.refinement.indicators import FaceShares, element_indicators, face_indicators
from fieldmap.iron.refinement.sizes import next_sizes
from fieldmap.iron.refinement.workspace_dipoles import WorkspaceDipoles
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.stages import Stages

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Level:
    """forms, solutions: the chosen form first, then the complementary one, where it may be used; points (n, 3): of the
    air, where errors count."""

    properties: BodyProperties
    points: Array
    forms: tuple[ConvexForm[Any], ...]
    solutions: tuple[LinearSolution, ...]

    @classmethod
    def solved(
        cls,
        device: Device,
        iron: AssembledIron,
        properties: BodyProperties,
        points: Array,
        tolerance: float,
        stages: Stages,
    ) -> "Level":
        """Solve all coils in both forms, or in the flux form alone where there are flux barriers."""
        names = ("potential", "flux") if chosen_form("auto", properties) == "potential" else ("flux",)
        forms = tuple(form_on(iron, name) for name in names)
        solutions = tuple(solved_in_form(device, form, properties, tolerance, stages) for form in forms)
        return cls(properties, points, forms, solutions)

    @property
    def solution(self) -> LinearSolution:
        """In the chosen form."""
        return self.solutions[0]

    @property
    def complement(self) -> LinearSolution | None:
        """In the other."""
        return self.solutions[1] if len(self.solutions) == 2 else None

    @cached_property
    def face_shares(self) -> FaceShares:
        """What the charges on the surface share in the error of B."""
        iron, state = self.forms[0].iron, self._states[0]
        triangles = iron.topology.nodes[iron.topology.surface]
        charge = state.density[: len(self._size)]
        return face_indicators(iron.surface, triangles, charge, self._dual.density, self._size)

    def next_sizes(self, tolerance: float) -> LocalSizes:
        """Element sizes for the next mesh."""
        iron = self.forms[0].iron
        elements = np.zeros(len(iron.mesh.tets))
        if self.complement is not None:
            other = self._dipoles.magnetise(self.forms[1], self.properties)
            mu_r, volume = self.properties.mu_r[iron.mesh.body], self.forms[0].elements.volume
            elements = element_indicators(volume, mu_r, self._states, (self._dual, other), self._size)
        return next_sizes(iron.mesh, iron.topology, iron.surface, self.face_shares, elements, tolerance)

    @cached_property
    def _dipoles(self) -> WorkspaceDipoles:
        return WorkspaceDipoles.near_iron(self.points, self.forms[0].iron.surface)

    @cached_property
    def _dual(self) -> IronState:
        return self._dipoles.magnetise(self.forms[0], self.properties)

    @cached_property
    def _size(self) -> Array:
        """Largest flux density (c,) of every coil."""
        fields = self.solution.unit_fields(self.points)[0]
        return np.maximum(np.linalg.norm(fields, axis=2).max(axis=1), 1e-300)

    @property
    def _states(self) -> tuple[IronState, ...]:
        return tuple(solution.state for solution in self.solutions if solution.state is not None)
