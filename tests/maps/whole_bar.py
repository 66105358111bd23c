"""A bar of iron as a solver of whole devices: its nodes are modes, and each state takes a millisecond."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from fieldmap.constants import MU0
from fieldmap.device.materials.froehlich import Froehlich
from fieldmap.device.model import CircularCoil
from fieldmap.errors import NotConverged, Problem
from fieldmap.iron.elements.bh_law import law_tables
from fieldmap.iron.solvers.nonlinear import StateImage
from tests.maps.bar import bar

COILS = tuple(CircularCoil(name, 6e-3, 8e-3, 10e-3, 100 + 50 * k) for k, name in enumerate("abc"))
POINTS = 1e-3 * np.array(
    [[1.0, 2.0, 30.0], [-8.0, 5.0, 25.0], [3.0, -9.0, 45.0], [0.0, 1.0, 60.0], [7.0, 1.0, 33.0]]
)
FACES = 6


@dataclass(frozen=True)
class Report:
    """The solver's report: the currents of the state."""

    currents: tuple[float, ...]


class WholeBar:
    """A stand-in for `NonlinearSolver` in a training. Half of the bar's own energy counts as energy of the air."""

    def __init__(self, coils=2, nodes=30, points=150, strength=5e-3, images=True):
        self.bar = bar(law_tables([Froehlich("steel", 2000.0, 2.1)]), coils, nodes, points, strength)
        self.model, self.unknowns, self.matrix_bytes = self.bar.model, nodes, 0
        random = np.random.default_rng(31)
        self._charge = random.standard_normal((FACES, nodes)) / (1.0 + np.arange(nodes))
        self._flux = 2e-3 * random.standard_normal((FACES, len(POINTS), 3))
        self._gradient = 0.1 * random.standard_normal((FACES, len(POINTS), 3, 3))
        self.device = SimpleNamespace(coils=COILS[:coils], background=None, fixed_sources=())
        self.surface = SimpleNamespace(field_and_gradient=self._fields)
        reversal = StateImage(np.arange(coils), -np.ones(coils), np.arange(nodes), -1.0)
        self.images = (reversal,) if images else ()
        self.solves, self.fails = [], ()

    def _fields(self, points, charge):
        assert points is POINTS
        return tuple(np.tensordot(charge, of, 1) for of in (self._flux, self._gradient))

    def potential(self, currents):
        return self.model.solve(np.asarray(currents, float), np.zeros(self.unknowns), 1e-10)[0]

    def solve_potential(self, currents, tolerance, start=None):
        self.solves.append((tuple(currents), tolerance, start))
        if tuple(currents) in self.fails:
            raise NotConverged(Problem("bar", "must converge", "no", "refine"))
        potential = self.potential(currents)
        return potential, self.air(potential)

    def solve(self, currents, tolerance, start=None):
        potential = self.solve_potential(currents, tolerance, start)[0]
        state = SimpleNamespace(potential=potential[:, None])
        return SimpleNamespace(state=state, report=Report(tuple(currents)))

    def sensitivities(self, currents, potential, directions):
        steps = 1e-4 * directions.T
        pairs = [self.potential(currents + step) - self.potential(currents - step) for step in steps]
        return np.array(pairs).T / 2e-4

    def air(self, potential):
        return 0.5 * self.model.air @ potential

    def _whole(self, currents, potential):
        factor = self.model.tangent_factor(currents, potential)
        return factor @ factor.T

    def tangent(self, currents, potential):
        return self._whole(currents, potential) - 0.5 * self.model.air

    def energy_operator(self, currents, potential):
        return self._whole(currents, potential).__matmul__

    def project(self, basis, air=None):
        return self.model.combined(basis)

    def corrections(self, currents, potential, air, tolerance=0.03):
        unsaturated = self._whole(np.zeros(currents.shape[1]), np.zeros(self.unknowns))
        return np.linalg.solve(unsaturated, self.model.residuals(currents, potential.T).T)

    def iron_linkage(self, currents, potential):
        h = self.model.source @ currents - self.model.gradients @ potential
        size = np.linalg.norm(h.reshape(-1, 3), axis=1)
        b = self.model.tables.flux_density(size, self.model.law)[0]
        moments = (self.model.weights * (b / size - 1.0))[:, None] * h.reshape(-1, 3)
        return self.model.source.T @ moments.ravel() / MU0

    def iron_inductance(self, currents, potential):
        ends = (
            currents + step * 1e-4 for step in np.concatenate([np.eye(len(currents)), -np.eye(len(currents))])
        )
        linkages = np.array([self.iron_linkage(end, self.potential(end)) for end in ends])
        plus, minus = np.split(linkages, 2)
        return (plus - minus).T / 2e-4

    def charge_density(self, potential):
        return (self._charge @ potential).T
