"""Libraries that only some functions need, and that `pip install "fieldmap[EXTRA]"` brings.

pip takes the extras of the fieldmap that is installed, from a checkout or a wheel, and looks for no other one.
"""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from fieldmap.errors import MissingExtraError


def require(module: str, extra: str, where: str, otherwise: str = "") -> ModuleType:
    """The module. Raises MissingExtraError for `where` if it cannot be imported, with the command that installs it and
    what can be done `otherwise`.

    >>> require("math", "none", "example").pi
    3.141592653589793
    """
    with needs(extra, where, otherwise, module):
        return importlib.import_module(module)


@contextmanager
def needs(extra: str, where: str, otherwise: str = "", module: str = "") -> Iterator[None]:
    """Turns an import inside it that fails into the MissingExtraError that `require` raises. module: the one to name;
    otherwise the one that was not found.

    >>> with needs("none", "example"):
    ...     import math
    """
    try:
        yield
    except MissingExtraError:
        raise
    except ImportError as error:
        missing = module or error.name or "a library"
        command = f'install it: pip install "fieldmap[{extra}]"'
        remedy = f"{command}, or {otherwise}" if otherwise else command
        raise MissingExtraError.of(where, f"{missing} must be installed", str(error), remedy) from None
