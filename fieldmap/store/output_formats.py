"""Formats of output files, and the check of their paths.

No output replaces an input or a file of another origin: `output_problems` lists the problems of a path. Every command
calls it before the work begins, with the formats of its options, and `whole_file` calls it before anything is written.
A file may be replaced if its beginning shows that this program wrote it in the same format.
"""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fieldmap.errors import Problem
from fieldmap.file_contents import file_in_words, head_of
from fieldmap.records import Record
from fieldmap.typing import PathLike


@dataclass(frozen=True, repr=False)
class Format(Record):
    """A format: the endings of its files, and a pattern that the head of a file matches if it may be replaced."""

    endings: tuple[str, ...]
    ours: re.Pattern[bytes]


def _format(endings: str, pattern: bytes) -> Format:
    return Format(tuple(endings.split()), re.compile(pattern, re.DOTALL))


FORMATS: dict[str, Format] = {
    "map": _format(".h5 .hdf5", rb"\A\x89HDF(?=.*fieldmap)(?=.*openPMD)"),
    "recorded runs": _format(".h5 .hdf5", rb"\A\x89HDF.*fieldmap run"),
    "recorded run": _format(".csv", rb"\Atime \(s\),position x \(m\)"),
    "study": _format(".nc", rb"\A\x89HDF(?=.*_NCProperties)(?=.*fieldmap \d)"),
    "study table": _format(".csv", rb"\A(design,role,|[^\n]*,(currents|map_file),[^\n]*,problem\n)"),
    "device": _format(".toml", rb"\A# Written by fieldmap"),
    "table of a field": _format(".csv", rb"\A# [^\n]*\n# device: [^\n]*\n# frame: "),
    "VTK image data": _format(".vti", rb"<VTKFile type=.ImageData"),
    "VTK mesh": _format(".vtu", rb"<VTKFile type=.UnstructuredGrid.*(mu_r|charge_T)"),
    "XDMF mesh": _format(".xdmf", rb"<Xdmf.*mu_r"),
    "map for C": _format(".fmap", rb"\A(fieldmap|fmapiron)"),
    "C header": _format(
        ".h", rb"\A/\* ([^\n]*, written by fieldmap|(fieldmap\w*|calibration_curve|controller)\.h: )"
    ),
    "unit of FMI": _format(".fmu", rb"\APK.*resources/map\.fmap"),
    "field for mag_manip": _format(".yaml .yml", rb"\A# coils in current order: "),
    "linear models": _format(".json .npz", rb'\A(\{\s*"scenario": .*"states"|PK.*depth_mm\.npy)'),
    "figure": _format(".png .svg .pdf", rb"\A\x89PNG|\A%PDF|\A<\?xml[^>]*>.*<svg"),
    # A figure that the user has not named, next to a map or a study.
    "drawn figure": _format(".png", rb"\A\x89PNG.{,400}Matplotlib version"),
    "picture": _format(".png", rb"\A\x89PNG"),
    "web page": _format(".html", rb"drag: turn; wheel: zoom"),
    "ParaView scene": _format(".vtm", rb"<VTKFile type=.vtkMultiBlockDataSet"),
    "film": _format(".gif .mp4", rb"\A(GIF8|....ftyp)"),
    "saved states": _format(".json", rb'\A\{\s*"format": 1,\s*"states"'),
    "report": _format(".html .md", rb"<title>fieldmap: (the thesis|gallery)|\A# The thesis, side by side"),
    "table of numbers": _format(".csv", rb"\Arow,"),
    "written log": _format(".csv", rb"\A# Log written by fieldmap"),
    "log": _format(".log .txt", rb"\A\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} "),
    # Its name is a hash of its contents.
    "kept mesh": _format(".npz", rb""),
}


def output_problems(
    where: str, path: PathLike, formats: Iterable[str], others: Iterable[PathLike] = ()
) -> list[Problem]:
    """Problems of an output path.

    Parameters
    ----------
    where
        The option, or the path itself.
    path
        The path.
    formats
        Names of the formats (`FORMATS`) that the file may have, by its ending.
    others
        Input files, and other output files.

    Returns
    -------
    list[Problem]
        A wrong ending, a folder in its place, a file that is also read or written elsewhere, a file of another
        origin that it would replace, a folder that cannot be made.
    """
    target = Path(path)
    known = [FORMATS[name] for name in formats]
    chosen = [one for one in known if target.suffix in one.endings]
    if not chosen:
        *first, last = dict.fromkeys(ending for one in known for ending in one.endings)
        must_hold = f"must end in {', '.join(first)}{' or ' if first else ''}{last}"
        return [Problem(where, must_hold, str(path), "programs know a file's format by its ending")]
    if os.path.isdir(target):
        return [Problem(where, "must be a file", f"{path}, a folder", "name the file inside it")]
    if any(_same(target, Path(other)) for other in others):
        must_hold = "must not be a file that is read, or written by another option"
        return [Problem(where, must_hold, str(path), "give it a name of its own")]
    if os.path.exists(target) and not _replaceable(target, chosen):
        must_hold = f"must not replace a file of another origin: it may replace a {' or '.join(formats)}"
        received = f"{path}, {file_in_words(target)}"
        return [Problem(where, must_hold, received, "give another name, or move that file away")]
    folder = target.absolute().parent
    while not os.path.exists(folder):
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        received = f"{path}: {folder} is {'not writable' if folder.is_dir() else 'a file'}"
        return [Problem(where, "must lie in a folder that can be written", received, "choose another")]
    return []


def _same(one: Path, other: Path) -> bool:
    # Path.exists would raise for a text that cannot be a file name.
    if os.path.exists(one) and os.path.exists(other):
        return os.path.samefile(one, other)
    return os.path.abspath(one) == os.path.abspath(other)


def _replaceable(path: Path, formats: list[Format]) -> bool:
    """Whether a file is empty, or begins as one that was written in one of these formats."""
    try:
        head = head_of(path)
    except OSError:
        return False
    return not head or any(one.ours.search(head) for one in formats)
