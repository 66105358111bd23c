"""How a command solves the iron of a device: linear, or one nonlinear state after another."""

from dataclasses import dataclass
from typing import Any

from fieldmap.cli.progress import Progress
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array

# The fraction at which a nonlinear solver has assembled; later states begin there.
_ASSEMBLED = 0.6


@dataclass(frozen=True)
class IronChoice:
    """The values of --mu-r, --nonlinear, --refinement, --form and --tolerance."""

    mu_r: float | None = None
    nonlinear: bool = False
    refinement: float = 1.0
    form: str = "auto"
    tolerance: float | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """The options that differ from their defaults."""
        changed = {
            "--mu-r": self.mu_r is not None,
            "--nonlinear": self.nonlinear,
            "--refinement": self.refinement != 1.0,
            "--form": self.form != "auto",
        }
        return tuple(name for name, differs in changed.items() if differs)


def checked_choice(
    mu_r: float | None, nonlinear: bool, refinement: float, form: str, tolerance: float | None = None
) -> IronChoice:
    """The choice, or InputError with everything that is wrong with it."""
    problems = []
    if mu_r is not None and not 0.0 < mu_r < float("inf"):
        remedy = "give the relative permeability"
        problems.append(Problem("--mu-r", "must be a positive number", f"{mu_r}", remedy))
    if not 0.0 < refinement < float("inf"):
        remedy = "try 1.5 for a finer mesh, 0.7 for a coarser one"
        problems.append(Problem("--refinement", "must be a positive number", f"{refinement}", remedy))
    if form != "auto":
        problems += _form_problems(form)
    if nonlinear and mu_r is not None:
        remedy = "leave one of them out: nonlinear iron follows its B-H table, --mu-r makes it linear"
        problems.append(Problem("--nonlinear", "must not come with --mu-r", f"--mu-r {mu_r:g}", remedy))
    if nonlinear and form == "flux":
        remedy = "leave --form out; the flux form is for linear iron"
        problems.append(Problem("--nonlinear", "must go with the potential form", "--form flux", remedy))
    if tolerance is not None:
        problems += _tolerance_problems(tolerance, nonlinear, refinement, form)
    if problems:
        raise InputError(*problems)
    return IronChoice(mu_r, nonlinear, refinement, form, tolerance)


def _form_problems(form: str) -> list[Problem]:
    from fieldmap.iron.solvers.linear import FORMS

    if form in FORMS:
        return []
    return [Problem("--form", f"must be one of {', '.join(FORMS)}", form, "leave it out")]


def _tolerance_problems(tolerance: float, nonlinear: bool, refinement: float, form: str) -> list[Problem]:
    """--tolerance chooses the mesh and the form itself, and estimates the error of linear iron only."""
    problems = []
    if not 0.0 < tolerance < 1.0:
        problems.append(Problem("--tolerance", "must lie between 0 and 1", f"{tolerance}", "try 1e-3"))
    others = {
        "--nonlinear": nonlinear,
        f"--refinement {refinement:g}": refinement != 1.0,
        f"--form {form}": form != "auto",
    }
    for other in (name for name, given in others.items() if given):
        remedy = "leave one of them out: --tolerance refines linear iron by itself"
        problems.append(Problem("--tolerance", "must stand alone", other, remedy))
    return problems


def require_currents(nonlinear: bool, currents: list[str] | None) -> None:
    """Currents must be given where the answer is not proportional to them."""
    if nonlinear and not currents:
        raise InputError(
            Problem(
                "--nonlinear",
                "must come with --currents: how far iron saturates depends on them",
                "no --currents",
                "add --currents A (one number for all coils, or one per coil)",
            )
        )


def require_iron(device: Device) -> None:
    """There must be a body to be nonlinear."""
    if not device.bodies:
        remedy = "leave --nonlinear out: the field of coils alone is linear"
        raise InputError(Problem(device.name, "must have iron for --nonlinear", "no bodies", remedy))


def solve_device(device: Device, choice: IronChoice) -> Any:
    """Linear solution of a device, with progress."""
    from fieldmap.iron import solve_linear, solve_to_tolerance

    with Progress("solving") as progress:
        if choice.tolerance is not None:
            return solve_to_tolerance(device, choice.tolerance, mu_r=choice.mu_r, progress=progress)
        return solve_linear(
            device, mu_r=choice.mu_r, progress=progress, refinement=choice.refinement, form=choice.form
        )


class States:
    """Nonlinear states of one device, meshed once; each begins at the last one. Progress for each."""

    def __init__(self, device: Device, choice: IronChoice) -> None:
        self._device, self._choice = device, choice
        self._progress: Progress | None = None
        self._solver: Any = None
        self._first = True
        self.last: Any = None

    def __call__(self, currents: Array) -> Any:
        """The state at currents (n_coils,), A."""
        from fieldmap.iron import NonlinearSolver

        several = "the given currents" if len(set(currents)) > 1 else f"{currents[0]:.4g} A"
        self._first = self._solver is None
        with Progress(f"state at {several}") as self._progress:
            if self._solver is None:
                self._solver = NonlinearSolver(self._device, self._choice.refinement, self._tell)
            self.last = self._solver.solve(currents, start=self.last)
        return self.last

    def _tell(self, message: str, fraction: float) -> None:
        # The solver calls itself done when it has assembled, but the first state is still to come.
        if self._progress is None or message == "assembled":
            return
        share = fraction if self._first else max(0.0, (fraction - _ASSEMBLED) / (1.0 - _ASSEMBLED))
        self._progress(message, share)
