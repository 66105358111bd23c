"""Small maps with numbers that any mix-up would show."""

import h5py
import numpy as np
import pytest

from fieldmap.store import FieldError, Grid, MapData, Provenance


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
