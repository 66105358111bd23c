"""The solved device: total flux density and its gradient anywhere outside the iron, flux density inside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.device.model import Coil
from fieldmap.errors import InputError, Problem
from fieldmap.iron.inside import containing_element
from fieldmap.iron.mesh import IronMesh, volumes
from fieldmap.iron.problem import LinearState
from fieldmap.iron.report import SolverReport
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Coils and linear iron, solved once per coil; any currents by superposition.

    Fields in T, gradients G[..., i, j] = dB_i/dx_j in T/m, points (n, 3) or (3,) in m, global frame. The remanence
    of permanent magnets, if any, adds a field that no current changes.

    >>> import fieldmap as fm                                                    # doctest: +SKIP
    >>> unit = fm.solve_linear(fm.read_device("loop_and_sphere"))                # doctest: +SKIP
    >>> unit.field([0.0, 0.0, -0.05], [1.0])                                     # doctest: +SKIP
    """

    coils: tuple[Coil, ...]
    mesh: IronMesh | None
    state: LinearState | None
    has_remanence: bool
    report: SolverReport

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return tuple(coil.name for coil in self.coils)

    def unit_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Total field (c, n, 3) in T/A and gradient (c, n, 3, 3) in T/(m A) of 1 A in each coil, outside the iron.

        Without the field of permanent magnets. Raises InputError for points that are not (n, 3) or not finite, and
        for points inside the iron, where the gradient is not defined by the solver.
        """
        x, _ = _checked_points(points)
        self._refuse_inside(x)
        b, g = self._air_fields(x)
        return b[: len(self.coils)], g[: len(self.coils)]

    def remanent_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Field (n, 3) and gradient (n, 3, 3) of the permanent magnets with all currents off, outside the iron."""
        x, _ = _checked_points(points)
        self._refuse_inside(x)
        if not self.has_remanence:
            return np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
        b, g = self._air_fields(x)
        return b[-1], g[-1]

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Flux density (n, 3) at points (n, 3), or (3,) at (3,), for currents (c,) in A.

        Inside the iron it is the flux density of the element, constant per element. Raises InputError as
        `unit_fields` does, and for a wrong number of currents.
        """
        x, single = _checked_points(points)
        weights = self._weights(currents)
        b = np.einsum("c,cnd->nd", weights, self._columns(x))
        if self.mesh is not None and self.state is not None:
            element = containing_element(self.mesh, x)
            inside = element >= 0
            if inside.any():
                b[inside] = self._element_flux_density(weights)[element[inside]]
        return b[0] if single else b

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Gradient (n, 3, 3) at points (n, 3), or (3, 3) at (3,), for currents (c,) in A; outside the iron only."""
        x, single = _checked_points(points)
        weights = self._weights(currents)
        self._refuse_inside(x)
        g = np.einsum("c,cnij->nij", weights, self._air_fields(x)[1])
        return g[0] if single else g

    def flux_density(self, body: str, currents: ArrayLike) -> Array:
        """Mean flux density (3,) in T over the volume of a named body, for currents (c,) in A."""
        weights = self._weights(currents)
        if self.mesh is None or self.state is None or body not in self.mesh.body_names:
            names = self.mesh.body_names if self.mesh is not None else ()
            raise InputError(
                Problem(
                    "flux_density, body",
                    f"the name must be one of {', '.join(names)}",
                    repr(body),
                    "use one of these",
                )
            )
        mine = self.mesh.body == self.mesh.body_names.index(body)
        volume = volumes(self.mesh.points, self.mesh.tets)[mine]
        return volume @ self._element_flux_density(weights)[mine] / volume.sum()

    def _element_flux_density(self, weights: Array) -> Array:
        """Flux density (e, 3) of every element for the weights of all columns."""
        assert self.mesh is not None
        assert self.state is not None
        corners = self.mesh.points[self.mesh.tets]
        arms = corners.mean(axis=1)[:, None, :] - corners
        flux = np.einsum("c,cek->ek", weights, self.state.flux)
        return np.einsum("ek,ekd->ed", flux, arms) / (3 * volumes(self.mesh.points, self.mesh.tets)[:, None])

    def _weights(self, currents: ArrayLike) -> Array:
        values = np.atleast_1d(np.asarray(currents, dtype=float))
        if values.shape != (len(self.coils),) or not np.isfinite(values).all():
            raise InputError(
                Problem(
                    "currents",
                    f"there must be {len(self.coils)} finite currents, one per coil ({', '.join(self.coil_names)})",
                    f"shape {values.shape}: {values}",
                    "give them in the order of the device file",
                )
            )
        return np.append(values, 1.0) if self.has_remanence else values

    def _columns(self, x: Array) -> Array:
        """Field (c, n, 3) of every column: coils, then remanence."""
        b = np.zeros((len(self.coils) + self.has_remanence, len(x), 3))
        for k, coil in enumerate(self.coils):
            b[k] = unit_flux_density(coil, x)
        if self.state is not None:
            b += self.state.faces.field(x, self.state.density)
        return b

    def _air_fields(self, x: Array) -> tuple[Array, Array]:
        columns = len(self.coils) + self.has_remanence
        b, g = np.zeros((columns, len(x), 3)), np.zeros((columns, len(x), 3, 3))
        for k, coil in enumerate(self.coils):
            b[k], g[k] = unit_flux_density_and_gradient(coil, x)
        if self.state is not None:
            iron_b, iron_g = self.state.faces.field_and_gradient(x, self.state.density)
            b += iron_b
            g += iron_g
        return b, g

    def _refuse_inside(self, x: Array) -> None:
        if self.mesh is None:
            return
        element = containing_element(self.mesh, x)
        inside = np.flatnonzero(element >= 0)
        if len(inside):
            name = self.mesh.body_names[self.mesh.body[element[inside[0]]]]
            raise InputError(
                Problem(
                    "points",
                    "the gradient is defined outside the iron only",
                    f"{len(inside)} of {len(x)} points inside, the first at {x[inside[0]]} m in body '{name}'",
                    "keep the points in the air",
                )
            )


def _checked_points(points: ArrayLike) -> tuple[Array, bool]:
    x = np.ascontiguousarray(points, dtype=float)
    if x.shape[-1:] != (3,) or x.ndim > 2 or not np.isfinite(x).all():
        raise InputError(
            Problem(
                "points",
                "points must be finite and of shape (n, 3) or (3,)",
                f"shape {x.shape}",
                "give x, y, z in m",
            )
        )
    return np.atleast_2d(x), x.ndim == 1
