"""Largest and smallest accepted numbers: the limit itself is accepted, the next number beyond it is not."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device import parts
from fieldmap.dynamics.scenario import schema as scenarios
from fieldmap.errors import FieldmapError
from fieldmap.interop import measured_map
from fieldmap.maps import recipe
from fieldmap.studies import study


def mapped(*nodes):
    """The grid of a recipe with these numbers of nodes along the axes, 2 mm apart."""
    return recipe.choose_grid((np.zeros(3), 2e-3 * (np.array(nodes) - 1.0)), np.full(3, 2e-3)).shape


def fitted(*nodes):
    """The grid of a fit to readings, like `mapped`."""
    return measured_map._grid(np.zeros(3), 2e-3 * (np.array(nodes) - 1.0), 2e-3).shape


def stepped(share):
    """A scenario whose mechanical step is the period over `share`; its period is a power of two."""
    scenarios._of_bounded_number(8.0 / share, SimpleNamespace(data={"period_ms": 8.0}))


def run(periods):
    control = SimpleNamespace(period_ms=2.0)
    scenarios._of_bounded_length(2e-3 * periods, SimpleNamespace(data={"control": control}))


def lifted(amperes):
    """Signals of a study: coils 2 and 5 get this current, the others the same, because n = 1."""
    study._of_some_size(SimpleNamespace(u_A=amperes, x=0.0, y=0.0, n=1.0))


def joint(gap_mm):
    parts._no_gap_or_a_micrometre(gap_mm)


def ranged(low, high):
    recipe._range([low, high])


# Function, accepted arguments, refused arguments. A fit takes two million nodes, 125 x 125 x 128.
LIMITS = {
    "no limit of a map's nodes": (mapped, [(125, 125, 129), (300, 300, 300)], []),
    "fewest nodes of a map": (mapped, [(5, 5, 5), (5, 9, 8)], [(4, 9, 9), (9, 4, 9), (9, 9, 4)]),
    "most nodes of a fit": (fitted, [(125, 125, 128)], [(125, 125, 129), (126, 125, 128)]),
    "steps of a period": (stepped, [(1e6,)], [(1.001e6,)]),
    "periods of a run": (run, [(5e6,)], [(5.001e6,)]),
    "current by signals": (lifted, [(1e9,), (-1e9,)], [(1.001e9,), (-1.001e9,)]),
    "least gap of a joint, mm": (joint, [(0.0,), (1e-3,)], [(0.999e-3,), (1e-12,)]),
    "range of a signal": (
        ranged,
        [(-1e6, 1e6), (0.5, 0.6)],
        [(-1.001e6, 0.0), (0.0, 1.001e6), (0.5, 0.5), (0.6, 0.5)],
    ),
}


@pytest.mark.parametrize("name", LIMITS)
def test_the_limit_is_taken_and_the_next_number_is_not(name):
    function, inside, outside = LIMITS[name]
    for numbers in inside:
        assert function(*numbers) in (None, numbers)
    for numbers in outside:
        # Errors at keys are pydantic's ValueErrors.
        with pytest.raises((FieldmapError, ValueError)):
            function(*numbers)
