"""Solved iron as a magpylib source: magpylib's answers against the solution and magpylib's own objects."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron import NonlinearSolver
from fieldmap.magpylib_source import FieldSource
from fieldmap.maps.fields import from_arrays, to_arrays
from fieldmap.sources import CoilSet
from fieldmap.sources.magpylib_objects import magpylib_coil, magpylib_tetrahedra

AIR = np.array([[0.0, 0.0, -0.006], [0.008, 0.002, -0.004], [0.012, 0.0, 0.01], [0.0, -0.03, 0.05]])
# One point in the core, one in the magnet, one in the winding.
INSIDE = np.array([[0.001, 0.0, 0.005], [0.0005, 0.0004, 0.03], [0.007, 0.0, 0.01]])
EVERYWHERE = np.vstack([AIR, INSIDE])
TURN = Rotation.from_rotvec([0.3, 0.2, -0.5])
SHIFT = np.array([0.01, -0.02, 0.03])
BLOCK = magpylib.magnet.Cuboid(
    polarization=(0.2, 0.0, 1.0), dimension=(0.01, 0.008, 0.006), position=(0.05, 0, 0)
)


def device(material):
    core = fm.Body("core", "iron", fm.Cylinder(0.005, 0.02), 0.004, 0.001)
    magnet = fm.Body("magnet", "magnet", fm.Sphere(0.003), 0.0015).moved([0, 0, 0.03])
    coil = fm.CircularCoil("coil", 0.006, 0.008, 0.01, 100.0).moved([0, 0, 0.01])
    magnetised = fm.PermanentMagnet("magnet", np.array([0.3, 0.0, 1.0]), 1.05)
    return fm.Device("d", "", (coil,), (core, magnet), {"iron": material, "magnet": magnetised})


@pytest.fixture(scope="module")
def unit():
    return fm.solve_linear(device(fm.LinearMaterial("iron", 200.0)))


@pytest.fixture(scope="module")
def solver():
    return NonlinearSolver(device(fm.Froehlich("iron", 2000.0, 2.1)))


@pytest.fixture(scope="module")
def state(solver):
    return solver.solve([30.0])


def relative(one, other):
    return np.abs(one - other).max() / np.abs(other).max()


def test_beside_another_source_and_on_sensors(unit):
    sensors = [magpylib.Sensor(pixel=AIR), magpylib.Sensor(pixel=AIR, position=SHIFT, orientation=TURN)]
    both = magpylib.getB([unit.as_magpylib([3.0]), BLOCK], sensors)
    for k, sensor in enumerate(sensors):
        points = TURN.apply(AIR) + SHIFT if k else AIR
        ours = unit.field(points, [3.0])
        theirs = BLOCK.getB(points)
        for j, field in enumerate((ours, theirs)):
            assert relative(both[j, k], TURN.inv().apply(field) if k else field) < 1e-12
        sum_of_both = magpylib.getB([unit.as_magpylib([3.0]), BLOCK], sensor, sumup=True)
        assert relative(sum_of_both, TURN.inv().apply(ours + theirs) if k else ours + theirs) < 1e-12


def test_a_saturated_state_everywhere(solver, state):
    assert relative(state.as_magpylib().getB(EVERYWHERE), state.field(EVERYWHERE)) < 1e-12
    assert relative(solver.as_magpylib([30.0]).getB(AIR), state.field(AIR)) < 1e-6


def test_h_j_and_m_in_air_iron_and_magnet(unit):
    source = unit.as_magpylib([3.0])
    flux, polarisation = source.getB(EVERYWHERE), source.getJ(EVERYWHERE)
    strength, magnetisation = source.getH(EVERYWHERE), source.getM(EVERYWHERE)
    assert relative(magpylib.mu_0 * strength + polarisation, flux) < 1e-15
    assert relative(magpylib.mu_0 * magnetisation, polarisation) < 1e-15
    # The laws of the materials: J = (1 - 1/mu_r) B, and B = mu_r mu0 H + remanence.
    assert relative(polarisation[4], (1 - 1 / 200) * flux[4]) < 1e-9
    remanence = flux[5] - 1.05 * magpylib.mu_0 * strength[5]
    assert remanence == pytest.approx(np.array([0.3, 0.0, 1.0]), abs=1e-9)
    assert not polarisation[[0, 1, 2, 3, 6]].any()


def test_moved_and_turned_on_a_path(unit):
    source = unit.as_magpylib([3.0], position=SHIFT)
    source.rotate(TURN, anchor=None).move([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]], start=0)
    found = source.getB(AIR)
    for k, shift in enumerate([SHIFT, SHIFT + [0.01, 0.0, 0.0]]):
        exact = TURN.apply(unit.field(TURN.inv().apply(AIR - shift), [3.0]))
        assert relative(found[k], exact) < 1e-12


def test_in_a_collection_that_is_turned_and_as_a_copy_that_moves_apart(unit):
    source = unit.as_magpylib([3.0])
    group = magpylib.Collection(source.copy(), BLOCK.copy()).rotate(TURN, anchor=(0, 0, 0))
    inward = TURN.inv().apply(AIR)
    exact = TURN.apply(unit.field(inward, [3.0]) + BLOCK.getB(inward))
    assert relative(group.getB(AIR), exact) < 1e-12
    twin = source.copy(position=SHIFT)
    assert twin.field is source.field
    both = magpylib.getB([source, twin], AIR)
    assert relative(both[1], unit.field(AIR - SHIFT, [3.0])) < 1e-12
    assert relative(both[0], unit.field(AIR, [3.0])) < 1e-12


def test_force_and_torque_on_a_small_magnet(unit):
    """magpylib's sum over cells of a small cube against a dipole in the solver's gradient."""
    position, polarisation = np.array([0.006, 0.002, -0.012]), np.array([0.5, -0.3, 1.0])
    cube = magpylib.magnet.Cuboid(polarization=polarisation, dimension=(5e-4,) * 3, position=position)
    force, torque = magpylib.getFT(unit.as_magpylib([3.0]), cube, meshing=27)
    wrench = unit.wrench([position], [polarisation * 5e-4**3 / magpylib.mu_0], [3.0])[0]
    assert np.linalg.norm(force - wrench[:3]) < 1e-3 * np.linalg.norm(wrench[:3])
    assert np.linalg.norm(torque - wrench[3:]) < 1e-3 * np.linalg.norm(wrench[3:])


def test_making_a_source_evaluates_nothing():
    class Unasked:
        coil_names, currents = ("coil",), np.ones(1)

        def field(self, points):
            raise AssertionError(f"asked at {points}")

    source = FieldSource(Unasked())
    with pytest.raises(AssertionError):
        source.getB([0.0, 0.0, 0.0])
    with pytest.raises(AttributeError):
        source.field_func = lambda field, observers: observers


def test_each_observer_is_asked_once(unit, monkeypatch):
    """getB then costs as much as `field`."""
    source, asked = unit.as_magpylib([3.0]), []
    own = type(source.field).field
    monkeypatch.setattr(type(source.field), "field", lambda self, x: asked.append(len(x)) or own(self, x))
    magpylib.getB([source, BLOCK], [magpylib.Sensor(pixel=AIR), magpylib.Sensor(pixel=AIR, position=SHIFT)])
    assert asked == [2 * len(AIR)]


@pytest.mark.parametrize("backend", ["plotly", "matplotlib"])
def test_show_draws_iron_and_windings(unit, backend, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    source = unit.as_magpylib([3.0], style_label="unit")
    figure = magpylib.show(source, backend=backend, return_fig=True)
    assert figure is not None
    traces = source.style.model3d.data
    assert [trace.kwargs["name"] for trace in traces] == ["core", "magnet", "coil"]
    core, coil = (np.column_stack([traces[k].kwargs[axis] for axis in "xyz"]) for k in (0, 2))
    assert np.hypot(*core[:, :2].T).max() == pytest.approx(0.005, rel=0.1)
    assert core[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    radius = np.hypot(*coil[:, :2].T)
    assert (radius.min(), radius.max()) == pytest.approx((0.006, 0.008))
    for trace in traces:
        corners = np.column_stack([trace.kwargs[axis] for axis in "xyz"])
        assert volume(corners, np.column_stack([trace.kwargs[k] for k in "ijk"])) > 0


def test_a_style_that_is_given_later_is_taken(unit):
    source = unit.as_magpylib([3.0], style_label="unit")
    source.style = {"label": "mine"}
    assert source.style.label == "mine"


def volume(points, triangles):
    """Signed volume of a closed surface: positive if its triangles turn outward."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return np.einsum("kd,kd->", a, np.cross(b, c)) / 6


def test_outlines_are_closed_and_turn_outward(unit):
    core, magnet, coil = unit.outlines()
    assert volume(core.points, core.triangles) == pytest.approx(np.pi * 0.005**2 * 0.02, rel=1e-3)
    assert volume(magnet.points, magnet.triangles) == pytest.approx(4 / 3 * np.pi * 0.003**3, rel=1e-2)
    exact = np.pi * (0.008**2 - 0.006**2) * 0.01
    assert volume(coil.points, coil.triangles) == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_the_polarisation_of_a_magnet_makes_magpylibs_field(form):
    """At mu_r = 1 it is the remanence at any current: magpylib's own block and coil, and its tetrahedra."""
    remanence = np.array([0.3, -0.2, 1.0])
    block = fm.Body("block", "magnet", fm.Box((0.01, 0.008, 0.006)), 0.003).moved([0, 0, 0.02])
    coil = fm.CircularCoil("coil", 0.006, 0.008, 0.01, 100.0).moved([0, 0, 0.008])
    magnet = {"magnet": fm.PermanentMagnet("magnet", remanence, 1.0)}
    unit = fm.solve_linear(fm.Device("d", "", (coil,), (block,), magnet), form=form, tolerance=1e-7)
    exact = magpylib.magnet.Cuboid(
        polarization=remanence, dimension=(0.01, 0.008, 0.006), position=(0, 0, 0.023)
    ).getB(AIR) + magpylib_coil(coil, 3.0).getB(AIR)
    assert relative(unit.as_magpylib([3.0]).getB(AIR), exact) < 1e-4
    cells = tetrahedra_of(unit.at([3.0])).getB(AIR) + magpylib_coil(coil, 3.0).getB(AIR)
    assert cells == pytest.approx(exact, rel=1e-7, abs=1e-12)


def tetrahedra_of(state):
    """The polarisation that `getJ` gives, as magpylib's own tetrahedra."""
    corners = state.mesh.points[state.mesh.tets]
    return magpylib_tetrahedra(corners, state.as_magpylib().getJ(corners.mean(axis=1)), "iron")


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_the_polarisation_of_linear_iron_makes_its_field(form):
    """Tetrahedra of constant polarisation, to their discretisation error."""
    unit = fm.solve_linear(device(fm.LinearMaterial("iron", 200.0)), form=form, refinement=1.3)
    ours = unit.field(AIR, [3.0])
    theirs = tetrahedra_of(unit.at([3.0])).getB(AIR) + magpylib_coil(unit.coils[0], 3.0).getB(AIR)
    assert (np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)).max() < 0.03


def test_the_polarisation_of_a_saturated_state_makes_its_field():
    """Mean polarisations replace the second-order form's charges; the mesh makes the difference small."""

    def error(refinement):
        state = fm.solve(device(fm.Froehlich("iron", 2000.0, 2.1)), [30.0], refinement=refinement)
        ours = state.field(AIR)
        theirs = tetrahedra_of(state).getB(AIR) + magpylib_coil(state.coils[0], 30.0).getB(AIR)
        return np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)

    coarse, fine = error(0.7), error(1.4)
    assert fine.max() < 0.02
    assert (fine < 0.7 * coarse).all()


def test_coils_alone_and_solutions_read_back(unit):
    coils = device(fm.LinearMaterial("iron", 2.0)).coils
    source = CoilSet(coils).as_magpylib(2.0)
    assert relative(source.getB(EVERYWHERE), CoilSet(coils).field(EVERYWHERE, 2.0)) < 1e-15
    assert relative(source.getB(AIR), magpylib_coil(coils[0], 2.0).getB(AIR)) < 1e-6
    assert not source.getJ(EVERYWHERE).any()
    whole = device(fm.LinearMaterial("iron", 2.0))
    core = whole.replace(bodies=whole.bodies[:1])
    solved = fm.solve_linear(core)
    stored = from_arrays(core, *to_arrays(solved, np.ones(1))).as_magpylib([1.0])
    assert relative(stored.getB(AIR), solved.field(AIR, [1.0])) < 1e-12
    with pytest.raises(InputError) as caught:
        stored.getH(AIR)
    assert caught.value.problems[0].where == "magnetisation"


def test_options_that_magpylib_refuses(unit):
    with pytest.raises(InputError) as caught:
        unit.as_magpylib([3.0], position="here")
    assert caught.value.problems[0].where == "as_magpylib"
