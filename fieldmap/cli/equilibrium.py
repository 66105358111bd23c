"""`fieldmap equilibrium`: where the payload floats, or the current that carries it at a height."""

from typing import Annotated, Any

import typer

from fieldmap.cli.options import Form, Json, MuR, Nonlinear, Refinement, devices


def equilibrium(
    source: Annotated[
        str,
        typer.Argument(
            metavar="MAP_OR_DEVICE", help="Map file, or device file or name.", autocompletion=devices
        ),
    ],
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, or one for all: where does it float?"
        ),
    ] = None,
    height_mm: Annotated[
        float | None,
        typer.Option(
            "--height-mm",
            metavar="MM",
            help="z of the magnet's centre (negative: below): what current lifts it?",
        ),
    ] = None,
    sensor_mm: Annotated[
        float | None,
        typer.Option(
            "--sensor-mm", metavar="MM", help="The same, by the thesis's sensor reading, mm downward."
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option("--start", metavar="X Y Z", help="Where to begin the search, m.")
    ] = None,
    moment: Annotated[
        str,
        typer.Option("--moment", metavar="NAME", help="fixed: stays vertical; aligned: follows the field."),
    ] = "fixed",
    payload_of: Annotated[
        str | None, typer.Option("--payload-of", metavar="DEVICE", help="Take the payload from this device.")
    ] = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    form: Form = "auto",
    json: Json = False,
) -> None:
    """Find where the payload floats and how stiffly, or the current that carries it at a height."""
    from fieldmap.cli.arguments import parse_currents, parse_points
    from fieldmap.cli.balance import floating, lifted
    from fieldmap.cli.equilibrium_text import print_answer
    from fieldmap.cli.iron import checked_choice
    from fieldmap.cli.opening import find_source, open_device
    from fieldmap.levitation.balance import check_payload

    _exactly_one(currents, height_mm, sensor_mm)
    choice = checked_choice(mu_r, nonlinear, refinement, form)
    begin = None if start is None else parse_points([start], [])[0]
    found = find_source(source, choice)
    amperes = parse_currents(currents, found.coil_names) if currents else None
    payload = check_payload(
        found.payload if payload_of is None else open_device(payload_of).payload, "equilibrium"
    )
    if amperes is not None:
        answer = floating(found, amperes, payload, begin, moment)
    else:
        answer = lifted(found, payload, _height(height_mm, sensor_mm, payload))
    if json:
        from fieldmap.cli.printing import print_json

        print_json(answer)
    else:
        print_answer(answer)


def _height(height_mm: float | None, sensor_mm: float | None, payload: Any) -> float:
    from fieldmap.thesis.vertical_sensor import magnet_height

    if height_mm is not None:
        return 1e-3 * height_mm
    return magnet_height(float(sensor_mm or 0.0), payload.magnet_offset)


def _exactly_one(*given: Any) -> None:
    from fieldmap.errors import InputError, Problem

    count = sum(bool(value) if isinstance(value, list) else value is not None for value in given)
    if count != 1:
        raise InputError(
            Problem(
                "equilibrium",
                "must have exactly one of --currents, --height-mm and --sensor-mm",
                f"{count} of them",
                "--currents asks where the payload floats, the other two ask for the current that lifts it",
            )
        )
