"""Newton's method for the convex energy of iron and air, docs/theory/planar.md (19)."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from fieldmap.errors import NotConverged, Problem
from fieldmap.planar.boundary_operator import BoundaryOperator
from fieldmap.planar.iron_energy import IronTriangles
from fieldmap.typing import Array

_MOST_STEPS = 60
_MOST_HALVINGS = 40


@dataclass(frozen=True, eq=False)
class Balance:
    """Energy of iron and air in terms of the total vector potential u (n,) at the points of the triangles, T m.

    The first m points are the outline's nodes. air: its operator; stiffness (m, m): that operator between the nodes;
    load (m,): what conductors and walls add; coil (m,): the conductors' own potential at the nodes; wall (k,): the
    reaction at the walls' nodes.
    """

    iron: IronTriangles
    air: BoundaryOperator
    stiffness: Array
    load: Array
    coil: Array
    wall: Array

    def energy(self, u: Array) -> float:
        """The functional, T2 m2."""
        nodes = u[: len(self.coil)]
        reaction = nodes - self.coil
        return float(self.iron.energy(u) + 0.5 * reaction @ self.stiffness @ reaction + self.load @ nodes)

    def derivatives(self, u: Array) -> tuple[Array, csc_array]:
        """First derivatives (n,), and the iron's part of the second; the air's is `stiffness`."""
        residual, second = self.iron.derivatives(u)
        nodes = len(self.coil)
        residual[:nodes] += self.stiffness @ (u[:nodes] - self.coil) + self.load
        return residual, second


def minimise(balance: Balance, tolerance: float) -> tuple[Array, tuple[float, ...]]:
    """Potential (n,) at the minimum, and the residuals of the steps relative to that of no reaction at all."""
    u = np.zeros(len(balance.iron.points))
    scale = float(np.linalg.norm(balance.load) + np.linalg.norm(balance.stiffness @ balance.coil)) or 1.0
    residuals = []
    for _ in range(_MOST_STEPS):
        residual, second = balance.derivatives(u)
        residuals.append(float(np.linalg.norm(residual)) / scale)
        if residuals[-1] <= tolerance:
            return u, tuple(residuals)
        step = -_solve(balance.stiffness, second, residual)
        u = _searched(balance, u, step, float(residual @ step))
    raise NotConverged(
        Problem(
            "solve_planar_state",
            f"the residual must fall to {tolerance:g}",
            f"{residuals[-1]:.3g} after {_MOST_STEPS} steps",
            "raise the tolerance, or lower the currents",
        ),
        residuals=tuple(residuals),
    )


def _searched(balance: Balance, u: Array, step: Array, slope: float) -> Array:
    """The first of the steps 1, 1/2, 1/4, ... that lowers the energy as it should."""
    energy, share = balance.energy(u), 1.0
    for _ in range(_MOST_HALVINGS):
        moved = u + share * step
        # The last steps change the energy by less than its rounding.
        if balance.energy(moved) <= energy + 1e-4 * share * slope + 1e-12 * abs(energy):
            return moved
        share *= 0.5
    return moved


def _solve(stiffness: Array, second: csc_array, right: Array) -> Array:
    """Solve with the inner points eliminated: sparse inside, dense on the outline."""
    nodes = len(stiffness)
    dense = stiffness + second[:nodes, :nodes].toarray()
    if len(right) == nodes:
        return np.asarray(cho_solve(cho_factor(dense), right))
    coupling = second[nodes:, :nodes].toarray()
    inner = splu(csc_array(second[nodes:, nodes:]))
    spread = inner.solve(np.column_stack([coupling, right[nodes:]]))
    dense -= coupling.T @ spread[:, :-1]
    outline = cho_solve(cho_factor(0.5 * (dense + dense.T)), right[:nodes] - coupling.T @ spread[:, -1])
    return np.concatenate([outline, spread[:, -1] - spread[:, :-1] @ outline])
