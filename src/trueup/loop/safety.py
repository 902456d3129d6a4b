# SPDX-License-Identifier: Apache-2.0
"""Checks a trial against limits before it is handed out: what it commands, and what the simulator says it will do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Rollout
from trueup.errors import TrialError
from trueup.recording import is_command
from trueup.rounding import ROUNDED
from trueup.trial import Limits, Trial

_RANGE, _SPEED, _EFFORT = ("rad", "m"), ("rad/s", "m/s"), ("N m", "N")


def exceeded(trial: Trial) -> tuple[str, ...]:
    """What in a trial's command and references goes beyond its limits, one sentence each; () where nothing does.

    A commanded position is held to the joint's range and, by its differences, to its speed; a commanded speed or effort
    to that limit. Reference columns are held to the workspace, or to the range of the joint of that name.
    """
    limits = trial.limits
    if limits is None:
        return ()
    found: list[str] = []
    if trial.command is not None:
        c = trial.command
        found += _beyond(limits, c.labels, c.unit, c.values, "is commanded to")
        if c.unit in _RANGE and len(c.time) > 1:
            speed = np.diff(c.values, axis=0) / np.diff(c.time)[:, None]
            found += _beyond(limits, c.labels, f"{c.unit}/s", speed, "is commanded to move at")
    for name, reference in trial.references.items():
        for label, unit, column in zip(reference.labels, reference.units, reference.values.T, strict=True):
            found += _beyond(limits, (label,), unit, column[:, None], f"of reference '{name}' reaches")
    return tuple(found)


def predicted(rollouts: Sequence[Rollout]) -> tuple[str, ...]:
    """What the simulated runs (all rows) of limited trials go beyond, one sentence each; () where nothing does."""
    found: list[str] = []
    for rollout in rollouts:
        if rollout.trial.limits is None:
            continue
        for name, observed in rollout.trial.observed.items():
            values = rollout.channels[name].reshape(-1, len(observed.labels))
            words = "would be commanded to" if is_command(name) else "would reach, as simulated,"
            found += _beyond(rollout.trial.limits, observed.labels, observed.unit, values, words)
    return tuple(dict.fromkeys(found))


def require_safe(trial: Trial) -> None:
    """Raises TrialError, which names every limit that `trial` goes beyond."""
    if found := exceeded(trial):
        raise TrialError(f"trial '{trial.name}' is not handed out: " + "; ".join(found))


def _beyond(limits: Limits, labels: Sequence[str], unit: str, values: Array, words: str) -> list[str]:
    found = []
    for label, column in zip(labels, values.T, strict=True):
        low, high = _bounds(limits, label, unit)
        seen = column[np.isfinite(column)]
        if not len(seen):
            continue
        for extreme, bad in (
            (float(seen.min()), seen.min() < low - ROUNDED),
            (float(seen.max()), seen.max() > high + ROUNDED),
        ):
            if bad:
                found.append(f"'{label}' {words} {extreme:.4g} {unit} (allowed: {low:.4g} to {high:.4g})")
    return found


def _bounds(limits: Limits, label: str, unit: str) -> tuple[float, float]:
    """What `label` may be in `unit`; infinite where nothing is said."""
    if label in limits.workspace:
        return limits.workspace[label]
    if label not in limits.labels:
        return -np.inf, np.inf
    k = limits.labels.index(label)
    if unit in _RANGE:
        low, high = limits.lower[k], limits.upper[k]
    elif unit in _SPEED:
        low, high = -limits.speed[k], limits.speed[k]
    elif unit in _EFFORT:
        low, high = -limits.effort[k], limits.effort[k]
    else:
        return -np.inf, np.inf
    return (-np.inf if np.isnan(low) else float(low)), (np.inf if np.isnan(high) else float(high))
