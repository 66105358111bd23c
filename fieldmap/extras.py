"""Libraries that only some functions need, and that `pip install ".[EXTRA]"` in the checkout brings."""

import importlib
from types import ModuleType

from fieldmap.errors import FieldmapError, Problem


def require(module: str, extra: str, where: str) -> ModuleType:
    """The module. Raises FieldmapError for `where`, with the command that installs it, if it cannot be imported.

    >>> require("math", "none", "example").pi
    3.141592653589793
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        remedy = f'install it, in the checkout: pip install ".[{extra}]"'
        raise FieldmapError(Problem(where, f"{module} must be installed", str(error), remedy)) from None
