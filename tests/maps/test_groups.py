"""A map of saturating iron over the currents of groups of coils, which carry one current each."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.currents import CoilGroups
from fieldmap.errors import OutsideMapError
from fieldmap.iron import NonlinearSolver
from fieldmap.maps import generation, read_recipe
from fieldmap.maps.training import condensation
from fieldmap.store import read_map


@pytest.mark.filterwarnings("ignore::fieldmap.errors.MapAccuracyWarning")
def test_two_coils_moved_together(few_states, monkeypatch):
    """The field is the solver's at equal currents; others are outside the map."""
    # How well the workspace is seen by fewer modes, and the certificate, are other tests' claims.
    monkeypatch.setattr(condensation, "_STATES", 60)
    monkeypatch.setattr(generation, "certified_bounds", lambda *_: {})
    lines = [
        line for line in few_states.read_text().splitlines() if not line.startswith(("lower_A", "upper_A"))
    ]
    at = lines.index("[currents]") + 1
    groups = ["lower_A = 0.5", "upper_A = 2.0", 'groups = [["left", "right"]]']
    recipe = few_states.with_name("groups.toml")
    recipe.write_text("\n".join([*lines[:at], *groups, *lines[at:]]))
    made = fm.generate(recipe, few_states.with_name("map.h5"), accept_error=True)

    model, opened = read_map(made).reduced_model, fm.open_map(made)
    assert model.parametrisation == CoilGroups(((0, 1),))
    assert (model.lower.tolist(), model.upper.tolist()) == ([0.5], [2.0])
    assert (np.ptp(model.known_currents, axis=1) < 1e-12).all()
    point, order = 0.5 * (opened.lower + opened.upper), read_recipe(recipe)
    solver = NonlinearSolver(fm.read_device(few_states.with_name("two_cores.toml")), order.refinement)
    for current in (0.7, 1.9):
        truth = solver.at([current, current]).field(point)
        ours = opened.field(point, [current, current])
        assert np.linalg.norm(ours - truth) < 0.01 * np.linalg.norm(truth)
    for currents in ([1.0, 1.1], [2.5, 2.5]):
        with pytest.raises(OutsideMapError):
            opened.field(point, currents)
