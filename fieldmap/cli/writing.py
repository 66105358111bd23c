"""The file that an option asks for, before any work."""

from pathlib import Path

from fieldmap.errors import Problem


def output_problems(option: str, path: Path | None, suffixes: tuple[str, ...]) -> list[Problem]:
    """What is wrong with where a result is to go: its suffix, its folder; nothing where none is asked for."""
    problems = []
    if path is not None and path.suffix not in suffixes:
        allowed = f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"
        problems.append(Problem(option, f"must end in {allowed}", str(path), "choose a suffix"))
    if path is not None and not path.absolute().parent.is_dir():
        problems.append(Problem(option, "must lie in a folder that exists", str(path), "make the folder"))
    return problems
