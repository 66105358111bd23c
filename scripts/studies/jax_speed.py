"""A million points in one call by JAX, by the compiled kernels and by plain numpy with the same formula, in turns.

    taskset -c 0 python scripts/studies/jax_speed.py maps/out/linear.h5

Times of field and gradient at one set of currents, s; numpy for kind="harmonic" only. docs/other_programs.md has them.
"""

import ast
import inspect
import sys
import time
from collections.abc import Callable

import jax
import numpy as np
from numpy.typing import NDArray

from fieldmap.core import block as map_block
from fieldmap.interop import jax_field
from fieldmap.interop.jax_field import SIZE, cell_field_and_gradient
from fieldmap.lookup import FieldMap, open_map, unit_block

POINTS, PIECE, ROUNDS = 1_000_000, 1024, 5


class _NewNames(ast.NodeTransformer):
    """a += b becomes a = a + b, so that numpy does not change arrays in place."""

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.Assign:
        assert isinstance(node.target, ast.Name)
        value = ast.BinOp(ast.Name(node.target.id, ast.Load()), node.op, node.value)
        return ast.Assign([node.target], value)


def formula_for_numpy() -> Callable[..., tuple[NDArray[np.float64], ...]]:
    """The kernel's formula as a numpy function of arrays."""
    source = inspect.getsource(cell_field_and_gradient)
    tree = ast.fix_missing_locations(_NewNames().visit(ast.parse(source)))
    tree.body[0].decorator_list = []
    names: dict[str, Callable[..., tuple[NDArray[np.float64], ...]]] = {}
    exec(compile(tree, "numpy", "exec"), names)
    return names["cell_field_and_gradient"]


def by_numpy(
    m: FieldMap, currents: NDArray[np.float64]
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """A numpy function from points (n, 3) to (n, 9), in pieces."""
    block, of_cell = unit_block(m.at(currents)), formula_for_numpy()
    c = block[map_block.HEADER :].reshape(-1, SIZE)
    lower, inverse, cells, local = (
        block[first : first + 3]
        for first in (map_block.LOWER, map_block.INVERSE, map_block.CELLS, map_block.LOCAL)
    )

    def evaluate(points: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.empty((len(points), 9))
        for a in range(0, len(points), PIECE):
            u = (points[a : a + PIECE] - lower) * inverse
            index = np.clip(u.astype(int), 0, cells.astype(int) - 1)
            cell = (index[:, 0] * int(cells[1]) + index[:, 1]) * int(cells[2]) + index[:, 2]
            x, y, z = ((u - index - 0.5) * local).T
            out[a : a + PIECE] = np.stack(of_cell(c[cell].T, x, y, z), axis=1)
        return out

    return evaluate


def seconds(call: Callable[[], object]) -> float:
    """Time of a call."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def main(path: str) -> None:
    """Print the times for a map."""
    jax.config.update("jax_enable_x64", True)
    for kind in ("harmonic", "global"):
        m = open_map(path, kind, threads=1)
        currents = np.ones(len(m.coil_names))
        points = m.lower + np.random.default_rng(0).random((POINTS, 3)) * (m.upper - m.lower)
        compiled, there = jax.jit(jax_field(m).field_and_gradient), jax.device_put(points)
        calls: dict[str, Callable[[], object]] = {
            "jax": lambda: jax.block_until_ready(compiled(there, currents)),  # noqa: B023
            "kernels": lambda: m.field_and_gradient(points, currents),  # noqa: B023
        }
        if kind == "harmonic":
            plain = by_numpy(m, currents)
            off = np.abs(plain(points[:2000])[:, :3] - m.field(points[:2000], currents)).max()
            assert off < 1e-12 * np.abs(m.field(points[:2000], currents)).max()
            calls["numpy"] = lambda: plain(points)  # noqa: B023
        for call in calls.values():
            call()
        times = {name: [] for name in calls}
        for _ in range(ROUNDS):
            for name, call in calls.items():
                times[name].append(seconds(call))
        found = ", ".join(f"{name} {min(t):.3f} to {max(t):.3f} s" for name, t in times.items())
        print(f"{kind}: {found}")


if __name__ == "__main__":
    main(sys.argv[1])
