# SPDX-License-Identifier: Apache-2.0
"""What was known of a drive at each instant, from measurements until then: pose and velocities on the simulation's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.errors import RecordingError
from trueup.recording import Channel
from trueup.trial import Trial

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WINDOW = 0.25  # s: a parabola through this much of the past gives pose and velocity at its end
PAST = 2.0  # s of the past over which the model is compared with the car
SETTLE = 1.0  # s of commands before that, for servo and motor to forget where they started


@dataclass(frozen=True, eq=False)
class Drive:
    """One trial's commands, and what was seen, on a grid of `step` s from `begin` on the trial's clock."""

    begin: float
    step: float
    commands: Array
    """(G, 2) throttle and steering, held between their samples."""
    seen: Array
    """(G, 6) x, y, heading, forward and sideways speed, yaw rate; no sample after an instant counts at that instant."""
    known: Mask
    """(G,) where `seen` is known."""
    pasts: NDArray[np.int64]
    """(G,) for how many steps back it is known without a gap, at most PAST."""

    @classmethod
    def of(cls, trial: Trial, step: float) -> Drive:
        """From a trial's command and its measured 'position' and 'heading'. Raises RecordingError without them."""
        if trial.command is None or "position" not in trial.initial or "heading" not in trial.initial:
            raise RecordingError(
                f"trial '{trial.name}' needs commands, and a measured position and heading to start from"
            )
        begin = trial.start - PAST - SETTLE - step
        count = int(np.ceil((trial.duration + PAST + SETTLE) / step)) + 3
        grid = begin + step * np.arange(count, dtype=np.float64)
        commands = trial.command.select(("throttle", "steering")).at(grid, hold=True)
        seen, known = _seen(trial.initial["position"], trial.initial["heading"], grid, step)
        return cls(begin, step, np.ascontiguousarray(commands), seen, known, _pasts(known, round(PAST / step)))

    def index(self, time: float) -> int:
        """The last grid instant at or before a time."""
        return int(np.floor((time - self.begin) / self.step + 1e-6))

    def at(self, times: Array) -> Array:
        """(T, 5) x, y, heading, speed and yaw rate as seen at `times`."""
        grid = self.begin + self.step * np.arange(len(self.seen))
        return np.stack([np.interp(times, grid, self.seen[:, c]) for c in (0, 1, 2, 3, 5)], axis=1)

    @property
    def settle(self) -> int:
        """Steps of SETTLE."""
        return round(SETTLE / self.step)

    @property
    def earliest(self) -> int:
        """The first instant at which a stretch may begin: before it, there is no grid to settle on."""
        return round((PAST + SETTLE) / self.step)


def _seen(position: Channel, heading: Channel, grid: Array, step: float) -> tuple[Array, Mask]:
    good = np.isfinite(position.values).all(axis=1) & np.isfinite(heading.values[:, 0])
    seen, known = np.zeros((len(grid), 6)), np.zeros(len(grid), dtype=bool)
    if good.sum() < 3:
        return seen, known
    time = position.time[good]
    near = max(0.06, 2.5 * float(np.median(np.diff(time))))
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    measured = (time[after] - time[after - 1] < near) & (grid >= time[0]) & (grid <= time[-1])
    width = max(4, round(WINDOW / step) + 1)
    value, slope = _parabola(width, step)
    signals = [position.column("x")[good], position.column("y")[good], np.unwrap(heading.values[good, 0])]
    paths = [np.interp(grid, time, s) for s in signals]
    (x, dx), (y, dy), (angle, turn) = ((_past_only(p, value), _past_only(p, slope)) for p in paths)
    seen[:, :3] = np.stack([x, y, angle], axis=1)
    seen[:, 3] = np.cos(angle) * dx + np.sin(angle) * dy
    seen[:, 4] = -np.sin(angle) * dx + np.cos(angle) * dy
    seen[:, 5] = turn
    return seen, _run_lengths(measured) >= width


def _parabola(width: int, step: float) -> tuple[Array, Array]:
    """(width,) weights that give value and slope at the last of `width` samples."""
    t = step * np.arange(1 - width, 1)
    weights = np.linalg.pinv(np.stack([np.ones(width), t, t * t], axis=1))
    return weights[0], weights[1]


def _past_only(path: Array, weights: Array) -> Array:
    padded = np.concatenate([np.full(len(weights) - 1, path[0]), path])
    return np.convolve(padded, weights[::-1], mode="valid")


def _run_lengths(mask: Mask) -> NDArray[np.int64]:
    """(T,) how many True values in a row end here."""
    index = np.arange(1, len(mask) + 1)
    return index - np.maximum.accumulate(np.where(mask, 0, index))


def _pasts(known: Mask, longest: int) -> NDArray[np.int64]:
    return np.clip(_run_lengths(known) - 1, 0, longest).astype(np.int64)
