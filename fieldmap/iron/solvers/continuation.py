"""Newton's method, and continuation in the sources where it fails: a state at a share of the currents starts the next.

From the potential at one share of the currents (and of the magnets' remanence), scaled up in proportion, the iron is
nearer to the next state than from zero. The steps adapt: halved where Newton fails, doubled where it succeeds.
"""

from dataclasses import dataclass, replace

from fieldmap.errors import NotConverged, Problem
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import Magnetisation, PotentialForm, PotentialState
from fieldmap.records import Record
from fieldmap.typing import Array

_FIRST_STEP, _SMALLEST_STEP = 0.5, 1 / 64
# States on the way need only lead to the next one.
_TOLERANCE_ON_THE_WAY = 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class Sources(Record):
    """What drives the iron: its materials with their remanence, and the coils' field."""

    material: Magnetisation
    field: CoilField

    def scaled(self, share: float) -> "Sources":
        """The same at a share of the currents and remanences."""
        material = replace(self.material, remanence=share * self.material.remanence)
        return Sources(material, CoilField(share * self.field.constant, share * self.field.bubble))


def solve_with_continuation(
    form: PotentialForm, sources: Sources, tolerance: float, start: Array | None
) -> tuple[PotentialState, tuple[float, ...]]:
    """The state, and the shares of the sources that were solved on the way to it: none where Newton converged.

    Tries Newton from `start` (n, 1), then from zero, then in steps of the sources. Raises NotConverged with all
    residuals once none of these has succeeded.
    """
    residuals: list[float] = []
    begins: tuple[Array | None, ...] = (None,) if start is None else (start, None)
    for begin in begins:
        try:
            return form.solve(sources.material, sources.field, tolerance, begin), ()
        except NotConverged as error:
            residuals += error.residuals
    return _in_steps(form, sources, tolerance, residuals)


def _in_steps(
    form: PotentialForm, sources: Sources, tolerance: float, residuals: list[float]
) -> tuple[PotentialState, tuple[float, ...]]:
    reached, step = 0.0, _FIRST_STEP
    potential: Array | None = None
    shares: list[float] = []
    while step >= _SMALLEST_STEP:
        share = min(1.0, reached + step)
        part = sources.scaled(share)
        begin: Array | None = None if potential is None else potential * (share / reached)
        wanted = tolerance if share == 1.0 else max(tolerance, _TOLERANCE_ON_THE_WAY)
        try:
            state = form.solve(part.material, part.field, wanted, begin)
        except NotConverged as error:
            residuals += error.residuals
            step = 0.5 * step
            continue
        shares.append(share)
        if share == 1.0:
            return state, tuple(shares)
        reached, step, potential = share, 2 * step, state.potential
    raise NotConverged(
        Problem(
            "iron solver, Newton and continuation in the currents",
            f"the residual must fall to {tolerance:g}",
            f"no state beyond {100 * reached:.3g} % of the currents; last residual "
            f"{residuals[-1]:.2e} after {len(residuals)} steps in all",
            "loosen the tolerance, smooth the B-H table where its slope jumps, or look for slivers in the mesh",
        ),
        residuals=tuple(residuals),
    )
