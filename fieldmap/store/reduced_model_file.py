"""A reduced model in a map file: one array per field, each with its checksum."""

from dataclasses import fields

import h5py
import numpy as np

from fieldmap.store.names import OWN
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.store.trust import stored

REDUCED_MODEL = f"{OWN}/reduced_model"


def write_reduced_model(file: h5py.File, model: ReducedModel | None) -> None:
    """Store a model; nothing where there is none."""
    if model is None:
        return
    group = file.create_group(REDUCED_MODEL)
    for field in fields(model):
        values = getattr(model, field.name)
        # What HDF5 gives for a block that it does not find is no number of any model.
        missing = np.nan if values.dtype.kind == "f" else -1
        checked = {"fletcher32": True, "fillvalue": missing} if values.size else {}
        group.create_dataset(field.name, data=values, **checked)


def read_reduced_model(file: h5py.File) -> ReducedModel:
    """The model of `write_reduced_model`; Refused, ValueError or InputError if the arrays are no such model."""
    names = [field.name for field in fields(ReducedModel)]
    arrays = {name: stored(file, f"{REDUCED_MODEL}/{name}", "fi") for name in names}
    return ReducedModel(**{name: np.ascontiguousarray(data[()]) for name, data in arrays.items()})
