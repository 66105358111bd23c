"""What a window with sliders keeps, whatever draws it: values, the answer to them, reset, saved states."""

import json
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, ValidationError

from fieldmap.errors import InputError, Problem
from fieldmap.plot.live_answers import LiveAnswer, LiveMap
from fieldmap.plot.words import fixed, force_in_words
from fieldmap.store.whole_files import write_whole

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
    def words(self) -> dict[str, str]:
        """The answer for people: currents, force, lift and equilibrium, each a line; force and lift empty beyond a
        map's currents."""
        answer, names = self.answer, self.live.field_map.coil_names
        amperes = ", ".join(
            f"{name}: {fixed(value, 3)}" for name, value in zip(names, answer.currents, strict=True)
        )
        force = lift = ""
        if np.isfinite(answer.lift):
            at = ", ".join(fixed(1e3 * x, 1) for x in answer.place)
            force = f"force at ({at}) mm: {force_in_words(answer.force)}"
            lift = f"lift {100 * answer.lift:.1f} % of the weight"
        return {
            "currents": f"currents, A: {amperes}",
            "force": force,
            "lift": lift,
            "equilibrium": answer.words,
        }


class _File(BaseModel):
    """A file of saved states: names of states -> names of controls -> values."""

    model_config = ConfigDict(strict=True, extra="ignore")
    format: Literal[1]
    states: dict[str, dict[str, float]]


def _read_states(path: Path) -> dict[str, dict[str, float]]:
    try:
        return _File.model_validate_json(path.read_bytes()).states
    except ValidationError as error:
        remedy = "name another file, or delete it"
        must, received = f"must hold saved states of format {FORMAT}", error.errors()[0]["msg"]
        raise InputError(Problem(str(path), must, received, remedy)) from None
