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


def _begin(names: list[str], start: str) -> list[str]:
    return [name for name in names if name.startswith(start)]
