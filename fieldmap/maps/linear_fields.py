"""A linear solution as plain arrays and back, so that a resumed run need not solve again.

Only what the field in the air needs is kept: the charged faces and their densities. The solution made from it
gives the same bits as the one that was stored, but knows no mesh: it does not refuse points inside the iron,
which the geometry check has excluded already.
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from fieldmap.device.model import Device
from fieldmap.iron import LinearSolution, SolverReport, solve_linear
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.store import Checkpoint
from fieldmap.typing import Progress

# Key of the solution in the checkpoint.
_SOLUTION = "solution"
_FACES = [field.name for field in fields(ChargedFaces)]


def linear_fields(
    device: Device,
    mu_r: float | None,
    tolerance: float,
    refinement: float,
    checkpoint: Checkpoint,
    say: Progress,
) -> LinearSolution:
    """The solution in the checkpoint, or a new one, which is then kept there."""
    if _SOLUTION not in checkpoint:
        checkpoint.put(_SOLUTION, *to_arrays(solve_linear(device, mu_r, tolerance, say, refinement)))
    # Read back, so that a resumed run gives the same bits.
    kept = checkpoint.get(_SOLUTION)
    assert kept is not None
    return from_arrays(device, *kept)


def to_arrays(solution: LinearSolution) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and a plain description of a solution."""
    about = {"has_remanence": solution.has_remanence, "report": asdict(solution.report)}
    if solution.state is None:
        return {}, about
    arrays = {name: getattr(solution.state.faces, name) for name in _FACES}
    return {**arrays, "density": solution.state.density}, about


def from_arrays(device: Device, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> LinearSolution:
    """The solution of `to_arrays`; KeyError or TypeError if the arrays are another solver's."""
    report = SolverReport.from_dict(about["report"])
    state = None
    if arrays:
        faces = ChargedFaces(**{name: np.ascontiguousarray(arrays[name]) for name in _FACES})
        density = np.ascontiguousarray(arrays["density"])
        state = IronState(
            faces, density, np.empty((len(density), 0, 3)), report.iterations, (report.residual,)
        )
    remanence, bounds = bool(about["has_remanence"]), device.bounds
    more = (device.sections, bounds, device.background)
    return LinearSolution(device.coils, None, state, remanence, report, None, *more)
