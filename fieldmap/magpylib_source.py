"""Any field at fixed currents as a magpylib source: the field itself, evaluated where magpylib asks for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import getattr_static
from typing import Any, Protocol

import numpy as np

from fieldmap.errors import InputError
from fieldmap.extras import needs
from fieldmap.typing import Array

with needs("make", "models of magpylib"):
    import magpylib


class AtCurrents(Protocol):
    """Required members of a field at fixed currents, see `fieldmap.field.FieldAtCurrents`."""

    @property
    def currents(self) -> Array:
        """Currents (n_coils,), A."""

    def field(self, points: Array) -> Array:
        """B (n, 3), T, at points (n, 3), m."""


Outlines = Callable[[], Sequence[Any]]
"""Returns the outlines for a drawing, `fieldmap.device.drawing.Outline`."""

_COLOURS = {"iron": "#9aa5b1", "coil": "#d08b5b", "magnet": "#7a9e7e", "map": "#4c72b0"}


class FieldSource(magpylib.misc.CustomSource):
    """A field as a magpylib source. getB, getH, getJ, getM and getFT take it, alone or with other sources; `show` draws
    its iron, windings or box.

    field: at fixed currents. domain: lower and upper corner (3,), m, of the box in which it holds, NaN outside; None
    for all space. outlines: called by the first `show`. position, orientation, style: as for every magpylib object,
    paths included; the field moves and turns with the source. B is `field.field`, to rounding;
    J is `field.polarisation`, zero where the field has none; H = (B - J) / mu0. Copies of a source share its field.

    >>> import fieldmap as fm
    >>> coils = fm.sources.CoilSet(fm.read_device("loop_and_sphere").coils)
    >>> source = coils.as_magpylib(1.0)
    >>> points = [[0.0, 0.0, 0.0], [0.0, 0.01, 0.02]]
    >>> bool(np.allclose(source.getB(points), coils.field(points, 1.0), rtol=1e-14))
    True
    """

    def __init__(
        self,
        field: AtCurrents,
        domain: tuple[Array, Array] | None = None,
        outlines: Outlines = tuple,
        position: Any = (0.0, 0.0, 0.0),
        orientation: Any = None,
        style: Any = None,
        **style_keys: Any,
    ) -> None:
        self._shared = _Shared(field, domain, outlines)
        self._drawn = False
        super().__init__(position=position, orientation=orientation, style=style, **style_keys)

    @property
    def field(self) -> AtCurrents:
        """The field at its currents, in the frame of the source."""
        return self._shared.field

    @property
    def currents(self) -> Array:
        """Currents (n_coils,), A. To change them, make another source."""
        return self._shared.field.currents

    @property  # type: ignore[misc]
    def field_func(self) -> Callable[[str, Array], Array]:
        """The function that magpylib calls. There is no setter, in which magpylib would test it at its own points."""
        return self._shared.evaluate

    @property
    def style(self) -> Any:
        """Style of the drawing, as for every magpylib object, with the outlines as its 3D model."""
        style = super().style
        if not self._drawn:
            self._drawn = True
            traces = self._shared.traces()
            for trace in traces:
                style.model3d.add_trace(**trace)
            if traces:
                style.model3d.showdefault = False
        return style

    @style.setter
    def style(self, style: Any) -> None:
        self._drawn = False
        getattr_static(magpylib.misc.CustomSource, "style").__set__(self, style)


class _Shared:
    """Data that copies of a source share, because solutions and maps are large and never change."""

    def __init__(self, field: AtCurrents, domain: tuple[Array, Array] | None, outlines: Outlines) -> None:
        self.field, self.domain, self.outlines = field, domain, outlines

    def __deepcopy__(self, memo: dict[int, object]) -> _Shared:
        return self

    def evaluate(self, field: str, observers: Array) -> Array:
        """B and J in T, H and M in A/m (n, 3) at observers (n, 3) in m, frame of the source."""
        points = np.ascontiguousarray(observers, dtype=float)
        if self.domain is None:
            return self._inside(field, points)
        held = ((points >= self.domain[0]) & (points <= self.domain[1])).all(axis=1)
        values = np.full(points.shape, np.nan)
        if held.any():
            values[held] = self._inside(field, np.ascontiguousarray(points[held]))
        return values

    def _inside(self, field: str, points: Array) -> Array:
        if field == "B":
            return np.asarray(self.field.field(points), dtype=float)
        polarisation = self._polarisation(points)
        if field == "H":
            return np.asarray((self.field.field(points) - polarisation) / magpylib.mu_0, dtype=float)
        return polarisation if field == "J" else polarisation / magpylib.mu_0

    def _polarisation(self, points: Array) -> Array:
        own = getattr(self.field, "polarisation", None)
        return np.zeros(points.shape) if own is None else np.asarray(own(points), dtype=float)

    def traces(self) -> list[dict[str, Any]]:
        """The outlines as magpylib's generic traces."""
        traces = []
        for outline in self.outlines():
            x, y, z = outline.points.T
            i, j, k = outline.triangles.T
            look = {"color": _COLOURS[outline.kind], "opacity": 0.15 if outline.kind == "map" else 1.0}
            kwargs = {"x": x, "y": y, "z": z, "i": i, "j": j, "k": k, "name": outline.name, **look}
            traces.append({"backend": "generic", "constructor": "Mesh3d", "kwargs": kwargs})
        return traces


def source_of_field(
    field: AtCurrents, domain: tuple[Array, Array] | None, outlines: Outlines, **options: Any
) -> FieldSource:
    """A `FieldSource`; options are its position, orientation and style. Raises InputError for what magpylib refuses."""
    try:
        return FieldSource(field, domain, outlines, **options)
    except (TypeError, ValueError, AttributeError) as error:
        remedy = "see help(magpylib.misc.CustomSource)"
        must_hold = "position, orientation and style must be as of a magpylib CustomSource"
        raise InputError.of("as_magpylib", must_hold, str(error), remedy) from None
