"""Count files, lines, imports and tests of the package, for a table or as JSON.

    python scripts/dev/architecture_counts.py                          # this checkout
    python scripts/dev/architecture_counts.py --package ../before      # another one
    python scripts/dev/architecture_counts.py --json

How each figure is counted:

- lines: a line is code if it holds a token other than a comment or a docstring. Lines of docstrings (of modules,
  classes and functions, and texts below a name), comment lines and blank lines are counted separately.
- small files: at most 60 lines in all.
- one importer: a module that exactly one other module of the package imports, at its top or inside a function.
  `__init__.py` counts neither as importer, since it only passes names on, nor as imported. `same folder`: the importer
  is in the same folder. `untested`: no test and no script imports the module either.
- import circles: groups of modules that import each other, directly or through others. Imports inside functions and
  for type checking count; the figure without them is given too.
- thesis: Python files that contain the word, in upper or lower case.
- prose: an `assert`, or a `match=` of pytest.raises or pytest.warns, that holds a literal text of three words or more
  and is not the message of the assert. A word has two letters or more.
"""

import argparse
import ast
import gc
import io
import json
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parents[2]
SMALL = 60
_BY_NAME = ("import_module", "__import__", "require", "import_modules")
# Functions of these modules import modules by name; calls of the functions count as imports.
_GIVEN = ("fieldmap.extras", "fieldmap.extensions")
PROSE = 3


@dataclass(frozen=True)
class Module:
    """One Python file: its dotted name, its text, and its syntax tree."""

    name: str
    path: Path
    text: str
    tree: ast.Module


@dataclass(frozen=True)
class Lines:
    """Numbers of lines of each kind; their sum is the length of the files."""

    code: int
    docstrings: int
    comments: int
    blank: int


@dataclass(frozen=True)
class Counts:
    """All figures of one checkout."""

    files: int
    lines: Lines
    small_files: int
    one_importer: tuple[str, ...]
    one_importer_same_folder: tuple[str, ...]
    one_importer_untested: tuple[str, ...]
    protocols: tuple[str, ...]
    array_definitions: int
    circles: tuple[tuple[str, ...], ...]
    circles_at_module_level: tuple[tuple[str, ...], ...]
    thesis: dict[str, int]
    any_by_package: dict[str, int]
    prose: dict[str, int]


def modules(root: Path) -> dict[str, Module]:
    """Every module of the package in a checkout, by its dotted name."""
    found = {}
    with _all_kept():
        for path in sorted((root / "fieldmap").rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            text = path.read_text(encoding="utf-8")
            found[name] = Module(name, path, text, ast.parse(text))
    return found


@contextmanager
def _all_kept() -> Iterator[None]:
    """Context without the garbage collector, which would take half of the time on a million nodes of syntax trees."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def imports(package: dict[str, Module], lazy: bool = True) -> dict[str, set[str]]:
    """Module -> modules of the package that it imports; without `lazy` only imports that run on its own import."""
    graph: dict[str, set[str]] = {name: set() for name in package}
    for name, module in package.items():
        for node in _import_nodes(module.tree, lazy):
            graph[name] |= set(_targets(node, module, package)) - {name}
    return graph


def imports_by_name(module: Module) -> Iterator[str]:
    """Arguments of `import_module`, `__import__`, `require` of extras and `import_modules` of extensions: a name, or
    its beginning and "*"; "*" if unknown.

    A table of the module, such as the names that are imported on first use, counts with all its values.
    """
    if module.name in _GIVEN:
        return
    package = module.name if module.path.name == "__init__.py" else module.name.rpartition(".")[0]
    tables = {
        target.id: [value.value for value in node.value.values if isinstance(value, ast.Constant)]
        for node in module.tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(module.tree):
        if not isinstance(node, ast.Call) or _last_name(node.func) not in _BY_NAME:
            continue
        given = node.args[0] if node.args else node
        if isinstance(given, ast.Name) and given.id == "__name__":
            yield f"{package}.*"
        elif isinstance(given, ast.Constant):
            name = str(given.value)
            yield f"{package}{name}" if name.startswith(".") else name
        elif isinstance(given, ast.JoinedStr):
            first = given.values[0]
            own = isinstance(first, ast.FormattedValue) and ast.unparse(first.value) == "__name__"
            yield f"{package}.*" if own else f"{first.value}*" if isinstance(first, ast.Constant) else "*"
        elif isinstance(given, ast.Subscript) and _last_name(given.value) in tables:
            yield from tables[_last_name(given.value)]
        elif _last_name(node.func) != "require":  # other functions have this name, too
            yield "*"


def by_packages(package: dict[str, Module]) -> dict[str, set[str]]:
    """Package -> packages that its modules import, at their tops, inside functions or by name."""
    graph: dict[str, set[str]] = {_package_of(module): set() for module in package.values()}
    for name, targets in imports(package).items():
        graph[_package_of(package[name])] |= {_package_of(package[target]) for target in targets}
    for module in package.values():
        for name in imports_by_name(module):
            pattern = re.compile(re.escape(name).replace(r"\*", ".*"))
            graph[_package_of(module)] |= {
                _package_of(package[other]) for other in package if pattern.fullmatch(other)
            }
    # `fieldmap` itself names all packages, for users, and is imported by none.
    return {name: targets - {name, "__init__"} for name, targets in graph.items() if name != "__init__"}


def _import_nodes(tree: ast.AST, lazy: bool) -> Iterator[ast.Import | ast.ImportFrom]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif isinstance(node, ast.expr):
            continue
        elif lazy or not (isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or _for_types(node)):
            yield from _import_nodes(node, lazy)


def _for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def _targets(node: ast.Import | ast.ImportFrom, module: Module, package: dict[str, Module]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in package)
        return
    base = node.module or ""
    if node.level:
        own = module.name.split(".") if module.path.name == "__init__.py" else module.name.split(".")[:-1]
        kept = own[: len(own) - node.level + 1]
        base = ".".join([*kept, *([node.module] if node.module else [])])
    for alias in node.names:
        target = f"{base}.{alias.name}"
        if target in package:
            yield target
        elif base in package:
            yield base


def circles(graph: dict[str, set[str]]) -> tuple[tuple[str, ...], ...]:
    """Groups of two modules or more that reach each other (strongly connected components), by name."""
    number = {name: k for k, name in enumerate(graph)}
    edges = [(number[name], number[target]) for name, targets in graph.items() for target in targets]
    start, end = np.array(edges, dtype=int).reshape(-1, 2).T
    matrix = coo_array((np.ones(len(edges)), (start, end)), shape=(len(graph), len(graph)))
    _, group = connected_components(matrix, directed=True, connection="strong")
    members: dict[int, list[str]] = defaultdict(list)
    for name, k in number.items():
        members[group[k]].append(name)
    return tuple(sorted(tuple(sorted(names)) for names in members.values() if len(names) > 1))


def lines_of(module: Module) -> Lines:
    """Lines of one file."""
    total = len(module.text.splitlines())
    documented = set(_docstring_lines(module.tree))
    coded: set[int] = set()
    commented: set[int] = set()
    nothing = (tokenize.NEWLINE, tokenize.NL, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        spanned = range(token.start[0], token.end[0] + 1)
        if token.type == tokenize.COMMENT:
            commented |= set(spanned)
        elif token.type not in nothing:
            coded |= set(spanned) - documented
    commented -= coded | documented
    return Lines(len(coded), len(documented), len(commented), total - len(coded | documented | commented))


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    """Lines of texts that are statements."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def one_importer(package: dict[str, Module]) -> list[tuple[str, str]]:
    """(module, its only importer), by name."""
    importers: dict[str, set[str]] = defaultdict(set)
    for name, targets in imports(package).items():
        if not _is_folder(package[name]):
            for target in targets:
                importers[target].add(name)
    return sorted(
        (name, next(iter(by)))
        for name, by in importers.items()
        if len(by) == 1 and not _is_folder(package[name])
    )


def _is_folder(module: Module) -> bool:
    return module.path.name == "__init__.py"


def imported_outside(root: Path, package: dict[str, Module]) -> set[str]:
    """Modules that a test or a script imports."""
    found: set[str] = set()
    for folder in ("tests", "scripts"):
        for path in sorted((root / folder).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            outsider = Module(path.stem, path, text, ast.parse(text))
            for node in _import_nodes(outsider.tree, lazy=True):
                found |= set(_targets(node, outsider, package))
    return found


def protocols(package: dict[str, Module]) -> list[str]:
    """Names of the classes that derive from Protocol, with their modules."""
    return [
        f"{module.name}.{node.name}"
        for module in package.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ClassDef) and any(_last_name(base) == "Protocol" for base in node.bases)
    ]


def _last_name(node: ast.expr) -> str:
    if isinstance(node, ast.Subscript):
        return _last_name(node.value)
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def array_definitions(package: dict[str, Module]) -> int:
    """How often a module names its own type of arrays: `Array = NDArray[...]`, with or without an annotation."""
    pattern = re.compile(r"^\w*(?:Array|Index|Bools?)\w*(?:: TypeAlias)? = NDArray\[", re.MULTILINE)
    return sum(len(pattern.findall(module.text)) for module in package.values())


def by_package(package: dict[str, Module], pattern: str) -> dict[str, int]:
    """Package -> number of its files that contain the pattern, in upper or lower case."""
    return _tally(module for module in package.values() if re.search(pattern, module.text, re.IGNORECASE))


def uses_of_any(package: dict[str, Module]) -> dict[str, int]:
    """Package -> number of Any in its annotations and casts."""
    found: dict[str, int] = defaultdict(int)
    for module in package.values():
        uses = sum(isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(module.tree))
        if uses:
            found[_package_of(module)] += uses
    return _largest_first(found)


def _tally(chosen: Iterable[Module]) -> dict[str, int]:
    found: dict[str, int] = defaultdict(int)
    for module in chosen:
        found[_package_of(module)] += 1
    return _largest_first(found)


def _largest_first(found: dict[str, int]) -> dict[str, int]:
    return dict(sorted(found.items(), key=lambda pair: (-pair[1], pair[0])))


def _package_of(module: Module) -> str:
    parts = module.name.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def prose(root: Path) -> dict[str, int]:
    """Folder of tests -> asserts that hold a text of three words or more."""
    found: dict[str, int] = defaultdict(int)
    for path in sorted((root / "tests").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        count = sum(any(map(_is_prose, texts)) for texts in _asserted_texts(tree))
        if count:
            parts = path.relative_to(root / "tests").parts
            found[parts[0] if len(parts) > 1 else path.stem] += count
    return _largest_first(found)


def _asserted_texts(tree: ast.Module) -> Iterator[list[str]]:
    """The literal texts of each assert and of each match=."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield _texts(node.test)
        elif isinstance(node, ast.Call) and _last_name(node.func) in ("raises", "warns"):
            yield [text for key in node.keywords if key.arg == "match" for text in _texts(key.value)]


def _texts(node: ast.AST) -> list[str]:
    return [n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


def _is_prose(text: str) -> bool:
    return len(re.findall(r"(?<![\w.\\])[A-Za-z]{2,}(?![\w(])", text)) >= PROSE and " " in text.strip()


def count(root: Path) -> Counts:
    """All figures of the checkout at `root`."""
    package = modules(root)
    every = [lines_of(module) for module in package.values()]
    single = one_importer(package)
    outside = imported_outside(root, package)
    return Counts(
        files=len(package),
        lines=Lines(*(sum(getattr(one, name) for one in every) for name in Lines.__dataclass_fields__)),
        small_files=sum(len(module.text.splitlines()) <= SMALL for module in package.values()),
        one_importer=tuple(f"{name} <- {by}" for name, by in single),
        one_importer_same_folder=tuple(
            name for name, by in single if package[name].path.parent == package[by].path.parent
        ),
        one_importer_untested=tuple(name for name, _ in single if name not in outside),
        protocols=tuple(protocols(package)),
        array_definitions=array_definitions(package),
        circles=circles(imports(package)),
        circles_at_module_level=circles(imports(package, lazy=False)),
        thesis=by_package(package, "thesis"),
        any_by_package=uses_of_any(package),
        prose=prose(root),
    )


def table(counts: Counts) -> Iterator[str]:
    """Lines of the table: the sums, then the figures of each package."""
    lines = counts.lines
    total = lines.code + lines.docstrings + lines.comments + lines.blank
    yield f"{counts.files:6d} Python files in the package"
    yield (
        f"{total:6d} lines: {lines.code} code, {lines.docstrings} docstrings, "
        f"{lines.comments} comments, {lines.blank} blank"
    )
    yield f"{counts.small_files:6d} files of {SMALL} lines or fewer"
    same = len(counts.one_importer_same_folder)
    untested = len(counts.one_importer_untested)
    yield f"{len(counts.one_importer):6d} files with exactly one importer: {same} beside it, {untested} untested"
    yield f"{len(counts.protocols):6d} Protocol classes"
    yield f"{counts.array_definitions:6d} definitions of a type of arrays (Array = NDArray[...])"
    yield f"{len(counts.circles):6d} import circles, {len(counts.circles_at_module_level)} of them at module level"
    yield from (f"         {' - '.join(circle)}" for circle in counts.circles)
    others = {name: files for name, files in counts.thesis.items() if name != "thesis"}
    yield f"{sum(others.values()):6d} files outside thesis that name it: {_listed(others)}"
    yield f"{sum(counts.any_by_package.values()):6d} times Any: {_listed(counts.any_by_package)}"
    yield f"{sum(counts.prose.values()):6d} asserts on prose: {_listed(counts.prose)}"


def _listed(figures: dict[str, int]) -> str:
    return ", ".join(f"{name} {figure}" for name, figure in figures.items()) or "none"


def main() -> None:
    """Print the counts of a checkout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--package", type=Path, default=ROOT, help="a checkout; its own as a default")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--list", action="store_true", help="name the files with one importer, and the Protocols"
    )
    arguments = parser.parse_args()
    counts = count(arguments.package.resolve())
    if arguments.json:
        print(json.dumps(asdict(counts), indent=2))
        return
    print(*table(counts), sep="\n")
    if arguments.list:
        print("\nOne importer:", *counts.one_importer, "\nProtocols:", *counts.protocols, sep="\n  ")


if __name__ == "__main__":
    main()
