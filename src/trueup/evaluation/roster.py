# SPDX-License-Identifier: Apache-2.0
"""Who is there on a cluster: workers that are as this process is, workers that are not, and those that were lost."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

from trueup.errors import EvaluationError
from trueup.evaluation.connection import Connection
from trueup.evaluation.worker import identity

T = TypeVar("T")

LOOK = 0.5
"""Seconds between two looks at who is there."""


class Roster:
    """The workers of a cluster that fit, each with its threads; `say` hears of those that do not."""

    renewal: ClassVar[float] = 60.0
    """s for which a cluster without workers is waited for."""

    def __init__(self, connection: Connection, say: Callable[[str], None]) -> None:
        self.connection, self._say = connection, say
        self.fit: dict[str, int] = {}
        self.has: dict[str, set[str]] = {}
        """Worker to the parts that it was sent."""
        self.renewed = False
        """Whether somebody came after a loss."""
        self._unfit: dict[str, str] = {}  # worker to why nothing is sent to it
        self._seen: set[str] = set()
        self._own = identity()
        self._looked, self._peopled, self._lost = -math.inf, time.monotonic(), -math.inf  # when

    @property
    def where(self) -> str:
        """The cluster, for sentences."""
        return f"the cluster '{self.connection.address}'"

    def wait(self) -> None:
        """Waits for the first worker that fits. Raises EvaluationError where there are only others, or none comes."""
        while not self.fit:
            self._seen |= set(self._there())  # who is there at the beginning has been for long
            self.look()
            if self._unfit:
                raise EvaluationError(next(iter(self._unfit.values())))
            self.endure()
            time.sleep(0.0 if self.fit else 0.1)

    def look(self) -> list[str]:
        """Workers that are gone since the last look; there is nothing to see so soon after one."""
        now = time.monotonic()
        if now < self._looked + LOOK:
            return []
        self._looked, there = now, self._there()
        gone = [w for w in self.fit if w not in there]
        for worker in gone:
            self._forget(worker)
        self._unfit = {w: why for w, why in self._unfit.items() if w in there}
        # Who dies before its nanny knows that it lives is not started again: nobody is sent work at first sight.
        self._admit({w: n for w, n in there.items() if w in self._seen and w not in self.fit and w not in self._unfit})
        self._seen = set(there)
        self._peopled = now if self.fit else self._peopled
        if math.isfinite(self._lost) and sum(there.values()) < self.connection.expected:
            self.connection.replenish()
        return gone

    def endure(self) -> None:
        """Raises EvaluationError where nobody has been there for too long; a queue may take its time."""
        if not self.fit and not self.connection.jobs and time.monotonic() > self._peopled + self.renewal:
            why = next(iter(self._unfit.values()), f"start some: dask worker {self.connection.address}")
            raise EvaluationError(f"{self.where} has no worker: {why}")

    @property
    def last(self) -> bool:
        """Whether a single worker is left, and no other one will come."""
        return len(self.fit) == 1 and not self.renewed and time.monotonic() > self._lost + self.renewal

    def bar(self, worker: str, why: str) -> None:
        """A worker that hangs is ended, where somebody there can start it again, and left alone where not."""
        self._forget(worker)
        self._unfit[worker] = why
        client = self.connection.client

        def restart() -> None:
            try:
                client.restart_workers([worker], timeout=self.renewal, raise_for_error=False)
            except Exception:  # it has no nanny: it stays as it is, and nothing is sent to it
                return

        threading.Thread(target=restart, daemon=True).start()

    def answer(self, ask: Callable[[Any], T]) -> T:
        """What the scheduler answers to its client. Raises EvaluationError where it is gone."""
        try:
            if self.connection.client.status == "running":
                return ask(self.connection.client)
        except (OSError, TimeoutError, RuntimeError) as error:  # the last where it was closed since its status was read
            raise EvaluationError(self._unreachable) from error
        raise EvaluationError(self._unreachable)

    @property
    def _unreachable(self) -> str:
        return (
            f"the scheduler of {self.where} does not answer any more; what was finished is kept, go on when it is back"
        )

    def _there(self) -> dict[str, int]:
        return self.answer(lambda client: client.nthreads())

    def _forget(self, worker: str) -> None:
        del self.fit[worker], self.has[worker]
        self.renewed, self._lost = False, time.monotonic()

    def _admit(self, new: dict[str, int]) -> None:
        """Takes workers that are as this process is; the others are named."""
        if not new:
            return
        said = self.answer(lambda client: client.run(identity, workers=list(new), on_error="return"))
        for worker, threads in new.items():
            why = self._unlike(worker, said.get(worker))
            if why:
                self._unfit[worker] = why
                self._say(f"{why}; nothing is sent to it")
            elif why is not None:
                self.fit[worker], self.has[worker] = threads, set()
                self.renewed = self.renewed or math.isfinite(self._lost)

    def _unlike(self, worker: str, said: Any) -> str | None:
        """In what a worker differs from this process; '' if in nothing, None if it is not there any more."""
        if isinstance(said, ImportError):
            return f"worker {worker} has no trueup {self._own['trueup']} ({said}): install the same there as here"
        if not isinstance(said, dict):
            return None
        differ = [f"{k} {said.get(k, 'none')} (here {v})" for k, v in self._own.items() if said.get(k) != v]
        return f"worker {worker} has {', '.join(differ)}: install the same there as here" if differ else ""
