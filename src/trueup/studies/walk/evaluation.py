# SPDX-License-Identifier: Apache-2.0
"""What a walk is worth on the robot: some trials to the line, as the paper measured it, or many fresh runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from trueup.arrays import Array
from trueup.ends import ended
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.studies.walk.odds import expected_shares
from trueup.tasks.task import robot_trials
from trueup.tasks.walking import ANGLES, ARRIVED, PLACE, VEERED, LineWalk

Numbers = TypeVar("Numbers", float, Array)


@dataclass(frozen=True)
class Runs:
    """How runs to the line went."""

    speeds: tuple[float, ...] = ()
    """m/s of those that arrived."""
    falls: int = 0
    forward: float = 0.0
    """Of the falls, those with the nose down, the others are on the back; half of one where that was not measured."""
    veers: int = 0
    """Those that left their lane, or did not arrive in time."""
    seconds: float = 0.0
    """Robot time."""
    trials: int = 0
    """In which these runs were made: one that goes on to a second line is two runs."""
    recordings: tuple[Recording, ...] = field(default=(), repr=False, compare=False)

    @property
    def number(self) -> int:
        """How many runs."""
        return len(self.speeds) + self.failed

    @property
    def failed(self) -> int:
        """How many of them fell or veered."""
        return self.falls + self.veers

    @property
    def speed(self) -> float:
        """m/s, mean of those that arrived; NaN where none did."""
        return float(np.mean(self.speeds)) if self.speeds else float("nan")

    def __add__(self, other: Runs) -> Runs:
        return Runs(
            self.speeds + other.speeds, self.falls + other.falls, self.forward + other.forward, self.veers + other.veers,
            self.seconds + other.seconds, self.trials + other.trials, self.recordings + other.recordings,
        )  # fmt: skip

    def score(self, fall: float) -> float:
        """m/s, the mean of all runs where each that fell or veered counts as -`fall`."""
        return (float(np.sum(self.speeds)) - fall * self.failed) / max(self.number, 1)

    def worth(self, fall: float, share: float) -> float:
        """m/s that the walk is worth if it falls in this share of runs, of which each costs `fall` m/s; -`fall` at worst.

        The mean speed of arrivals is taken less its standard error.
        """
        if not self.speeds:
            return -fall
        spread = float(np.std(self.speeds, ddof=1)) / len(self.speeds) ** 0.5 if len(self.speeds) > 1 else 0.0
        return worth(self.speed - spread, share, fall)


def worth(speed: Numbers, share: Numbers, fall: float) -> Numbers:
    """What walks of such speeds are worth, in m/s, if they fall in such shares of runs, of which each costs `fall` m/s."""
    return (1.0 - share) * speed - share * fall


def expected_falls(runs: Sequence[Runs]) -> Array:
    """(n,) shares in which walks are expected to fall on the robot that has run them so; who veered off counts as fallen.

    Few runs of one walk say little, but all walks' runs together say how falls grow with speed (`odds`, each walk with a
    deviation of its own). Signals are logarithms of speeds, with the standard deviation 1/2 that the slope's prior is meant
    for; a walk that never arrived counts as fast as the fastest.
    """
    arrived = np.array([bool(r.speeds) for r in runs])
    logs = np.zeros(len(runs))
    if arrived.any():
        logs[arrived] = [np.log(r.speed) for r in runs if r.speeds]
        logs[~arrived] = logs[arrived].max()
    spread = float(np.sqrt(np.cov(logs, aweights=[r.number for r in runs], ddof=0))) if len(runs) > 1 else 0.0
    failed, made = np.array([(r.failed, r.number) for r in runs]).T
    return expected_shares(logs / (2.0 * spread) if spread > 0.0 else np.zeros(len(runs)), failed, made)


def outcome(recordings: Sequence[Recording], walk: LineWalk) -> Runs:
    """What recordings of runs to the line show: each lap is a run, the last one of those that did not arrive failed."""
    speeds, falls, forward, veers = list[float](), 0, 0.0, 0
    for run in recordings:
        end = ended(run)
        arrived = end is not None and end.name == ARRIVED
        reached = [*_passed(run, walk), *([end.at] if end is not None and arrived else [])]
        speeds += [walk.line / float(lasted) for lasted in np.diff([run.start, *reached])]
        if end is not None and end.name not in (ARRIVED, VEERED):
            falls += 1
            forward += _forward(run)
        elif not arrived:
            veers += 1
    seconds = sum(r.stop - r.start for r in recordings)
    return Runs(tuple(speeds), falls, forward, veers, seconds, len(recordings), tuple(recordings))


def _forward(run: Recording) -> float:
    """1 for a fall with the nose down, 0 for one on the back, a half where nothing says which."""
    if ANGLES not in run.channels:
        return 0.5
    pitch = run.channel(ANGLES).column("pitch")
    return float(pitch[np.isfinite(pitch)][-1] > 0.0)


def _passed(run: Recording, walk: LineWalk) -> list[float]:
    """When a run passed the lines before the last, those that it came to."""
    if walk.laps == 1:
        return []
    channel = run.channel(PLACE)
    ahead = np.maximum.accumulate(channel.column("x"))
    lines = walk.line * np.arange(1, walk.laps)
    return [float(np.interp(x, ahead, channel.time)) for x in lines[lines <= ahead[-1]]]


def at_once(robot: Robot, walk: LineWalk, candidate: Array, runs: int, label: str = "") -> Runs:
    """So many trials of one candidate (m,), whatever becomes of them."""
    trial = robot_trials(walk, candidate, label)[0]
    return outcome(robot.perform(replace(trial, repeats=runs)), walk)
