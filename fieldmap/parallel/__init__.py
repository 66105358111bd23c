"""Independent pieces of work, done in this process, in several of this machine, or on a cluster.

Depends on: errors, arguments, threads, threadpoolctl; dask.distributed for more than one process.
"""

from fieldmap.parallel.work import (
    Common,
    Outcome,
    SchedulerLost,
    WorkerDied,
    in_threads,
    results_of,
    same_arithmetic,
    threads_of_kernels,
    threads_of_linear_algebra,
)
from fieldmap.parallel.workers import Workers

__all__ = [
    "Common",
    "Outcome",
    "SchedulerLost",
    "WorkerDied",
    "Workers",
    "in_threads",
    "results_of",
    "same_arithmetic",
    "threads_of_kernels",
    "threads_of_linear_algebra",
]
