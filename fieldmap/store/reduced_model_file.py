"""A reduced model in a map file: one array per field, each with its checksum."""

from dataclasses import fields

import h5py
import numpy as np

from fieldmap.store.names import OWN
from fieldmap.store.reduced_model import ReducedModel

REDUCED_MODEL = f"{OWN}/reduced_model"
# No model of a sensible map has more numbers in one array; a hostile file must not make the reader allocate them.
_MOST_NUMBERS = 50_000_000


def write_reduced_model(file: h5py.File, model: ReducedModel | None) -> None:
    """Store a model; nothing where there is none."""
    if model is None:
        return
    group = file.create_group(REDUCED_MODEL)
    for field in fields(model):
        values = getattr(model, field.name)
        group.create_dataset(field.name, data=values, fletcher32=bool(values.size) or None)


def read_reduced_model(group: h5py.Group) -> ReducedModel:
    """The model of `write_reduced_model`; ValueError, KeyError or InputError if the arrays are no such model."""
    arrays = {}
    for field in fields(ReducedModel):
        link = group.get(field.name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            raise KeyError(f"{group.name}/{field.name}")
        data = group[field.name]
        if data.size > _MOST_NUMBERS or data.is_virtual or data.external or data.dtype.kind not in "fi":
            raise ValueError(f"{data.name}: {data.size} numbers of type {data.dtype}")
        arrays[field.name] = np.ascontiguousarray(data[()])
    return ReducedModel(**arrays)
