# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulator: candidates x trials in one batch on native threads, failed simulations reported, never fatal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.assignments import Assignment, acts_in_each_step, needs
from trueup.articulated.declarations import SOFTNESS, Declaration, alike, declare, lacking, of_contacts, undeclared
from trueup.articulated.gains import Gains
from trueup.articulated.proportion import grown, proportion
from trueup.articulated.signals import Signals
from trueup.articulated.starts import measured_base
from trueup.articulated.wiring import joints_commanded
from trueup.controllers.controller import ControllerFactory, as_declared
from trueup.cores import in_turns, shares
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.batches import Batches
from trueup.engines.mujoco.engine_log import unlogged
from trueup.engines.mujoco.gears import SECOND
from trueup.engines.mujoco.model import Model, needs_shapes, prepared
from trueup.engines.mujoco.run import Run
from trueup.engines.mujoco.setup.footsteps import with_pose
from trueup.engines.mujoco.setup.tendons import leading
from trueup.engines.mujoco.stepping import unclocked
from trueup.engines.mujoco.trees import Trees
from trueup.engines.mujoco.wiring import actuators_of, source_of
from trueup.engines.simulator import CONTACTS, Rollout, Simulator
from trueup.errors import ModelError
from trueup.parameters import ParameterSpace, concatenate
from trueup.proportion import Proportion
from trueup.reckoned import reckoned_of
from trueup.recording import Recording, is_command
from trueup.trial import STEP, Trial, command_of

if TYPE_CHECKING:
    from trueup.engines.mujoco.lone.loads import InverseDynamics

_ROWS = 4096
"""Simulations at once, of which a robot on four legs takes 12 kB each: thousands of windows with all their starts took GB."""


class MujocoSimulator:
    """A robot model whose parameters can be written into every simulation of a batch (see `simulator.Simulator`).

    `quantities[i]` says what parameter i sets. With a `controller`, the parameters of `controller_parameters` follow
    those of the model and are handed to it. `step` in s; `threads` native threads (None: all this process may use).
    `gains`: what the recordings say of the servos' settings.
    """

    def __init__(
        self, model: Model, space: ParameterSpace | None = None, quantities: Sequence[Assignment] = (), *,
        step: float = STEP, threads: int | None = None, controller: ControllerFactory | None = None,
        controller_parameters: ParameterSpace | None = None, gains: Gains | None = None,
    ) -> None:  # fmt: skip
        own = space if space is not None else ParameterSpace(())
        self.model = model
        self.quantities = tuple(quantities)
        self.step = step
        self.controller = controller
        self.gains = gains or Gains()
        self.parameters = concatenate([own, controller_parameters]) if controller_parameters is not None else own
        self._threads = threads
        self.batches = self._prepare()
        self._trees = Trees.of(self.compiled, self.quantities, len(self.parameters))
        # None until a run with contacts has shown whether anything touches anything.
        self._touching: bool | None = None if self._can_touch() else False
        self._learning = True
        self._carried: list[InverseDynamics] = []  # of the joints one by one, shared by twins: motions do not change

    def __getstate__(self) -> dict[str, object]:
        """In another process nothing is learned from one call for the next: it must not matter who was asked what before."""
        return {**self.__dict__, "_learning": False, "_carried": [], "_threads": None}

    @property
    def name(self) -> str:
        """The model file's name without its ending."""
        return self.model.name

    @property
    def period(self) -> float:
        """Time between two commands of the simulator's own controller, in s; 0 without one."""
        own = self.parameters.nominal[None, len(self.quantities) :]
        return 0.0 if self.controller is None else float(self.controller(own).period)

    def shipped(self) -> MujocoSimulator:
        """The same model as it came: no parameter applied, the same step."""
        own = as_declared(self.controller, self.parameters.nominal[len(self.quantities) :])
        return MujocoSimulator(self.model, step=self.step, threads=self._threads, controller=own, gains=self.gains)

    def with_parameters(self, space: ParameterSpace) -> MujocoSimulator:
        """The same simulator with other nominal values or frozen flags (names and order must stay)."""
        if space.names != self.parameters.names:
            raise ModelError("with_parameters needs the same parameters in the same order")
        return self._changed(parameters=space)

    def with_gains(self, gains: Gains) -> MujocoSimulator:
        """The same simulator for recordings that say other things of the servos' settings."""
        return self._changed(gains=gains)

    def at_step(self, step: float) -> MujocoSimulator:
        """The same simulator with another step, in s: coarser for a first search, finer to verify."""
        return self._changed(step=step, batches=self.batches.at_step(step))

    def _changed(self, **changes: object) -> MujocoSimulator:
        """A twin with some attributes of its own; it shares what was compiled."""
        twin = object.__new__(MujocoSimulator)
        twin.__dict__.update(self.__dict__ | changes)
        return twin

    def approximation(self, trials: Sequence[Trial]) -> Simulator | None:
        """Each joint alone, where gears let joints be taken so (see `lone`)."""
        from trueup.engines.mujoco.lone.lone_joints import LoneJoints

        found = LoneJoints.of(self, trials, next(iter(self._carried), None))
        if found is not None:
            self._carried[:] = [found.dynamics]
        return found

    def related(self) -> MujocoSimulator | None:
        """See `engines.simulator.Related`: what is not declared at its joints and drives."""
        joints = self.model.scalar_joints()
        led = {*joints} - {*leading(self.model, joints)}
        return self._with(undeclared(self.model, self.quantities, [j for j in joints if j in led]), led)

    def structures(self) -> dict[str, Simulator]:
        """See `engines.simulator.Related`."""
        lines = lacking(self.model, self.quantities)
        if self.touches and all(a.kind != SOFTNESS for a in self.quantities):
            lines[CONTACTS] = of_contacts(self.model)
        known = {name: self._with(own) for name, own in lines.items()}
        return {name: simulator for name, simulator in known.items() if simulator is not None}

    def rivals(self) -> list[tuple[MujocoSimulator, dict[str, tuple[str, ...]]]]:
        """See `engines.simulator.Related`."""
        found = []
        for group in alike(self.model, lacking(self.model, self.quantities)):
            simulator = self._with([line for lines in group.values() for line in lines])
            if simulator is not None:
                names = {name: declare(self.model, lines)[0].names for name, lines in group.items()}
                found.append((simulator, names))
        return found

    def proportion(self, space: ParameterSpace) -> Proportion | None:
        """See `trueup.proportion.Weighed`."""
        return proportion(self.model, space, self.quantities)

    def grown(self, space: ParameterSpace) -> Mapping[str, str]:
        """See `trueup.proportion.Weighed`."""
        return grown(self.model, space, self.quantities)

    def _with(self, lines: Sequence[Declaration], led: Set[str] = frozenset()) -> MujocoSimulator | None:
        """The same with further parameters behind its own, where it can have any; no motion tells those of joints `led`."""
        space, more = declare(self.model, lines)
        if not more or len(self.parameters) > len(self.quantities):
            return None
        told = [led.isdisjoint(quantity.targets) for quantity in more]
        further = [p.replace(identifiable=t) for p, t in zip(space.parameters, told, strict=True)]
        whole = concatenate([self.parameters, ParameterSpace(tuple(further))])
        other = MujocoSimulator(self.model, whole, (*self.quantities, *more), step=self.step, threads=self._threads,
                                controller=self.controller, gains=self.gains)  # fmt: skip
        if other._touching is None:  # known of the same bodies: contacts cost several times what all else does
            other._touching = self._touching
        return other

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The measured channels that this model can reproduce. Raises UnknownNameError for joints it does not have."""
        command = command_of(recording)
        if command is not None and self.controller is None:
            actuators_of(self.model, command)
        reckoned = reckoned_of(recording)
        measured = [c for name, c in recording.channels.items() if not is_command(name) and name not in reckoned]
        return tuple(c.name for c in measured if source_of(self.model, self.compiled, c.name, c.labels) is not None)

    @property
    def commanded(self) -> tuple[str, ...]:
        """(width,) the joint that each column of a controller's command drives."""
        return joints_commanded(self.model)

    @property
    def forced(self) -> tuple[str, ...]:
        """The joints on which a controller may push past all drives."""
        return self.model.scalar_joints()

    def placed(self, trial: Trial) -> bool:
        """See `engines.simulator.Floating`."""
        return free_joint(self.compiled) < 0 or measured_base(trial) is not None

    @property
    def touches(self) -> bool:
        """Whether anything touched anything in what was simulated."""
        return self._touching is True

    def passive(self, trial: Trial) -> bool:
        """See `engines.floating.Passive`."""
        return self.touches and self.swings(trial)

    def swings(self, trial: Trial) -> bool:
        """See `engines.floating.Passive`. What tendons and equalities move counts as driven."""
        seen, driven = trial.observed.get("position"), self.model.actuator_of_joint()
        return not (self.compiled.ntendon or self.compiled.neq or seen is None or driven.keys() >= set(seen.labels))

    def reckoned(self, recording: Recording) -> Recording | None:
        """See `engines.simulator.Reckoning`."""
        return with_pose(self.model, recording)

    def held(self, trial: Trial) -> Array:
        """(width,) what is told to drives that nobody commands in a trial."""
        return Signals(self.model, (), [trial], np.zeros((1, 0))).hold(0)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """Simulates every trial for every row of values (b, n). See `Simulator.rollout`."""
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        verifying = len(values) == 1
        contacts = self._touching is not False or self._has_floor or (verifying and self._can_touch())
        controllers = controllers or self.controller
        trees = None if contacts or verifying or controllers is not None else self._trees
        if trees is None or not all(map(trees.alone, trials)):
            return self._run(trials, values, controllers, contacts)
        rows, where = trees.packed(values)
        done = [trees.unpacked(r, where) for r in self._run(trials, rows, None, contacts)]
        return [self._by_themselves(rollout, values) if rollout.failures else rollout for rollout in done]

    def _by_themselves(self, rollout: Rollout, values: Array) -> Rollout:
        """With those rows anew that may have failed for what another row does."""
        rows = sorted(rollout.failures)
        (again,) = self._run([rollout.trial], values[rows], None, False)
        for name, seen in again.channels.items():
            rollout.channels[name][rows] = seen
        return replace(rollout, failures={rows[k]: reason for k, reason in again.failures.items()})

    def _run(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None, contacts: bool
    ) -> list[Rollout]:
        order = sorted(range(len(trials)), key=lambda k: -trials[k].duration)
        at_once = max(1, _ROWS // len(values))
        with unclocked(), unlogged():
            runs = [
                self._at_once([trials[k] for k in order[first : first + at_once]], values, controllers, contacts)
                for first in range(0, len(order), at_once)
            ]
        if contacts and self._learning:
            self._touching = any(touched for _, touched in runs)
        done = dict(zip(order, chain(*(rollouts for rollouts, _ in runs)), strict=True))
        return [done[k] for k in range(len(trials))]

    def _at_once(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None, contacts: bool
    ) -> tuple[list[Rollout], bool]:
        """Their rollouts, and whether anything touched; the engine steps some of them while controllers act in others."""
        stepwise = acts_in_each_step(self.quantities, values[:, : len(self.quantities)])
        count = 1 if stepwise else self.batches.side_by_side(len(values), contacts)
        parts = shares([bool(trial.controller or controllers) for trial in trials], count)
        runs = [
            Run(self, [trials[k] for k in part], values, controllers, contacts, (i, len(parts)))
            for i, part in enumerate(parts)
        ]
        in_turns([run.simulate() for run in runs], self.batches.threads)
        done = dict(zip(chain(*parts), chain(*(run.rollouts() for run in runs)), strict=True))
        return [done[k] for k in range(len(trials))], any(run.touched for run in runs)

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
            second={kind: needs(self.quantities, kind) for kind in SECOND},
            limited=needs(self.quantities, "limit"),
            stopped=needs(self.quantities, "stop"),
            held=bool(needs(self.quantities, "held")),
            floor=self._has_floor,
            sliding=any("world.floor_friction" in a.quantity.attributes for a in self.quantities),
        )
        whole = prepare()
        shaped = needs_shapes(whole) or bool(needs(self.quantities, "shapes"))
        return Batches(whole, whole if shaped or self._has_floor else prepare(bare=True), self._threads)

    def _can_touch(self) -> bool:
        m = self.compiled
        return bool(m.npair or np.any((m.geom_contype != 0) | (m.geom_conaffinity != 0)))
