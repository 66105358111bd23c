"""Makes this process behave as if only some of the package's dependencies were installed.

`only("cli")`, called before other imports, leaves the standard library, fieldmap, the dependencies in pyproject.toml,
the named extras, and the dependencies of all these. Any other import fails as if the distribution were not installed.
"""

import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, requires
from importlib.metadata import packages_distributions as modules_of_distributions
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def name_of(requirement: str) -> str:
    """The normalised name of the distribution in a requirement."""
    return re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", requirement)[0]).lower()


def distributions(*extras: str) -> set[str]:
    """The distributions of an installation with these extras, including indirect dependencies."""
    waiting = [*PROJECT["dependencies"], f"fieldmap[{','.join(extras)}]"]
    found: set[str] = set()
    while waiting:
        requirement = waiting.pop()
        name = name_of(requirement)
        if name == "fieldmap":
            asked = re.findall(r"[\w-]+", requirement)[1:]
            waiting += [one for extra in asked for one in PROJECT["optional-dependencies"][extra]]
        if name in found | {"fieldmap"}:
            continue
        found.add(name)
        try:
            waiting += [one for one in requires(name) or () if "extra ==" not in one]
        except PackageNotFoundError:
            continue  # for another system, or another Python
    return found


class Without:
    """A finder for modules that does not find some of them."""

    def __init__(self, finder: Any, hidden: set[str]) -> None:
        self.finder, self.hidden = finder, hidden

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        """The finder's result, or None for a hidden module."""
        return None if name.partition(".")[0] in self.hidden else self.finder.find_spec(name, path, target)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.finder, name)


def only(*extras: str) -> None:
    """Hide all other distributions from now on."""
    left = distributions(*extras)
    owners = modules_of_distributions().items()
    hidden = {module for module, names in owners if not {name_of(name) for name in names} & left}
    sys.meta_path[:] = [Without(finder, hidden - {"fieldmap", "tests"}) for finder in sys.meta_path]
