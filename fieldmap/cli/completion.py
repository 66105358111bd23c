"""What the shell may complete: names of shipped files. Without a match it completes file names, as ever."""

from fieldmap.shipped import shipped_names


def devices(incomplete: str) -> list[str]:
    """Shipped devices that begin so.

    >>> devices("drive_unit_n")
    ['drive_unit_no_centre_core']
    """
    return _begin(shipped_names("geometry"), incomplete)


def recipes(incomplete: str) -> list[str]:
    """Shipped recipes that begin so.

    >>> recipes("qu")
    ['quick']
    """
    return _begin(shipped_names("maps"), incomplete)


def studies(incomplete: str) -> list[str]:
    """Shipped studies that begin so.

    >>> studies("po")
    ['pole_disk']
    """
    return _begin([name.split("/")[-1] for name in shipped_names("maps", "studies")], incomplete)


def scenarios(incomplete: str) -> list[str]:
    """Shipped scenarios that begin so.

    >>> scenarios("vertical_r")
    ['vertical_ramp']
    """
    return _begin([name.split("/")[-1] for name in shipped_names("maps", "scenarios")], incomplete)


def rows(incomplete: str) -> list[str]:
    """Rows of the thesis that begin so.

    >>> rows("S2")
    ['S20']
    """
    from fieldmap.thesis import row_names

    return _begin(list(row_names()), incomplete)


def _begin(names: list[str], start: str) -> list[str]:
    return [name for name in names if name.startswith(start)]
