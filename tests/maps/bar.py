"""A bar of iron on smooth modes; each mode has a weaker field than the one before."""

from dataclasses import dataclass

import numpy as np

from fieldmap.iron.solvers.reduced import GalerkinModel


@dataclass
class Bar:
    """A model, and some numbers (r, k) of the field of each mode."""

    model: GalerkinModel
    fields: np.ndarray

    def off(self, currents, amplitudes, changes):
        sizes = np.linalg.norm(amplitudes @ self.fields, axis=1)
        return np.linalg.norm(changes @ self.fields, axis=1) / np.maximum(sizes, 1e-3 * sizes.max())


def solved(model, currents, tolerance=1e-10):
    return np.array([model.solve(values, np.zeros(model.modes), tolerance)[0] for values in currents])


def bar(tables, coils, modes, points, field=5e-3, falls=1, seen=12):
    """field: size of the coils' field at the points, T; falls: power by which the fields of modes fall."""
    random, places = np.random.default_rng(4), np.linspace(0.0, 1.0, points)
    waves = np.cos(np.pi * places[:, None] * np.arange(modes) + random.uniform(0.0, 3.0, (3, 1, modes)))
    gradients = np.moveaxis(waves, 0, 1).reshape(3 * points, modes) * np.geomspace(1.0, 0.05, modes)
    near = np.exp(-(((places[:, None] - np.linspace(0.1, 0.9, coils)) / 0.2) ** 2))
    source = (near[:, None] * random.standard_normal((3, coils))).reshape(3 * points, coils) * field
    model = GalerkinModel(
        gradients,
        source,
        np.full(points, 1.0 / points),
        np.zeros(points, np.int64),
        tables,
        gradients.T @ gradients / points + 0.05 * np.eye(modes),
        np.zeros(modes),
        remanent=np.zeros(coils),
    )
    weight = (1.0 + np.arange(modes))[:, None] ** falls
    return Bar(model, random.standard_normal((modes, seen)) / weight)
