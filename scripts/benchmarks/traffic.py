"""Traffic through client and scheduler when many pieces of work share an object: bytes, pickles, seconds.

Two processes of this machine do the work. Client and scheduler are this process, and its sockets are counted, so bytes
from the client to the scheduler count twice. Each way has at most 16 unfinished pieces:

- in each task: the object is an argument of every piece, as in a plain `client.submit`.
- scattered: `client.scatter(broadcast=True)`, then a future instead of the object.
- fieldmap: `fieldmap.parallel.Workers.map`, which submits the object once; dask's workers pass it on, also to workers
  that join later.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from distributed import Client, as_completed
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from tornado.iostream import IOStream

from fieldmap.parallel import Common, Workers

WORKERS, UNDER_WAY = 2, 16


class Shared:
    """An object of some size that counts how often this process pickles it."""

    pickled = 0

    def __init__(self, size: int) -> None:
        self.data: NDArray[np.float64] = np.random.default_rng(1).random(size // 8)

    def __getstate__(self) -> dict[str, Any]:
        Shared.pickled += 1
        return self.__dict__


def piece(shared: Shared, item: int) -> float:
    """A piece of work that takes hardly any time."""
    return float(shared.data[item % len(shared.data)])


@contextmanager
def counted() -> Iterator[list[int]]:
    """Count the bytes that this process reads from its sockets and writes to them in the block."""
    read, write, found = IOStream.read_from_fd, IOStream.write_to_fd, [0]

    def reads(stream: IOStream, buffer: Any) -> int | None:
        count = read(stream, buffer)
        found[0] += count or 0
        return count

    def writes(stream: IOStream, data: memoryview) -> int:
        count = write(stream, data)
        found[0] += count
        return count

    IOStream.read_from_fd, IOStream.write_to_fd = reads, writes
    try:
        yield found
    finally:
        IOStream.read_from_fd, IOStream.write_to_fd = read, write


def by_client(client: Client, argument: Any, pieces: int) -> list[float]:
    """Submit all pieces with this argument, at most `UNDER_WAY` at a time."""
    waiting, found = iter(range(pieces)), []
    first = [client.submit(piece, argument, k, pure=False) for k in itertools.islice(waiting, UNDER_WAY)]
    done = as_completed(first, loop=client.loop)
    for future in done:
        found.append(future.result())
        for k in itertools.islice(waiting, 1):
            done.add(client.submit(piece, argument, k, pure=False))
    return found


def ways(workers: Workers, shared: Shared, pieces: int) -> dict[str, Callable[[], list[float]]]:
    """Each way to do the work."""
    client = workers._pool._client
    return {
        "in each task": lambda: by_client(client, shared, pieces),
        "scattered": lambda: by_client(client, client.scatter(shared, broadcast=True, hash=False), pieces),
        "fieldmap": lambda: workers.results(piece, range(pieces), Common.of(shared)),
    }


def measure(quick: bool) -> dict[str, Any]:
    """Rows for 1 000 and 10 000 pieces that share 1 MB."""
    size, counts = (200_000, (20, 40)) if quick else (1_000_000, (1_000, 10_000))
    rows, shared = [], Shared(size)
    with Workers(WORKERS) as workers:
        workers.results(abs, range(UNDER_WAY))
        for pieces in counts:
            wanted = sorted(piece(shared, k) for k in range(pieces))
            for name, work in ways(workers, shared, pieces).items():
                Shared.pickled, begin = 0, time.perf_counter()
                with counted() as passed:
                    found = work()
                assert sorted(found) == wanted
                seconds = time.perf_counter() - begin
                rows.append(
                    {
                        "pieces": pieces,
                        "way": name,
                        "bytes": passed[0],
                        "pickles": Shared.pickled,
                        "seconds": seconds,
                    }
                )
    return {"size": size, "workers": WORKERS, "rows": rows}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(
        caption=f"pieces that share {result['size'] / 1e6:g} MB, {result['workers']} workers; bytes: read and written "
        "by client and scheduler; share: of the bytes with the object in each task"
    )
    table.add_column("pieces", justify="right")
    table.add_column("way")
    for heading in ("bytes", "share", "pickles", "seconds"):
        table.add_column(heading, justify="right")
    first = {row["pieces"]: row["bytes"] for row in result["rows"] if row["way"] == "in each task"}
    for row in result["rows"]:
        share = row["bytes"] / first[row["pieces"]]
        numbers = (f"{row['bytes']:.2e}", f"{share:.4f}", f"{row['pickles']}", f"{row['seconds']:.1f}")
        table.add_row(f"{row['pieces']}", row["way"], *numbers)
    console.print(table)
