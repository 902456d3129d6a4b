# SPDX-License-Identifier: Apache-2.0
"""Whole-body transitions of a humanoid, such as sitting to standing: keyframed motions in, how well it stood out.

J. Tan et al., "Simulation-based design of dynamic controllers for humanoid balancing", IROS 2016, section V.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.chance import Buffeting, Push
from trueup.controllers.controller import Observation
from trueup.controllers.keyframes import Keyframes, Motion, Tilt
from trueup.ends import End, Fallen
from trueup.engines.simulator import Rollout
from trueup.errors import ParameterError, unknown_name
from trueup.parameters import ParameterSpace
from trueup.recording import Channel
from trueup.rounding import SAME_INSTANT
from trueup.trial import Observed, Trial
from trueup.units import GRAVITY

FITNESS = ("paper", "repaired")
ANGLES, HEIGHT = "base_orientation", "base_position"
_AT_REST = 0.005  # rad/s and m/s, of all joints and the base at once: a fall from there takes longer than is watched
_TURNING = "base_turning"
_EPSILON = 0.1  # rad, in the paper's integrand 1 / (|angle| + 0.1)
_NEAREST = 0.1  # beside 1 for standing all the time


@dataclass(frozen=True, eq=False)
class Settled:
    """An End of simulated runs: the motion is over, and nothing moves any more, or `after` s have gone by since.

    It needs to know the motion, so recordings and runs of planned commands do not end so; nor do runs that are pushed, of
    which nobody knows whether they are over.
    """

    motion: Motion
    after: float
    name: str = "settled"

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """See End: nothing by its name."""
        return {}

    def reached(self, observation: Observation) -> Mask:
        """See End."""
        pushed = observation.trial is not None and any(
            isinstance(d, (Push, Buffeting)) for d in observation.trial.disturbances
        )
        if observation.settings is None or pushed:
            return np.zeros(len(observation.position), dtype=bool)
        since = observation.time - self.motion.arrivals(observation.settings)
        if not (since > 0.0).any():
            return np.zeros(len(since), dtype=bool)
        # MuJoCo's speeds are those of the base too; DART tells its turning beside those of the joints.
        speeds = [observation.velocity, *(v for n, v in observation.sensors.items() if n == _TURNING)]
        fastest = np.max([np.abs(v).max(axis=1, initial=0.0) for v in speeds], axis=0)
        return (since > self.after) | ((since > 0.0) & (fastest < _AT_REST))


@dataclass(frozen=True)
class Standing:
    """How a robot has to stand at the end: what a small humanoid does; others may be asked for more or less."""

    lasting: float = 0.5
    """s at the end over which it must be upright, high and still."""
    upright: float = 0.25
    """rad: one that leans further does not come back by itself."""
    high: float = 0.93
    """Share of the settled final height: below, a knee or a hand carries it."""
    still: float = 0.5
    """rad/s of tilting, in the mean."""


@dataclass(frozen=True, eq=False)
class Transition:
    """A Task: the keyframes and times with which a humanoid gets from one pose to another, and stays there.

    Every candidate stands or falls as it is `after` s after its last keyframe (the paper's T + 1), where simulated runs end;
    scores are over the same time for all, the longest motion and `after`, for which what was last seen is kept. The score
    is minus a fitness. 'paper' is theirs as printed, eq. 3: the integral of 1 / (|angle| + 0.1) from 0 to T + 1, which grows
    with T and pays for waiting and then falling. 'repaired' (default) counts what is gained over the start: the mean over the
    trial of their integrand times the square of the share of the final height, both at most 1, less what the start has of it,
    so that waiting earns nothing. And how near it ever came to being upright, high and about to rest (extrapolated centre of
    mass: A. L. Hof et al., J. Biomechanics 38, 2005), with a small weight: it compares those who fall at once, and would hide
    how long the others stood.
    """

    name: str
    motion: Motion
    start: Mapping[str, Channel]
    """Measured or settled state at the start: 'position', 'base_position', 'base_orientation' at one instant."""
    final_height: float
    """Of the base in the settled final pose, in m."""
    inverted: bool = False
    """Upside down at the end: a handstand."""
    fitness: str = "repaired"
    rate: float = 50.0
    """Of observation, in Hz."""
    period: float = 0.008
    """Between two commands, in s."""
    tilt: Tilt | None = None
    """For motions with feedback."""
    fallen: float = 0.5
    """Share of the final height below which a run ends, once its start is behind it; 0: runs never end early."""
    standing: Standing = Standing()
    after: float = 1.0
    """s that the robot has to keep its final pose before it is judged."""
    parameters: ParameterSpace = field(init=False)
    trials: tuple[Trial, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Makes the one trial. Raises UnknownNameError for other fitnesses, ParameterError without a start."""
        if self.fitness not in FITNESS:
            raise unknown_name("fitness", self.fitness, FITNESS, "a transition")
        for name in ("position", HEIGHT, ANGLES):
            if name not in self.start:
                raise ParameterError(
                    f"transition '{self.name}': its start lacks '{name}'; it has {', '.join(self.start)}"
                )
        object.__setattr__(self, "parameters", self.motion.parameters())
        object.__setattr__(self, "trials", (self._trial(),))

    @property
    def duration(self) -> float:
        """Of the trial, in s."""
        return self.motion.latest + self.after

    def controllers(self, values: Array) -> Keyframes:
        """The controller of b copies with values (b, m)."""
        return self.motion.controller(values, period=self.period, tilt=self.tilt)

    def planned(self, candidate: Array) -> tuple[Trial, ...]:
        """The trial with the command channel of one candidate, for robots that play commands.

        With feedback it brings its controller too: a robot that plays commands alone does without the feedback.
        """
        arrival = float(self.motion.arrivals(candidate[None])[0])
        command = self.motion.command(candidate, rate=1.0 / self.period, lasting=self.duration - arrival)
        (trial,) = self.trials
        own = (lambda values: self.controllers(np.tile(candidate, (len(values), 1)))) if self.motion.feedback else None
        return (replace(trial, command=command, controller=own),)

    def watched(self, candidate: Array) -> Trial:
        """`planned`, until it is judged: all that a robot has to be recorded for."""
        (trial,) = self.planned(candidate)
        stop = float(self.motion.arrivals(candidate[None])[0]) + self.after
        seen = {n: replace(o, time=o.time[o.time < stop + 1.0 / self.rate]) for n, o in trial.observed.items()}
        return replace(trial, duration=min(stop + 1.0 / self.rate, trial.duration), observed=seen)

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        """(b,) minus the fitness, NaN where a simulation failed or nothing was measured. See Task.score."""
        (rollout,) = rollouts
        angle, height, rate = self._seen(rollout)
        time, arrival = rollout.trial.observed[ANGLES].time, self.arrivals(rollout)
        if self.fitness == "paper":
            counted = np.clip((arrival + self.after)[:, None] - time[:-1], 0.0, 1.0 / self.rate)
            return -(counted / (angle[:, :-1] + _EPSILON)).sum(axis=1)
        high = np.clip(height / self.final_height, 0.0, 1.0) ** 2
        value = high * _EPSILON / (angle + _EPSILON)
        gained = np.maximum(value - value[:, :1], 0.0).mean(axis=1)
        # Of a pendulum as long as the robot is high: zero if it is going to come to rest upright (capture point).
        capture = np.minimum(np.hypot(angle, rate * np.sqrt(self.final_height / GRAVITY)), np.pi)
        nearest = (high * (0.5 * (1.0 + np.cos(capture)) + _EPSILON / (capture + _EPSILON))).max(axis=1)
        return -(gained + _NEAREST * nearest)

    def arrivals(self, rollout: Rollout) -> Array:
        """(b,) when each motion reaches its last pose, in s; the latest that may be where nobody says which motion it was."""
        if rollout.settings is None:
            return np.full(len(rollout.channels[ANGLES]), self.duration - self.after)
        return self.motion.arrivals(rollout.settings)

    def succeeded(self, rollouts: Sequence[Rollout]) -> Mask:
        """(b,) whether it ended upright (or inverted), high and still, by simulations and recordings alike."""
        (rollout,) = rollouts
        angle, height, rate = self._seen(rollout)
        away = rollout.trial.observed[ANGLES].time - self._judged(rollout)[:, None]
        last = (away > -self.standing.lasting + SAME_INSTANT) & (away <= SAME_INSTANT)
        over = {row for row, end in rollout.ends.items() if end.name != Settled.name}
        whole = np.array([row not in over and row not in rollout.failures for row in range(len(angle))])
        with np.errstate(invalid="ignore"):
            return (
                whole & ~np.any(last & ~(angle < self.standing.upright), axis=1)
                & (np.mean(rate, axis=1, where=last) < self.standing.still)
                & ~np.any(last & ~(height > self.standing.high * self.final_height), axis=1)
            )  # fmt: skip

    def _judged(self, rollout: Rollout) -> Array:
        """(b,) when each run is judged, in s: `after` s after its motion; where it is pushed, at the end of its trial."""
        pushed = any(isinstance(d, (Push, Buffeting)) for d in rollout.trial.disturbances)
        return self.arrivals(replace(rollout, settings=None) if pushed else rollout) + self.after

    def _seen(self, rollout: Rollout) -> tuple[Array, Array, Array]:
        """(b, T) angle of the torso from the wanted direction in rad, height in m, and size of the tilt's rate in rad/s."""
        held = rollout.held()
        kept = {name: self._kept(rollout, held.channels[name]) for name in (ANGLES, HEIGHT)}
        roll, pitch, _ = np.moveaxis(kept[ANGLES], 2, 0)
        cosine = np.cos(roll) * np.cos(pitch) * (-1.0 if self.inverted else 1.0)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        rate = np.abs(np.gradient(angle, 1.0 / self.rate, axis=1))
        return angle, kept[HEIGHT][:, :, 2], rate

    def _kept(self, rollout: Rollout, values: Array) -> Array:
        """(b, T, k) held from the last sample on, in runs that were watched until they are judged."""
        known = np.isfinite(values).all(axis=2)
        last = np.maximum.accumulate(np.where(known, np.arange(values.shape[1]), 0), axis=1)
        whole = rollout.trial.observed[ANGLES].time[last.max(axis=1)] > self._judged(rollout) - 1.5 / self.rate
        return np.where(whole[:, None, None], np.take_along_axis(values, last[:, :, None], axis=1), values)

    def _trial(self) -> Trial:
        time = np.arange(round(self.duration * self.rate) + 1) / self.rate
        lowest = min(self.final_height, float(self.start[HEIGHT].column("z")[0]))
        fallen = (Fallen(height=self.fallen * lowest),) if self.fallen > 0.0 else ()
        ends: tuple[End, ...] = (*fallen, Settled(self.motion, self.after))
        return Trial(
            name=self.name, start=0.0, duration=float(time[-1]), command=None, initial=self.start, ends=ends,
            observed={
                "position": Observed(self.motion.joints, "rad", time),
                HEIGHT: Observed(("x", "y", "z"), "m", time),
                ANGLES: Observed(("roll", "pitch", "yaw"), "rad", time),
            },
            notes=(
                "Angles of the torso: roll, pitch, yaw in rad, x forward, z up. The first pose is held before the start; the "
                f"run counts until {self.after:g} s after the longest motion, whatever happens.",
            ),
        )  # fmt: skip
