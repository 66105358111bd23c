"""What a window with sliders keeps, whatever draws it: values, the answer to them, reset, saved states."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.plot.colours import fitting_prefix
from fieldmap.plot.live_answers import LiveAnswer, LiveMap
from fieldmap.records import Record
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array

FORMAT = 1


class LiveState:
    """Values of the sliders of a `LiveMap`, and the answer to them.

    states_file: where saved states are kept, as JSON, read at once where it is there. `move`, `reset`, `save` and
    `restore` return the new answer, or nothing changed.
    Raises InputError for a file that is none of saved states.
    """

    def __init__(self, live: LiveMap, states_file: Path | None = None) -> None:
        self.live, self.states_file = live, states_file
        self.initial = np.array([control.value for control in live.controls])
        self.values = self.initial.copy()
        self.saved: dict[str, dict[str, float]] = {}
        if states_file is not None and states_file.is_file():
            self.saved = _read_states(states_file)
        self.answer = live.answer(self.values)

    def move(self, values: ArrayLike) -> LiveAnswer:
        """Answer at new values of all controls, which are clipped to their ends."""
        lower, upper = (np.array([getattr(c, end) for c in self.live.controls]) for end in ("lower", "upper"))
        self.values = np.clip(np.asarray(values, dtype=float), lower, upper)
        self.answer = self.live.answer(self.values)
        return self.answer

    def reset(self) -> LiveAnswer:
        """Back to where it began."""
        return self.move(self.initial)

    def save(self, name: str) -> tuple[str, ...]:
        """Keep the values under a name, and write the file if there is one; names of all saved states.

        Raises InputError for an empty name, and for a file that cannot be written.
        """
        chosen = name.strip()
        if not chosen:
            raise InputError(Problem("save", "a state must have a name", "none", "type one"))
        names = [control.name for control in self.live.controls]
        self.saved[chosen] = dict(zip(names, self.values.tolist(), strict=True))
        if self.states_file is not None:
            content = {"format": FORMAT, "states": self.saved}
            write_whole(self.states_file, (json.dumps(content, indent=1) + "\n").encode())
        return tuple(self.saved)

    def restore(self, name: str) -> LiveAnswer:
        """Answer at a saved state; controls that it does not know begin anew. Raises InputError for an unknown one."""
        if name not in self.saved:
            known = ", ".join(self.saved) or "none saved"
            raise InputError(Problem("restore", f"must be one of: {known}", name, "choose one of these"))
        values = self.saved[name]
        return self.move([values.get(c.name, c.value) for c in self.live.controls])

    @property
    def words(self) -> "AnswerInWords":
        """The answer for people."""
        return answer_in_words(self.answer, self.live.field_map.coil_names)


def _read_states(path: Path) -> dict[str, dict[str, float]]:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        content, problem = None, str(error)
    else:
        problem = "something else"
    states = content.get("states") if isinstance(content, dict) and content.get("format") == FORMAT else None
    good = isinstance(states, dict) and all(
        isinstance(one, Mapping) and all(isinstance(value, int | float) for value in one.values())
        for one in states.values()
    )
    if not good:
        remedy = "name another file, or delete it"
        must = f"must hold saved states of format {FORMAT}"
        raise InputError(Problem(str(path), must, problem, remedy))
    assert isinstance(states, dict)
    return {name: {key: float(value) for key, value in one.items()} for name, one in states.items()}


@dataclass(frozen=True, repr=False)
class AnswerInWords(Record):
    """currents, force, lift and equilibrium of an answer, each a line; force and lift empty beyond a map's currents."""

    currents: str
    force: str
    lift: str
    equilibrium: str


def answer_in_words(answer: LiveAnswer, coil_names: tuple[str, ...]) -> AnswerInWords:
    """An answer for people: coils by name, the force in the unit that fits its largest component."""
    amperes = ", ".join(
        f"{name}: {_number(value, 3)}" for name, value in zip(coil_names, answer.currents, strict=True)
    )
    force = lift = ""
    if np.isfinite(answer.lift):
        at = ", ".join(_number(1e3 * x, 1) for x in answer.place)
        force = f"force at ({at}) mm: {force_in_words(answer.force)}"
        lift = f"lift {100 * answer.lift:.1f} % of the weight"
    return AnswerInWords(f"currents, A: {amperes}", force, lift, answer.words)


def force_in_words(force: Array) -> str:
    """Components of a force (3,), N, to four digits of the largest, in the unit that fits it.

    >>> force_in_words(np.array([0.0, -2e-7, 0.11])), force_in_words(np.array([1.2e-5, 0.0, 0.0]))
    ('(0.0, 0.0, 110.0) mN', '(12.00, 0.00, 0.00) uN')
    """
    prefix, factor = fitting_prefix(float(np.abs(force).max()))
    scaled = factor * np.asarray(force)
    largest = float(np.abs(scaled).max())
    decimals = int(np.clip(3 - np.floor(np.log10(largest)), 0, 3)) if largest else 1
    return f"({', '.join(_number(x, decimals) for x in scaled)}) {prefix}N"


def _number(value: float, decimals: int) -> str:
    return f"{round(float(value), decimals) + 0.0:.{decimals}f}"  # no -0.00
