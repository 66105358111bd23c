"""Every table of units against the SI: each unit is parsed from its name, and must have that size and dimension."""

import re

import numpy as np
import pytest

from fieldmap.cli.studies import _UNITS as IN_TABLES
from fieldmap.inputs.columns import UNITS as OF_COLUMNS
from fieldmap.inputs.tables import UNITS as OF_KEYS
from fieldmap.interop.fmu import _UNITS as OF_FMI
from fieldmap.plot.words import _UNITS as IN_WORDS
from fieldmap.plot.words import fitting_prefix
from fieldmap.store.map_format import FLUX_DENSITY, GRADIENT
from fieldmap.studies.machine_fit import _KINDS as OF_FITS
from fieldmap.studies.quantities import QUANTITIES as OF_STUDIES

BASE = ("m", "kg", "s", "A", "K", "mol", "cd", "rad")
"""The bases of openPMD's unitDimension in their order, and the angle, a base of FMI."""

# By their definitions as products (SI brochure, 9th edition, table 4).
DERIVED = {
    "Hz": "s-1",
    "N": "kg m s-2",
    "J": "N m",
    "W": "J s-1",
    "V": "W A-1",
    "ohm": "V A-1",
    "S": "A V-1",
    "Wb": "V s",
    "T": "Wb m-2",
    "H": "Wb A-1",
}
OTHERS = {
    "g": (1e-3, "kg"),
    "min": (60.0, "s"),
    "deg": (np.pi / 180.0, "rad"),
    "%": (1e-2, "1"),
    "1": (1.0, ""),
    # Keys in degrees Celsius are not converted: kelvins from a stated zero.
    "degC": (1.0, "K"),
}
OTHERS |= {"in": (0.0254, "m"), "G": (1e-4, "T"), "Oe": (1e3 / (4.0 * np.pi), "A m-1")}
PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}


def si(text):
    """Factor to SI units and exponents (8,) of a unit: "mm/s", "N m-1", "kg.m2", "mT_per_m", "g_mm2"."""
    factor, exponents = 1.0, np.zeros(len(BASE), int)
    text = f"1_{text}" if text.startswith("per_") else text
    above, _, below = text.replace("_per_", "/").replace("²", "2").replace("^", "").partition("/")
    for part, side in ((above, 1), (below, -1)):
        for name, power in re.findall(r"([^\W\d_]+|%|\b1\b)(-?\d*)", part):
            of_one, its = symbol(name)
            times = side * int(power or 1)
            factor, exponents = factor * of_one**times, exponents + times * its
    return factor, exponents


def symbol(name):
    if name in BASE:
        return 1.0, np.eye(len(BASE), dtype=int)[BASE.index(name)]
    if name in DERIVED:
        return si(DERIVED[name])
    if name in OTHERS:
        factor, unit = OTHERS[name]
        size, exponents = si(unit)
        return factor * size, exponents
    factor, exponents = symbol(name[1:])
    return PREFIXES[name[0]] * factor, exponents


def test_units_are_parsed():
    """Against units of known size: 1 g mm^2 = 1e-9 kg m^2, 1 T/m = 1 kg s^-2 A^-1 m^-1."""
    assert si("g_mm2")[0] == pytest.approx(1e-9)
    assert si("uT")[0] == pytest.approx(1e-6)
    assert dict(zip(BASE, si("T_per_m")[1].tolist(), strict=True)) | {"rad": 0} == {
        **dict.fromkeys(BASE, 0), "kg": 1, "s": -2, "A": -1, "m": -1,
    }  # fmt: skip
    assert si("N_s2_per_m2")[1].tolist() == si("kg/m")[1].tolist()


@pytest.mark.parametrize("unit", OF_FMI)
def test_units_of_fmi_have_their_exponents(unit):
    factor, exponents = si(unit)
    assert factor == 1.0
    assert OF_FMI[unit] == {name: n for name, n in zip(BASE, exponents.tolist(), strict=True) if n}


@pytest.mark.parametrize("unit", sorted(OF_KEYS.keys() - {"deg"}))
def test_units_of_keys_have_their_size(unit):
    assert OF_KEYS[unit] == pytest.approx(si(unit)[0], rel=1e-12)


@pytest.mark.parametrize("kind", OF_FITS)
def test_units_of_fits_have_their_size(kind):
    unit, factor = OF_FITS[kind].unit
    assert factor == pytest.approx(si(unit)[0], rel=1e-12)


@pytest.mark.parametrize("unit", OF_COLUMNS)
def test_units_of_columns_are_multiples_of_what_they_are_read_as(unit):
    read_as, factor = OF_COLUMNS[unit]
    (size, exponents), (one, same) = si(unit), si(read_as)
    assert (one, same.tolist()) == (1.0, exponents.tolist())
    assert factor == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize("quantity", OF_STUDIES, ids=lambda one: one.name)
def test_numbers_of_studies_are_printed_in_their_unit(quantity):
    (size, exponents), (one, same) = si(quantity.printed_unit), si(quantity.unit)
    assert (one, same.tolist()) == (1.0, exponents.tolist())
    assert quantity.printed[0] * size == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("words", [IN_WORDS, IN_TABLES], ids=["figures", "tables"])
def test_a_unit_in_words_is_the_same_unit(words):
    for unit, text in words.items():
        (size, exponents), (same_size, same) = si(unit), si(text)
        assert (size, exponents.tolist()) == (same_size, same.tolist())


@pytest.mark.parametrize("size", [3e-9, 4e-5, 2e-2, 7.0, 3e4])
def test_a_prefix_has_its_factor(size):
    prefix, factor = fitting_prefix(size)
    assert factor * si(f"{prefix}A")[0] == pytest.approx(1.0, rel=1e-12)
    assert size * factor >= 0.5


@pytest.mark.parametrize(("quantity", "unit"), [(FLUX_DENSITY, "T"), (GRADIENT, "T/m")])
def test_records_of_maps_have_the_dimension_of_their_unit(quantity, unit):
    assert quantity.unit.tolist() == si(unit)[1][:7].tolist()
