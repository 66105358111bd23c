"""The mesher's CAD kernel, imported where it is first used: solutions and pictures are read and drawn without it."""

from typing import TYPE_CHECKING, Any

from fieldmap.extras import needs

if TYPE_CHECKING:
    from netgen import occ as occ


class _OnFirstUse:
    """`netgen.occ`; an attribute of it raises MissingExtraError where the mesher is not installed."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        with needs("make", "bodies and windings as solids"):
            from netgen import occ
        value = getattr(occ, name)
        # Kept: finding it again takes longer than many calls of the kernel.
        setattr(self, name, value)
        return value


if not TYPE_CHECKING:
    occ = _OnFirstUse()


def kernel_errors() -> tuple[type[Exception], ...]:
    """What is raised where a solid cannot be built: by the kernel, and ValueError by `shapes`."""
    return RuntimeError, occ.OCCException, ValueError
