# SPDX-License-Identifier: Apache-2.0
"""A cluster of many workers, played event by event with trueup's own rules of sharing out, from measured times and sizes.

The client (with the scheduler, where these share a process) does one thing at a time; so does its network link.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, replace

import numpy as np

from trueup.evaluation.chunks import Chunk, Chunks, Hazard, Pace


@dataclass(frozen=True)
class Measured:
    """What a generation costs, in s and bytes."""

    fixed: float
    """Of a chunk on a worker of one thread, whatever its size."""
    each: float
    """Of a candidate."""
    spread: float
    """Of a chunk's time, from worker to worker and chunk to chunk, as a share (standard deviation of its logarithm)."""
    send: float
    """Of the client and the scheduler, for a chunk out and its scores back."""
    latency: float
    """Until a worker begins."""
    model: float
    """Bytes that a worker is sent once."""
    row: float
    """Bytes of a candidate and its scores."""
    link: float = 125e6
    """Bytes a second between client and workers; one Gbit/s."""


@dataclass(frozen=True)
class Played:
    """One generation, all its workers idle at its beginning."""

    seconds: float
    client: float
    """Share of the time in which the client was busy."""
    link: float
    """The same of its network link."""
    work: float
    """Share of the workers' time that went into candidates, not into what chunks cost beside."""
    lost: int


def played(
    measured: Measured, rows: int, workers: int, rng: np.random.Generator, *, fresh: bool = True,
    between: float = math.inf, renewal: float = 5.0,
) -> Played:  # fmt: skip
    """One generation of so many rows. `fresh`: workers have not the model yet; `between`: mean s between losses of a worker,
    which is back after `renewal` s.
    """
    chunks = Chunks(rows, Pace(), Hazard())
    events: list[tuple[float, int, str, int, Chunk | None]] = [(0.0, w, "idle", w, None) for w in range(workers)]
    client = link = now = client_busy = link_busy = 0.0
    count, lost, waiting = workers, 0, list[int]()
    holds = set[int]() if fresh else set(range(workers))
    while not chunks.settled:
        now, _, what, worker, chunk = heapq.heappop(events)
        if what == "done" and chunk is not None:
            client, client_busy = max(client, now) + measured.send / 2, client_busy + measured.send / 2
            chunks.settle(chunk)
        if what == "lost" and chunk is not None:
            lost += 1
            chunks.lost(chunk, "lost")
            holds.discard(worker)
        waiting += [] if what == "lost" else [worker]
        while waiting and (chunk := chunks.take(1, workers)) is not None:
            worker = waiting.pop(0)
            client, client_busy = max(client, now) + measured.send / 2, client_busy + measured.send / 2
            size = measured.row * len(chunk) + (0.0 if worker in holds else measured.model)
            holds.add(worker)
            link, link_busy = max(link, client) + size / measured.link, link_busy + size / measured.link
            lasts = (measured.fixed + measured.each * len(chunk)) * float(rng.lognormal(0.0, measured.spread))
            ends, fails = link + measured.latency + lasts, link + float(rng.exponential(between))
            count += 2
            if fails < ends:
                heapq.heappush(events, (fails, count, "lost", worker, chunk))
                heapq.heappush(events, (fails + renewal, count + 1, "idle", worker, None))
            else:
                heapq.heappush(events, (ends, count, "done", worker, chunk))
    seconds = max(client, now)
    return Played(seconds, client_busy / seconds, link_busy / seconds,
                  measured.each * rows / (workers * seconds), lost)  # fmt: skip


def limits(measured: Measured, rows: int, workers: int, rng: np.random.Generator) -> str:
    """What costs a generation the most time beside its work: what makes it the fastest when it is taken away."""
    without = {
        "the client's messages": replace(measured, send=0.0),
        "the client's link": replace(measured, link=math.inf),
        "the part of a chunk that all its candidates share": replace(measured, fixed=0.0),
        "the slowest worker": replace(measured, spread=0.0),
        "latency": replace(measured, latency=0.0),
    }
    seeds = rng.integers(2**31, size=10)
    means = {
        name: float(np.mean([played(m, rows, workers, np.random.default_rng(s)).seconds for s in seeds]))
        for name, m in without.items()
    }
    return min(means, key=lambda name: means[name])


def table(measured: Measured, rows: int, workers: tuple[int, ...], rng: np.random.Generator) -> list[str]:
    """Lines: workers, seconds a generation, speed-up over one worker, shares, what limits it."""
    lines = [f"{rows} candidates:  workers   s/generation   speed-up   in work   client busy   link busy   limited by"]
    one = 0.0
    for number in workers:
        runs = [played(measured, rows, number, np.random.default_rng(s)) for s in rng.integers(2**31, size=10)]
        seconds, client, link, work = np.mean([(r.seconds, r.client, r.link, r.work) for r in runs], axis=0).tolist()
        one = one or seconds
        lines.append(
            f"{'':18} {number:8d} {seconds:14.2f} {one / seconds:10.1f} {100 * work:7.0f} % {100 * client:11.1f} % "
            f"{100 * link:9.1f} %   {limits(measured, rows, number, rng)}"
        )
    return lines
