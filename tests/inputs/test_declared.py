"""Records that users write: tables and values that follow from one declared field."""

import warnings
from dataclasses import dataclass
from typing import Annotated

import pytest

from fieldmap.errors import InputError
from fieldmap.inputs.declared import Key, check_fields, record_of, table_of
from fieldmap.records import Record


@dataclass(frozen=True, eq=False, repr=False)
class Offset(Record):
    """Offset of a sensor."""

    by: Annotated[tuple[float, float], Key(..., "along x and y", "mm")] = (0.0, 1e-3)

    def __post_init__(self) -> None:
        check_fields(self)


def test_a_tuple_is_a_list_in_files_and_a_tuple_in_python():
    table = table_of(Offset)
    assert record_of(table.model_validate({"by_mm": [2.0, 3.0]})).by == pytest.approx((2e-3, 3e-3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert table().model_dump()["by_mm"] == pytest.approx((0.0, 1.0))
    assert Offset().by == (0.0, 1e-3)
    with pytest.raises(InputError):
        Offset((1.0,))
    with pytest.raises(InputError):
        Offset((1.0, "1"))
