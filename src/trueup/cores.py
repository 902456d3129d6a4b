# SPDX-License-Identifier: Apache-2.0
"""How many cores this process may use, and work shared among threads on them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

THREADS = "TRUEUP_THREADS"
"""Environment variable that says how many threads simulations take, where it is not all cores of this process."""


def cores() -> int:
    """As THREADS says, else all that the system lets this process use."""
    asked = os.environ.get(THREADS, "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_threads(work: Callable[[slice], None], count: int, threads: int) -> None:
    """Does `work` on rows 0 ... count - 1, cut into as many slices as threads; compiled loops let go of Python's lock."""
    parts = min(threads, count)
    if parts <= 1:
        work(slice(0, count))
        return
    edges = [k * count // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(parts) as pool:
        list(pool.map(work, [slice(a, b) for a, b in pairwise(edges)]))
