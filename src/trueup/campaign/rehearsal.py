# SPDX-License-Identifier: Apache-2.0
"""The task simulated once before any robot moves: what does not fit together is said then, not after an hour of runs."""

from __future__ import annotations

import math
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from trueup.campaign.parts import Parts
from trueup.campaign.plan import Plan
from trueup.ends import Fallen
from trueup.engines.simulator import Rollout
from trueup.errors import PlanError, TrueupError, unknown_name
from trueup.loop.safety import require_safe
from trueup.loop.transfer import prepared
from trueup.noise import FEWEST
from trueup.tasks.task import robot_trials
from trueup.trial import Limits, Trial


@contextmanager
def blamed(what: str, kind: type[TrueupError]) -> Iterator[None]:
    """Turns an error in a user's own code into one that names the place; trueup's own errors pass."""
    try:
        yield
    except TrueupError:
        raise
    except Exception as error:
        places = traceback.extract_tb(error.__traceback__)
        at = places[-1]
        said = f"{type(error).__name__}: {error}".rstrip(": ")
        raise kind(f"{what}: {said} ({Path(at.filename).name}, line {at.lineno}; --debug shows more)") from error


def rehearse(parts: Parts, plan: Plan) -> str:
    """Simulates the task's trials with the settings of today; returns a doubt about their score, '' without one.

    Runs that end in a fall are told of where the robot's first trial has these settings, and a search does not come before.

    Raises PlanError where task, simulator and limits do not fit together, TrialError where a trial goes beyond a limit, and
    what the simulator raises.
    """
    task, simulator = parts.task, parts.simulator
    # Side by side, so that a score of the wrong shape shows; where chance acts, as many as tell whether most of them fall:
    # that half of eight do by luck where one in ten does has odds of 1 in 200.
    by_chance = any(t.disturbances or t.sensing for t in task.trials)
    rows = max(2, math.ceil(FEWEST / max(len(task.trials), 1))) if by_chance else 2
    with blamed(f"task '{task.name}', before anything moved", PlanError):
        trials = robot_trials(task, task.parameters.nominal)
        if len(trials) != len(task.trials):
            raise PlanError(
                f"task '{task.name}': `planned` gives {len(trials)} trials, `trials` has {len(task.trials)}"
            )
        row = np.concatenate([simulator.parameters.nominal, task.parameters.nominal])
        rollouts = simulator.rollout(task.trials, np.repeat(row[None], rows, axis=0), task.controllers)
        scores = np.asarray(task.score(rollouts), dtype=np.float64)
    if scores.shape != (rows,):
        raise PlanError(
            f"task '{task.name}': `score` gave shape {scores.shape} for {rows} simulations; it must be (b,)"
        )
    require_within_limits(parts)
    if np.isfinite(scores).all():
        first = plan.optimize.method == "on-robot" or plan.experiment.settings > 0
        return _falling(rollouts) if first else ""
    why = next((w for r in rollouts for w in r.failures.values()), "the task gave it none")
    return f"simulated with the settings of today, the task has no score: {why}"


def _falling(rollouts: Sequence[Rollout]) -> str:
    """A doubt where at least half of the simulated runs end in a fall."""
    falls = []
    for r in rollouts:
        names = {e.name for e in r.trial.ends if isinstance(e, Fallen)}
        falls += [e.at for e in r.ends.values() if e.name in names]
    count = sum(len(next(iter(r.channels.values()))) for r in rollouts)
    if 2 * len(falls) < max(count, 1):
        return ""
    return (
        f"simulated with the settings of today, {len(falls)} of {count} runs end in a fall, the first after "
        f"{min(falls):.2g} s: so may the robot's, whose first trial has these settings. Begin with settings that stand, or "
        "mend the model if the robot itself stands with these"
    )


def require_within_limits(parts: Parts) -> None:
    """Raises PlanError for a limit of nothing, TrialError where a trial with the settings of today goes beyond a limit."""
    with blamed(f"task '{parts.task.name}', before anything moved", PlanError):
        trials = robot_trials(parts.task, parts.task.parameters.nominal)
    if parts.limits is not None:
        _check_limits(parts.limits, trials)
    for trial in trials:
        require_safe(prepared(trial, parts.limits, repeats=1))


def _check_limits(limits: Limits, trials: tuple[Trial, ...]) -> None:
    """Raises PlanError for a limit of something that is nowhere in the trials: it would limit nothing."""
    known: dict[str, None] = {}
    for t in trials:
        known |= dict.fromkeys(t.command.labels if t.command is not None else ())
        known |= {x: None for table in (*t.observed.values(), *t.references.values()) for x in table.labels}
    for label in (*limits.labels, *limits.workspace):
        if label not in known:
            error = unknown_name("limit", label, list(known), "what the trials command, measure or follow")
            raise PlanError(f"[limits]: {error}")
