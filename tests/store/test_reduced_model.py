"""The arrays of a reduced model: consistency, refusals, and storage."""

import h5py
import numpy as np
import pytest

from fieldmap.currents import IndependentCurrents, LiftAndDirections
from fieldmap.errors import InputError
from fieldmap.store import ReducedModel, read_map, write_map
from fieldmap.store.map_format import REDUCED_MODEL
from fieldmap.store.reduced_model import parametrisation_of
from tests.refusals import refused
from tests.store.conftest import make_model, make_saturating

# Lengths as in the class: p = 3, r = 4, c = 2, k = 5, 7 knots, 6 states, 2 signals.
SHAPES = {
    "gradients": (9, 4),
    "source": (9, 2),
    "weights": (3,),
    "law": (3,),
    "law_offset": (3,),
    "law_knots": (7,),
    "law_coefficients": (7, 4),
    "air": (4, 4),
    "constant": (4,),
    "output": (5, 4),
    "known_currents": (6, 2),
    "known_amplitudes": (6, 4),
    "lower": (2,),
    "upper": (2,),
    "reference_weights": (5,),
    "fixed": (9,),
}


def test_all_arrays_and_their_counts():
    model = make_model()
    assert {name: values.shape for name, values in model.arrays.items()} == SHAPES | {
        "pinning": (0, 0),
        "shares": (0,),
    }
    assert (model.coil_count, model.field_count, model.division_exponent.size) == (2, 5, 0)
    for name, values in model.arrays.items():
        assert values.dtype == (np.int64 if name in ("law", "law_offset") else np.float64)
        with pytest.raises(ValueError, match="read-only"):
            values[...] = 0
    for one, name in zip(model.laws, ("law_offset", "law_knots", "law_coefficients"), strict=True):
        assert one is model.arrays[name]
    assert (model.domain.lower.tolist(), model.domain.upper.tolist()) == ([-1.0, 0.5], [2.0, 3.0])
    fields = {name: values for name, values in model.arrays.items() if name != "fixed"}
    assert ReducedModel(**fields, parametrisation=model.parametrisation).fixed.shape == (0,)


LENGTHS = [
    (name, axis, step) for name, shape in SHAPES.items() for axis in range(len(shape)) for step in (-1, 1)
]


@pytest.mark.parametrize(("name", "axis", "step"), LENGTHS)
def test_an_array_one_longer_or_shorter_does_not_fit(name, axis, step):
    values = make_model().arrays[name]
    longer = np.concatenate([values, values.take([-1], axis=axis)], axis=axis)
    with pytest.raises(InputError) as caught:
        make_model(**{name: longer if step > 0 else values.take(range(values.shape[axis] - 1), axis=axis)})
    assert caught.value.problems[0].where.startswith("reduced model, ")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", [name for name in SHAPES if not name.startswith("law_o") and name != "law"])
def test_numbers_are_finite(name, value):
    values = make_model().arrays[name].copy()
    values.flat[-1] = value
    with refused(InputError, where=f"reduced model, {name}", received="NaN or infinity"):
        make_model(**{name: values})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("source", np.zeros(9)),
        ("source", np.zeros((9, 2, 1))),
        ("source", np.float64(1.0)),
        ("weights", np.float64(1.0)),
        ("law_offset", [3]),
        ("law_offset", [7]),
        ("law_offset", [1, 3, 7]),
        ("law_offset", [-1, 3, 7]),
        ("law_offset", [-1, 0, 7]),
        ("law_offset", [0, 3, 6]),
        ("law_offset", [0, 3, 8]),
        ("law_offset", [0, 7, 8]),
        ("law_offset", [0, 0, 7]),
        ("law_offset", [0, 7, 7]),
        ("law_offset", [0, 5, 3, 7]),
        ("law", [1, 0, 2]),
        ("law", [-1, 0, 1]),
        ("weights", [0.2, 0.0, 0.1]),
        ("weights", [0.2, -0.1, 0.1]),
        ("known_currents", np.zeros((0, 2))),
    ],
)
def test_numbers_that_do_not_belong_together(name, values):
    beside = {"known_amplitudes": np.zeros((0, 4))} if name == "known_currents" else {}
    with pytest.raises(InputError) as caught:
        make_model(**{name: np.array(values)}, **beside)
    # An array with another number of dimensions is reported together with the others.
    where = "source" if np.ndim(values) != make_model().arrays[name].ndim else name
    assert caught.value.problems[0].where == f"reduced model, {where}"


def test_what_was_received_is_told():
    with refused(InputError, received="[-1, 2]", must_hold="numbers of 2 laws"):
        make_model(law=np.array([2, -1, 0]))
    with refused(InputError, received="-0.1"):
        make_model(weights=np.array([0.2, -0.1, 0.1]))
    with refused(InputError, received="one of 6 coils", must_hold="one of 2 coils"):
        make_model(parametrisation=LiftAndDirections(1.25))
    with refused(InputError, received="one of 1 coils", must_hold="one of 2 coils"):
        make_model(parametrisation=IndependentCurrents(1))
    empty = {"law_knots": np.zeros(0), "law_coefficients": np.zeros((0, 4)), "law_offset": np.array([0])}
    with refused(InputError, where="reduced model, law_offset"):
        make_model(**empty)


def test_one_law_and_laws_of_one_knot():
    one = make_model(law=np.zeros(3), law_offset=np.array([0, 7]))
    assert one.laws[0].tolist() == [0, 7]
    make_model(law=np.array([2, 2, 1]), law_offset=np.array([0, 1, 2, 7]))


def test_a_file_keeps_each_array_with_its_checksum(tmp_path):
    """A missing chunk reads as nan, or as -1 for integers, which no model contains."""
    path = write_map(tmp_path / "map.h5", make_saturating())
    with h5py.File(path) as file:
        group = file[REDUCED_MODEL]
        assert set(group) == {*SHAPES, "division_exponent"}
        for name, shape in SHAPES.items():
            whole = name in ("law", "law_offset")
            assert (group[name].shape, group[name].dtype) == (shape, "i8" if whole else "f8")
            assert group[name].fletcher32
            np.testing.assert_array_equal(group[name].fillvalue, -1 if whole else np.nan)
            np.testing.assert_array_equal(group[name], make_model().arrays[name])
        assert group["division_exponent"].shape == (0,)
    again = read_map(path).reduced_model
    for name, values in make_model().arrays.items():
        np.testing.assert_array_equal(again.arrays[name], values)
    without = make_saturating(
        make_model(fixed=np.zeros(0)), constant_field=False, fixed_sources=(),
        flux_density=np.zeros((7, 4, 3, 5, 3)), gradient=np.zeros((7, 4, 3, 5, 3, 3)),
    )  # fmt: skip
    with h5py.File(write_map(tmp_path / "without.h5", without)) as file:
        assert set(file[REDUCED_MODEL]) == {*SHAPES, "division_exponent"} - {"fixed"}


def test_older_files_name_an_exponent_or_none():
    assert parametrisation_of(np.array([1.5]), 6) == LiftAndDirections(1.5)
    assert parametrisation_of(np.array([]), 3).coil_count == 3
    with refused(InputError, where="reduced model, division_exponent", received="2 numbers"):
        parametrisation_of(np.array([1.5, 1.5]), 6)
