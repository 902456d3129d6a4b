# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulator: candidates x trials in one batch on native threads, failed simulations reported, never fatal."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial

import mujoco
import numpy as np
from mujoco.batch import SimulationError
from numpy.typing import NDArray

from trueup.articulated.assignments import Assignment, laws, needs, write
from trueup.articulated.kernels import read_off
from trueup.articulated.pose import angles_of, near
from trueup.articulated.signals import Signals
from trueup.controllers.controller import ControllerFactory
from trueup.engines.mujoco.attributes import MujocoCopies
from trueup.engines.mujoco.batches import Batches
from trueup.engines.mujoco.engine_log import unlogged
from trueup.engines.mujoco.gains import Gains
from trueup.engines.mujoco.model import Model, needs_shapes, prepared
from trueup.engines.mujoco.stepping import Stepper, stepper, unclocked
from trueup.engines.mujoco.wiring import Source, activations, actuators_of, source_of, start_state
from trueup.engines.simulator import Rollout
from trueup.errors import ModelError
from trueup.parameters import ParameterSpace, concatenate
from trueup.recording import Recording, is_command
from trueup.trial import Trial, command_of

Array = NDArray[np.float64]

# Steps simulated between two readings: long enough to hide the call, short enough for memory.
_CHUNK = 256


class MujocoSimulator:
    """A robot model whose parameters can be written into every simulation of a batch (see `simulator.Simulator`).

    `quantities[i]` says what parameter i sets. With a `controller`, the parameters of `controller_parameters` follow
    those of the model and are handed to it. `step` in s; `threads` native threads (None: all this process may use).
    `gains`: what the recordings say of the servos' settings.
    """

    def __init__(
        self, model: Model, space: ParameterSpace | None = None, quantities: Sequence[Assignment] = (), *,
        step: float = 0.002, threads: int | None = None, controller: ControllerFactory | None = None,
        controller_parameters: ParameterSpace | None = None, gains: Gains | None = None,
    ) -> None:  # fmt: skip
        own = space if space is not None else ParameterSpace(())
        self.model = model
        self.quantities = tuple(quantities)
        self.step = step
        self.controller = controller
        self.gains = gains or Gains()
        self.parameters = concatenate([own, controller_parameters]) if controller_parameters is not None else own
        self._threads = threads or len(os.sched_getaffinity(0))
        self.batches = self._prepare()
        # None until a run with contacts has shown whether anything touches anything.
        self._touching: bool | None = None if self._can_touch() else False

    @property
    def name(self) -> str:
        """The model file's name without its ending."""
        return self.model.name

    def shipped(self) -> MujocoSimulator:
        """The same model as it came: no parameter applied, the same step."""
        own = self._as_declared()
        return MujocoSimulator(self.model, step=self.step, threads=self._threads, controller=own, gains=self.gains)

    def _as_declared(self) -> ControllerFactory | None:
        """The controller with the nominal values of its own parameters, whatever it is given."""
        controller, own = self.controller, self.parameters.nominal[len(self.quantities) :]
        if controller is None or not len(own):
            return controller
        return lambda values: controller(np.tile(own, (len(values), 1)))

    def with_parameters(self, space: ParameterSpace) -> MujocoSimulator:
        """The same simulator with other nominal values or frozen flags (names and order must stay)."""
        if space.names != self.parameters.names:
            raise ModelError("with_parameters needs the same parameters in the same order")
        twin = object.__new__(MujocoSimulator)
        twin.__dict__.update(self.__dict__)
        twin.parameters = space
        return twin

    def at_step(self, step: float) -> MujocoSimulator:
        """The same simulator with another step, in s: coarser for a first search, finer to verify."""
        twin = object.__new__(MujocoSimulator)
        twin.__dict__.update(self.__dict__)
        twin.step = step
        twin.batches = self.batches.at_step(step)
        return twin

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The measured channels that this model can reproduce. Raises UnknownNameError for joints it does not have."""
        command = command_of(recording)
        if command is not None and self.controller is None:
            actuators_of(self.model, command)
        measured = [c for name, c in recording.channels.items() if not is_command(name)]
        return tuple(c.name for c in measured if source_of(self.model, self.compiled, c.name, c.labels) is not None)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """Simulates every trial for every row of values (b, n). See `Simulator.rollout`."""
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        verifying = len(values) == 1
        contacts = self._touching is not False or self._has_floor or (verifying and self._can_touch())
        order = sorted(range(len(trials)), key=lambda k: -trials[k].duration)
        with unclocked(), unlogged():
            run = _Run(self, [trials[k] for k in order], values, controllers or self.controller, contacts)
            touched = run.simulate()
        if contacts:
            self._touching = touched
        done = run.rollouts()
        return [done[order.index(k)] for k in range(len(trials))]

    @property
    def _has_floor(self) -> bool:
        """Whether a floor may come up to the robot, though nothing touches it as things stand."""
        return bool(needs(self.quantities, "floor"))

    @property
    def compiled(self) -> mujoco.MjModel:
        """The model as it is simulated."""
        return self.batches.whole

    def _prepare(self) -> Batches:
        prepare = partial(
            prepared,
            self.model,
            step=self.step,
            slack=needs(self.quantities, "slack"),
            limited=needs(self.quantities, "limit"),
            floor=self._has_floor,
        )
        whole = prepare()
        shaped = needs_shapes(whole) or bool(needs(self.quantities, "shapes"))
        return Batches(whole, whole if shaped or self._has_floor else prepare(bare=True), self._threads)

    def _can_touch(self) -> bool:
        m = self.compiled
        return bool(m.npair or np.any((m.geom_contype != 0) | (m.geom_conaffinity != 0)))


class _Run:
    """One call of `rollout`: trials x candidates as rows of a batch, trial-major, the longest trial first."""

    def __init__(
        self, simulator: MujocoSimulator, trials: Sequence[Trial], values: Array,
        controllers: ControllerFactory | None, contacts: bool,
    ) -> None:  # fmt: skip
        self.simulator, self.trials = simulator, trials
        self.candidates = len(values)
        self.contacts = contacts
        self.compiled = simulator.compiled
        self.signals = Signals(simulator.model, simulator.quantities, trials, values[:, : len(simulator.quantities)])
        self.failures: list[dict[int, str]] = [{} for _ in trials]
        self.out: list[dict[str, Array]] = []
        self.sources: list[dict[str, Source]] = []
        self._allocate()
        read = any(s.field == "sensordata" for per in self.sources for s in per.values())
        self.batch = simulator.batches.get(
            len(trials) * self.candidates, contacts=contacts, sensors=controllers is not None or read
        )
        self.copies = MujocoCopies(self.compiled, self.batch)
        self._write_model(values)
        self.stepper = self._stepper(values, controllers)

    def simulate(self) -> bool:
        """Steps all rows to the end of their trials, reading off on the way. True if anything ever touched."""
        total = [self._steps(k) for k in range(len(self.trials))]
        fields = sorted({s.field for per in self.sources for s in per.values()})
        record = (*fields, "ncon") if self.contacts else tuple(fields)
        previous = {f: np.array(self.batch.bind(f))[:, None] for f in fields}
        touched, at = False, 0
        while at < max(total):
            active = sum(1 for t in total if t > at) * self.candidates
            count = min(_CHUNK, max(total) - at)
            history = self._advance(at, count, active, record)
            touched = touched or bool(self.contacts and np.any(history["ncon"]))
            joined = {f: np.concatenate([previous[f][:active], history[f]], axis=1) for f in fields}
            self._read(joined, at, count)
            previous = {f: np.ascontiguousarray(joined[f][:, -1:]) for f in fields}
            at += count
        self._blank_failures()
        return touched

    def rollouts(self) -> list[Rollout]:
        """What was read off, one Rollout a trial."""
        return [
            Rollout(trial, {name: self._seen(k, name) for name in self.out[k]}, self.failures[k])
            for k, trial in enumerate(self.trials)
        ]

    def _seen(self, trial: int, name: str) -> Array:
        """(b, T, k) a channel as it is measured: a quaternion as angles, in the turn in which they were measured."""
        values, observed = self.out[trial][name], self.trials[trial].observed[name]
        if not self.sources[trial][name].turned:
            return values
        measured = self.trials[trial].initial.get(name)
        return near(angles_of(values), measured.at(observed.time)) if measured is not None else angles_of(values)

    def _steps(self, trial: int) -> int:
        return int(np.ceil(self.trials[trial].duration / self.simulator.step + 1e-9)) + 1

    def _allocate(self) -> None:
        for trial in self.trials:
            sources, out = {}, {}
            for name, o in trial.observed.items():
                source = source_of(self.simulator.model, self.compiled, name, o.labels)
                if source is None:
                    raise ModelError(f"channel '{name}' of '{trial.name}' is no signal of '{self.simulator.name}'")
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
        model = self.simulator.model
        self.simulator.gains.scale(model, self.copies, [t.name for t in self.trials], self.candidates)
        qpos, qvel, joints = self.batch.bind("qpos"), self.batch.bind("qvel"), list(model.drives())
        for k, (q, v) in enumerate(self.signals.starts()):
            rows = slice(k * self.candidates, (k + 1) * self.candidates)
            qpos[rows], qvel[rows], places, speeds = start_state(self.compiled, self.trials[k], joints)
            qpos[rows, places], qvel[rows, speeds] = q, v
            if self.compiled.na:
                first = self.signals.commands(k, 0, 1, self.simulator.step)[:, 0]
                self.batch.bind("act")[rows] = activations(model, first, q)

    def _stepper(self, values: Array, controllers: ControllerFactory | None) -> Stepper:
        own = len(self.simulator.quantities)
        tiled = np.tile(values, (len(self.trials), 1))
        controller = controllers(tiled[:, own:]) if controllers is not None else None
        acting = laws(self.simulator.quantities, tiled[:, :own], self.simulator.model, self.copies)
        return stepper(self.batch, self.compiled, self.signals, acting, controller, self.simulator.step)

    def _advance(self, at: int, count: int, active: int, record: tuple[str, ...]) -> dict[str, Array]:
        clock = np.array(self.batch.bind("time")[:active])
        try:
            history = self.stepper.advance(at, count, active, record)
        except SimulationError as error:
            history = self.stepper.salvaged()
            for row in np.atleast_1d(error.ids):
                self._fail(int(row), self.batch.error(int(row)) or str(error))
        moved = self.batch.bind("time")[:active] - clock
        # A simulation that blows up stops (or is reset by the engine): its clock tells.
        for row in np.flatnonzero(np.abs(moved - count * self.simulator.step) > 0.5 * self.simulator.step):
            self._fail(int(row), f"the simulation became unstable after {at * self.simulator.step:.3g} s")
        return history

    def _fail(self, row: int, why: str) -> None:
        self.failures[row // self.candidates].setdefault(row % self.candidates, why)

    def _read(self, joined: dict[str, Array], at: int, count: int) -> None:
        for k in range(len(self.trials)):
            if self._steps(k) <= at:
                continue
            rows = slice(k * self.candidates, (k + 1) * self.candidates)
            ends = at + count >= self._steps(k)
            for name, source in self.sources[k].items():
                # Derived fields describe the state before each step: their history begins one step earlier.
                first = at - 1 if source.derived else at
                instants = self.signals.instants(k, name, self.simulator.step)
                history = np.ascontiguousarray(source.read(joined[source.field][rows]))
                read_off(
                    history, first, first + count, ends, instants, len(instants) == 1,
                    self.signals.bias(k, name, len(source.columns)),
                    self.out[k][name],
                )  # fmt: skip

    def _blank_failures(self) -> None:
        for out, failed in zip(self.out, self.failures, strict=True):
            for channel in out.values():
                for row in failed:
                    channel[row] = np.nan
                bad = ~np.isfinite(channel).all(axis=(1, 2))
                for row in np.flatnonzero(bad):
                    failed.setdefault(int(row), "the simulation gave values that are not finite")
