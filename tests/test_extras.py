"""A function whose library is not installed names the command that installs it."""

import sys

import numpy as np
import pytest

from fieldmap.errors import FieldmapError
from fieldmap.extras import require
from fieldmap.interop import MagnetForces, jax_field, read_mag_manip
from fieldmap.interop.levitation_env import LevitationEnv
from fieldmap.studies.data_set import require_xarray


@pytest.mark.parametrize(
    ("call", "module", "extra"),
    [
        (lambda: MagnetForces(None, None, {}, np.zeros(1)), "mujoco", "mujoco"),
        (lambda: jax_field(None), "jax", "jax"),
        (LevitationEnv, "gymnasium", "gymnasium"),
        (lambda: read_mag_manip("none.yaml"), "yaml", "mag-manip"),
        (require_xarray, "h5netcdf", "studies"),
        (require_xarray, "xarray", "studies"),
    ],
)
def test_the_extra_is_named(call, module, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(FieldmapError) as caught:
        call()
    (problem,) = caught.value.problems
    assert problem.must_hold.split()[0] == module
    assert f'pip install ".[{extra}]"' in problem.remedy


def test_what_is_installed_is_given():
    assert require("numpy", "none", "here") is np
