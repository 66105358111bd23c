"""The file that a path means, or the name of a shipped one."""

from pathlib import Path

from fieldmap.device.findings import closest, one_of
from fieldmap.errors import FieldmapError, Problem
from fieldmap.shipped import shipped_file, shipped_names


def find_input_file(
    path_or_name: str | Path, what: str, error: type[FieldmapError], kind: str, subfolder: str = ""
) -> Path:
    """The file at a path, or the shipped one of that name; `error` if there is neither.

    what: "device", "recipe", ...: which file it is to be. kind, subfolder: where the shipped ones lie.
    """
    path = Path(path_or_name)
    if path.is_file():
        return path
    shipped = shipped_file(kind, str(Path(subfolder) / path_or_name))
    if shipped is not None:
        return shipped
    names = [Path(name).name for name in shipped_names(kind, subfolder)]
    guess = closest(path.stem, names)
    remedy = f'did you mean "{guess}"?' if guess else f"give a path, or one of {one_of(names)}"
    must_hold = f"must be a {what} file or the name of a shipped {what}"
    raise error(Problem(str(path_or_name), must_hold, "no such file", remedy))
