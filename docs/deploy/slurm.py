"""A farm on Slurm by dask-jobqueue: this program holds the scheduler, Slurm starts the workers.

python docs/deploy/slurm.py --jobs 16 --tls certs [--queue gpu] [--walltime 04:00:00] [--cpus 32]

With --script it prints what it would give to sbatch, and ends.
"""

from __future__ import annotations

import argparse
import shlex
import signal
import threading
from pathlib import Path

from dask_jobqueue import SLURMCluster
from penumbra_service.engine.dask.addresses import DEFAULT_PORT, security
from penumbra_service.engine.dask.config import environment

QUIET = [f"export {name}={shlex.quote(value)}" for name, value in environment().items()]
"""Dask's habits of looking at itself, turned down as `penumbra worker` does."""


def main() -> None:
    parser = argparse.ArgumentParser(description="Keep up a farm of Slurm jobs until Ctrl-C.")
    parser.add_argument("--jobs", type=int, required=True, help="workers, one a node")
    parser.add_argument("--tls", type=Path, required=True, help="folder that `penumbra certs` made")
    parser.add_argument("--queue", help="Slurm's partition")
    parser.add_argument("--walltime", default="04:00:00")
    parser.add_argument("--cpus", type=int, default=32, help="cores of a node")
    parser.add_argument("--memory", default="32GB", help="of a node")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="of the scheduler")
    parser.add_argument("--script", action="store_true", help="print the job that sbatch would get, and end")
    options = parser.parse_args()
    cluster = SLURMCluster(
        queue=options.queue,
        walltime=options.walltime,
        cores=1,  # of Dask, which runs no task; the device's threads are PoCL's or the GPU's
        processes=1,
        job_cpu=options.cpus,
        memory=options.memory,
        nanny=False,
        protocol="tls",
        security=security(options.tls.absolute(), "scheduler", "worker", "client"),
        scheduler_options={"port": options.port, "dashboard_address": "127.0.0.1:8787"},
        job_script_prologue=[f"export POCL_MAX_PTHREAD_COUNT={options.cpus}", *QUIET],
        worker_extra_args=[
            "--preload",
            "penumbra_service.engine.dask.preload",
            "--dashboard-address",
            "127.0.0.1:0",
        ],
    )
    if options.script:
        print(cluster.job_script())
        cluster.close()
        return
    cluster.scale(jobs=options.jobs)
    print(f"penumbra serve --scheduler {cluster.scheduler_address} --tls {options.tls}", flush=True)
    leave = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: leave.set())
    leave.wait()
    cluster.close()


if __name__ == "__main__":
    main()
