"""`fieldmap linearise`: the machine of a scenario as a linear model."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json, ScenarioArgument, ScenarioMap, device_of_option, field_opener

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fieldmap.cli.printing import Section
    from fieldmap.dynamics.scenario import Linearisation, LinearPoint


def linearise(
    scenario: ScenarioArgument,
    map_file: ScenarioMap = None,
    depths: Annotated[
        str | None,
        typer.Option(
            "--depths",
            metavar="A,B,...",
            help="Readings of the vertical sensor, mm. Default: the one at the start.",
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change a key, such as control.z.Kc=0.2; may be repeated."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the models: .json or .npz.")
    ] = None,
    json: Json = False,
) -> None:
    """Linearise the machine of a scenario about its operating point: poles, coupling, margins.

    The exit code is 1 if the loop is unstable at any depth.
    """
    from fieldmap.cli.arguments import parse_setting
    from fieldmap.cli.printing import print_result
    from fieldmap.dynamics.scenario import Linearisation, linear_points, prepare, read_scenario

    readings = _checked(depths, output)
    read = read_scenario(scenario, dict(parse_setting(text, "--set") for text in changes or []))
    opener = field_opener(map_file)
    device = device_of_option(map_file) if read.contents.device is None else None
    experiment = prepare(read, None if opener is None else opener(), device)
    found = Linearisation(experiment, tuple(linear_points(experiment, readings)))
    if output is not None:
        found.write(output)
    print_result(found, partial(_page, scenario, output), json, written=output)
    if not found.stable:
        raise typer.Exit(1)


def _checked(depths: str | None, output: Path | None) -> list[float] | None:
    """The depths, mm. Raises InputError for them and for the file, before any work."""
    from fieldmap.cli.arguments import output_problems
    from fieldmap.errors import InputError, Problem

    problems, readings = output_problems("--output", output, (".json", ".npz")), None
    try:
        readings = None if depths is None else [float(part) for part in depths.split(",")]
    except ValueError:
        remedy = "write for example 0,10,20"
        problems.append(Problem("--depths", "must be numbers A,B,...", str(depths), remedy))
    if problems:
        raise InputError(*problems)
    return readings


def _page(scenario: str, output: Path | None, found: "Linearisation") -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading, table

    points = found.points
    yield heading(found.experiment.scenario.contents.title, scenario)
    yield table(
        ("depth mm", "pole 1/s", "Hz", "damping", "moves", "input gain", "output gain"), _modes(points)
    )
    yield table(("depth mm", "from", "to x mm", "to y mm", "to z mm", "relative gain"), _coupling(points))
    yield table(("depth mm", "loop", "slowest pole 1/s", "least damping", "at Hz"), _loops(points))
    columns = ("depth mm", "loop at", "phase deg", "at Hz", "gain up", "gain down", "modulus")
    yield table(columns, _margins(points))
    yield facts(assumption_lines(points[0].linear.assumptions))
    yield facts([("written", str(output))]) if output else None


def _modes(points: "tuple[LinearPoint, ...]") -> list[tuple[str, ...]]:
    from fieldmap.cli.printing import without_noise

    lines: list[tuple[str, ...]] = []
    for point in points:
        reached = without_noise([mode.input_gains.max() for mode in point.modes])
        seen = without_noise([mode.output_gains.max() for mode in point.modes])
        for k, mode in enumerate(point.modes):
            # One line for a pair.
            if mode.pole.imag < -1e-9:
                continue
            shares = mode.named_shares(point.linear)
            lines.append(
                (
                    f"{point.depth_mm:g}",
                    _complex(mode.pole),
                    f"{mode.frequency:.3f}",
                    f"{mode.damping:.3f}",
                    ", ".join(sorted(shares, key=lambda name: -shares[name])),
                    f"{reached[k]:.3g}",
                    f"{seen[k]:.3g}",
                )
            )
    return lines


def _complex(value: complex) -> str:
    return f"{value.real:.3f}" + (f" ± {abs(value.imag):.3f}i" if abs(value.imag) > 1e-9 else "")


def _coupling(points: "tuple[LinearPoint, ...]") -> list[tuple[str, ...]]:
    """Where each signal moves the body, its loops open; and its relative gain with the axis that it belongs to."""
    from fieldmap.cli.printing import without_noise
    from fieldmap.dynamics.scenario.linear_points import coupling_signals

    lines: list[tuple[str, ...]] = []
    for point in points:
        gain, relative = without_noise(1e3 * point.coupling.gain), point.coupling.relative
        for k, name in enumerate(coupling_signals(point)):
            cells = [f"{value:.4g}" for value in gain[:, k]]
            lines.append((f"{point.depth_mm:g}", name, *cells, f"{relative[k, k]:.3f}"))
    return lines


def _loops(points: "tuple[LinearPoint, ...]") -> list[tuple[str, ...]]:
    import numpy as np

    from fieldmap.dynamics.scenario.linear_points import loop_poles

    lines: list[tuple[str, ...]] = []
    for point in points:
        poles = loop_poles(point)
        damping = -poles.real / np.maximum(np.abs(poles), 1e-12)
        least = int(np.argmin(damping))
        lines.append(
            (
                f"{point.depth_mm:g}",
                "stable" if point.loop.stable else "UNSTABLE",
                _complex(complex(poles[0])),
                f"{damping[least]:.3f}",
                f"{abs(poles[least].imag) / (2 * np.pi):.3f}",
            )
        )
    return lines


def _margins(points: "tuple[LinearPoint, ...]") -> list[tuple[str, ...]]:
    return [
        (
            f"{point.depth_mm:g}",
            found.output,
            f"{found.phase:.1f}",
            f"{found.crossover:.3f}",
            f"{found.gain_up:.3g}",
            f"{found.gain_down:.3g}",
            f"{found.modulus:.3f}",
        )
        for point in points
        for found in point.margins
    ]
