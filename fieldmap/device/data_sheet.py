"""B-H curves of data sheets: text files with a column of H and one of B, which a device names like a material file."""

from pathlib import Path
from typing import Any

from fieldmap.arguments import check, raise_all
from fieldmap.device.materials.bh_table import CurveKeys
from fieldmap.errors import Problem
from fieldmap.inputs.columns import columns_of_roles, read_columns, si_values
from fieldmap.inputs.document import schema_findings

_ROLES = {
    "H": ("h", "field strength", "magnetic field strength", "field", "h-field"),
    "B": ("b", "flux density", "magnetic flux density", "induction", "b-field"),
}


def data_sheet(path: Path) -> Any:
    """The keys of the curve in a data sheet.

    Columns are recognised by their names, and units by the text after the names. Without a unit, H is in A/m and B in
    T. In a file without names the first of two columns is H. Raises InputError with every mistake.
    """
    table = read_columns(path, least=2)
    if table.named:
        found, problems = columns_of_roles(table, _ROLES, tuple(_ROLES), {}, {"names": "a heading"})
    else:
        count = len(table.columns)
        must, remedy = (
            "must have two columns, H and B, where no line names them",
            "add a line such as `H (A/m),B (T)`",
        )
        check(count == 2, f"{path}:{table.rows[0][0]}", must, f"{count} columns", remedy)
        found, problems = dict(zip(_ROLES, table.columns, strict=True)), []
    values, wrong = si_values(table, found, {"H": "A/m", "B": "T"}, {"H": "A/m", "B": "T"})
    raise_all(problems + wrong)
    data = {"H_A_per_m": values["H"].tolist(), "B_T": values["B"].tolist()}
    raise_all(
        Problem(f"{path}: {found[str(one.location[0])[0]].name}", one.must_hold, one.received, one.remedy)
        for one in schema_findings(CurveKeys, data)
    )
    return CurveKeys.model_validate(data)
