"""What `open_map` lets its caller choose."""

from fieldmap.errors import InputError, Problem
from fieldmap.interpolants import OUTSIDE_RULES, cell_form, global_form, hermite_form
from fieldmap.lookup.current_model import OUTSIDE_CURRENTS

FORMS = {"harmonic": cell_form, "hermite": hermite_form, "global": global_form}


def check_choices(kind: str, outside: str, outside_currents: str) -> None:
    """Raise InputError, all at once, for a kind or an outside rule that does not exist."""
    problems = []
    choices = (
        ("kind", kind, list(FORMS)),
        ("outside", outside, list(OUTSIDE_RULES)),
        ("outside_currents", outside_currents, list(OUTSIDE_CURRENTS)),
    )
    for name, value, allowed in choices:
        if value not in allowed:
            names = " or ".join(f'"{choice}"' for choice in allowed)
            problems.append(
                Problem(f"open_map, {name}", f"is {names}", repr(value), "choose one that exists")
            )
    if problems:
        raise InputError(*problems)
