"""Small maps whose numbers reveal any exchange."""

import h5py
import numpy as np
import pytest

from fieldmap.currents import IndependentCurrents
from fieldmap.store import FieldError, Grid, MapData, Provenance, ReducedModel


def make_map(coil_names=("1", "upper left"), reference_current=1.0, shape=(4, 3, 5), **provenance):
    rng = np.random.default_rng(0)
    grid = Grid([-0.02, 0.01, -0.14], [0.004, 0.005, 0.0031], shape)
    n = len(coil_names)
    record = {
        "title": "A map for tests, 20 °C",
        "device_name": "rig",
        "recipe_text": "spacing_mm = 4\n",
        "device_text": 'title = "µ-metal"\n',
        "fingerprint": "abc",
        "versions": {"fieldmap": "0.1.0", "numpy": "2"},
        "included": {"../materials/steel.toml": 'name = "steel"\n', "core.step": "sha256:0f"},
        "solver_report": {"iterations": 7, "residual": 1.5e-9, "seconds": {"solve": 0.1}},
        "assumptions": ("linear iron", "no remanence"),
        "created": "2026-01-02 03:04:05 +0000",
    }
    return MapData(
        grid,
        tuple(coil_names),
        np.full(n, reference_current),
        Provenance(**(record | provenance)),
        FieldError(1e-9, 2e-7),
        {"harmonic": FieldError(2e-9, 3e-7), "global": FieldError(1e-9, 2e-7)},
        flux_density=rng.normal(size=(n, *shape, 3)),
        gradient=rng.normal(size=(n, *shape, 3, 3)),
    )


def numbers_in(path):
    """The bytes of all numbers in a file, by name."""
    found = {}

    def note(name, item):
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu":
            found[name] = item[()].tobytes()

    with h5py.File(path) as file:
        file.visititems(note)
    return found


@pytest.fixture(name="make_map", scope="session")
def _make_map():
    return make_map


@pytest.fixture
def data():
    """A map of two coils."""
    return make_map()


def make_model(**changes):
    """A made-up reduced model of two coils, whose arrays all have different lengths: 3 sample points, 4 modes, 5 fields
    of the iron, 7 knots, 6 training states."""
    rng = np.random.default_rng(3)
    given = {
        "gradients": rng.normal(size=(9, 4)),
        "source": rng.normal(size=(9, 2)),
        "weights": np.array([0.2, 0.5, 0.1]),
        "law": np.array([1, 0, 1]),
        "law_offset": np.array([0, 3, 7]),
        "law_knots": np.array([0.0, 1.0, 2.0, 0.0, 0.5, 1.0, 4.0]),
        "law_coefficients": rng.normal(size=(7, 4)),
        "air": rng.normal(size=(4, 4)),
        "constant": rng.normal(size=4),
        "output": rng.normal(size=(5, 4)),
        "known_currents": rng.normal(size=(6, 2)),
        "known_amplitudes": rng.normal(size=(6, 4)),
        "lower": np.array([-1.0, 0.5]),
        "upper": np.array([2.0, 3.0]),
        "parametrisation": IndependentCurrents(2),
        "reference_weights": np.array([0.5, -1.5, 2.5, 3.5, -4.5]),
        "fixed": rng.normal(size=9),
    }
    return ReducedModel(**(given | changes))


def make_saturating(model=None, **changes):
    """A map of two coils, five fields of iron and a background; every component of every field has its own numbers."""
    rng = np.random.default_rng(4)
    grid = Grid([-0.02, 0.01, -0.14], [0.004, 0.005, 0.0031], (4, 3, 5))
    given = {
        "reduced_model": make_model() if model is None else model,
        "fixed_sources": ("magnet", "background"),
        "constant_field": True,
        "current_error": FieldError(4e-6, 5e-3),
        "flux_density": rng.normal(size=(8, 4, 3, 5, 3)),
        "gradient": rng.normal(size=(8, 4, 3, 5, 3, 3)),
    }
    return MapData(grid, ("upper left", "1"), np.array([0.3, 7.0]), **(given | changes))
