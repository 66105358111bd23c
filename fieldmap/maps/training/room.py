"""Whether a training has room: its memory and its disk, known before a state is solved, and a grouping that has room.

Many independent currents need much of both: each state has a tangent for each signal, and the iron of each coil needs
modes of its own. Coils that carry one current are one signal. Coils that act on the same iron share much of their
fields, so these are grouped first.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.errors import InputError
from fieldmap.inputs.document import AtKey
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.operators.assembled import memory_bytes
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.sampling import candidates_at_first
from fieldmap.records import Record
from fieldmap.typing import Array

# States with tangents that a training of many independent coils solves. The tangents of each hold so much of the iron
# that 16 to 64 coils took 11 to 15 states to train on, and about 30 to test the model.
_STATES = 45
# Matrices of nodes and modes, and of points and modes, that are in memory at the same time; points per node of
# second-order tetrahedra with four points each.
_OF_NODES, _OF_POINTS, _POINTS_PER_NODE = 6, 3, 2.75
# States whose conditions on sample points are in memory.
_CONDITIONS = 32
# As many as the core looks up (FIELDMAP_IRON_MAX_SIGNALS, and the sizes of a model in core/iron.h).
_MOST_COILS = 256
# Solver, mesh and libraries, bytes.
_BASE = 4e8
# Time of a training over that of one linear solve for all coils: 64 coils took 254 s and 1 s.
_SECONDS = 250


@dataclass(frozen=True, repr=False)
class Needs(Record):
    """What a training needs.

    Attributes
    ----------
    memory : bytes at the same time.
    disk : bytes of the checkpoint.
    """

    memory: float
    disk: float

    def within(self, memory: float, disk: float) -> bool:
        """Whether it has room in so many bytes."""
        return self.memory <= memory and self.disk <= disk


def needs(nodes: int, coils: int, signals: int, modes: int, plan: Plan) -> Needs:
    """Estimate what a training needs, within a factor of about two.

    Parameters
    ----------
    nodes
        Nodes of the mesh of the iron.
    coils
        Coils of the device.
    signals
        Signals that set their currents.
    modes
        Most modes of the model.
    plan
        Of the training.
    """
    tangents = coils + signals if plan.inductance and signals < coils else signals
    points = _POINTS_PER_NODE * nodes
    candidates = min(candidates_at_first(modes, plan.points), points)
    conditions = modes + coils + (coils * (coils + 1) / 2 if plan.inductance else 0)
    numbers = (
        _OF_NODES * nodes * modes
        + _OF_POINTS * points * (3 * modes + 2 * coils)
        + 3 * candidates**2
        + 2 * _CONDITIONS * conditions * candidates
    )
    states = _STATES + plan.held_out
    return Needs(_BASE + 8.0 * numbers, 8.0 * states * nodes * (2 * tangents + 2))


def require_room(
    solver: NonlinearSolver, domain: CurrentDomain, plan: Plan, modes_of: Callable[[int], int], free_disk: int
) -> None:
    """Refuse a training that has no room, before a state is solved.

    Parameters
    ----------
    solver
        Of the whole iron.
    domain
        Of the currents.
    plan
        Of the training.
    modes_of
        Most modes for a number of signals.
    free_disk
        Bytes that are free where states are kept.

    Raises
    ------
    InputError
        If memory or disk are too small. It names groups of coils with which they would be large enough. If there are
        more coils than the core looks up.
    """
    coils, signals = domain.parametrisation.coil_count, domain.parametrisation.signal_count
    if coils > _MOST_COILS:
        must_hold = f"maps of saturating iron have at most {_MOST_COILS} coils"
        raise InputError(AtKey("currents", must_hold, f"{coils}", 'make a map with iron.model = "linear"'))
    memory = memory_bytes() or float("inf")

    def of(count: int) -> Needs:
        return needs(solver.unknowns, coils, count, modes_of(count), plan)

    if of(signals).within(memory, free_disk):
        return
    began = monotonic()
    rest = np.zeros(coils)
    inductance = solver.iron_inductance(rest, np.zeros(solver.unknowns))
    seconds = _SECONDS * (monotonic() - began)
    fewer = next((n for n in range(signals - 1, 0, -1) if of(n).within(memory, free_disk)), None)
    remedy = "coarser meshes (iron.refinement), or a machine with more memory and disk"
    if fewer is not None:
        names = [[solver.coil_names[k] for k in group] for group in coupled_groups(inductance, fewer)]
        lists = ", ".join("[" + ", ".join(f'"{name}"' for name in group) + "]" for group in names)
        remedy = (
            f"{fewer} groups of coils have room, those together that the iron couples most: "
            f"groups = [{lists}]; or {remedy}"
        )
    must_hold = (
        f"a training needs room: {_gigabytes(memory)} of memory and {_gigabytes(free_disk)} of disk are there"
    )
    found = of(signals)
    received = (
        f"{signals} signals on {solver.unknowns} nodes: about {_gigabytes(found.memory)} of memory, "
        f"{_gigabytes(found.disk)} of disk, {_STATES + plan.held_out} states, {seconds / 60.0:.0f} minutes"
    )
    raise InputError(AtKey("currents.groups", must_hold, received, remedy))


def coupled_groups(inductance: Array, count: int) -> tuple[tuple[int, ...], ...]:
    """Groups of the coils that are coupled most.

    Two coils are coupled by |L_ij| / sqrt(L_ii L_jj). Groups are joined by the mean coupling of their coils (average
    linkage: R. Sokal and C. Michener, Univ. Kansas Sci. Bull. 38 (1958) 1409).

    Parameters
    ----------
    inductance
        (c, c), symmetric, H.
    count
        Number of groups.

    Returns
    -------
    tuple[tuple[int, ...], ...]
        Numbers of the coils of each group, from 0, as `fieldmap.currents.CoilGroups` takes them.

    Examples
    --------
    >>> coupled_groups(np.array([[1.0, 0.1, 0.8], [0.1, 1.0, 0.1], [0.8, 0.1, 1.0]]), 2)
    ((0, 2), (1,))
    """
    # Imported here: scipy.cluster takes a while to load, and only a refusal needs it.
    from scipy.cluster.hierarchy import cut_tree, linkage
    from scipy.spatial.distance import squareform

    coils = len(inductance)
    if coils == 1:
        return ((0,),)
    size = np.sqrt(np.diag(inductance))
    apart = np.maximum(1.0 - np.abs(inductance) / np.outer(size, size), 0.0)
    np.fill_diagonal(apart, 0.0)
    tree = linkage(squareform(0.5 * (apart + apart.T), checks=False), "average")
    group = cut_tree(tree, n_clusters=count)[:, 0]
    return tuple(tuple(np.flatnonzero(group == number).tolist()) for number in range(count))


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:.2g} GB"
