# SPDX-License-Identifier: Apache-2.0
"""A simulator that replays each joint of a geared arm alone, a hundred times faster than the engine and nearly as exact.

Where gears make a joint stiff against all others, its drive decides its motion, and what the others do to it can be taken
from the motion that was measured. It says nothing of contacts, joint limits and drives that yield: compare it with the
engine where it is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.kernels import read_off
from trueup.articulated.lone_joint import Load, replay
from trueup.articulated.signals import Signals
from trueup.controllers.controller import ControllerFactory
from trueup.engines.mujoco.lone.drives import Driven, alone
from trueup.engines.mujoco.lone.loads import InverseDynamics
from trueup.engines.mujoco.run import Parametrised
from trueup.engines.mujoco.wiring import joint_id, source_of
from trueup.engines.simulator import Rollout, Simulator, refuse_unsupported
from trueup.errors import ModelError
from trueup.parameters import ParameterSpace
from trueup.recording import Channel, Recording
from trueup.rounding import whole_steps
from trueup.trial import Trial

_STATES = ("qpos", "qvel")
_BLOWN = "the simulation gave values that are not finite"


class LoneJoints:
    """A Simulator with the parameters of the engine's, for trials that carry the motion that was measured.

    `measured`: the positions of trials by their names, where those are not the trial's own.
    """

    def __init__(
        self, whole: Parametrised, dynamics: InverseDynamics, measured: Mapping[str, Channel], step: float
    ) -> None:
        self.whole, self.step = whole, step
        self._dynamics, self._measured = dynamics, measured

    @classmethod
    def of(
        cls, whole: Parametrised, trials: Sequence[Trial], known: InverseDynamics | None = None
    ) -> LoneJoints | None:
        """With what is `known` of the motions of these trials from another of the same engine. None where joints cannot be
        taken one by one: a free base, backlash, drives with a memory, or nothing measured of what moves.
        """
        if whole.controller is not None or not alone(whole.compiled, whole.quantities):
            return None
        if not all(_replayable(whole, trial) for trial in trials):
            return None
        # By name: a trial that begins elsewhere, or ends earlier, is carried along the same motion.
        measured = {trial.name: trial.initial["position"] for trial in trials}
        if any(measured[trial.name] is not trial.initial["position"] for trial in trials):
            return None
        dynamics = known or InverseDynamics(whole.batches.bare, whole.quantities)
        return cls(whole, dynamics, measured, whole.step)

    @property
    def dynamics(self) -> InverseDynamics:
        """What joints carry, which is the same for all steps and recordings of one model."""
        return self._dynamics

    @property
    def name(self) -> str:
        """The model's name."""
        return self.whole.name

    @property
    def parameters(self) -> ParameterSpace:
        """Those of the engine."""
        return self.whole.parameters

    def at_step(self, step: float) -> LoneJoints:
        """The same with another step; the loads stay."""
        return LoneJoints(self.whole, self._dynamics, self._measured, step)

    def shipped(self) -> Simulator:
        """The engine as it came."""
        return self.whole.shipped()

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """Those of the engine that are positions and speeds of joints."""
        return tuple(
            name
            for name in self.whole.observable(recording)
            if _readable(self.whole, name, recording.channel(name).labels)
        )

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """See Simulator. Raises ModelError with controllers: nothing here could be observed while it moves."""
        if controllers is not None:
            raise ModelError(
                f"simulator '{self.name}' replays joints one by one from recorded commands; it has no place for controllers"
            )
        refuse_unsupported(self.name, trials, "ends", "disturbances", "sensing")
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        signals = Signals(self.whole.model, self.whole.quantities, trials, values, self.step)
        sets, which = self._dynamics.sets(values)
        rigid = np.stack([self._dynamics.reference(own) for own in sets])
        done, beside = list[Rollout](), None
        for k, trial in enumerate(trials):
            driven = Driven(self.whole, signals, k, values, which, rigid, self.step, beside)
            beside = driven if driven.usual else beside
            done.append(self._replayed(signals, driven, k, trial, sets))
        return done

    def _replayed(self, signals: Signals, driven: Driven, k: int, trial: Trial, sets: Array) -> Rollout:
        """One trial, joint by joint; rows that agree in all that a joint feels are replayed once."""
        compiled = self.whole.compiled
        measured = self._measured.get(trial.name, trial.initial["position"])
        out = {name: np.empty((driven.rows, len(o.time), len(o.labels))) for name, o in trial.observed.items()}
        motion, stiffness = self._dynamics.motion(measured, signals.measured_start(k)[0])
        loads = [self._dynamics.loads(measured, own) for own in sets]
        steps = whole_steps(trial.duration, self.step) + 2
        for label in dict.fromkeys(label for o in trial.observed.values() for label in o.labels):
            joint = joint_id(compiled, label)
            columns = (
                np.stack([getattr(x, part)[:, joint] for x in loads]) for part in ("inertia", "torque", "position")
            )
            load = Load(motion.time - trial.start, np.ascontiguousarray(stiffness[:, joint]), *columns)
            drives, again = driven.alike(joint)
            history = np.empty((len(drives.delay), steps + 1, 2))
            replay(drives, driven.command(joint), load, self.step, history)
            for name, o in trial.observed.items():
                if label in o.labels:
                    self._read(signals, k, name, label, history, again, out[name])
        # What MuJoCo itself calls unstable: no joint alone may pass for a prediction where the engine would fail.
        whole = np.all([(np.abs(channel) < mujoco.mjMAXVAL).all(axis=(1, 2)) for channel in out.values()], axis=0)
        return Rollout(trial, out, {int(row): _BLOWN for row in np.flatnonzero(~whole)})

    def _read(
        self, signals: Signals, k: int, name: str, label: str, history: Array, again: Integers, out: Array
    ) -> None:
        """Reads one joint of one channel off the histories (u, steps, 2), each of which serves several rows of `out`."""
        labels = signals.trial(k).observed[name].labels
        column, source = labels.index(label), source_of(self.whole.model, self.whole.compiled, name, (label,))
        if source is None:
            raise ModelError(f"channel '{name}' of '{signals.trial(k).name}' is no signal of '{self.name}'")
        instants, bias = signals.instants(k, name, self.step, label), signals.bias(k, name, len(labels))
        shared = len(instants) == 1
        state = _STATES.index(source.field)
        states = history[:, :, state : state + 1] if shared else history[again][:, :, state : state + 1]
        seen = np.empty((len(states), out.shape[1], 1))
        rows = np.arange(len(states))
        read_off(states, rows, 0, history.shape[1] - 1, True, instants, shared, np.zeros((len(states), 1)), seen)
        out[:, :, column] = (seen[again] if shared else seen)[:, :, 0] + bias[:, column : column + 1]


def _replayable(whole: Parametrised, trial: Trial) -> bool:
    """Whether a trial carries the motion of all that it observes, as long as it is observed."""
    fewest = 5  # samples that a smoothed motion can be taken from
    if trial.controller is not None or trial.ends or trial.disturbances or trial.sensing:
        return False
    measured: Channel | None = trial.initial.get("position")
    if measured is None or len(measured.time) < fewest:
        return False
    first, last = measured.time[0], measured.time[-1]
    return all(
        _readable(whole, name, o.labels)
        and set(o.labels) <= set(measured.labels)
        and (first <= o.time[0] and o.time[-1] <= last)
        for name, o in trial.observed.items()
    )


def _readable(whole: Parametrised, name: str, labels: tuple[str, ...]) -> bool:
    source = source_of(whole.model, whole.compiled, name, labels)
    return source is not None and source.field in _STATES and source.second is None and not source.turned
