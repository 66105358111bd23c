"""Libraries that only some functions need, and that `pip install ".[EXTRA]"` in the checkout brings."""

import importlib
from types import ModuleType

from fieldmap.errors import FieldmapError, Problem


def require(module: str, extra: str, where: str, otherwise: str = "") -> ModuleType:
    """The module. Raises FieldmapError for `where` if it cannot be imported, with the command that installs it and what
    can be done `otherwise`.

    >>> require("math", "none", "example").pi
    3.141592653589793
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        command = f'install it, in the checkout: pip install ".[{extra}]"'
        remedy = f"{command}, or {otherwise}" if otherwise else command
        raise FieldmapError(Problem(where, f"{module} must be installed", str(error), remedy)) from None
