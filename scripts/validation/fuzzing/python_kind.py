"""Machines made in Python with wrong arguments: any type and value, anywhere."""

import dataclasses
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fieldmap as fm
from validation.fuzzing.case import Case, Generator, Kind, not_finite
from validation.fuzzing.mutations import strange_places


class Strange:
    """An object of a foreign class with unusual methods."""

    def __len__(self) -> int:
        raise RuntimeError("no length")

    def __repr__(self) -> str:
        return "Strange()"


def strange_values(folder: Path) -> tuple[Callable[[], Any], ...]:
    """Makers of values that few arguments or none accept."""
    plain = (
        None, True, "", "text", "x" * 3000, "\x00", b"bytes", 0, -1, 1, 0.0, -0.0, 1e308, -1e308, 5e-324,
        1e-300, float("nan"), float("inf"), -float("inf"), 10**400, 2**70, 1j, (), [], {}, set(),
        [[1, 2], [3]], {"a": 1}, [1.0, 2.0], [1.0, 2.0, 3.0, 4.0], (0.0, 0.0, float("nan")),
        ("a", "b", "c"), [None] * 3, range(3), object, print, Strange(), np.zeros(0), np.zeros(3),
        np.ones((3, 3)), np.zeros((2, 2, 2)), np.array(1.0), np.nan, np.array(["a"]), np.array([None, 1]),
        np.float32(0.1), np.int8(-3), np.array([1e308] * 3), np.eye(3) * 2, np.datetime64("2026-11-23"),
        Path(folder), Path("missing"), *strange_places(folder),
    )  # fmt: skip
    ours = (
        lambda: fm.Cylinder(1e-2, 1e-2),
        lambda: fm.CircularCoil("c", 0.02, 0.03, 0.01, 100),
        lambda: fm.placed((0, 0, 0), (0, 0, 30)),
        lambda: fm.LinearMaterial("m", 100.0),
        lambda: fm.Device,
    )
    return (*((lambda one=one: one) for one in plain), *ours)


def sound_calls() -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Constructors and functions with valid arguments."""
    coil = fm.CircularCoil("c", 0.02, 0.03, 0.01, 100)
    body = fm.Body("b", "steel", fm.Cylinder(0.01, 0.02), mesh_size=0.005)
    steel = fm.LinearMaterial("steel", 1000.0)
    h, b = [100.0, 1000.0, 1e4], [0.5, 1.2, 1.6]
    return {
        "CircularCoil": (fm.CircularCoil, {"name": "c", "inner_radius": 0.02, "outer_radius": 0.03, "height": 0.01,
                                           "turns": 100, "placement": fm.placed((0, 0, 0.1))}),
        "RoundedRectangleCoil": (fm.RoundedRectangleCoil, {"name": "r", "half_width_x": 0.03, "half_width_y": 0.04, "corner_radius": 0.015,  # noqa: E501
 "thickness": 0.005, "height": 0.01, "turns": 50}),
        "Cylinder": (fm.Cylinder, {"radius": 0.01, "height": 0.02}),
        "Ring": (fm.Ring, {"inner_radius": 0.01, "outer_radius": 0.02, "height": 0.02}),
        "Box": (fm.Box, {"size": (0.01, 0.02, 0.03)}),
        "Sphere": (fm.Sphere, {"radius": 0.01}),
        "ExtrudedPolygon": (fm.ExtrudedPolygon, {"points": [[0, 0], [0.01, 0], [0, 0.01]], "height": 0.01}),
        "TriangleSurface": (fm.TriangleSurface, {"points": np.vstack([np.zeros(3), 0.01 * np.eye(3)]),
                                                 "triangles": [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]}),
        "LinearMaterial": (fm.LinearMaterial, {"name": "steel", "mu_r": 100.0}),
        "Froehlich": (fm.Froehlich, {"name": "steel", "mu_r": 1000.0, "saturation": 2.0}),
        "BHTable": (fm.BHTable, {"name": "steel", "h": h, "b": b, "below": "straight line to the origin", "above": "slope mu0"}),  # noqa: E501
        "PermanentMagnet": (fm.PermanentMagnet, {"name": "steel", "remanence": (0.0, 0.0, 1.2), "mu_r": 1.05}),
        "Body": (fm.Body, {"name": "b", "material": "steel", "parts": fm.Cylinder(0.01, 0.02), "mesh_size": 0.005}),
        "Driver": (fm.Driver, {"gain": 1.0, "current_limit": 3.0}),
        "Payload": (fm.Payload, {"mass": 0.01, "moment": 0.8}),
        "WorkspaceBox": (fm.WorkspaceBox, {"lower": [-0.01, -0.01, -0.12], "upper": [0.01, 0.01, -0.1]}),
        "WorkspaceCylinder": (fm.WorkspaceCylinder, {"base": (0.0, 0.0, -0.12), "radius": 0.01, "height": 0.02}),
        "Background": (fm.Background, {"flux_density": (0.0, 0.0, 1e-3)}),
        "Device": (fm.Device, {"name": "d", "title": "a", "coils": [coil], "bodies": [body], "materials": {"steel": steel}}),  # noqa: E501
        "placed": (fm.placed, {"position": (0.0, 0.0, 0.1), "rotation_deg": (0.0, 0.0, 30.0)}),
        "turned": (coil.turned, {"axis": "z", "angle_deg": 30.0, "centre": (0.0, 0.0, 0.0)}),
        "moved": (coil.moved, {"by": (0.0, 0.0, 0.1)}),
        "mirrored": (coil.mirrored, {"plane": "x", "at": 0.0, "name": "m"}),
        "around": (coil.around, {"axis": "z", "count": 3}),
        "along": (coil.along, {"step": (0.1, 0.0, 0.0), "count": 3}),
        "read_device": (fm.read_device, {"path_or_name": "loop_and_sphere", "changes": {"coil.loop.turns": 3.0}}),
        "material": (fm.material, {"path_or_name": "steel_a3", "above": "slope mu0", "name": "steel"}),
        "open_map": (fm.open_map, {"path": "sample"}),
    }  # fmt: skip


def in_a_device(name: str, made: Any) -> Any:
    """A machine with the made object. Its constructor checks the object completely."""
    coil = fm.CircularCoil("other", 0.02, 0.03, 0.01, 100)
    steel = fm.LinearMaterial("steel", 1000.0)
    if isinstance(made, fm.Device):
        return made
    if isinstance(made, fm.Coil):
        return fm.Device("d", "a", [coil, made])
    if name in ("around", "along"):
        return fm.Device("d", "a", list(made))
    if name in ("LinearMaterial", "Froehlich", "BHTable", "PermanentMagnet", "material"):
        body = fm.Body("b", "steel", fm.Cylinder(0.01, 0.02), mesh_size=0.005)
        return fm.Device("d", "a", [coil], [body], materials={"steel": made})
    if isinstance(made, fm.Body):
        return fm.Device("d", "a", [coil], [made], materials={"steel": steel})
    for key, kind in (("driver", fm.Driver), ("payload", fm.Payload), ("background", fm.Background)):
        if isinstance(made, kind):
            return fm.Device("d", "a", [coil], **{key: made})
    if isinstance(made, fm.WorkspaceBox | fm.WorkspaceCylinder):
        return fm.Device("d", "a", [coil], workspace=made)
    if isinstance(made, fm.Placement):
        return fm.Device("d", "a", [coil.replace(placement=made) if hasattr(coil, "replace") else
                                    dataclasses.replace(coil, placement=made)])  # fmt: skip
    if name in ("Cylinder", "Ring", "Box", "Sphere", "ExtrudedPolygon", "TriangleSurface"):
        body = fm.Body("b", "steel", made, mesh_size=0.005)
        return fm.Device("d", "a", [coil], [body], materials={"steel": steel})
    return made


def machines(folder: Path) -> Callable[[Generator, int], Case]:
    """Calls with one to three arguments replaced, left out, added or renamed."""
    calls, values = sound_calls(), strange_values(folder)
    usable = {}
    for name, (function, arguments) in calls.items():
        known = set(inspect.signature(function).parameters)
        given = {key: value for key, value in arguments.items() if key in known}
        if given != arguments and set(given) != set(arguments):
            raise AssertionError(f"{name} takes {sorted(known)}, not {sorted(set(arguments) - known)}")
        in_a_device(name, function(**given))
        usable[name] = (function, given)
    names = sorted(usable)

    def make(rng: Generator, number: int) -> Case:
        name = names[number % len(names)]
        function, given = usable[name]
        chosen, extra, done = dict(given), (), []
        for _ in range(int(rng.choice([1, 1, 2, 3]))):
            key = sorted(given)[int(rng.integers(len(given)))]
            what = str(rng.choice(["value", "value", "value", "value", "left out", "renamed", "too many"]))
            value = values[int(rng.integers(len(values)))]()
            if what == "value":
                chosen[key] = value
            elif what == "left out":
                chosen.pop(key, None)
            elif what == "renamed":
                chosen[f"{key}_mm"] = chosen.pop(key, None)
            else:
                extra, chosen = (*chosen.values(), *[value] * 20), {}
            done.append(f"{what} {key}" + (f" = {value!r:.40}" if what == "value" else ""))
        methods = (
            "turned", "moved", "mirrored", "around", "along", "placed", "read_device", "material",
            "open_map",
        )  # fmt: skip
        if name in methods and any(not word.startswith("value") for word in done):
            # Python itself raises TypeError for arguments that a function does not have.
            chosen, extra = dict(given), ()

        def read() -> Any:
            return in_a_device(name, function(*extra, **chosen))

        return Case(f"{name}: {' and '.join(done)}", read, _fault)

    return make


def _fault(made: Any) -> str:
    """Fault of a machine with NaN or infinity, or of one that is not the same after writing and reading."""
    if not isinstance(made, fm.Device):
        return ""
    parts = {
        key: getattr(made, key) for key in ("coils", "bodies", "payload", "driver", "workspace", "background")
    }
    if lost := not_finite(parts):
        return f"NaN or infinity in {lost}"
    if any(len(made.included) for _ in (1,)):
        return ""
    again = fm.read_device(made.to_toml())
    return (
        ""
        if again.coil_names == made.coil_names and len(again.bodies) == len(made.bodies)
        else "lost in writing"
    )


MACHINES = Kind("Python machines", machines, seconds=2.0, names_files=True, through_command=0)
