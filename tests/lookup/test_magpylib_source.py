"""Maps as magpylib sources: the map's own field inside its box, NaN outside."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.lookup import FieldMap

CURRENTS = np.array([1.0, -2.0, 0.5])
TURN = Rotation.from_rotvec([0.3, 0.2, -0.5])


@pytest.mark.parametrize("kind", ["hermite", "harmonic", "global"])
@pytest.mark.parametrize("outside", ["raise", "nan", "clamp"])
def test_the_maps_field_inside_and_nan_outside(dipoles, kind, outside):
    opened = FieldMap(dipoles.map((6, 5, 6)), kind=kind, outside=outside)
    points = dipoles.points(50)
    source = opened.as_magpylib(CURRENTS)
    field = opened.field(points, CURRENTS)
    beyond = points + [1.0, 0.0, 0.0]
    found = source.getB(np.vstack([points, beyond]))
    assert np.abs(found[:50] - field).max() < 1e-12 * np.abs(field).max()
    assert np.isnan(found[50:]).all()
    assert np.abs(magpylib.mu_0 * source.getH(points) - field).max() < 1e-12 * np.abs(field).max()
    assert not source.getM(points).any()
    assert np.isnan(source.getJ(beyond)).all()


def test_corners_of_the_box_belong_to_it(coarse, dipoles):
    corners = np.array([dipoles.lower, dipoles.upper])
    assert np.isfinite(coarse.as_magpylib(CURRENTS).getB(corners)).all()
    assert np.isfinite(coarse.at(CURRENTS).as_magpylib().getB(corners)).all()
    assert np.isnan(coarse.at(CURRENTS).as_magpylib().getB([1.0, 0.0, 0.0])).all()


def test_making_one_asks_the_map_for_nothing(coarse, monkeypatch):
    """magpylib tries field functions at (1, 2, 3) and (4, 5, 6) m, far outside: nothing must depend on it."""
    fixed = coarse.at(CURRENTS)
    monkeypatch.setattr(type(fixed), "field", None)
    source = coarse.as_magpylib(CURRENTS)
    with pytest.raises(TypeError):
        source.getB((coarse.lower + coarse.upper) / 2)


def test_beside_a_magnet_and_moved(coarse, dipoles):
    magnet = magpylib.magnet.Sphere(polarization=(0, 0, 1.0), diameter=0.01, position=(0.1, 0, 0))
    points, shift = dipoles.points(20), np.array([0.3, 0.1, -0.2])
    source = coarse.as_magpylib(CURRENTS, position=shift, orientation=TURN)
    moved = TURN.apply(points) + shift
    both = magpylib.getB([source, magnet], magpylib.Sensor(pixel=moved))
    field = TURN.apply(coarse.field(points, CURRENTS))
    assert np.abs(both[0] - field).max() < 1e-12 * np.abs(field).max()
    assert both[1] == pytest.approx(magnet.getB(moved), rel=1e-14)


def test_force_and_torque_on_a_small_magnet(fine):
    position, polarisation = np.array([0.002, 0.003, -0.011]), np.array([0.5, -0.3, 1.0])
    ball = magpylib.magnet.Sphere(polarization=polarisation, diameter=1e-3, position=position)
    force, torque = magpylib.getFT(fine.as_magpylib(CURRENTS), ball)
    moment = polarisation * np.pi / 6 * 1e-9 / magpylib.mu_0
    wrench = fine.wrench([position], [moment], CURRENTS)[0]
    assert np.linalg.norm(force - wrench[:3]) < 1e-3 * np.linalg.norm(wrench[:3])
    assert np.linalg.norm(torque - wrench[3:]) < 1e-3 * np.linalg.norm(wrench[3:])


def test_show_draws_box_windings_and_iron(coarse):
    source = coarse.as_magpylib(CURRENTS)
    (box,) = source.style.model3d.data
    assert [min(box.kwargs[axis]) for axis in "xyz"] == pytest.approx(list(coarse.lower))
    assert [max(box.kwargs[axis]) for axis in "xyz"] == pytest.approx(list(coarse.upper))
    assert magpylib.show(source, backend="plotly", return_fig=True).data


def test_outlines_of_a_recorded_device(dipoles):
    """A map made of a device records its text: windings and iron are drawn from the text."""
    from dataclasses import replace

    data = dipoles.map((3, 3, 3), n_coils=1)
    provenance = replace(data.provenance, device_text=fm.read_device("loop_and_sphere").text)
    names = [one.kind for one in FieldMap(replace(data, provenance=provenance)).outlines()]
    assert names == ["iron", "coil", "map"]
