"""The parts of a device that a key changes, and derivatives of quantities by their field samples, without a solve."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import DeviceFileError, InputError
from fieldmap.iron.sensitivity.changes import Parameters, same
from fieldmap.iron.sensitivity.quantities import (
    Derivatives,
    DipoleForce,
    FieldFunction,
    FluxDensityAt,
    FluxLinkage,
    GradientAt,
    Samples,
)
from tests.conftest import DEVICES
from tests.refusals import refused

RNG = np.random.default_rng(4)
SAMPLES = Samples(RNG.normal(size=(2, 3)), RNG.normal(size=(2, 3, 3)), RNG.normal(size=2), ("a", "b"))
AT = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]])
MOMENT = np.array([0.5, -1.0, 2.0])


@pytest.mark.parametrize(
    ("quantity", "value", "uses"),
    [
        (FluxDensityAt(AT), SAMPLES.field, {"field"}),
        (GradientAt(AT), SAMPLES.gradient, {"gradient"}),
        (DipoleForce(AT, MOMENT), np.einsum("i,nij->nj", MOMENT, SAMPLES.gradient), {"gradient"}),
        (FluxLinkage(), SAMPLES.linkage, {"linkage"}),
        (FluxLinkage("b"), SAMPLES.linkage[1], {"linkage"}),
        (
            FieldFunction(lambda f: 3.0 * f.field(AT[0])[2] - f.gradient(AT[1])[0, 1]),
            3.0 * SAMPLES.field[0, 2] - SAMPLES.gradient[1, 0, 1],
            {"field", "gradient"},
        ),
    ],
)
@pytest.mark.parametrize("size", [1.0, 0.0])
def test_quantities_and_how_they_follow_their_samples(quantity, value, uses, size):
    """All quantities here are linear: weights times samples give the values again, also where the samples are zero."""
    samples = replace(
        SAMPLES, **{name: size * getattr(SAMPLES, name) for name in ("field", "gradient", "linkage")}
    )
    np.testing.assert_allclose(quantity.of(samples), size * np.asarray(value), atol=1e-15)
    assert set(quantity.uses) == uses
    weights = quantity.weights(samples)
    total = np.zeros(np.size(value))
    for name in ("field", "gradient", "linkage"):
        own = getattr(weights, name)
        assert own.shape == (np.size(value), *getattr(SAMPLES, name).shape)
        assert own.any() == (name in uses)
        total += own.reshape(len(total), -1) @ getattr(SAMPLES, name).ravel()
    np.testing.assert_allclose(total, np.ravel(value), rtol=1e-9)


def test_places_of_quantities():
    single = FluxDensityAt(AT[0])
    assert single.points.tolist() == [AT[0].tolist()]
    assert single.of(replace(SAMPLES, field=SAMPLES.field[:1])).shape == (3,)
    assert DipoleForce(AT[0], MOMENT).of(replace(SAMPLES, gradient=SAMPLES.gradient[:1])).shape == (3,)
    assert GradientAt(AT[0]).of(replace(SAMPLES, gradient=SAMPLES.gradient[:1])).shape == (3, 3)
    assert FluxLinkage().points.shape == (0, 3)
    both = FieldFunction(lambda f: f.field(AT).sum() + f.field(AT[0])[0])
    assert (both.points.tolist(), both.uses) == ([*AT.tolist(), AT[0].tolist()], ("field",))
    with refused(InputError, where="FluxLinkage, coil"):
        FluxLinkage("c").of(SAMPLES)


def test_what_follows_from_derivatives():
    found = Derivatives(np.zeros(2), {"a": np.array([3.0, 0.0]), "b": np.array([-2.0, 0.0])}, 5)
    assert found["b"].tolist() == [-2.0, 0.0]
    assert found.change({"a": 0.5, "b": 2.0}).tolist() == [-2.5, 0.0]
    spread = found.spread({"a": 1.0, "b": 2.0})
    assert spread.deviation.tolist() == [5.0, 0.0]
    # A number that depends on no key has no shares.
    assert {key: share.tolist() for key, share in spread.shares.items()} == {
        "a": [0.36, 0.0],
        "b": [0.64, 0.0],
    }
    with pytest.raises(KeyError):
        found.spread({"c": 1.0})


@pytest.fixture(scope="module")
def keys():
    return Parameters(fm.read_device(DEVICES / "core_and_magnet.toml"))


@pytest.mark.parametrize(
    ("key", "currents"),
    [("current.around", [1.0, 0.0]), ("current.beside", [0.0, 1.0]), ("current.*", [1.0, 1.0])],
)
def test_a_current_changes_no_part_of_the_device(keys, key, currents):
    change = keys.change(key)
    assert change.currents.tolist() == currents
    assert change.above is change.below is keys.device
    assert (change.coils, change.has_shapes, change.has("coils", "bodies")) == ((), False, False)


@pytest.mark.parametrize(
    ("key", "step", "width"),
    [
        ("coil.around.position_mm.3", None, 2 * 15e-4),
        ("coil.around.position_mm.1", None, 2e-3),
        ("coil.beside.rotation_deg.2", None, 2e-2),
        ("coil.around.turns", None, 2 * 200e-4),
        ("material.magnet.remanence_T.2", None, 2e-6),
        ("material.magnet.remanence_T.3", None, 2e-4),
        ("coil.around.turns", 0.5, 1.0),
    ],
)
def test_a_step_is_a_share_of_the_value_or_the_least_of_its_unit(keys, key, step, width):
    assert keys.change(key, step).width == pytest.approx(width, rel=1e-9)


@pytest.mark.parametrize(
    ("key", "velocity", "axis"),
    [
        ("coil.beside.position_mm.2", [0.0, 1e-3, 0.0], [0.0, 0.0, 0.0]),
        # Rotations are taken about the fixed x, then the fixed y, then the fixed z axis.
        ("coil.beside.rotation_deg.3", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        (
            "coil.beside.rotation_deg.2",
            [0.0, 0.0, 0.0],
            [-np.sin(np.radians(30.0)), np.cos(np.radians(30.0)), 0.0],
        ),
    ],
)
def test_a_coil_that_moves_as_a_whole(keys, key, velocity, axis):
    change = keys.change(key)
    motion, spin = change.motion(1), np.radians(1.0) * np.cross(axis, np.eye(3)).T
    np.testing.assert_allclose(motion.velocity, velocity, atol=1e-12)
    # The columns are w x r of the machine's axes, per degree.
    np.testing.assert_allclose(motion.spin, spin, atol=1e-9)
    assert (change.coils, change.turns(1), change.has_shapes) == ((1,), None, False)
    assert (change.has("coils"), change.has("bodies", "materials", "background")) == (True, False)
    # The other coil stays as it is.
    other = change.motion(0)
    assert not np.any([*other.velocity, *other.spin.ravel()])


def test_what_else_follows_a_key(keys):
    turns = keys.change("coil.beside.turns")
    assert (turns.coils, turns.motion(1), turns.turns(1)) == ((1,), None, pytest.approx(0.01))
    wide = keys.change("coil.around.outer_radius_mm")
    assert (wide.coils, wide.motion(0), wide.turns(0)) == ((0,), None, None)
    assert wide.slope(lambda side: side.coils[0].outer_radius) == pytest.approx(1e-3)
    body = keys.change("body.plate.size_mm.1")
    assert (body.coils, body.has_shapes, body.has("materials")) == ((), True, False)
    finer = keys.change("body.plate.mesh_size_mm")
    assert (finer.has_shapes, finer.has("bodies")) == (False, True)
    law = keys.change("material.iron.mu_r")
    assert (law.has_shapes, law.has("bodies"), law.has("materials")) == (False, False, True)
    assert keys.change("background.flux_density_mT.3").has("background")


@pytest.mark.parametrize(
    ("key", "error", "received"),
    [
        ("current.centre", InputError, "'centre'"),
        ("coil.around.name", InputError, "['around']"),
        ("coil.*.turns", InputError, "[200, 100]"),
        ("coil.around.colour", DeviceFileError, None),
    ],
)
def test_keys_without_a_derivative(keys, key, error, received):
    with pytest.raises(error) as caught:
        keys.change(key)
    if received is not None:
        (told,) = caught.value.problems
        assert (told.where, told.received) == (f"derivative, {key}", received)


def test_parts_that_are_the_same_number_by_number():
    one, array = fm.Placement((0.1, 0.2, 0.3)), np.arange(3.0)
    assert same(one, fm.Placement((0.1, 0.2, 0.3)))
    assert not same(one, fm.Placement((0.1, 0.2, 0.31)))
    for a, b, equal in (
        (array, array.copy(), True),
        (array, array + 1.0, False),
        ({"a": array}, {"a": array.copy()}, True),
        ({"a": array}, {"b": array}, False),
        ({"a": array}, {"a": 2 * array}, False),
        ([1, array], [1, array.copy()], True),
        ((1, 2), (1, 2, 3), False),
        ((1, 2), [1, 2], False),
        (1.0, 1, False),
        ("a", "a", True),
        (None, None, True),
    ):
        assert same(a, b) is equal
