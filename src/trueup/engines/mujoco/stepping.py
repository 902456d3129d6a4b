# SPDX-License-Identifier: Apache-2.0
"""Steps a batch: natively over many steps, or one by one where something acts in each; controllers at their own rate."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numba import cfunc

from trueup.arrays import Array, Integers
from trueup.articulated.closed_loop import ClosedLoop
from trueup.articulated.laws import Law
from trueup.articulated.signals import Signals
from trueup.cores import Work
from trueup.engines.mujoco.acts import Acts

_CLOCK = int(mujoco.mjtState.mjSTATE_TIME)  # what the engine records as 'time'


@cache
def _stopped_clock() -> Any:
    """Handed to MuJoCo in place of its profiling clock (see `unclocked`); compiled when it is first wanted."""

    @cfunc("float64()", cache=True)
    def stopped() -> float:
        return 0.0

    return stopped


@contextmanager
def unclocked() -> Iterator[None]:
    """Without the profiling clock, which MuJoCo reads some thirty times a step: a seventh of a small robot's step.

    The clock belongs to the process: one that the caller has set stays, and MuJoCo's own is back afterwards.
    """
    if mujoco.get_mjcb_time() is not None:
        yield
        return
    mujoco.set_mjcb_time(_stopped_clock().ctypes)
    try:
        yield
    finally:
        mujoco.set_mjcb_time(None)


class Stepper:
    """Steps some rows of a batch: natively from one instant at which somebody acts to the next, or one step at a time.

    Controllers act when their commands are due, pushes when they begin and end. `laws` (dead bands, friction that
    depends on speed and load) act in every step.
    """

    def __init__(
        self, batch: Batch, signals: Signals, laws: Sequence[Law], loops: Mapping[int, ClosedLoop], acts: Acts,
        step: float,
    ) -> None:  # fmt: skip
        self._batch, self._signals, self._laws, self._step = batch, signals, laws, step
        self._loops, self._acts, self._twins = loops, acts, signals.twins
        self._candidates, self._width = signals.delay.shape
        self._ctrl = batch.bind("ctrl")
        self.errors: dict[int, str] = {}
        """Row to what the engine says of its failure."""

    def advance(
        self, at: int, count: int, rows: Integers, record: Sequence[str]
    ) -> Generator[Work, None, dict[str, Array]]:
        """Field to (len(rows), count, ...) after each of `count` steps; `at` is the number of steps done so far.

        Yields the engine's work, which is to be done before it goes on.
        Of a row whose simulation broke off, 'time' stands still or is NaN from there on.
        """
        bound = {f: self._batch.bind(f) for f in record}
        shapes = {f: ((1,) if f == "time" else b.shape[1:], b.dtype) for f, b in bound.items()}
        out = {f: _blank((len(rows), count, *shape), kind) for f, (shape, kind) in shapes.items()}
        planned = {k: self._planned(k, at, count) for k in self._open(rows)}
        mine = {k: self._rows_of(k, rows) for k in self._loops}
        parts = dict[int, dict[str, Array]]()  # to record into, by length
        done = 0
        while done < count:
            now = at + done
            self._act_at(now, mine)
            for loop in self._loops.values():
                loop.foretell(at + count)
            n = min(
                count - done, self._acts.next_after(now) - now, *(max(w.due - now, 1) for w in self._loops.values())
            )
            given = {k: commands[:, done : done + n] for k, commands in planned.items()}
            commands = self._commands(now, n, rows, given)
            whole = n == count
            if not whole and n not in parts:
                parts[n] = {f: _blank((len(rows), n, *shape), kind) for f, (shape, kind) in shapes.items()}
            part = out if whole else parts[n]
            yield partial(self._stretch, commands, n, rows, part)
            if not whole:
                for field, values in part.items():
                    out[field][:, done : done + n] = values
            self._acts.note(part, rows)
            done += n
        return out

    def _act_at(self, now: int, mine: Mapping[int, Integers]) -> None:
        self._acts.push(now)
        for k, loop in self._loops.items():
            own = mine[k]
            if len(own) and loop.due <= now:
                loop.ask(self._acts.observation(k, now * self._step, own, loop.looks_at))
                if loop.push is not None:
                    self._acts.force(k, *loop.push)

    def _rows_of(self, k: int, rows: Integers) -> Integers:
        """Those of `rows` that belong to one trial."""
        first, last = np.searchsorted(rows, (k * self._candidates, (k + 1) * self._candidates))
        return rows[first:last]

    def _open(self, rows: Integers) -> list[int]:
        """The trials of `rows` that play recorded commands."""
        return [k for k in np.unique(rows // self._candidates).tolist() if k not in self._loops]

    def _planned(self, k: int, at: int, count: int) -> Array:
        """(b, count, nu) recorded commands of a trial, as they arrive."""
        return self._acts.disturbed(k, at, self._signals.commands(k, at, count, self._step))

    def _commands(self, at: int, n: int, rows: Integers, planned: Mapping[int, Array]) -> Array:
        """(r, n, nu) commands of the first r rows, among them all of `rows`."""
        parts = []
        for k in range(int(rows[-1]) // self._candidates + 1):
            if k in planned:
                parts.append(planned[k])
            elif len(self._rows_of(k, rows)):
                parts.append(self._acts.disturbed(k, at, self._loops[k].commands(at, n)))
            else:
                parts.append(np.zeros((self._candidates, n, self._width)))
        commands = parts[0] if len(parts) == 1 else np.concatenate(parts)
        for twin, main in self._twins:
            commands[:, :, twin] = commands[:, :, main]
        return commands

    def _stretch(self, commands: Array, n: int, rows: Integers, out: dict[str, Array]) -> None:
        if not self._laws:
            control = commands if len(rows) == len(commands) else commands[rows]
            into = {_CLOCK if f == "time" else f: values for f, values in out.items()}
            spec = int(mujoco.mjtState.mjSTATE_CTRL)
            self._guarded(
                lambda: self._batch.rollout(n, control, control_spec=spec, record=tuple(into), ids=rows, out=into)
            )
            return
        ids = None if len(rows) == self._batch.nsim else rows
        which = slice(0, len(rows)) if len(rows) == rows[-1] + 1 else rows
        bound = {f: self._batch.bind(f) for f in out}
        for s in range(n):
            self._act(commands[:, s])
            self._guarded(lambda: self._batch.step(ids))
            for field, array in bound.items():
                out[field][:, s] = array[which].reshape(out[field][:, s].shape)

    def _guarded(self, work: Callable[[], object]) -> None:
        """Steps; what broke off is kept beside, and the others go on."""
        try:
            work()
        except SimulationError as error:
            for row in np.atleast_1d(error.ids):
                self.errors.setdefault(int(row), self._batch.error(int(row)) or str(error))

    def _act(self, wanted: Array) -> None:
        command = np.array(wanted)
        for law in self._laws:
            law.act(command)
        self._ctrl[: len(command)] = command


def _blank(shape: tuple[int, ...], kind: np.dtype[Any]) -> Array:
    """An array to record into, of numbers that no simulation gives."""
    return np.full(shape, np.nan if kind.kind == "f" else 0, kind)
