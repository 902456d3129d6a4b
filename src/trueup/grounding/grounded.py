# SPDX-License-Identifier: Apache-2.0
"""Any simulator, grounded: each controller's commands are changed to what makes the simulated joints move as the robot's."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Controller, ControllerFactory, Looking, Observation
from trueup.controllers.playback import Playback
from trueup.engines.simulator import REFUSED, Commanded, Forced, InPlaceOf, Rollout, Simulator
from trueup.errors import GroundingError
from trueup.grounding.grounding import Grounding
from trueup.instant import usual_step
from trueup.parameters import ParameterSpace
from trueup.rounding import SAME_INSTANT
from trueup.samples import SLIGHT
from trueup.trial import Trial


@dataclass(frozen=True)
class Refusal:
    """That a run asked for what the grounding had not learned."""

    time: float
    """Since the start of the trial, in s."""
    reason: str


class GroundedController:
    """A Controller that passes another one's commands through a grounding, for b copies in lockstep.

    What the grounding changes is found once a frame, as it was learned, and held; commands come as often as they are asked.
    `columns` names the joint of each command. `weights` (b, 2) go before the grounding's own. Rows that ask for what was not
    learned are kept in `refused`; they are commanded on as asked. Raises GroundingError for a period that does not fit.
    """

    def __init__(
        self, inner: Controller, grounding: Grounding, columns: Sequence[str], weights: Array | None = None
    ) -> None:
        self._inner, self._grounding, self._weights = inner, grounding, weights
        inputs = grounding.inputs
        missing = [j for j in inputs.commands if j not in columns]
        if missing:
            raise GroundingError(
                f"the grounding was learned for joint '{missing[0]}', which the simulator does not command; it commands: "
                f"{', '.join(columns)}"
            )
        self._columns = np.array([list(columns).index(j) for j in inputs.commands])
        self.period = min(inner.period, inputs.period)
        self._every = round(inputs.period / self.period)
        if abs(self._every * self.period - inputs.period) > SLIGHT * inputs.period:
            raise GroundingError(
                f"the controller's period of {1e3 * inner.period:g} ms does not divide the grounding's frame of "
                f"{1e3 * inputs.period:g} ms; learn with --period {inner.period:g}"
            )
        slower = inner.period / inputs.period
        if slower > 1.0 and abs(slower - round(slower)) > SLIGHT * slower:
            raise GroundingError(
                f"the controller's period of {1e3 * inner.period:g} ms is no whole number of the grounding's frames of "
                f"{1e3 * inputs.period:g} ms; learn with --period {inner.period:g}"
            )
        self.refused: dict[int, Refusal] = {}
        self.forced = inputs.commands if grounding.torque else ()
        self.torque = np.zeros((0, 0))
        self._past: deque[tuple[Array, Array]] = deque(maxlen=inputs.history)
        self._chain: deque[tuple[Array, Array]] = deque(maxlen=inputs.history)
        self._goal: Array | None = None

    @property
    def looks_at(self) -> dict[str, tuple[str, ...]]:
        """Channels that the grounding and the controller within want to see."""
        within = dict(self._inner.looks_at) if isinstance(self._inner, Looking) else {}
        own = self._grounding.inputs.looks_at
        for name, labels in within.items():
            if name in own and tuple(labels) != own[name]:
                raise GroundingError(f"the controller and its grounding look at different columns of '{name}'")
        return {**within, **own}

    def reset(self, observation: Observation) -> None:
        """Forgets the frames before."""
        self._inner.reset(observation)
        self._past.clear()
        self._chain.clear()
        self._goal = None
        self.refused = {}
        self._due, self._ticks = 0.0, 0
        self._asked = self._correction = np.zeros((0, 0))
        self._far = np.zeros((0, len(self._grounding.domain.blocks)), dtype=np.int64)

    def command(self, observation: Observation) -> Array:
        """(b, nu) the commands to give in place of those that the controller within asks for."""
        if observation.time >= self._due - SAME_INSTANT:
            self._asked = np.asarray(self._inner.command(observation), dtype=np.float64)
            self._due += self._inner.period
        if self._ticks % self._every == 0:
            self._correction = self._corrected(observation)
        self._ticks += 1
        out = np.array(self._asked)
        out[:, self._columns] += self._correction
        return out

    def _corrected(self, observation: Observation) -> Array:
        """(b, k) what is added to the commands of the learned joints in this frame."""
        inputs = self._grounding.inputs
        if "position" not in observation.channels:
            raise GroundingError("this simulator does not show its controllers the channel 'position' by its labels")
        asked = self._asked[:, self._columns]
        self._past.appendleft((np.array(observation.channels["position"]), asked))
        others = inputs.other_channels(observation.channels)
        X = self._inputs(self._past, others)
        goal = None
        if self._grounding.chained:
            seen, _ = self._past[0]
            own = np.array(seen)
            if self._goal is not None:
                own[:, self._grounding.inputs.position_columns] = self._goal
            self._chain.appendleft((own, asked))
            goal = self._goal = self._grounding.goal(self._inputs(self._chain, others))
        if self._weights is not None or self._grounding.weights[1]:
            self._watch(X, observation.time)
        # A residual is asked of the chain too: what the simulated joints are wrong by then does not come back through it.
        state = self._inputs(self._chain, others) if self._grounding.chained and self._grounding.residual else X
        correction = self._grounding.commands(state, self._weights, goal) - asked
        self.torque = self._grounding.torques(state, self._weights)
        correction[list(self.refused)] = 0.0
        self.torque[list(self.refused)] = 0.0
        return correction

    def _inputs(self, past: Sequence[tuple[Array, Array]], others: Sequence[Array]) -> Array:
        """(b, d) from the frames before, the present one first; before its first frame a run stood as it stands there."""
        frames = [past[min(k, len(past) - 1)] for k in range(self._grounding.inputs.history)]
        positions, commands = zip(*frames, strict=True)
        return self._grounding.inputs.row(positions, commands, others)

    def _watch(self, X: Array, now: float) -> None:
        """Counts how many frames in a row each run is outside of what was learned."""
        domain = self._grounding.domain
        far = domain.far(np.nan_to_num(X))
        self._far = np.where(far, (self._far if len(self._far) else 0) + 1, 0)
        over = self._far > domain.patience
        for row in np.flatnonzero(over.any(axis=1)):
            if int(row) not in self.refused:
                block = int(np.argmax(over[row]))
                frames = int(self._far[row, block])
                self.refused[int(row)] = Refusal(now, domain.reason(X[row], block, frames))


@dataclass(frozen=True, eq=False)
class GroundedSimulator(InPlaceOf):
    """A Simulator whose commands pass through a grounding. Rows that ask for what was not learned fail, and say why.

    With `extrapolate` they do not. `weights` (b, 2), one row for each row of values, go before the grounding's own.
    """

    whole: Simulator
    grounding: Grounding
    extrapolate: bool = False
    weights: Array | None = None

    @property
    def parameters(self) -> ParameterSpace:
        """What may be calibrated."""
        return self.whole.parameters

    def placed(self, trial: Trial) -> bool:
        """See `placed`. A grounding that looks at frames before may not begin where these are not there."""
        return self.grounding.inputs.history == 1 and not self.grounding.chained and super().placed(trial)

    def at_step(self, step: float) -> GroundedSimulator:
        """The same with another step."""
        return dataclasses.replace(self, whole=self.whole.at_step(step))

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """See Simulator. Recorded commands are played by a controller. Raises GroundingError where nothing commands."""
        made: list[list[GroundedController]] = [[] for _ in trials]
        # Each trial's own factory goes before that of the call, so every trial gets its own.
        changed = [self._grounded(t, controllers, kept) for t, kept in zip(trials, made, strict=True)]
        done = self.whole.rollout(changed, values, controllers)
        return [self._judged(r, t, kept) for r, t, kept in zip(done, trials, made, strict=True)]

    def _grounded(self, trial: Trial, controllers: ControllerFactory | None, made: list[GroundedController]) -> Trial:
        inner = trial.controller or controllers
        columns = self.whole.commanded if isinstance(self.whole, Commanded) else ()
        if self.grounding.torque and not isinstance(self.whole, Forced):
            raise GroundingError(
                f"simulator '{self.whole.name}' has no joints that can be pushed on: no residual torque here"
            )
        if inner is None:
            if trial.command is None:
                raise GroundingError(f"trial '{trial.name}' has neither a controller nor commands to play")
            inner = playing(self.whole, trial, self.grounding.inputs.period)
            columns = columns or trial.command.labels
        factory = inner

        def grounded(values: Array) -> Controller:
            made.append(GroundedController(factory(values), self.grounding, columns, self.weights))
            return made[-1]

        return dataclasses.replace(trial, controller=grounded)

    def _judged(self, rollout: Rollout, trial: Trial, made: Sequence[GroundedController]) -> Rollout:
        refused = {} if self.extrapolate else {row: r for c in made for row, r in c.refused.items()}
        failures = dict(rollout.failures)
        channels = {n: np.array(v) for n, v in rollout.channels.items()} if refused else rollout.channels
        for row, refusal in refused.items():
            failures.setdefault(row, f"{REFUSED} {refusal.time:.3g} s: {refusal.reason}")
            for name, observed in trial.observed.items():
                channels[name][row, observed.time > trial.start + refusal.time] = np.nan
        ends = {row: e for row, e in rollout.ends.items() if row not in refused}
        return dataclasses.replace(rollout, trial=trial, channels=channels, failures=failures, ends=ends)


def playing(simulator: Simulator, trial: Trial, frame: float) -> ControllerFactory:
    """A controller that plays a trial's commands, in the order in which the simulator takes them, several times a frame."""
    command = trial.command
    if command is None:
        raise GroundingError(f"trial '{trial.name}' has no commands to play")
    if isinstance(simulator, Commanded):
        labels, held = simulator.commanded, simulator.held(trial)
        each = [command.column(x) if x in command.labels else np.full(len(command.time), h)
                for x, h in zip(labels, held, strict=True)]  # fmt: skip
        command = command.replace(labels=labels, values=np.stack(each, axis=1), units=())
    played = command
    spacing = usual_step(command.time) if len(command.time) > 1 else frame
    period = frame / max(round(frame / spacing), 1)  # as often as it was commanded, in whole parts of a frame
    return lambda values: Playback(played, len(values), period=period, start=trial.start)
