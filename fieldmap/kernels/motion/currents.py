"""From the controller's outputs to the coils' voltages, their currents, and the weights of the map's fields.

docs/theory/dynamics.md (25)..(28), docs/theory/control.md (6).
"""

from typing import Any, NamedTuple

from numba import types

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.late_call import LateFunctions, array_at
from fieldmap.kernels.map.current_table import BEYOND, table_weights
from fieldmap.kernels.map.iron_block import ADDRESS, OUTSIDE, call_weights
from fieldmap.kernels.map.lift_and_directions import divide
from fieldmap.kernels.map.map_block import PLAIN, PLAIN_INLINED
from fieldmap.kernels.map.parametrisation import LIFT_AND_DIRECTIONS


class Allocation(NamedTuple):
    """The voltages of a current parametrisation (`fieldmap.kernels.map.parametrisation`), in V where that has A, and
    constant (n,): kind, exponent, matrix as there."""

    kind: int
    exponent: float
    matrix: Any
    constant: Any


@njit(**PLAIN)
def allocate(allocation, outputs, voltages):
    """Fill voltages (n,)."""
    if allocation.kind == LIFT_AND_DIRECTIONS:
        found = divide(outputs[0], outputs[1], outputs[2], allocation.exponent)
        for k in range(6):
            voltages[k] = found[k]
        return
    for k in range(voltages.shape[0]):
        voltages[k] = allocation.constant[k]
        for j in range(outputs.shape[0]):
            voltages[k] += allocation.matrix[k, j] * outputs[j]


# Of the coils (n, 4), for one length of step h: decay exp(-R h / L) of the winding; decay exp(-h / tau) of the
# amplifier's own answer (0: it follows at once as far as its supply allows); final currents V_upper / R and
# V_lower / R.
WINDING, AMPLIFIER, HIGHEST, LOWEST = 0, 1, 2, 3


@inlined(**PLAIN_INLINED)
def advance_currents(coils, commands, currents):
    """Advance currents (n,) by one step towards commands (n,); whether a supply limit held one back, and whether any
    changed.

    L di/dt + R i = V, V what the amplifier asks for within its supply. The current goes where the amplifier steers it
    unless the supply's limits allow less: exact for any length of step.
    """
    held, moved = False, False
    for k in range(currents.shape[0]):
        wanted = commands[k] + (currents[k] - commands[k]) * coils[k, AMPLIFIER]
        high = coils[k, HIGHEST] + (currents[k] - coils[k, HIGHEST]) * coils[k, WINDING]
        low = coils[k, LOWEST] + (currents[k] - coils[k, LOWEST]) * coils[k, WINDING]
        held |= wanted > high or wanted < low
        new = min(max(wanted, low), high)
        moved |= new != currents[k]
        currents[k] = new
    return held, moved


SUPERPOSED, TABLED, MODELLED = 0, 1, 2


class Superposition(NamedTuple):
    """How weights of the map's fields follow the currents, times `scale`, a calibration.

    kind SUPERPOSED: a field per coil, and one of weight 1 behind them if the block has one more: linear iron, or
    saturating iron linearised about currents. TABLED: saturating iron by a table over the current division, which is
    what fieldmap.kernels.map.current_table takes. MODELLED: saturating iron by its model, solved at these currents:
    iron, an array of the C core (fieldmap/core/iron_array.h), which every run has for itself.
    """

    kind: int
    scale: float
    table: Any
    iron: Any


def _late_table(
    division,
    mismatch,
    lower,
    upper,
    knots_u,
    knots_x,
    knots_y,
    coefficients,
    nodes_u,
    nodes_x,
    nodes_y,
    slopes,
    currents,
    weights,
    nu,
    nx,
    ny,
    k,
    fields,
):
    knots = array_at(knots_u, (nu + 4,)), array_at(knots_x, (nx + 4,)), array_at(knots_y, (ny + 4,))
    nodes = array_at(nodes_u, (nu,)), array_at(nodes_x, (nx,)), array_at(nodes_y, (ny,))
    table = (
        array_at(division, (2,)),
        array_at(mismatch, (1,)),
        array_at(lower, (3,)),
        array_at(upper, (3,)),
        knots,
        array_at(coefficients, (nu, nx, ny, k)),
        nodes,
        array_at(slopes, (nu, nx, ny, 6, k)),
    )
    return table_weights(table, array_at(currents, (6,)), array_at(weights, (fields,)))


# By an address: in a loop that superposes nothing of the table is compiled, and in others it is compiled once.
_VECTOR, _STACK, _SLOPES = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 4, 5))
_WEIGHTS = types.Array(types.float64, 1, "C")
_LATE_TABLE = LateFunctions(
    "fieldmap_table_weights",
    types.intp,
    (*7 * (_VECTOR,), _STACK, *3 * (_VECTOR,), _SLOPES, _VECTOR, _WEIGHTS, *5 * (types.intp,)),
    [_late_table],
    **PLAIN,
)
_call_table = _LATE_TABLE.call


@njit(**PLAIN)
def _of_table(table, currents, weights):
    division, mismatch, lower, upper, knots, coefficients, nodes, slopes = table
    nu, nx, ny, k = coefficients.shape
    ends = division, mismatch, lower, upper
    sizes = nu, nx, ny, k, weights.shape[0]
    return _call_table(0, (*ends, *knots, coefficients, *nodes, slopes, currents, weights, *sizes))


@njit(**PLAIN)
def find_weights(kind, scale, table, iron, currents, weights):
    """Fill weights (f,); False for currents beyond the table, which then goes on with its slopes, and beyond the domain
    of the model, which is solved there, too."""
    if kind == SUPERPOSED:
        n = currents.shape[0]
        for k in range(n):
            weights[k] = scale * currents[k]
        if weights.shape[0] > n:
            weights[n] = scale
        return True
    if kind == MODELLED:
        outside = iron[OUTSIDE]
        call_weights(int(iron[ADDRESS]), iron, currents, weights)
        within = iron[OUTSIDE] == outside
    else:
        within = _of_table(table, currents, weights) != BEYOND
    for f in range(weights.shape[0]):
        weights[f] *= scale
    return within
