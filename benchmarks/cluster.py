# SPDX-License-Identifier: Apache-2.0
"""Generations of walks on workers of a cluster on this machine, beside one process with as many threads.

Then the same while a worker is killed every few seconds: the numbers must be the same to the last bit. Last, what many
workers would do, played from the times and sizes measured here (`cluster_plan`).
"""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
from collections.abc import Callable

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from cluster_plan import Measured, table
from numpy.typing import NDArray
from results import result

from trueup.evaluation.cluster import Cluster
from trueup.evaluation.evaluator import Evaluator, Here, Outcome, Work
from trueup.evaluation.worker import packed
from trueup.studies.walk.scenes import simulator, task
from trueup.tasks.task import judgement
from trueup.tasks.walking import WalkFront

Array = NDArray[np.float64]

SPREAD = 0.03  # of the box, as in benchmarks/walk.py


def candidates(walk: WalkFront, number: int) -> Array:
    """Around the start walk."""
    space, rng = walk.parameters, np.random.default_rng(0)
    start = space.to_unit(space.nominal)
    return space.from_unit(np.clip(start + SPREAD * rng.standard_normal((number, len(start))), 0.0, 1.0))


def timed(do: Callable[[], Outcome]) -> tuple[float, Array]:
    """Wall seconds, and the scores."""
    begun = time.perf_counter()
    done = do()
    return time.perf_counter() - begun, done.values[:, 0]


class Killer:
    """Kills the workers of a local cluster, one after the other, every so many seconds while it is entered."""

    def __init__(self, cluster: Cluster, every: float) -> None:
        self.cluster, self.every, self.killed = cluster, every, 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._kill, daemon=True)

    def __enter__(self) -> Killer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _kill(self) -> None:
        while not self._over.wait(self.every):
            roster = self.cluster._roster
            for nanny in list(roster.connection.cluster.workers.values()):
                if (
                    nanny.worker_address in list(roster.fit)[:1] and nanny.process is not None
                ):  # who has lived the longest
                    os.kill(nanny.process.pid, signal.SIGKILL)
                    self.killed += 1


def empty(rows: Array, first: int) -> Outcome:
    """Nothing, for what a chunk costs beside its work."""
    return Outcome(np.zeros((len(rows), 1)))


def costs(cluster: Evaluator, work: Work, rows: Array) -> Measured:
    """What a generation costs, on a cluster of one worker that is warm."""
    sizes, spent = np.array([len(rows) // 10, len(rows) // 4, len(rows) // 2] * 2), []
    for n in sizes:
        spent.append(timed(lambda n=n: cluster.evaluate(work, rows[:n]))[0])
    each, fixed = np.polyfit(sizes, spent, 1)
    off = np.std(np.log(np.array(spent) / (fixed + each * sizes)))
    cpu, begun, many = time.process_time(), time.perf_counter(), 50
    for _ in range(many):
        cluster.evaluate(Work(empty, ()), rows[:1])
    wall, cpu = (time.perf_counter() - begun) / many, (time.process_time() - cpu) / many
    model = sum(len(packed(part)[1]) for part in (work.function, *work.parts))
    return Measured(max(fixed - wall, 0.0), each, float(off), cpu, max(wall - cpu, 0.0), model, rows[0].nbytes + 40.0)


def beside(work: Work, rows: Array, every: float) -> tuple[float, bool]:
    """How many times as fast two workers are as one process with two threads, and whether scores are the same, with a
    worker killed every so many seconds too.
    """
    here, alone, there, same = Here(), [], [], []
    begun = time.perf_counter()
    with Cluster("local:2") as cluster:
        print(f"two workers are there after {time.perf_counter() - begun:.1f} s")
        right = here.evaluate(work, rows[:4]).values  # compiles
        cluster.evaluate(work, rows[:4])
        for _ in range(2):
            seconds, right = timed(lambda: here.evaluate(work, rows))
            alone.append(seconds)
            seconds, scores = timed(lambda: cluster.evaluate(work, rows))
            there.append(seconds)
            same.append(np.array_equal(scores, right, equal_nan=True))
        print(f"one process, two threads   {min(alone):7.1f} s a generation ({', '.join(f'{s:.1f}' for s in alone)})")
        print(
            f"two workers of one core    {min(there):7.1f} s ({', '.join(f'{s:.1f}' for s in there)}); {_words(same)}"
        )
        spent = 0.0
        with Killer(cluster, every) as killer:
            for _ in range(3):
                seconds, scores = timed(lambda: cluster.evaluate(work, rows))
                spent, same = spent + seconds, [*same, np.array_equal(scores, right, equal_nan=True)]
        print(
            f"a worker killed every {every:g} s: {killer.killed} in three generations of {spent / 3:.1f} s; {_words(same)}"
        )
    return min(alone) / min(there), all(same)


def _words(same: list[bool]) -> str:
    return "the same scores, bit by bit" if all(same) else f"OTHER SCORES: {same}"


def several(work: Work, rows: Array, workers: int) -> Measured:
    """What a generation takes on so many workers, and what it costs."""
    with Cluster(f"local:{workers}") as cluster:
        cluster.evaluate(work, rows[:4])
        measured = costs(cluster, work, rows) if workers == 1 else Measured(*[0.0] * 7)
        seconds, _ = timed(lambda: cluster.evaluate(work, rows))
    more = " (more than there are cores)" if workers > len(os.sched_getaffinity(0)) else ""
    print(f"{workers} worker{'s' if workers > 1 else ''} of one core{more}: {seconds:.1f} s a generation")
    return measured


def main() -> None:
    """Prints throughputs, what became of killed workers, and the plan."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="100 x 4 runs of 2 s; a worker killed every 10 s, not 20 s"
    )
    asked = parser.parse_args()
    number, runs, lasting, every = (100, 4, 2.0, 10.0) if asked.quick else (150, 7, 15.0, 20.0)
    walk, engine = task(WalkFront, runs=runs, seconds=lasting), simulator(threads=2)
    rows = np.hstack([np.tile(engine.parameters.nominal, (number, 1)), candidates(walk, number)])
    work = judgement(walk, engine)
    print(f"{number} candidates x {runs} runs of {lasting:g} s")
    faster, same = beside(work, rows, every)
    measured = several(work, rows, 1)
    if not asked.quick:
        several(work, rows, 4)
    print(
        f"a chunk costs {measured.fixed:.3g} s, and {measured.each:.3g} s a candidate, {100 * measured.spread:.0f} % more or "
        f"less; {1e3 * measured.send:.1f} ms of the client, {1e3 * measured.latency:.1f} ms of waiting; a worker is sent "
        f"{measured.model / 1e3:.0f} kB once"
    )
    for many in (number, 10 * number):
        print("\n".join(table(measured, many, (1, 2, 4, 10, 30, 100, 300, 1000), np.random.default_rng(0))))
    result("cluster_over_threads", faster, "", 0.9, peer="one process with two threads", at_most=False)
    result("cluster_same_scores", float(same), "", 1.0, peer="one process, no worker killed", at_most=False)


if __name__ == "__main__":
    main()
