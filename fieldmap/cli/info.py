"""`fieldmap info`: what a map holds."""

from typing import Annotated

import typer


def info(
    source: Annotated[str, typer.Argument(metavar="MAP", help="Map file.")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print what a map holds: device, grid, field, gradient, lift current, and how accurate it is."""
    from fieldmap.cli.opening import check_map_path
    from fieldmap.cli.summary import print_summary

    print_summary(check_map_path(source), json)
