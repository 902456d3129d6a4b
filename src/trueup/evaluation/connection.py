# SPDX-License-Identifier: Apache-2.0
"""A cluster by its address: one that runs, one on this machine, or one of Slurm's or HTCondor's jobs."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trueup.cores import cores
from trueup.errors import EvaluationError, MissingExtraError

if TYPE_CHECKING:
    from distributed import Client

FORMS = "tcp://HOST:PORT (a dask scheduler), local or local:N (N workers on this machine), slurm:N, htcondor:N (N jobs)"
ANSWER = 10.0
"""Seconds in which a scheduler must answer, and in which what a worker has finished must be here."""
_QUEUES = {"slurm": ("SLURMCluster", "sbatch"), "htcondor": ("HTCondorCluster", "condor_submit")}


@dataclass
class Connection:
    """A client of a cluster."""

    address: str
    client: Client
    cluster: Any = None
    """What was started for it; None where it ran before."""
    expected: int = 0
    """Threads that were asked for; 0 where nobody knows."""
    jobs: int = 0
    """Jobs that were asked of a queue, which lets workers come when it will; 0 where there is none."""

    def replenish(self) -> None:
        """Starts again what was lost for good of what was started for it."""
        if self.cluster is not None:
            self.cluster.scale(**({"jobs": self.jobs} if self.jobs else {"n": self.expected}))

    def close(self) -> None:
        """Lets the cluster go; ends what was started for it."""
        with contextlib.suppress(TimeoutError, OSError):  # whoever does not let go by then is gone
            self.client.close(timeout=2)
            if self.cluster is not None:
                self.cluster.close(timeout=10)


def check(address: str) -> None:
    """Raises EvaluationError for what is no address (see FORMS), MissingExtraError without what a cluster needs."""
    if not re.fullmatch(r"(tcp|tls|ucx|wss?)://.+|local(:[1-9]\d*)?|(slurm|htcondor):[1-9]\d*", address):
        raise EvaluationError(f"'{address}' is no address of a cluster; it may be {FORMS}")
    for package in ("distributed", "dask_jobqueue") if address.startswith(tuple(_QUEUES)) else ("distributed",):
        if importlib.util.find_spec(package) is None:
            raise MissingExtraError(f"a cluster ('{address}')", package.replace("_", "-"), "cluster")
    kind = address.partition(":")[0]
    if kind in _QUEUES and shutil.which(_QUEUES[kind][1]) is None:
        raise EvaluationError(f"'{address}' needs the command {_QUEUES[kind][1]}, which this machine has not")


def connected(address: str, say: Callable[[str], None]) -> Connection:
    """A client of the cluster at an address. Raises EvaluationError, MissingExtraError."""
    check(address)
    from dask import config
    from distributed import Client

    config.set({"distributed.comm.timeouts.connect": f"{ANSWER:g}s", "distributed.comm.retry.count": 0})
    for name in ("", ".client", ".core", ".nanny", ".scheduler"):
        logging.getLogger(f"distributed{name}").setLevel(logging.CRITICAL)  # what matters is said in words of our own
    kind, _, count = address.partition(":")
    try:
        if kind == "local":
            return _local(address, int(count or cores()))
        if kind in _QUEUES:
            return _queued(address, kind, int(count), say)
        return Connection(address, Client(address, timeout=ANSWER, set_as_default=False))
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise EvaluationError(
            f"no cluster at '{address}': {' '.join(str(error).split()) or type(error).__name__}{_advice(kind)}"
        ) from error


def _local(address: str, workers: int) -> Connection:
    """Workers of one thread each on this machine, which nobody else can reach."""
    from distributed import Client, LocalCluster

    cluster = LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0", memory_limit=0, silence_logs=logging.CRITICAL,
        preload=["trueup.evaluation.worker"],
    )  # fmt: skip
    return Connection(address, Client(cluster, set_as_default=False), cluster, workers)


def _queued(address: str, kind: str, jobs: int, say: Callable[[str], None]) -> Connection:
    """Jobs of a queue, as dask-jobqueue's own configuration (jobqueue.yaml) describes them; of one core where it does not."""
    import dask_jobqueue
    from dask import config
    from distributed import Client

    given = {k: v for k, v in {"cores": 1, "memory": "2GB"}.items() if config.get(f"jobqueue.{kind}.{k}") is None}
    if kind == "htcondor" and config.get("jobqueue.htcondor.disk") is None:
        given["disk"] = "1GB"
    made, refused = getattr(dask_jobqueue, _QUEUES[kind][0]), list[str]()

    class Heard(made.job_cls):
        async def _submit_job(self, script_filename: str) -> Any:
            try:
                return await super()._submit_job(script_filename)
            except RuntimeError as error:  # nobody else would hear of it
                refused.append(str(error))
                raise

    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    cluster = made(**given, silence_logs=logging.CRITICAL, job_cls=Heard)
    cluster.scale(jobs=jobs)
    cluster.sync(cluster._correct_state)
    if refused:
        with contextlib.suppress(AssertionError, RuntimeError):  # jobs that never were cannot be closed
            cluster.close(timeout=5)
        raise RuntimeError(refused[0])
    threads = jobs * int(given.get("cores") or config.get(f"jobqueue.{kind}.cores"))
    say(f"{jobs} jobs are asked of {kind}; their scheduler is at {cluster.scheduler_address}")
    return Connection(address, Client(cluster, set_as_default=False), cluster, threads, jobs)


def _advice(kind: str) -> str:
    if kind == "local":
        return '. In a script of your own, what starts a cluster stands under `if __name__ == "__main__":`'
    if kind in _QUEUES:
        return ". What a job is asked for with stands in ~/.config/dask/jobqueue.yaml"
    return ". Does its scheduler run (`dask scheduler`), and can it be reached from here?"
