# SPDX-License-Identifier: Apache-2.0
"""How many cores this process may use, and work shared among threads on them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import pairwise

THREADS = "TRUEUP_THREADS"
"""Environment variable that says how many threads simulations take, where it is not all cores of this process."""

Work = Callable[[], None]
"""What touches nothing but its own run's arrays, and lets go of Python's lock: another thread may do it."""

_POOL = 5e-4
"""s that making a pool of threads and waiting for it takes, measured on two cores (0.1 to 0.7 ms)."""


def cores() -> int:
    """As THREADS says, else all that the system lets this process use."""
    asked = os.environ.get(THREADS, "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def worth(spent: float, handover: float, most: int) -> int:
    """How many of `most` threads pay for work that takes one of them `spent` s, where handing it over takes `handover` s:
    at least twice that for each, or all wait for one another.
    """
    return max(1, min(most, int(spent / (2.0 * handover))))


def in_threads(work: Callable[[slice], None], count: int, threads: int, *, timed: bool = False) -> None:
    """Does `work` on rows 0 ... count - 1, cut into as many slices as threads; compiled loops let go of Python's lock.

    `timed`, for work that gives each row the same numbers in whatever slice: the first row is done alone, and tells how many
    threads pay for the others.
    """
    first, parts = 0, min(threads, count)
    if timed and parts > 1:
        begun = time.perf_counter()
        work(slice(0, 1))
        first, spent = 1, time.perf_counter() - begun
        parts = worth((count - first) * spent, _POOL, min(parts, count - first))
    if parts <= 1:
        work(slice(first, count))
        return
    edges = [first + k * (count - first) // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(parts) as pool:
        list(pool.map(work, [slice(a, b) for a, b in pairwise(edges)]))


def shares(controlled: Sequence[bool], count: int) -> list[list[int]]:
    """Numbers of the trials in at most `count` runs, each with as many of those that have a controller, or one more; the
    first has the others. Trials keep their order within a run.
    """
    places = [k for k, own in enumerate(controlled) if own]
    others = [k for k, own in enumerate(controlled) if not own]
    parts = [places[k::count] for k in range(min(count, len(places)))] or [[]]
    return [sorted(parts[0] + others), *parts[1:]]


def in_turns(runs: Sequence[Iterator[Work]], threads: int) -> None:
    """Brings runs to their ends: each gives native work that is to be done before it goes on, and others go on meanwhile.

    All Python is done by the calling thread: where controllers act in every hundredth of a second, an engine's threads would
    stand still a quarter of the time. `threads` do the work, in the order in which it comes.
    """
    if len(runs) == 1:
        for work in runs[0]:
            work()
        return
    with ThreadPoolExecutor(min(threads, len(runs)), "engine") as engine:
        going: dict[Future[None], Iterator[Work]] = {}
        waiting: list[Iterator[Work]] = list(runs)
        while waiting or going:
            for run in waiting:
                if (work := next(run, None)) is not None:
                    going[engine.submit(work)] = run
            done, _ = wait(going, return_when=FIRST_COMPLETED) if going else (set[Future[None]](), None)
            waiting = [going.pop(each) for each in done]
            for each in done:
                each.result()
