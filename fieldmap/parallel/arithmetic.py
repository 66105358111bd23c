"""The same last bits whoever computes: linear algebra whose order of summation does not follow the number of cores."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def same_arithmetic() -> Iterator[None]:
    """Linear algebra in one thread: a BLAS divides its sums by the number of its threads, and so rounds otherwise.

    Our own kernels keep theirs: each of their threads has its own rows of the result, in whatever number. A state of
    the drive unit takes no longer for it (docs/cluster.md).
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
