"""Make a map with the jobs of a SLURM cluster: docs/cluster.md.

    python scripts/slurm_map.py RECIPE [-o FILE] --jobs 8 --cores 4 --memory 16GB [--walltime 04:00:00]
                                       [--queue NAME] [--account NAME] [--print | --try]

Run it on a node that may submit jobs and may compute a little itself: this process assembles the iron as well, chooses
states, and writes the file. Every job starts one worker per core. --print shows the job's script and submits nothing;
--try starts the jobs on this machine, without SLURM. Needs   pip install "fieldmap[cluster]"   on every node.
"""

import argparse

from dask_jobqueue import JobQueueCluster, SLURMCluster
from dask_jobqueue.local import LocalCluster

import fieldmap as fm
from fieldmap.progress import Progress


def cluster_of(chosen: argparse.Namespace) -> JobQueueCluster:
    """Jobs as the cluster will start them; none yet."""
    # One process per core: pieces of work in one process would take turns.
    job = {"cores": chosen.cores, "processes": chosen.cores, "memory": chosen.memory, "job_name": "fieldmap"}
    without_page = {"dashboard_address": None}
    if chosen.try_here:
        return LocalCluster(**job, scheduler_options=without_page)
    # Workers take their leave before the cluster kills them; what they had in hand is done again.
    lifetime = ["--lifetime", f"{minutes(chosen.walltime) - 5}m", "--lifetime-stagger", "3m"]
    return SLURMCluster(
        **job,
        walltime=chosen.walltime,
        queue=chosen.queue,
        account=chosen.account,
        worker_extra_args=lifetime,
        scheduler_options=without_page,
    )


def minutes(walltime: str) -> int:
    """Of hours:minutes:seconds."""
    hours, whole, _ = (int(part) for part in walltime.split(":"))
    return 60 * hours + whole


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recipe", help="recipe file, or the name of a shipped recipe")
    parser.add_argument("-o", "--output", help="map file; maps/out/RECIPE.h5 otherwise")
    parser.add_argument("--jobs", type=int, default=4, help="how many jobs")
    parser.add_argument("--cores", type=int, default=4, help="cores of a job, each with a worker")
    parser.add_argument("--memory", default="16GB", help="of a job, for all of its workers")
    parser.add_argument("--walltime", default="04:00:00", help="of a job, hours:minutes:seconds")
    parser.add_argument("--queue", help="partition")
    parser.add_argument("--account", help="whom the time is charged to")
    parser.add_argument("--print", action="store_true", help="print the job's script and stop")
    parser.add_argument("--try", action="store_true", dest="try_here", help="jobs on this machine")
    return parser.parse_args()


def main() -> None:
    """Submit, compute, write."""
    chosen = arguments()
    with cluster_of(chosen) as cluster:
        if chosen.print:
            print(cluster.job_script())
            return
        # As many as asked for; adapt() starts new jobs in the place of those whose time is up.
        cluster.adapt(minimum_jobs=chosen.jobs, maximum_jobs=chosen.jobs)
        with Progress("map") as progress:
            address = cluster.scheduler_address
            print(fm.generate(chosen.recipe, chosen.output, progress=progress, scheduler=address))


if __name__ == "__main__":
    main()
