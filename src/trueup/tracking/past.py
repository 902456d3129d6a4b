# SPDX-License-Identifier: Apache-2.0
"""What was known of a drive at each instant, from measurements until then: pose and velocities on the simulation's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import ModelError, RecordingError
from trueup.instant import MOVING, REACH, usual_step
from trueup.noise import spread
from trueup.recording import Channel
from trueup.rounding import PRINTED, SAME_INSTANT
from trueup.samples import between, in_force_over
from trueup.tracking.channels import PLACE, READ
from trueup.tracking.rest import stood
from trueup.tracking.start import POSE_WINDOW, start_state
from trueup.trial import SETTLE, Trial

_COUNTS = (4, 5, 7, 9)  # samples at least in the shorter window: as many as foretell the next one best
PAST = 2.0  # s of the past over which the model is compared with the car
MOVES = 0.2  # m/s: slower, the direction of motion and the curvature of the way say nothing
_PLACES = 0.1  # s: stretches begin at multiples of it, so that they are the same at every integration step


@dataclass(frozen=True, eq=False)
class Past:
    """One trial's commands, and what was seen, on a grid of `step` s from `begin` on the trial's clock."""

    begin: float
    step: float
    commands: Array
    """(G, 2) speed or throttle, and steering."""
    seen: Array
    """(G, 5) x, y, heading, forward speed, yaw rate; no sample after an instant counts at that instant."""
    known: Mask
    """(G,) where `seen` is known."""
    lengths: Integers
    """(G,) for how many steps back it is known without a gap, at most PAST."""
    log_begin: Integers
    """(3,) the first instants with a command, before which that one is held, and with a command of a car that is seen; and
    whether it stood at the first: then nothing drove it before (1). Where the log begins with such a command, that may have
    been told for longer (2): whoever simulates a delay often has its first command in force from the start."""

    lag: int
    """Steps over which the forward speed is taken, by a line through their means."""

    doubt: Array
    """(4,) standard deviations of x, y (m), heading (rad) and forward speed (m/s) as they are seen at an instant."""

    earliest: int
    """The first instant at which a stretch may begin: before it, there is no grid to settle on."""

    @classmethod
    def of(cls, trial: Trial, step: float, labels: tuple[str, str], *, turned: bool = False) -> Past:
        """From a trial's command (throttle, held between its samples, and steering) and measured 'position' and 'heading'.
        What is `turned` by its second command stands only where that was none.

        Raises RecordingError without them.
        """
        if trial.command is None or "position" not in trial.initial or "heading" not in trial.initial:
            raise RecordingError(
                f"trial '{trial.name}' needs commands, and a measured position and heading to start from"
            )
        begin, grid = _grid(trial, step)
        told = trial.command.select(labels)
        commands = told.at(grid) if labels[0] == "speed" else in_force_over(told.time, told.values, grid, step)
        time, pose = _tracked(trial.initial["position"], trial.initial["heading"])
        seen, known, lag, doubt = _seen(time, pose, grid, step)
        lengths = np.clip(_run_lengths(known) - 1, 0, round(PAST / step)).astype(np.int64)
        commanded = int(np.searchsorted(grid, trial.command.time[0] - SAME_INSTANT))
        rested = known.any() and stood(time, pose, float(trial.command.time[0]))
        if rested:
            commands[:commanded, : 1 + turned] = 0.0  # where wheels of a car that stands point no speed tells
        older = rested and time[0] > trial.command.time[0] - SAME_INSTANT and bool(commands[commanded, 0])
        log_begin = np.array([commanded, max(commanded, int(np.argmax(known))), int(rested) + int(older)])
        earliest = round((trial.start - begin) / step)
        return cls(begin, step, np.ascontiguousarray(commands), seen, known, lengths, log_begin, lag, doubt, earliest)

    @classmethod
    def at_start(cls, trial: Trial, step: float, labels: tuple[str, str]) -> Past:
        """The same where nothing is seen but the start (see `start_state`), and commands go from sample to sample.

        Until the first command the speed is that of the start. Raises RecordingError for a trial without command.
        """
        if trial.command is None:
            raise RecordingError(f"trial '{trial.name}' has no command, and no controller is given")
        state, command = start_state(trial), trial.command.select(labels)
        begin, grid = _grid(trial, step, trial.start - float(command.time[0]))
        commands = between(grid, command.time, command.values)
        if labels[0] == "speed":
            commands[grid < command.time[0] - SAME_INSTANT, 0] = state[PLACE["speed"]]
        seen, known = np.zeros((len(grid), READ)), np.zeros(len(grid), dtype=bool)
        first = round((trial.start - begin) / step)
        seen[first], known[first] = state, True
        return cls(begin, step, commands, seen, known, np.zeros(len(grid), dtype=np.int64), np.zeros(3, dtype=np.int64), 2,
                   np.zeros(4), first)  # fmt: skip

    def index(self, time: float) -> int:
        """The last grid instant at or before a time."""
        return int(np.floor((time - self.begin) / self.step + PRINTED))

    def at(self, times: Array) -> Array:
        """(T, 5) x, y, heading, speed and yaw rate as seen at `times`."""
        grid = self.begin + self.step * np.arange(len(self.seen), dtype=np.float64)
        return between(times, grid, self.seen)

    @property
    def settle(self) -> int:
        """Steps of SETTLE."""
        return round(SETTLE / self.step)


def stretches_begin(past: Past, trial: Trial, horizon: float) -> Integers:
    """(S,) grid instants at which stretches begin: every `horizon` s, later where nothing was known then.

    Raises ModelError where nothing is known in all that was measured; the first moments of a drive may show too little.
    """
    every = max(1, round(_PLACES / past.step))
    last = past.index(trial.start + trial.duration)
    places = np.arange(past.earliest, last + 1, every)
    places = places[past.known[places]]
    found: list[int] = []
    for place in places.tolist():
        if not found or (place - found[-1]) * past.step > horizon - 0.5 * past.step:
            found.append(place)
    if not found and trial.start + trial.duration > trial.initial["position"].time[-1] - past.step:
        raise ModelError(f"trial '{trial.name}' never shows position and heading for long enough to start a prediction")
    return np.array(found, dtype=np.int64)


def first_state(drive: Past, least: float) -> Integers:
    """(1,) the first grid instant at which the car drives and all is known, if tracked for `least` s more; else (0,)."""
    begun = np.flatnonzero(drive.known & (np.abs(drive.seen[:, 3]) > _drives(drive)))[:1].astype(np.int64)
    return begun[drive.begin + drive.step * begun + least <= last_known(drive) + 0.5 * drive.step]


def last_known(drive: Past) -> float:
    """The last instant at which the car was tracked, in s."""
    known = np.flatnonzero(drive.known)
    return drive.begin + drive.step * float(known[-1]) if len(known) else -np.inf


def begun_at(drive: Past, longest: float, every: float) -> Integers:
    """(S,) grid instants, every `every` s, at which the car drives and from which it is tracked for `longest` s."""
    ahead, back = round(longest / drive.step), round(PAST / drive.step)
    missing = np.concatenate([[0], np.cumsum(~drive.known)])
    candidates = np.arange(drive.earliest + back, len(drive.known) - ahead - 1, max(1, round(every / drive.step)))
    tracked = missing[candidates + ahead + 1] == missing[candidates]
    return candidates[tracked & (np.abs(drive.seen[candidates, 3]) > _drives(drive))].astype(np.int64)


def _drives(drive: Past) -> float:
    """The speed in m/s from which it drives: MOVES, of robots that are never fast half of what they often exceed, but not the
    noise of what was tracked.
    """
    often = float(np.percentile(np.abs(drive.seen[drive.known, 3]), 85)) if drive.known.any() else 0.0
    return min(MOVES, max(0.5 * often, MOVING * float(drive.doubt[3])))


def _grid(trial: Trial, step: float, before: float = 0.0) -> tuple[float, Array]:
    """Where the grid begins, and its instants: the trial and what comes before it, at least `before` s, a multiple of `step`
    away.
    """
    lead = max(round((PAST + SETTLE) / step), int(np.ceil(before / step - PRINTED)))
    count = lead + int(np.ceil(trial.duration / step)) + 3
    begin = trial.start - lead * step
    return begin, begin + step * np.arange(count, dtype=np.float64)


def _tracked(position: Channel, heading: Channel) -> tuple[Array, Array]:
    """(T,) instants at which both were tracked, and (T, 3) x, y and heading without jumps."""
    good = np.isfinite(position.values).all(axis=1) & np.isfinite(heading.values[:, 0])
    angle = np.unwrap(heading.values[good, 0])
    return position.time[good], np.stack([position.column("x")[good], position.column("y")[good], angle], axis=1)


def _seen(time: Array, pose: Array, grid: Array, step: float) -> tuple[Array, Mask, int, Array]:
    seen, known = np.zeros((len(grid), READ)), np.zeros(len(grid), dtype=bool)
    if len(time) < 3:
        return seen, known, 2, np.zeros(4)
    near = max(0.06, 2.5 * usual_step(time))
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    measured = (time[after] - time[after - 1] < near) & (grid >= time[0]) & (grid <= time[-1])
    x, y, angle = (np.interp(grid, time, s) for s in pose.T)
    short, turn = (
        max(_COUNTS[0], round(max(POSE_WINDOW, _samples(p) * usual_step(time)) / step) + 1)
        for p in (pose[:, :2], pose[:, 2:])
    )
    # Forward and sideways speed of its own change more slowly than its pose.
    long = max(short, turn, round(REACH / step) + 1)
    value, _ = _at_the_end(short, step, 2)
    seen[:, :2] = np.stack([_past_only(p, value) for p in (x, y)], axis=1)
    value, slope = _at_the_end(turn, step, 2)
    seen[:, 2], seen[:, 4] = _past_only(angle, value), _past_only(angle, slope)
    # Along the car, step by step: a car that turns quickly bends its path within the window, not its speed.
    middle = angle - 0.5 * np.diff(angle, prepend=angle[0])
    dx, dy = (np.diff(p, prepend=p[0]) / step for p in (x, y))
    begins = np.flatnonzero(measured[1:-1] & ~measured[:-2]) + 1  # no way led there: the next step stands for it
    dx[begins], dy[begins] = dx[begins + 1], dy[begins + 1]
    value, slope = _at_the_end(long, step, 1)
    # Differences belong to the middle of a step.
    speed = np.cos(middle) * dx + np.sin(middle) * dy
    seen[:, 3] = _past_only(speed, value + 0.5 * step * slope)
    known = _run_lengths(measured) >= long
    of = zip(seen.T[:4], (x, y, angle, speed), (short, short, turn, long), strict=True)
    doubt = [_apart(s, p, known, w) for s, p, w in of]
    return seen, known, long, np.array(doubt)


def _apart(seen: Array, path: Array, known: Mask, width: int) -> float:
    """Standard deviation, whatever outliers there are, of what is `seen` from the past `width` instants from a parabola
    through as many to both sides; 0 where there are not as many.
    """
    if len(path) <= 2 * width:  # a slow receiver, cut short
        return 0.0
    around, _ = _weights(np.arange(-width, width + 1, dtype=np.float64), 2)
    inner = np.convolve(path, around[::-1], mode="same") - seen
    inner = inner[width:-width][known[width:-width] & known[2 * width :]]
    return float(spread(inner)) if len(inner) else 0.0


def _samples(points: Array) -> int:
    """How many of the last samples (T, k) a parabola should go through: more for noise, fewer for quick bends.

    A slow receiver's window of many samples lags behind what the car does; of few, it takes noise for motion.
    """
    found = []
    for count in _COUNTS:
        after = np.arange(1 - count, 1, dtype=np.float64)
        weights = np.array([1.0, 1.0, 1.0]) @ np.linalg.pinv(np.stack([after**k for k in range(3)], axis=1))
        if len(points) < 4 * count:
            return count
        foretold = np.stack([np.convolve(p, weights[::-1], mode="valid") for p in points.T], axis=1)[:-1]
        found.append(float(np.mean(np.minimum(*_squares(points[count:] - foretold)))))
    return _COUNTS[int(np.argmin(found))]


def _squares(off: Array) -> tuple[Array, Array]:
    """(T,) squares of what is off, and beside each the most that one sample may count (outliers)."""
    squares = np.sum(off**2, axis=1)
    return squares, np.full(len(squares), 20.0 * float(np.median(squares)))


def _at_the_end(width: int, step: float, degree: int) -> tuple[Array, Array]:
    """(width,) weights that give value and slope of a fitted polynomial at the last of `width` samples."""
    return _weights(step * np.arange(1 - width, 1, dtype=np.float64), degree)


def _weights(time: Array, degree: int) -> tuple[Array, Array]:
    """(T,) weights that give value and slope, at 0, of a polynomial that is fitted to samples at `time` (T,)."""
    weights = np.linalg.pinv(np.stack([time**k for k in range(degree + 1)], axis=1))
    return weights[0], weights[1]


def _past_only(path: Array, weights: Array) -> Array:
    padded = np.concatenate([np.full(len(weights) - 1, path[0]), path])
    return np.convolve(padded, weights[::-1], mode="valid")


def _run_lengths(mask: Mask) -> Integers:
    """(T,) how many True values in a row end here."""
    index = np.arange(1, len(mask) + 1)
    return index - np.maximum.accumulate(np.where(mask, 0, index))
