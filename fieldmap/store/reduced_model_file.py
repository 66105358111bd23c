"""A reduced model in a map file: one array per field, each with its checksum, and its parametrisation as JSON."""

from dataclasses import fields

import h5py
import numpy as np

from fieldmap.currents import CurrentParametrisation, parametrisation_from_json
from fieldmap.store.names import OWN
from fieldmap.store.openpmd import fixed
from fieldmap.store.reduced_model import ARRAYS, ReducedModel, parametrisation_of
from fieldmap.store.seal import REMAKE
from fieldmap.store.trust import Refused, hard, stored

REDUCED_MODEL = f"{OWN}/reduced_model"
_PARAMETRISATION = "parametrisation"
# What readers before the parametrisation look for: n of LiftAndDirections, or nothing for independent currents.
_EXPONENT = "division_exponent"


def write_reduced_model(file: h5py.File, model: ReducedModel | None) -> None:
    """Store a model; nothing where there is none."""
    if model is None:
        return
    group = file.create_group(REDUCED_MODEL)
    group.attrs[_PARAMETRISATION] = fixed(model.parametrisation.to_json())
    for field in fields(model):
        name = _EXPONENT if field.name == _PARAMETRISATION else field.name
        values = getattr(model, name)
        # What HDF5 gives for a block that it does not find is no number of any model.
        missing = np.nan if values.dtype.kind == "f" else -1
        checked = {"fletcher32": True, "fillvalue": missing} if values.size else {}
        group.create_dataset(name, data=values, **checked)


def read_reduced_model(file: h5py.File) -> ReducedModel:
    """The model of `write_reduced_model`; Refused, ValueError or InputError if the arrays are no such model."""
    arrays = {
        name: np.ascontiguousarray(stored(file, f"{REDUCED_MODEL}/{name}", "fi")[()]) for name in ARRAYS
    }
    return ReducedModel(**arrays, parametrisation=_parametrisation(file, arrays["source"].shape[-1]))


def _parametrisation(file: h5py.File, coils: int) -> CurrentParametrisation:
    """As named in the file, or as an older file says it; both must agree."""
    exponent = stored(file, f"{REDUCED_MODEL}/{_EXPONENT}", "fi")[()]
    stated = hard(file, REDUCED_MODEL).attrs.get(_PARAMETRISATION)
    older = parametrisation_of(exponent, coils)
    if stated is None:
        return older
    named = parametrisation_from_json(bytes(stated).decode())
    if exponent.size and named != older:
        raise Refused(f"one parametrisation of the currents, {named}", f"{older} as well", REMAKE)
    return named
