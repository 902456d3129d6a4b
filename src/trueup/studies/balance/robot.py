# SPDX-License-Identifier: Apache-2.0
"""A stand-in for the paper's humanoid: a Robot simulated in DART with a hidden truth, its recordings as a real one's.

Servos tell their angles in steps of 0.29 degrees; motion capture tells the torso's pose with noise, drop-outs and a clock
of its own; the robot is never put down quite the same way twice.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.articulated.simulator import ArticulatedSimulator
from trueup.ends import with_end
from trueup.engines.dart.model import of
from trueup.engines.simulator import Rollout
from trueup.errors import RecordingError, SimulationFailedError
from trueup.recording import Channel, Recording
from trueup.samples import between
from trueup.studies.balance.hidden import ENCODER, Truth, random_truth
from trueup.studies.balance.scenes import model_of
from trueup.trial import Observed, Trial

LEAD = 0.4
"""s that a robot is recorded before its motion begins (see `led`)."""
_PUT_DOWN = 0.8  # s before that, in which it comes to rest where it was put
_SCATTER = {POSITION: 0.002, ORIENTATION: 0.01}  # m and rad: as well as a hand puts a robot on a mark
_RATE, _CAPTURE = 50.0, 100.0  # Hz at which servos and motion capture tell
_NOISE = {POSITION: 0.0005, ORIENTATION: 0.004}  # m and rad of the motion capture
_LOST = 0.8, (0.02, 0.08)  # drop-outs a second, and how long each of them is, in s


@dataclass(frozen=True, eq=False)
class StandInHumanoid:
    """A simulated Robot in one scene; two of the same number hide the same truth in all scenes.

    What it draws depends on `number`, `seed` and the trial's name alone. Raises MissingExtraError without dartpy.
    """

    scene: str
    number: int
    seed: int = 0
    gap: float = 1.0
    """How far its truth is from the model file (`hidden.random_truth`)."""

    @property
    def repeatable(self) -> bool:
        """True: the same trial gives the same recordings."""
        return True

    @property
    def truth(self) -> Truth:
        """What it hides."""
        model = of(model_of(self.scene))
        joints = tuple(model.drives())
        limits = np.array([model.get("actuator.force_limit", a)[0] for a in model.drives().values()])
        return random_truth(
            np.random.default_rng([20160, self.number]), model.names("body")[1:], joints, limits, self.gap
        )

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot: 'command', 'position' of the joints, 'base_position' and 'base_orientation' of the torso.

        A run in which it falls ends there and says so. Raises RecordingError for a trial without commands.
        """
        if trial.command is None:
            raise RecordingError(f"trial '{trial.name}': this robot plays commands; plan the motion first")
        rng = np.random.default_rng([self.number, self.seed, zlib.crc32(trial.name.encode())])
        return [self._once(name, trial, rng) for name in trial.runs]

    def simulator(self, truth: Truth | None = None) -> ArticulatedSimulator:
        """The robot itself as a Simulator of one parameter, its delay: what nobody has who has a robot."""
        from trueup.studies.balance.body import HiddenModel

        known = truth or self.truth
        model = HiddenModel(of(model_of(self.scene)).file, known, self.scene == "stand-to-handstand")
        line = Declaration("delay", tie="all", nominal=known.delay)
        return ArticulatedSimulator(model, *declare(model, [line]))

    def _once(self, name: str, trial: Trial, rng: np.random.Generator) -> Recording:
        truth = self.truth.repeat(rng)
        time = trial.start + np.arange(int(trial.duration * 200.0) + 1) / 200.0
        labels = {"position": trial.command.labels if trial.command else (), POSITION: AXES, ORIENTATION: ANGLES}
        begun = replace(
            trial, start=trial.start - _PUT_DOWN, duration=trial.duration + _PUT_DOWN, initial=_put(trial.initial, rng),
            observed={n: Observed(x, "m" if n == POSITION else "rad", time) for n, x in labels.items()},
        )  # fmt: skip
        simulator = self.simulator(truth)
        (done,) = simulator.rollout([begun], simulator.parameters.nominal[None])
        if done.failures:
            raise SimulationFailedError(f"stand-in {self.number}, '{name}': {done.failures[0]}")
        return _measured(name, replace(done, trial=replace(begun, start=trial.start)), truth, rng)


def led(trial: Trial, seconds: float = LEAD) -> Trial:
    """The trial, begun so much earlier with its first pose held: what a robot does there tells where it really began."""
    return replace(trial, start=trial.start - seconds, duration=trial.duration + seconds)


def _put(initial: Mapping[str, Channel], rng: np.random.Generator) -> dict[str, Channel]:
    put = dict(initial)
    for name, deviation in _SCATTER.items():
        moved = deviation * rng.standard_normal(3) * ((1.0, 1.0, 0.0) if name == POSITION else (0.2, 0.2, 1.0))
        raised = np.array([0.0, 0.0, 0.001]) if name == POSITION else 0.0  # let go a little above
        put[name] = initial[name].replace(values=initial[name].values + moved + raised)
    return put


def _measured(name: str, done: Rollout, truth: Truth, rng: np.random.Generator) -> Recording:
    """What encoders and motion capture make of a run, up to its end; each on its own clock."""
    trial, run = done.trial, done.held()
    stop = done.ends[0].at + 0.1 if done.ends else np.inf  # the operator needs a moment
    channels = {"command": trial.command.replace(name="command")} if trial.command is not None else {}
    for role, observed in trial.observed.items():
        rate, clock = (_RATE, (0.0, 0.0)) if role == "position" else (_CAPTURE, (truth.clock, truth.drift))
        ticks = np.arange(np.floor((min(stop, observed.time[-1]) - trial.start) * rate) + 1.0) / rate + trial.start
        ticks = ticks[ticks <= observed.time[-1]]
        shown = (ticks - clock[0]) * (1.0 - clock[1])
        shown = np.clip(shown, observed.time[0], observed.time[-1])
        values = between(shown, observed.time, np.unwrap(run.channels[role][0], axis=0))
        if role == "position":
            zero = truth.servos.zero
            values = ENCODER * np.round((values + zero + 0.2 * ENCODER * rng.standard_normal(values.shape)) / ENCODER)
        else:
            values = values + _NOISE[role] * rng.standard_normal(values.shape)
        channels[role] = Channel(role, observed.labels, observed.unit, ticks, values)
    lost = _dropped(channels[POSITION].time, rng)
    for role in (POSITION, ORIENTATION):
        channels[role] = channels[role].replace(values=np.where(lost[:, None], np.nan, channels[role].values))
    made = Recording(name, channels, {"source": "stand-in humanoid"})
    return with_end(made, done.ends[0]) if done.ends else made


def _dropped(time: Array, rng: np.random.Generator) -> Mask:
    """(T,) where the motion capture lost its markers; never at the start, while the robot is at rest."""
    lost = np.zeros(len(time), dtype=bool)
    span = max(0.0, float(time[-1] - time[0]) - LEAD)
    for _ in range(rng.poisson(_LOST[0] * span)):
        begin = time[0] + LEAD + rng.uniform(0.0, span)
        lost |= (time >= begin) & (time < begin + rng.uniform(*_LOST[1]))
    return lost
