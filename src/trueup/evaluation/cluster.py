# SPDX-License-Identifier: Apache-2.0
"""Candidates on the workers of a cluster (dask.distributed), of which any may be lost, hang, or talk nonsense."""

from __future__ import annotations

import queue
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.errors import EvaluationError, TrueupError
from trueup.evaluation.chunks import Chunk, Chunks, Hazard, Pace
from trueup.evaluation.connection import ANSWER, check, connected
from trueup.evaluation.evaluator import Outcome, Work
from trueup.evaluation.roster import LOOK, Roster
from trueup.evaluation.worker import Reply, packed, work_on


@dataclass(eq=False)
class _Run:
    """A chunk that is under way."""

    worker: str
    threads: int
    chunk: Chunk
    chunks: Chunks
    keys: tuple[str, ...]
    future: Any
    begun: float


class Cluster:
    """An Evaluator on a cluster; see `connection.FORMS` for addresses. To be used in a with statement.

    An evaluation ends when `quorum` of its rows are scored, as soon as all are at the latest; those that are not count as
    failed. The paper's quorum is 0.8 (A. Farchy et al., AAMAS 2013, section 4.2): what fails is run again until then. With
    1.0 the result is that of one machine, whatever happens on the way. A chunk that takes `grace` s and three times as long
    as others took counts as hung. `say` hears what goes wrong in whole sentences,
    `watch` how many rows are scored, of how many, and on how many workers.
    """

    def __init__(
        self, address: str, *, quorum: float = 1.0, grace: float = 5.0, say: Callable[[str], None] | None = None,
        watch: Callable[[int, int, int], None] | None = None,
    ) -> None:  # fmt: skip
        """Connects when it is first needed, or when it is entered. Raises EvaluationError for what is no address."""
        check(address)
        if not 0.0 < quorum <= 1.0:
            raise EvaluationError(f"a quorum of {quorum:g} cannot be: it is a share, above 0 and at most 1")
        self.address, self.quorum, self._grace = address, quorum, grace
        self._say, self._watch = say or (lambda _: None), watch or (lambda *_: None)
        self._runs: dict[str, _Run] = {}  # by the future's key
        self._parts: dict[int, tuple[object, str, bytes]] = {}
        self._paces: dict[str, Pace] = {}
        self._hazard = Hazard()
        self._arrived: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._connected: Roster | None = None

    def __enter__(self) -> Cluster:
        """Connects. Raises EvaluationError where there is no such cluster or none of its workers fits."""
        self._roster.wait()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Lets the cluster go, until it is needed again; one that was started for this is ended."""
        if self._connected is not None:
            for run in self._runs.values():
                run.future.release()
            self._runs.clear()
            self._connected.connection.close()
            self._connected = None

    @property
    def workers(self) -> int:
        """How many are there and fit."""
        return len(self._connected.fit) if self._connected is not None else 0

    @property
    def _roster(self) -> Roster:
        if self._connected is None:
            self._connected = Roster(connected(self.address, self._say), self._say)
            try:
                self._connected.wait()
            except BaseException:
                self.close()
                raise
            self._say(f"candidates are simulated on {self._connected.where}, {self.workers} workers so far")
        return self._connected

    def evaluate(self, work: Work, rows: Array) -> Outcome:
        """See Evaluator. Raises EvaluationError where no row can be scored, or the cluster is gone."""
        rows = np.ascontiguousarray(rows, dtype=np.float64)
        pace = self._paces.setdefault(f"{work.function.__qualname__} {work.kind}", Pace(self._grace))
        chunks = Chunks(len(rows), pace, self._hazard)
        done = Outcome(np.full((len(rows), work.width), np.nan), {})
        keys = tuple(self._pack(part) for part in (work.function, *work.parts))
        failures, errors = dict[int, str](), Counter[str]()
        try:
            while not chunks.settled and chunks.scored < self.quorum * len(rows):
                self._look(chunks)
                self._hand_out(rows, keys, chunks)
                for run, reply in self._replies():
                    if run.chunks is chunks:  # and not what was left behind by an earlier one
                        self._take(run, reply, work, done.values, failures, errors)
                if not chunks.scored and errors and max(errors.values()) > 2 * max(2, self.workers):
                    raise EvaluationError(f"wherever it is tried the same goes wrong: {errors.most_common(1)[0][0]}")
                self._watch(chunks.scored, len(rows), self.workers)
        except BaseException:
            self._leave(chunks)
            raise
        if not chunks.scored:
            why = next(iter(chunks.given_up.values()), "nothing came back")
            raise EvaluationError(f"none of {len(rows)} candidates could be evaluated on {self._roster.where}: {why}")
        for row in np.flatnonzero(np.isnan(done.values).all(axis=1)).tolist():
            failures.setdefault(row, chunks.given_up.get(row, f"not among the first {100 * self.quorum:g} %"))
        return Outcome(done.values, failures)

    def _look(self, chunks: Chunks) -> None:
        """Who was lost, and who hangs; what they had is for others."""
        for worker in self._roster.look():
            self._lose(worker, f"worker {worker} was lost")
        for run in list(self._runs.values()):
            limit = run.chunks.pace.limit(run.chunk, run.threads)
            if time.monotonic() - run.begun > limit and run.worker in self._roster.fit:
                why = f"worker {run.worker} hangs: no answer in {limit:.0f} s"
                self._roster.bar(run.worker, why)
                self._lose(run.worker, why)
        self._roster.endure()
        if self._roster.last and not self._runs:
            chunks.abandon("it was lost with its worker, and only one worker is left to try it on")

    def _lose(self, worker: str, why: str) -> None:
        """A worker is gone, and with it what it was doing."""
        self._hazard.losses += 1
        for key in [k for k, r in self._runs.items() if r.worker == worker]:
            run = self._runs.pop(key)
            run.future.release()
            self._hazard.worked += time.monotonic() - run.begun
            run.chunks.lost(run.chunk, why)
            self._say(f"{why}; {_rows(run.chunk)} again")

    def _pack(self, part: object) -> str:
        """The key of a part that is ready to be sent."""
        kept = self._parts.pop(id(part), None)
        self._parts[id(part)] = kept = (part, *packed(part)) if kept is None else kept
        for old in list(self._parts)[:-32]:  # so many are kept ready
            del self._parts[old]
        return kept[1]

    def _hand_out(self, rows: Array, keys: tuple[str, ...], chunks: Chunks) -> None:
        """A chunk for everyone who is idle."""
        busy = {r.worker for r in self._runs.values()}
        whole = max(sum(self._roster.fit.values()), self._roster.connection.expected)
        for worker in [w for w in self._roster.fit if w not in busy]:
            threads = self._roster.fit[worker]
            chunk = chunks.take(threads, whole, risky=self._roster.renewed or len(self._roster.fit) > 1)
            if chunk is None:
                return
            blobs = {
                key: blob
                for _, key, blob in self._parts.values()
                if key in keys and key not in self._roster.has[worker]
            }
            self._roster.has[worker].update(blobs)
            part = rows[chunk.start : chunk.stop]
            future = self._roster.answer(
                lambda client, w=worker, b=blobs, p=part, at=chunk.start, n=threads: client.submit(
                    work_on, keys, b, p, at, n, workers=[w], pure=False
                )
            )
            self._runs[future.key] = _Run(worker, threads, chunk, chunks, keys, future, time.monotonic())
            future.add_done_callback(lambda f: self._arrived.put(f.key))

    def _replies(self) -> Iterable[tuple[_Run, Reply]]:
        """What came back until now; waits for the first of it, for as long as nobody need be looked at."""
        wait = LOOK
        while True:
            try:
                run = self._runs.pop(self._arrived.get(timeout=wait), None)
            except queue.Empty:
                return
            wait = 0.0
            if run is not None:
                yield run, self._reply(run)

    def _reply(self, run: _Run) -> Reply:
        try:
            reply = run.future.result(timeout=ANSWER)
        except Exception as error:  # of the cluster, or of a part that cannot be read there
            reply = Reply(error=f"{type(error).__name__}: {error}".splitlines()[0])
        run.future.release()
        return (
            reply if isinstance(reply, Reply) else Reply(error=f"worker {run.worker} answered {type(reply).__name__}")
        )

    def _take(
        self, run: _Run, reply: Reply, work: Work, values: Array, failures: dict[int, str], errors: Counter[str]
    ) -> None:
        """What a chunk gave goes where it belongs. Raises what the work would raise here."""
        lasted = time.monotonic() - run.begun
        self._hazard.worked += lasted
        if reply.missing:
            self._roster.has.get(run.worker, set()).difference_update(reply.missing)
            run.chunks.returned(run.chunk)
            return
        wrong = reply.error or _nonsense(reply.outcome, len(run.chunk), work.width)
        if reply.outcome is None or wrong:
            if isinstance(reply.raised, TrueupError):
                raise reply.raised
            errors[wrong] += 1
            run.chunks.lost(run.chunk, wrong)
            self._say(f"worker {run.worker}: {wrong}; {_rows(run.chunk)} again")
            return
        run.chunks.pace.took(len(run.chunk), run.threads, lasted)
        run.chunks.settle(run.chunk)
        values[run.chunk.start : run.chunk.stop] = reply.outcome.values
        failures.update({run.chunk.start + row: why for row, why in reply.outcome.failures.items()})

    def _leave(self, chunks: Chunks) -> None:
        """What is under way of an evaluation that is over is not waited for."""
        for run in self._runs.values():
            if run.chunks is chunks:
                run.future.cancel()


def _rows(chunk: Chunk) -> str:
    return f"candidate {chunk.start}" if len(chunk) == 1 else f"candidates {chunk.start} to {chunk.stop - 1}"


def _nonsense(outcome: Outcome | None, rows: int, width: int) -> str:
    """What is wrong with an outcome; '' if nothing is."""
    values = getattr(outcome, "values", None)
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return f"nonsense: {type(values).__name__} instead of numbers"
    if values.shape != (rows, width):
        return f"nonsense: numbers of shape {values.shape} instead of {(rows, width)}"
    unsaid = np.isnan(values).all(axis=1).sum() - len(getattr(outcome, "failures", {}))
    return f"nonsense: {unsaid} rows of NaN, and no reason" if unsaid > 0 else ""
