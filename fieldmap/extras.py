"""Optional libraries, which `pip install "fieldmap[EXTRA]"` installs.

pip takes the extras of the installed fieldmap, from a checkout or a wheel, and does not look for another version.
"""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from fieldmap.errors import MissingExtraError


def require(module: str, extra: str, where: str, otherwise: str = "") -> ModuleType:
    """Import a module and return it. If that fails, MissingExtraError names `where`, the command that installs the
    module, and the alternative `otherwise`.

    >>> require("math", "none", "example").pi
    3.141592653589793
    """
    with needs(extra, where, otherwise, module):
        return importlib.import_module(module)


@contextmanager
def needs(extra: str, where: str, otherwise: str = "", module: str = "") -> Iterator[None]:
    """Context in which a failed import raises the MissingExtraError of `require`. module: its name in the message; by
    default the module that was not found.

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
