# SPDX-License-Identifier: Apache-2.0
"""One call of a rollout: trials x candidates as rows of a batch, each stepped to its end and read off on the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

import mujoco
import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.articulated.assignments import Assignment, acts_in_each_step, laws, write
from trueup.articulated.closed_loop import ClosedLoop
from trueup.articulated.gains import Gains
from trueup.articulated.pose import angles_of, near
from trueup.articulated.sensing import read_noise, scatter
from trueup.articulated.signals import Signals
from trueup.articulated.wiring import no_signal
from trueup.controllers.controller import ControllerFactory
from trueup.cores import Work
from trueup.ends import Ended
from trueup.engines.mujoco.acts import Acts
from trueup.engines.mujoco.attributes import MujocoCopies
from trueup.engines.mujoco.batches import Batches
from trueup.engines.mujoco.ending import Watch
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.sensing import finder
from trueup.engines.mujoco.stepping import Stepper
from trueup.engines.mujoco.wiring import (
    Source,
    activations,
    addresses,
    known_signals,
    placed_joints,
    rest,
    source_of,
    start_state,
)
from trueup.engines.simulator import Rollout, Simulator
from trueup.rounding import SAME_INSTANT, whole_steps
from trueup.trial import Trial

# Steps simulated between two readings: long enough to hide the call, short enough for memory. Where rows may end they are
# fewer, since rows leave the batch at the next reading only.
_CHUNK, _WATCHED = 256, 32


class Parametrised(Simulator, Protocol):
    """A simulator of a MuJoCo model with assigned quantities: what a run reads of it."""

    model: Model
    quantities: tuple[Assignment, ...]
    controller: ControllerFactory | None
    gains: Gains
    batches: Batches

    @property
    def compiled(self) -> mujoco.MjModel:
        """The model as it is simulated."""
        ...


class Run:
    """Integers are trial-major, the longest trial first. Integers that end or fail are stepped no further."""

    def __init__(
        self, simulator: Parametrised, trials: Sequence[Trial], values: Array,
        controllers: ControllerFactory | None, contacts: bool, place: tuple[int, int] = (0, 1),
    ) -> None:  # fmt: skip
        """`place`: which of how many runs it is that are under way at once."""
        self.simulator, self.trials, self.candidates = simulator, trials, len(values)
        count = len(simulator.quantities)
        self.settings = values[:, count:] if values.shape[1] > count else None
        self.contacts, self.compiled = contacts, simulator.compiled
        self.signals = Signals(simulator.model, simulator.quantities, trials, values[:, :count], simulator.step)
        self.failures: list[dict[int, str]] = [{} for _ in trials]
        self.ends: list[dict[int, Ended]] = [{} for _ in trials]
        self.touched = False
        """Whether anything ever touched anything."""
        self._stopped: list[dict[int, float]] = [{} for _ in trials]  # row to the instant up to which it is known
        self.out: list[dict[str, Array]] = []
        self.sources: list[dict[str, Source]] = []
        self._allocate()
        own = [trial.controller or controllers for trial in trials]
        self.watch = Watch(simulator.model, self.compiled, trials, simulator.step)
        read = any(s.field == "sensordata" for per in self.sources for s in per.values())
        self.batch = simulator.batches.get(
            len(trials) * self.candidates, contacts=contacts, sensors=any(own) or read or self.watch.any,
            stepwise=acts_in_each_step(simulator.quantities, values[:, :count]), place=place,
        )  # fmt: skip
        self.copies = MujocoCopies(self.compiled, self.batch)
        self._write_model(values)
        seeing = [factory is not None for factory in own]
        self.acts = Acts(self.batch, simulator.model, self.compiled, trials, self.signals, simulator.step, seeing)
        self.stepper = self._stepper(values, own)

    def simulate(self) -> Iterator[Work]:
        """Steps all rows to their ends, reading off on the way.

        Yields the engine's work, which is to be done before it goes on.
        """
        total = np.repeat([self._steps(k) for k in range(len(self.trials))], self.candidates)
        fields = sorted({s.field for per in self.sources for s in per.values()} | set(self.watch.fields))
        record = sorted({*fields, *self.acts.watched, "time"} | ({"ncon"} if self.contacts else set()))
        previous = {f: np.array(self.batch.bind(f))[:, None] for f in fields}
        self.acts.begin()
        rows, at = np.arange(len(total)), 0
        while len(rows):
            count = min(_WATCHED if self.watch.any else _CHUNK, int(total[rows].max()) - at)
            history = yield from self.stepper.advance(at, count, rows, record)
            self.touched = self.touched or bool(self.contacts and np.any(history["ncon"]))
            joined = {f: np.concatenate([previous[f][rows], history[f]], axis=1) for f in fields}
            good = self._good(history["time"], joined, rows, at)
            self._read(joined, rows, at, count)
            over = self._close(joined, rows, good, at, count)
            for f in fields:
                previous[f][rows] = joined[f][:, -1:]
            at += count
            rows = rows[~over & (total[rows] > at)]
        self._blank()

    def rollouts(self) -> list[Rollout]:
        """What was read off, one Rollout a trial."""
        return [
            Rollout(
                trial,
                {name: self._measured(k, name) for name in self.out[k]},
                self.failures[k],
                self.ends[k],
                self.settings,
            )
            for k, trial in enumerate(self.trials)
        ]

    def _measured(self, k: int, name: str) -> Array:
        """(b, T, k) a channel as it is measured: a quaternion as angles, in the turn in which they were measured; noisy."""
        trial, values = self.trials[k], self.out[k][name]
        if self.sources[k][name].turned:
            measured = trial.initial.get(name)
            values = angles_of(values)
            values = near(values, measured.at(trial.observed[name].time)) if measured is not None else values
        return read_noise(trial, name, values)

    def _steps(self, k: int) -> int:
        return whole_steps(self.trials[k].duration, self.simulator.step) + 2

    def _allocate(self) -> None:
        known = dict[tuple[str, tuple[str, ...]], Source | None]()  # thousands of windows observe the same
        for trial in self.trials:
            sources, out = {}, {}
            for name, o in trial.observed.items():
                if (key := (name, o.labels)) not in known:
                    known[key] = source_of(self.simulator.model, self.compiled, *key)
                if (source := known[key]) is None:
                    raise no_signal(trial.name, name, self.simulator.name, known_signals(self.simulator.model))
                sources[name] = source
                out[name] = np.full((self.candidates, len(o.time), len(source.columns)), np.nan)
            self.sources.append(sources)
            self.out.append(out)

    def _write_model(self, values: Array) -> None:
        own = values[:, : len(self.simulator.quantities)]
        self.batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        if self.simulator.quantities:
            write(self.simulator.quantities, np.tile(own, (len(self.trials), 1)), self.copies)
            self.batch.set_const()
        simulator, model = self.simulator, self.simulator.model
        simulator.gains.scale(model, self.copies, [t.name for t in self.trials], self.candidates)
        qpos, qvel, joints = self.batch.bind("qpos"), self.batch.bind("qvel"), list(model.drives())
        places, speeds = addresses(self.compiled, joints)
        for k, (q, v) in enumerate(self.signals.starts()):
            rows = slice(k * self.candidates, (k + 1) * self.candidates)
            qpos[rows], qvel[rows] = start_state(self.compiled, self.trials[k])
            qpos[rows, places], qvel[rows, speeds] = q, v
            if self.compiled.neq:
                placed = placed_joints(self.compiled, self.trials[k], joints)
                simulator.batches.linkages.close(rest(self.compiled)[0], qpos[rows], qvel[rows], placed)
            states = {"qvel": qvel[rows]}
            find = finder(model, self.compiled, self.trials[k])
            scatter(self.trials[k], self.candidates, find, lambda f, own=qpos[rows], more=states: more.get(f, own))
            if self.compiled.na:
                first = self.signals.commands(k, 0, 1, self.simulator.step)[:, 0]
                self.batch.bind("act")[rows] = activations(model, first, q)

    def _stepper(self, values: Array, controllers: Sequence[ControllerFactory | None]) -> Stepper:
        own, step = len(self.simulator.quantities), self.simulator.step
        loops = {
            k: ClosedLoop(factory(values[:, own:]), self.signals, k, step)
            for k, factory in enumerate(controllers)
            if factory is not None
        }
        tiled = np.tile(values[:, :own], (len(self.trials), 1))
        acting = laws(self.simulator.quantities, tiled, self.simulator.model, self.copies)
        return Stepper(self.batch, self.signals, acting, loops, self.acts, step)

    def _good(self, time: Array, joined: dict[str, Array], rows: Integers, at: int) -> Integers:
        """(n,) how many of the steps of a stretch went well: the clock of a simulation that blows up stops or is reset.

        What was recorded later repeats the last that is known.
        """
        step = self.simulator.step
        expected = (at + 1 + np.arange(time.shape[1])) * step
        bad = ~(np.abs(time.reshape(len(rows), -1) - expected) < 0.5 * step)
        good = np.where(bad.any(axis=1), bad.argmax(axis=1), time.shape[1])
        for i in np.flatnonzero(bad.any(axis=1)):
            for values in joined.values():
                values[i, good[i] + 1 :] = values[i, good[i]]
        return good

    def _close(self, joined: Mapping[str, Array], rows: Integers, good: Integers, at: int, count: int) -> Mask:
        """(n,) which rows ended in a stretch, by a condition or because their simulation broke off."""
        over = np.zeros(len(rows), dtype=bool)
        step = self.simulator.step
        for k, trial in enumerate(self.trials):
            mine = self._mine(k, rows)
            own = rows[mine] - k * self.candidates
            if not len(own):
                continue
            settings = None if self.settings is None else self.settings[own]
            for i, ended in self.watch.ends(k, {f: v[mine] for f, v in joined.items()}, at, good[mine], settings):
                self.ends[k][int(own[i])] = ended
                self._stopped[k][int(own[i])] = ended.at
                over[mine.start + i] = True
            for i in np.flatnonzero((good[mine] < count) & ~over[mine]):
                now = (at + int(good[mine][i])) * step
                if now < trial.duration:  # what happens after its end is no part of the run
                    reason = self.stepper.errors.get(int(rows[mine][i]), "")
                    self.failures[k][int(own[i])] = reason or f"the simulation became unstable after {now:.3g} s"
                    self._stopped[k][int(own[i])] = trial.start + now if now > 0.0 else -np.inf
                over[mine.start + i] = True
        return over

    def _mine(self, k: int, rows: Integers) -> slice:
        first, last = np.searchsorted(rows, (k * self.candidates, (k + 1) * self.candidates))
        return slice(int(first), int(last))

    def _read(self, joined: dict[str, Array], rows: Integers, at: int, count: int) -> None:
        for k in range(len(self.trials)):
            mine = self._mine(k, rows)
            own = rows[mine] - k * self.candidates
            if self._steps(k) <= at or not len(own):
                continue
            ends = at + count >= self._steps(k)
            for name, source in self.sources[k].items():
                # Derived fields describe the state before each step: their history begins one step earlier.
                first = at - 1 if source.derived else at
                history = np.ascontiguousarray(source.read(joined[source.field][mine]))
                span = (first, first + count, ends)
                self.signals.read(k, name, history, own, span, self.simulator.step, self.out[k][name])

    def _blank(self) -> None:
        """Takes away what lies beyond the end of a row, and says where what is left is not finite."""
        for trial, out, failed, stopped in zip(self.trials, self.out, self.failures, self._stopped, strict=True):
            for name, channel in out.items():
                time = trial.observed[name].time
                lasted = np.ones(channel.shape[:2], dtype=bool)
                for row, stop in stopped.items():
                    lasted[row] = time <= stop + SAME_INSTANT
                channel[~lasted] = np.nan
                bad = lasted & ~np.isfinite(channel).all(axis=2)
                for row in np.flatnonzero(bad.any(axis=1)):
                    when = time[bad[row].argmax()] - trial.start
                    failed.setdefault(int(row), f"the simulation gave a '{name}' that is not finite after {when:.3g} s")
