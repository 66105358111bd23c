"""Element sizes of the next mesh from the shares in the error of this one.

A share that falls like h^p on h^-d elements is used best where all are equal: h changes by the (p + d)th root of the
wanted share over the present one. p is what uniform refinement of devices with sharp edges shows; the first layer at
those edges has an order of its own, that of the singularity r^(-1/3).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fieldmap.device.model import Device
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.error.indicators import (
    FaceShares,
    WorkspaceDipoles,
    element_indicators,
    face_indicators,
    heights,
)
from fieldmap.iron.materials import BodyProperties
from fieldmap.iron.mesh.local_sizes import LocalSizes
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.mesh.topology import Faces
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.solvers.linear import chosen_form, form_on, solved_in_form
from fieldmap.iron.stages import Stages
from fieldmap.typing import Array

_LAYER_ORDER, _FACE_ORDER, _ELEMENT_ORDER = 4 / 3, 2.5, 3.0
# One step makes an element smaller by no more than this, and larger.
_SMALLEST, _LARGEST = 0.45, 1.3
# A layer at an edge costs about as many faces as it gains at this multiple of the share of others.
_LAYER_COST = 4.0
_THINNEST = 0.16
# No layer is thinner than this part of the elements' size.
_FLATTEST = 0.02
# One step lowers the predicted error by no more than this factor.
_STEP = 4.0
_NEIGHBOURS = 6


@dataclass(frozen=True, eq=False)
class _Shares:
    """Shares (k,) that fall with the power `order` of their sizes; a wanted size changes by the `root`th root of weight
    times the common share over its own, within limits."""

    shares: Array
    order: float
    root: float
    weight: float = 1.0
    limits: tuple[float, float] = (_SMALLEST, _LARGEST)

    def factors(self, common: float) -> Array:
        """Factors (k,) of the sizes, for the logarithm of the common share."""
        ratio = common + np.log(self.weight) - np.log(np.maximum(self.shares, 1e-300))
        return np.exp(np.clip(ratio / self.root, *np.log(self.limits)))

    def predicted(self, common: float) -> float:
        """Sum of the shares after that."""
        return float(self.shares @ self.factors(common) ** self.order)


def next_sizes(
    mesh: IronMesh,
    topology: Faces,
    surface: ChargedFaces,
    faces: FaceShares,
    elements: Array,
    tolerance: float,
) -> LocalSizes:
    """Sizes and layers for a predicted error of half the tolerance, from the shares of faces and of elements (e,)."""
    cells = mesh.cells
    if cells is None:
        raise ValueError("a mesh copied from a chamber has no cells")
    count = len(cells.sizes)
    below = cells.number[topology.owner[topology.surface, 0]]
    tips = np.flatnonzero(faces.at_edge)
    own = np.where(faces.at_edge, 0.0, faces.across) + faces.rest
    near, near_tips = _nearest(cells.centres), _nearest(surface.centres[tips])
    on_surface = np.bincount(below, own, count)[near].mean(axis=1)
    inside = np.bincount(cells.number, elements, count)[near].mean(axis=1)
    tip_limits = (_THINNEST, 1.0)
    parts = (
        _Shares(on_surface, _FACE_ORDER, _FACE_ORDER + 2),
        _Shares(inside, _ELEMENT_ORDER, _ELEMENT_ORDER + 3),
        _Shares(
            faces.across[tips][near_tips].mean(axis=1), _LAYER_ORDER, _LAYER_ORDER, _LAYER_COST, tip_limits
        ),
    )
    # The shares of all faces add up to more than the total, because each is for its own worst source.
    now = sum(float(part.shares.sum()) for part in parts)
    own_worst = float((faces.across + faces.rest).sum()) / max(faces.total, 1e-300)
    aim = max(0.5 * tolerance * own_worst, now / _STEP)
    common = _common_share(parts, aim)
    old = np.exp(np.log(cells.sizes)[near].mean(axis=1))
    sizes = old * np.minimum(parts[0].factors(common), parts[1].factors(common))
    thickness = np.exp(np.log(heights(surface.corners[tips]))[near_tips].mean(axis=1))
    layers = np.maximum(thickness * parts[2].factors(common), _FLATTEST * sizes[below[tips]])
    return LocalSizes(cells.centres, sizes, surface.centres[tips], layers)


def _common_share(parts: tuple[_Shares, ...], aim: float) -> float:
    """Logarithm of the largest common share for which the predicted error is `aim`, if the limits let it."""
    low, high = -90.0, 30.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        fine = sum(part.predicted(middle) for part in parts) < aim
        low, high = (middle, high) if fine else (low, middle)
    return low


def _nearest(places: Array) -> NDArray[np.int64]:
    """The nearest few (n, k) of places (n, 3) to each, itself included: shares of single cells scatter."""
    if len(places) == 0:
        return np.zeros((0, 1), np.int64)
    _, nearest = cKDTree(places).query(places, min(_NEIGHBOURS, len(places)))
    return np.asarray(nearest, np.int64).reshape(len(places), -1)


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
