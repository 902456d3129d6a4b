# SPDX-License-Identifier: Apache-2.0
"""How long replays may be that begin at measured instants, and recordings cut into windows of some length."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.floating import passive, placed, swings
from trueup.inspection.repeats import BASE
from trueup.loop.condensing import cut
from trueup.loop.problem import WORTH, Problem
from trueup.loop.shoot import Starts
from trueup.parameters import ParameterSpace
from trueup.rounding import SAME_INSTANT, TINY
from trueup.samples import MOST
from trueup.trial import Trial

GROWN = 5.0
"""Times an error at the start of a window may grow in it."""
LOUD = 20.0
"""Times the noise that an error at the start of a window may come to in it. Of ten drawn torque arms (`torque_arms`) windows
that end at 5, 20, 80 times leave friction, damping and inertia of joints that move off by 7, 0.6, 12 % (root mean square).
"""

SKILLED = 1.0 / 3.0
"""Of the time for which replays have skill. A UR10 that begins with 3.4 s of it is 60 mrad off in what was left out, half a
second at a time; calibrated in windows of 1, 1.1, 1.8 s: 52, 52, 99; in 2.4, 3.2, 4.8 s, by slopes: 64, 160, 248.
"""

OFF = 0.03
"""Of their boxes, by which parameters are changed for that: gains by a quarter, as files are often off."""


def window_length(problem: Problem, values: Array) -> float:
    """How long trials may be in s, so that an error at their start grows fivefold at most, and comes to `LOUD` times the
    noise of what is measured at most, and a third of the time in which torques lead less astray than standing still.
    Inf where all lasts. Where joints swing that nothing drives, noise is multiplied in few of many windows and decides the
    loss there: the root mean square over windows counts, elsewhere the median.

    Two starts a standard deviation of the measurements apart are followed at values (n,), in each part of every trial. Their
    distance counts speeds by how far these lead until then, so that what drifts apart steadily does not grow: only what is
    unstable does, at the rate of its largest Lyapunov exponent (A. Wolf et al., Physica D 16(3), 1985). What drifts, as a
    joint that a torque drives, hides what parameters do behind what the start did. Errors of the model itself drift there as
    well: a replay has skill while it is nearer to what was measured than the pose that it began at is (persistence as the
    standard of reference: A. H. Murphy, Weather and Forecasting 7(4), 1992), and tells most long before it loses that. What
    pulls back to commanded positions does not drift, and what stands on its feet stays near the pose that it began at: there
    standing still is no standard. Runs under a controller of the simulator's own begin only where it
    does, unless windows of some length are asked for.
    """
    parts = 4  # windows that a recording is cut into to see how fast errors grow: all kinds of motion have their say
    if any(t.command is None for t in problem.trials):
        return np.inf
    longest = max(t.duration for t in problem.trials)
    ends = [np.inf, np.inf]
    # Of long recordings the parts show enough: what grows too slowly for them is no chaos.
    for length in (longest / parts, longest) if problem.duration <= WORTH else (longest / parts,):
        reached = _reached(in_windows(problem, length), values, skill=by_torque(problem) and not carried(problem))
        ends = [end if np.isfinite(end) else new for end, new in zip(ends, reached, strict=True)]
        if np.isfinite(ends[0]):
            break
    return min(ends[0], SKILLED * ends[1])


def smooth_length(problem: Problem, values: Array, space: ParameterSpace, seed: int) -> float:
    """How long trials of what contacts carry may be in s for slopes along the free parameters of `space` to lead at values
    (n,): a third of the time from which on replays bend too far. Inf where they never do.

    Where feet touch and let go, replays bend more and more the longer they are, and a search along slopes ends wherever it is
    (A. H. Ribeiro et al., On the smoothness of nonlinear system identification, Automatica 121, 2020). How much is the
    relative curvature of D. M. Bates and D. G. Watts (J. R. Statist. Soc. B 42(1), 1980), along directions drawn at random.
    """
    pairs, parts = 4, 4  # as in `window_length`, the parts of long recordings show enough
    if not carried(problem) or any(t.command is None for t in problem.trials):
        return np.inf
    middle = np.clip(space.to_unit(values), OFF, 1.0 - OFF)
    off = OFF * np.random.default_rng(seed).choice([-1.0, 1.0], (pairs, len(middle)))
    around = space.from_unit(np.concatenate([middle[None], middle + off, middle - off]))
    longest, end = max(t.duration for t in problem.trials), np.inf
    for length in (longest / parts, longest) if problem.duration <= WORTH else (longest / parts,):
        begun = in_windows(problem, length)
        residuals = begun.residuals(around)
        level, more, less = residuals[0], residuals[1 : pairs + 1], residuals[pairs + 1 :]
        turns, stays = 0.5 * (more - less), 0.5 * (more + less) - level
        end = min(end, _lasting([_bending(begun, k, turns, stays) for k in range(len(begun.trials))]))
    return SKILLED * end


def _bending(problem: Problem, trial: int, turns: Array, stays: Array) -> tuple[Array, Array]:
    """(T,) s since its start and ln of how many times more than allowed a trial bends until then: what stays (K, m) of its
    changes when parameters turn round, against what turns with them; both empty where nothing changes.
    """
    time, both = np.zeros(0), []
    for changes in (stays, turns):
        seen = []
        for change in changes:
            time, series = _series(problem, trial, change)
            seen.append(np.cumsum(np.sum(series**2, axis=1)))
        both.append(np.sum(seen, axis=0))
    if not len(time) or not np.isfinite(both).all() or not np.any(both[1]):
        return np.zeros(0), np.zeros(0)
    bent = 0.5 * np.log(np.maximum(both[0], TINY) / np.maximum(MOST**2 * both[1], TINY))
    return time - problem.trials[trial].start, bent


def carried(problem: Problem) -> bool:
    """Whether contacts carry the robot in all that is replayed: its base is free and was tracked, or reckoned and it is known
    how far that is off, or it hangs on joints that nothing drives.
    """
    return all(set(BASE) & {*t.observed, *t.initial_sd} or passive(problem.simulator, t) for t in problem.trials)


def swinging(problem: Problem) -> bool:
    """Whether joints that nothing drives, nor contacts carry, swing in all that is replayed: how replays of these part is
    chance where a pole may go over the top or not, and so is which of many windows they part in.
    """
    return not carried(problem) and all(swings(problem.simulator, t) for t in problem.trials)


def by_torque(problem: Problem) -> bool:
    """Whether drives are told torques or forces in all that is replayed."""
    return all(t.command is not None and t.command.unit in ("N m", "N") for t in problem.trials)


def in_windows(problem: Problem, length: float) -> Problem:
    """The same problem with every trial cut into equal parts of about `length` s, each begun where the robot was then; whole
    where that is not known of its free base.
    """
    parts = [
        (part, owner)
        for t, owner in zip(problem.trials, problem.owners, strict=True)
        for part in (_cut(t, length, problem.period) if placed(problem.simulator, t) else [t])
    ]
    if len(parts) == len(problem.trials):
        return problem
    return problem.replayed_by([part for part, _ in parts], [owner for _, owner in parts])


def _cut(trial: Trial, length: float, period: float) -> list[Trial]:
    fewest = 8  # samples in a window
    samples = max(len(o.time) for o in trial.observed.values())
    count = max(1, min(round(trial.duration / length), samples // fewest))
    step = trial.duration / count
    # A controller's commands are due at multiples of its period.
    begins = step * np.arange(count) if not period else period * np.round(step / period * np.arange(count))
    lengths = np.diff(np.append(begins, trial.duration))
    parts = [cut(trial, trial.start + a, length) for a, length in zip(begins.tolist(), lengths.tolist(), strict=True)]
    # What is seen at the instant where the next part begins is seen there.
    ends = [p.start + p.duration - SAME_INSTANT for p in parts[:-1]] + [np.inf]
    if count == 1:
        return [trial]
    seen = (_until(part, end) for part, end in zip(parts, ends, strict=True))
    return [part for part in seen if part.observed]  # in a gap of what was measured there is nothing to compare


def _until(trial: Trial, end: float) -> Trial:
    observed = {n: replace(o, time=o.time[o.time < end]) for n, o in trial.observed.items()}
    return replace(trial, observed={n: o for n, o in observed.items() if len(o.time)})


def _reached(problem: Problem, values: Array, *, skill: bool) -> tuple[float, float]:
    """From when on errors at the start have grown too far, and there is no `skill` any more; inf where that does not come."""
    starts = Starts.every(problem)
    apart = replace(starts, amounts=np.ones_like(starts.amounts)).trials()
    both = problem.replayed_by([*problem.trials, *apart], problem.owners * 2)
    near, far = both.plain_residuals(values[None]).reshape(2, -1)
    trials = range(len(problem.trials))
    grown = _lasting([_growth(problem, k, far - near) for k in trials])
    if swinging(problem):
        grown = min(grown, _lasting([_loudness(problem, k, far - near) for k in trials], _root_mean_square))
    return grown, _lasting([_unskilled(problem, k, near) for k in trials]) if skill else np.inf


def _root_mean_square(logs: Array) -> Array:
    """(T,) ln of the root mean square over windows of what has `logs` (N, T), NaN where a window has ended."""
    return 0.5 * np.log(np.nanmean(np.exp(2.0 * logs), axis=0))


def _lasting(
    curves: Sequence[tuple[Array, Array]], middle: Callable[[Array], Array] = lambda each: np.nanmedian(each, axis=0)
) -> float:
    """The first of the times (T,) from which on the median (or another `middle`) over curves (T,) is never below zero; inf
    where none is.

    What a touch-down parts comes together again: only what lasts counts.
    """
    known = [(time, curve) for time, curve in curves if len(time)]
    if not known:
        return np.inf
    grid = np.unique(np.concatenate([time for time, _ in known]))
    each = np.array([np.interp(grid, time, curve, right=np.nan) for time, curve in known])
    many = 2 * np.isfinite(each).sum(axis=0) >= len(known)  # the last instants are of few
    grid = grid[many]
    below = np.flatnonzero(~(middle(each[:, many]) >= 0.0))
    return float(grid[below[-1] + 1]) if len(below) and below[-1] + 1 < len(grid) else np.inf


def _growth(problem: Problem, trial: int, change: Array) -> tuple[Array, Array]:
    """(T,) s since its start and ln of how many times further apart than allowed two runs of a trial are then; both empty
    where they are one. Allowed is `GROWN` times as far as they began, and `LOUD` times the noise.
    """
    time, seen = _series(problem, trial, change)
    if not len(time) or not np.isfinite(seen).all() or not np.any(seen):
        return np.zeros(0), np.zeros(0)
    place, pace = np.sum(seen**2, axis=1), np.sum(np.gradient(seen, time, axis=0) ** 2, axis=1)
    until = (time - time[0]) ** 2
    first, last = place[0] + until * pace[0], place + until * pace
    with np.errstate(over="ignore"):  # runs that begin as one are endlessly further apart
        too_far = np.maximum(last / np.maximum(first * GROWN**2, TINY), place / (seen.shape[1] * LOUD**2))
    return time - problem.trials[trial].start, 0.5 * np.log(np.maximum(too_far, TINY))


def _loudness(problem: Problem, trial: int, change: Array) -> tuple[Array, Array]:
    """(T,) s since its start and ln of how many times further apart than `LOUD` times the noise two runs of a trial are then;
    both empty where they are one.
    """
    time, seen = _series(problem, trial, change)
    if not len(time) or not np.isfinite(seen).all() or not np.any(seen):
        return np.zeros(0), np.zeros(0)
    far = np.mean(seen**2, axis=1) / LOUD**2
    return time - problem.trials[trial].start, 0.5 * np.log(np.maximum(far, TINY))


def _unskilled(problem: Problem, trial: int, residual: Array) -> tuple[Array, Array]:
    """(T,) s since its start and ln of how many times the error of a replay until then is that of the pose it began at; both
    empty where it fails.
    """
    time, error = _series(problem, trial, residual)
    if not len(time) or not np.isfinite(error).all():
        return np.zeros(0), np.zeros(0)
    still = error[0] + _series(problem, trial, _standing(problem))[1]
    ours, theirs = (np.cumsum(np.sum(x**2, axis=1)) for x in (error, still))
    worse = 0.5 * np.log(np.maximum(ours, TINY) / np.maximum(theirs, TINY))
    return time - problem.trials[trial].start, np.append(-np.inf, worse[1:])  # it begins at that pose


def _standing(problem: Problem) -> Array:
    """(m,) residuals of what stays where it was first measured in each trial."""
    parts = []
    for s in problem.segments:
        own = problem.trials[s.trial].observed[s.channel]
        measured = measured_at(problem.recordings[s.recording], s.channel, own.labels, own.time)
        first = measured[np.argmax(s.mask, axis=0), np.arange(len(s.labels))]
        parts.append(((first - measured) / s.scale)[s.mask])
    return np.concatenate(parts)


def _series(problem: Problem, trial: int, residual: Array) -> tuple[Array, Array]:
    """(T,) instants and (T, labels) of the residuals (m,) of a trial, of channels with as many samples as the first."""
    found: list[Array] = []
    time = np.zeros(0)
    for segment in problem.segments:
        if segment.trial == trial and segment.samples > 2:
            own = problem.trials[trial].observed[segment.channel].time
            if not len(time) or len(own) == len(time):
                time = own
                found.append(segment.shaped(residual))
    return time, np.concatenate(found, axis=1) if found else np.zeros((0, 0))
