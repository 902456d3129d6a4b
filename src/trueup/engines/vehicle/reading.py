# SPDX-License-Identifier: Apache-2.0
"""What is read off a vehicle's run: which channels, at which instants, and what a controller commanded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.controllers.controller import Observation
from trueup.ends import LOOK, Ended, which_end
from trueup.engines.simulator import Rollout
from trueup.errors import ModelError, unknown_name
from trueup.recording import is_command
from trueup.rounding import SAME_INSTANT
from trueup.tracking.channels import CHANNELS, PLACE, READ
from trueup.trial import Trial


@dataclass(frozen=True)
class Orders:
    """What a controller commanded: times (n,) on the trial's clock and (b, n, 2)."""

    time: Array
    values: Array

    def at(self, time: Array) -> Array:
        """(b, T, 2) the command in force."""
        last = np.searchsorted(self.time, time + SAME_INSTANT, side="right") - 1
        return self.values[:, np.clip(last, 0, None)]


@dataclass(frozen=True)
class Reading:
    """The instants at which a trial is observed, each once, and where the channels find theirs."""

    times: Array
    """(T,) since the start of the trial, in s."""
    rows: dict[str, Integers]

    @classmethod
    def of(cls, trial: Trial) -> Reading:
        """For all that a trial observes. Raises ModelError for channels that a vehicle has not."""
        measured = {name: o for name, o in trial.observed.items() if not is_command(name)}
        for name, o in measured.items():
            if name not in CHANNELS or any(label not in CHANNELS[name] for label in o.labels):
                known = "; ".join(f"{k} ({', '.join(v)})" for k, v in CHANNELS.items())
                raise ModelError(f"a vehicle has no channel '{name}' ({', '.join(o.labels)}); it has: {known}")
        times = np.unique(np.concatenate([np.zeros(0), *(o.time for o in measured.values())]))
        return cls(times - trial.start, {name: np.searchsorted(times, o.time) for name, o in measured.items()})

    def rollout(
        self, trial: Trial, run: Array, orders: Orders | None, unusable: Integers, ends: Mapping[int, Ended]
    ) -> Rollout:
        """The Rollout of a run (b, T, 5) read off at `times`; rows that are `unusable` or not finite have failed."""
        channels = {}
        for name, o in trial.observed.items():
            if is_command(name) and orders is not None:
                channels[name] = orders.at(o.time)[:, :, [int(label == "steering") for label in o.labels]]
            else:
                channels[name] = run[:, self.rows[name]][:, :, [PLACE[label] for label in o.labels]]
        failures = {int(row): "a parameter is not finite" for row in unusable}
        rollout = Rollout(trial, channels, failures, {row: end for row, end in ends.items() if row not in failures})
        for name, channel in channels.items():
            lasted = rollout.lasted(name)
            channel[~lasted] = np.nan
            for row in np.flatnonzero((lasted & ~np.isfinite(channel).all(axis=2)).any(axis=1)):
                failures.setdefault(int(row), "the simulation gave values that are not finite")
        for channel in channels.values():
            channel[unusable] = np.nan  # these were never simulated
        return rollout


def first_look(trial: Trial, rows: Array, start: Array) -> Observation:
    """What a controller sees of b rows (b, columns) at the start (STATE,) of a trial."""
    pose = np.tile(start[:READ], (len(rows), 1))
    return Observation(0.0, pose[:, :3], pose[:, 3:], {}, trial)


class Ending:
    """Which of b rows of a trial have ended, by its conditions."""

    def __init__(self, trial: Trial, rows: int) -> None:
        self._trial, self._next = trial, 0.0
        self.alive = np.ones(rows, dtype=bool)
        self.ends: dict[int, Ended] = {}

    def look(self, now: float, state: Array) -> None:
        """Looks at states (b, 5), x, y, heading, speed and yaw rate, `now` s after the start, if it is time to."""
        if not self._trial.ends or now < self._next - SAME_INSTANT:
            return
        self._next += LOOK
        rows = np.flatnonzero(self.alive)
        seen = state[rows]
        try:
            views = [
                Observation(
                    now, seen[:, :3], seen[:, 3:], {}, self._trial,
                    {name: seen[:, [PLACE[label] for label in labels]] for name, labels in end.looks_at.items()},
                )
                for end in self._trial.ends
            ]  # fmt: skip
        except KeyError as error:
            raise unknown_name("label", error.args[0], PLACE, "what an end can look at of a vehicle") from None
        which = which_end(self._trial.ends, views, len(rows))
        for row, end in zip(rows[which >= 0].tolist(), which[which >= 0].tolist(), strict=True):
            self.ends[row] = Ended(self._trial.start + now, self._trial.ends[end].name)
            self.alive[row] = False
