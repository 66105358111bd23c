"""Run a fieldmap command that takes --scheduler with the jobs of a SLURM cluster: docs/cluster.md.

    python scripts/slurm.py --jobs 8 --cores 4 --memory 16GB [--walltime 04:00:00] [--queue NAME] [--account NAME]
                            [--print | --try] COMMAND ...
    python scripts/slurm.py --array 20 --cores 4 --memory 16GB ... map RECIPE --over STUDY ...

COMMAND is a command of `fieldmap`: map RECIPE, study FILE, optimise FILE or fit FILE, with its options. Run this script
on a node that may submit jobs and compute a little: this process prepares the work, writes the results, and for a map
of saturating iron assembles the iron. Every job starts one worker per core. --print shows the job's script and submits
nothing; --try starts the jobs on this machine, without SLURM.
--array N makes many maps by an array job of N tasks, without a scheduler: each task makes its part of the maps with all
cores of its job, and a last job writes the index.
Needs   pip install "fieldmap[cluster]"   on every node.
"""

import argparse
import shlex
import subprocess
import sys

from dask_jobqueue import JobQueueCluster, SLURMCluster
from dask_jobqueue.local import LocalCluster

from fieldmap.cli import main as fieldmap


def cluster_of(chosen: argparse.Namespace) -> JobQueueCluster:
    """The cluster object, before any job has started."""
    # One process per core, because pieces of work in one process would run one after the other.
    job = {"cores": chosen.cores, "processes": chosen.cores, "memory": chosen.memory, "job_name": "fieldmap"}
    without_page = {"dashboard": False, "dashboard_address": ":0"}
    if chosen.try_here:
        return LocalCluster(**job, scheduler_options=without_page)
    # Workers stop before the cluster kills them; unfinished pieces of work are done again.
    lifetime = ["--lifetime", f"{minutes(chosen.walltime) - 5}m", "--lifetime-stagger", "3m"]
    return SLURMCluster(
        **job,
        walltime=chosen.walltime,
        queue=chosen.queue,
        account=chosen.account,
        worker_extra_args=lifetime,
        scheduler_options=without_page,
    )


def array_scripts(chosen: argparse.Namespace) -> tuple[str, str]:
    """Scripts of the array job, and of the job that writes the index."""
    asked = {
        "job-name": "fieldmap",
        "ntasks": 1,
        "cpus-per-task": chosen.cores,
        "mem": chosen.memory.removesuffix("B"),
        "time": chosen.walltime,
        "partition": chosen.queue,
        "account": chosen.account,
    }
    head = ["#!/bin/sh", *(f"#SBATCH --{key}={value}" for key, value in asked.items() if value is not None)]
    command = shlex.join([sys.executable, "-m", "fieldmap", *chosen.command])
    part = f"{command} --part $SLURM_ARRAY_TASK_ID/{chosen.array}"
    several = [*head, f"#SBATCH --array=1-{chosen.array}", part, ""]
    return "\n".join(several), "\n".join([*head, command, ""])


def submit_array(scripts: tuple[str, str]) -> None:
    """Submit the array job, and the job for the index, which starts when all tasks have ended."""
    after: list[str] = []
    for script in scripts:
        done = subprocess.run(
            ["sbatch", "--parsable", *after], input=script, stdout=subprocess.PIPE, text=True, check=True
        )
        number = done.stdout.strip().split(";")[0]
        print(number)
        after = [f"--dependency=afterany:{number}"]


def minutes(walltime: str) -> int:
    """Minutes of a time hours:minutes:seconds."""
    hours, whole, _ = (int(part) for part in walltime.split(":"))
    return 60 * hours + whole


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what follows fieldmap: map division")
    parser.add_argument("--jobs", type=int, default=4, help="how many jobs")
    parser.add_argument("--array", type=int, metavar="N", help="tasks of an array job, for map --over")
    parser.add_argument("--cores", type=int, default=4, help="cores of a job, each with a worker")
    parser.add_argument("--memory", default="16GB", help="of a job, for all of its workers")
    parser.add_argument("--walltime", default="04:00:00", help="of a job, hours:minutes:seconds")
    parser.add_argument("--queue", help="partition")
    parser.add_argument("--account", help="whom the time is charged to")
    parser.add_argument("--print", action="store_true", help="print the job's script and stop")
    parser.add_argument("--try", action="store_true", dest="try_here", help="jobs on this machine")
    return parser.parse_args()


def main() -> int:
    """Submit the jobs and run the command with their scheduler. Returns the exit code of the command."""
    chosen = arguments()
    if chosen.array is not None:
        scripts = array_scripts(chosen)
        print("\n".join(scripts)) if chosen.print else submit_array(scripts)
        return 0
    with cluster_of(chosen) as cluster:
        if chosen.print:
            print(cluster.job_script())
            return 0
        # A constant number of jobs; adapt() replaces jobs that have reached their walltime.
        cluster.adapt(minimum_jobs=chosen.jobs, maximum_jobs=chosen.jobs)
        return fieldmap([*chosen.command, "--scheduler", cluster.scheduler_address])


if __name__ == "__main__":
    sys.exit(main())
