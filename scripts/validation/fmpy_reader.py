"""Program for an environment with FMPy and without fieldmap: evaluates FMUs, runs them in closed loop, or integrates.

python fmpy_reader.py TASK.npz ANSWER.npz: `kind` of the task selects the function.
"""

import sys
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.validation import validate_fmu

AXES = "xyz"
POSE = [f"position_{a}" for a in AXES] + [f"quaternion_{p}" for p in "wxyz"]
STATE = [*POSE[:3], *(f"velocity_{a}" for a in AXES), *POSE[3:], *(f"angular_velocity_{a}" for a in AXES)]
OUTPUTS = [f"field_{a}" for a in AXES] + [f"gradient_{a}{b}" for a in AXES for b in AXES]
OUTPUTS += [f"force_{a}" for a in AXES] + [f"torque_{a}" for a in AXES]


class Unit:
    """An FMU, instantiated and started."""

    def __init__(self, path, start, exchange=False):
        assert validate_fmu(path) == []
        self.description = read_model_description(path)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.currents = [name for name in self.references if name.startswith("current_")]
        self.two = self.description.fmiVersion == "2.0"
        kind = self.description.modelExchange if exchange else self.description.coSimulation
        maker = (FMU2Model if exchange else FMU2Slave) if self.two else (FMU3Model if exchange else FMU3Slave)
        self.folder = TemporaryDirectory()
        self.unit = maker(
            guid=self.description.guid if self.two else self.description.instantiationToken,
            unzipDirectory=extract(path, self.folder.name),
            modelIdentifier=kind.modelIdentifier,
            instanceName="one",
        )
        self.unit.instantiate()
        if self.two:
            self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()
        for name, value in start.items():
            self.set([name], [value])
        self.unit.exitInitializationMode()

    def set(self, names, values):
        chosen = [self.references[name] for name in names]
        (self.unit.setReal if self.two else self.unit.setFloat64)(chosen, [float(v) for v in values])

    def get(self, names):
        chosen = [self.references[name] for name in names]
        return np.array((self.unit.getReal if self.two else self.unit.getFloat64)(chosen))

    def step(self, time, length):
        self.unit.doStep(currentCommunicationPoint=time, communicationStepSize=length)


def ask(task):
    """Outputs at poses (n, 7) and currents (n, k)."""
    unit, rows = Unit(str(task["path"]), {}), []
    for n, (pose, currents) in enumerate(zip(task["poses"], task["currents"], strict=True)):
        unit.set(POSE + unit.currents, [*pose, *currents])
        unit.step(1e-3 * n, 1e-3)
        rows.append(unit.get(OUTPUTS))
    return {"outputs": np.array(rows)}


def follow(task):
    """Outputs after steps of `period` at rows of inputs, from start values."""
    starts = dict(zip(map(str, task["names"]), task["starts"], strict=True))
    unit, period, rows = Unit(str(task["path"]), starts), float(task["period"]), []
    inputs, outputs = ([str(name) for name in task[kind]] for kind in ("inputs", "outputs"))
    for n, row in enumerate(task["rows"]):
        unit.set(inputs, row)
        unit.step(period * n, period)
        rows.append(unit.get(outputs))
    return {"outputs": np.array(rows)}


def seen_point(state, arm):
    """Position of a point of the body, in the frame of the map."""
    w, u = state[6], state[7:10]
    twice = 2.0 * np.cross(u, arm)
    return state[:3] + arm + w * twice + np.cross(u, twice)


def loop(task):
    """A linear controller with limits (docs/theory/closed_loop.md (5)) and sample time `period`, in closed loop with
    the body in the FMU. Coil currents are matrix @ outputs + constant."""
    unit = Unit(str(task["path"]), dict(zip(STATE, task["state"], strict=True)))
    memory, period, rows = task["memory"], float(task["period"]), []
    for n, reference in enumerate(task["references"]):
        rows.append(unit.get(STATE))
        signals = np.concatenate([reference, seen_point(rows[-1], task["seen_at"]), [1.0]])
        wanted = task["C"] @ memory + task["D"] @ signals
        memory = task["A"] @ memory + task["B"] @ signals + task["E"] @ wanted
        unit.set(unit.currents, task["matrix"] @ wanted + task["constant"])
        unit.step(period * n, period)
    return {"states": np.array(rows)}


def integrate(task):
    """States at the end of a motion at fixed currents, by FMPy's own integrator and by the FMU's."""
    path, currents = str(task["path"]), task["currents"]
    start = dict(zip(STATE, task["state"], strict=True))
    start |= {f"current_{k + 1}": value for k, value in enumerate(currents)}
    every = {}
    for kind, more in (
        ("ModelExchange", {"solver": "CVode", "relative_tolerance": 1e-10}),
        ("CoSimulation", {}),
    ):
        found = fmpy.simulate_fmu(
            path,
            fmi_type=kind,
            stop_time=float(task["duration"]),
            output_interval=float(task["duration"]) / 50,
            start_values=start,
            output=STATE,
            **more,
        )
        every[kind] = np.array([found[name] for name in STATE]).T
    return every


if __name__ == "__main__":
    assert not any("fieldmap" in name for name in sys.modules)
    with np.load(sys.argv[1]) as given:
        task = dict(given)
    kinds = {"ask": ask, "follow": follow, "loop": loop, "integrate": integrate}
    np.savez(sys.argv[2], **kinds[str(task["kind"])](task))
