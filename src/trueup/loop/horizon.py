# SPDX-License-Identifier: Apache-2.0
"""How long the replays are that are searched: whole, or windows in which errors at the start do not grow and slopes lead."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.calibration import WINDOWS
from trueup.loop.alike import alike
from trueup.loop.apart import GLANCE
from trueup.loop.descent import HELD
from trueup.loop.elsewhere import losses_at
from trueup.loop.lengthening import lengthened
from trueup.loop.problem import WORTH, Problem
from trueup.loop.shoot import SHORTEST, Starts
from trueup.loop.start_errors import with_start_errors
from trueup.loop.watch import Watch
from trueup.loop.windows import (
    GROWN,
    LOUD,
    SKILLED,
    by_torque,
    carried,
    in_windows,
    smooth_length,
    swinging,
    window_length,
)
from trueup.parameters import ParameterSpace
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

_PARTS = 4  # of each window, for the next shorter ones: half as long they lead to nearly the same place


def cut_for_search(
    problem: Problem, values: Array, space: ParameterSpace | None, wanted: float, seed: int, watch: Watch | None = None
) -> tuple[Problem, Array, float, list[str]]:
    """The problem in windows of `wanted` s, or with a `space` in such as a search along its free
    parameters takes at values (n,); from which values (n,) to search it; how long windows may be for replays from measured
    starts to last, which is how they are shown; and both in words. Trials of it know how far off starts are that were
    reckoned. `watch` is told where several lengths are searched, which takes minutes.
    """
    problem = with_start_errors(problem, values)
    if space is None:
        begun = _freed(in_windows(problem, wanted), values)
        return begun, values, wanted, _words(begun, "", "")
    legs = by_torque(problem) and carried(problem)  # which soon lie on the floor
    looked = in_windows(problem, GLANCE) if legs else problem
    smooth = smooth_length(looked, values, space, seed)
    # A start that was reckoned is louder at once than any noise, and is corrected in the search.
    lasting = np.inf if _reckoned(problem) else window_length(looked, values)
    if legs and np.isinf(lasting):  # where nothing grows: nothing that is shown is longer than what is searched
        lasting = smooth
    reason = _reason(problem)
    if np.isinf(min(lasting, smooth)) and carried(problem) and space.free.any():
        smooth, values = horizon(problem, space, values, watch)
        reason = ": of several lengths this one led to where whole recordings are replayed best"
    if unstable := bool(np.isfinite(lasting) and space.free.any() and swinging(problem) and not _reckoned(problem)):
        values, lasting = lengthened(problem, space, values, lasting)
    elif by_torque(problem) and not (carried(problem) or _reckoned(problem)) and space.free.any():
        smooth = led_length(problem, space, values, lasting)
        if smooth < lasting:
            reason = ": of several lengths a step of least squares explains this one best"
    whole = in_windows(problem, min(lasting, smooth))
    begun = _freed(_spread(whole), values, unstable)
    shown = (
        "" if lasting <= smooth else "; shown whole" if np.isinf(lasting) else f"; shown in windows of {lasting:.2g} s"
    )
    if len(begun.trials) < len(whole.trials):
        shown += f"; of all {len(whole.trials)}, evenly spread"
    return begun, values, lasting, _words(begun, reason, shown)


def _reckoned(problem: Problem) -> bool:
    """Whether torques drive what stands on its feet from starts that were reckoned."""
    return by_torque(problem) and any(t.initial_sd for t in problem.trials)


def _freed(problem: Problem, values: Array, unstable: bool = False) -> Problem:
    """The problem with first corrections of starts eliminated at values (n,) where these were reckoned, or replays are
    `unstable`: in replays of torques that last a tenth of a stride, or that end where errors have grown, starts decide more
    than all that is searched, which would be taken for the other.
    """
    if not (problem.windowed and (unstable or _reckoned(problem))):
        return problem
    return Starts.as_measured(problem, values).eliminated_from(problem, values)


def _spread(problem: Problem) -> Problem:
    """Every so many windows only, evenly spread, of what torques drive and contacts carry: as many s as a first look takes.

    Each step of a search takes hundreds of replays there. Of a made-up quadruped with 2.5 and 4 s of windows 17 and 12 of 18
    intervals hold, armatures are 4.3 and 13.9 % off (medians) and the mass 5.9 and 2.9, in 171 and 365 CPU s
    up to the questions which values may stay as they came; where only its attitude was logged 6 of 6 and 9 of 9, all windows
    replayed to 20.7 and 21.2 mrad, in 172 and 375 CPU s.
    """
    every = int(problem.duration / GLANCE)
    if every < 2 or not (problem.windowed and by_torque(problem) and carried(problem)):
        return problem
    return problem.replayed_by(problem.trials[::every], problem.owners[::every])


def led_length(problem: Problem, space: ParameterSpace, values: Array, lasting: float) -> float:
    """How long windows are in s that one step of least squares from `values` (n,) explains best: of `lasting` and ever
    shorter ones; inf where it is whole replays.

    What torques swing forgets where it began, but not what drives it: the longer a replay, the sooner slopes along parameters
    lead astray, and the shorter it is, the more of its errors are those of its start (A. H. Ribeiro et al., On the smoothness
    of nonlinear system identification, Automatica 121, 2020). A step of least squares shows both, in the share of the loss
    that it leaves.
    """
    start = np.clip(space.to_unit(values), 0.0, 1.0)
    looked = problem.shortened(WORTH / len(problem.trials))
    lengths = _ever_shorter(looked, lasting)
    left = [_left(looked if np.isinf(length) else in_windows(looked, length), space, start) for length in lengths]
    return lengths[int(np.argmin(left))]


def _ever_shorter(problem: Problem, longest: float) -> list[float]:
    """`longest`, and fractions of it or of the trials' length in s."""
    lengths = [longest]
    length = min(longest, max(t.duration for t in problem.trials))
    while length / _PARTS > 2.0 * SHORTEST:
        length /= _PARTS
        lengths.append(length)
    return lengths


def _left(problem: Problem, space: ParameterSpace, start: Array) -> float:
    """The share of the loss that the first step of least squares leaves from `start` in the unit box."""
    ranges = np.array([p.log_range for p in space.parameters if not p.frozen])
    search = LeastSquares(start, ranges, robust=3.0, nudge=0.0, least_damping=HELD, share=3e-2)
    columns = search.ask()
    residuals = problem.residuals(space.from_unit(columns))
    if not np.isfinite(residuals[0]).all():
        return np.inf
    search.tell(columns, residuals)
    losses = robust_losses(problem.residuals(space.from_unit(search.ask())), search.delta)
    return float(np.nan_to_num(losses, nan=np.inf).min()) / search.loss


def horizon(problem: Problem, space: ParameterSpace, values: Array, watch: Watch | None = None) -> tuple[float, Array]:
    """How long windows are in s that lead lowest from `values` (n,), and where (n,); inf where it is whole replays.

    Windows of several lengths are searched, kind by kind, and judged by what whole replays make of where they lead: what
    contacts make of parameters grows rougher the longer it lasts, and shorter replays tell less (A. H. Ribeiro et al., On
    the smoothness of nonlinear system identification, Automatica 121, 2020). All at the model's own step: how stiff a contact
    is hangs on it, and a coarser one that tells the same of a poor start leads elsewhere.
    """
    start = np.clip(space.to_unit(values), 0.0, 1.0)
    looked = problem.shortened(WORTH / len(problem.trials))
    if watch is not None:
        begun = looked.residuals(values[None])[0]
        watch.begins(WINDOWS, looked, float(0.5 * begun @ begun), looked.rmse(begun))
    lengths = _ever_shorter(looked, np.inf)
    parts = [looked if np.isinf(length) else in_windows(looked, length) for length in lengths]
    ends = np.array([alike(part, space, start) for part in parts])
    best = int(np.argmin(losses_at(looked, space, ends)))
    return lengths[best], space.from_unit(ends[best])


def _reason(problem: Problem) -> str:
    """Why windows are as long as errors at their start and slopes allow."""
    errors = f"in that time errors at their start grow {GROWN:g} times, or to {LOUD:g} times the noise"
    ends = [] if _reckoned(problem) else [errors]
    if by_torque(problem) and not carried(problem):
        ends.append(f"they take {SKILLED:.2g} of the time in which replays from the start values beat standing still")
    if carried(problem):
        ends.append(f"they take {SKILLED:.2g} of the time after which replays bend too much with what is searched")
    return ": " + ", or ".join(ends)


def _words(problem: Problem, reason: str, shown: str) -> list[str]:
    """A sentence on the windows that recordings are replayed in, with the `reason` for their length, and how they are `shown`
    if otherwise; none where they are replayed whole.
    """
    if not problem.windowed:
        return []
    longest = max(t.duration for t in problem.trials)
    doubt = ""
    if longest < SHORTEST and by_torque(problem) and carried(problem):
        doubt = (
            ". So short replays of torques tell less of a robot than others (by "
            f"{SHORTEST:g} s a start has shown its effect), and forces only beside masses that are known: log the positions "
            "and gains that its controller was told, or hang it up and move its legs"
        )
    return [
        f"recordings are replayed in windows of {longest:.2g} s, {len(problem.trials)} in all, each from where the robot was "
        f"then{reason}{shown}{doubt}"
    ]
