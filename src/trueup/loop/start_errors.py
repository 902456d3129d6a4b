# SPDX-License-Identifier: Apache-2.0
"""How far off starts are that were reckoned from other channels: the simulator shows it on runs of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import AXES, POSITION
from trueup.instant import LOOKS, at_instant
from trueup.loop.condensing import cut
from trueup.loop.problem import Problem
from trueup.loop.shoot import SHORTEST
from trueup.loop.windows import by_torque
from trueup.noise import spread
from trueup.reckoned import RATE_OF, RECKONED, reckoned_as, reckoned_of
from trueup.recording import Channel, Recording
from trueup.trial import Observed, Trial


def with_start_errors(problem: Problem, values: Array) -> Problem:
    """The problem whose trials know by how much what was reckoned of their starts is off (`Trial.initial_sd`).

    Feet sink in, slip and leave the ground, and what an accelerometer shows while a robot walks is not gravity alone: none of
    this is seen in how far samples scatter. So commands are simulated at values (n,), what was reckoned is reckoned anew
    from that, and held against what the simulator did: a parametric bootstrap (B. Efron and R. Tibshirani, An Introduction
    to the Bootstrap, 1993), of medians, since a simulator that is not yet calibrated may fall. Told torques it soon does:
    there each look is at a short run of its own, and trials begin as much lower as feet sink in.
    """
    found: dict[str, list[Array]] = {}
    for name, errors in _errors(problem, values):
        found.setdefault(name, []).append(errors)
    if not found:
        return problem
    every = {name: np.concatenate(errors, axis=1) for name, errors in found.items()}
    sunk = 0.0
    if by_torque(problem) and POSITION in every:
        heights = every[POSITION][0, :, AXES.index("z")]
        sunk = float(np.median(heights))
        heights -= sunk
    known = {name: spread(np.swapaxes(errors, 0, 1)) for name, errors in every.items()}
    trials = [
        replace(
            _lowered(t, sunk), initial_sd={n: sd for n, sd in known.items() if n in reckoned_of(problem.recordings[k])}
        )
        for t, k in zip(problem.trials, problem.owners, strict=True)
    ]
    return problem.replayed_by(trials, problem.owners)


def _lowered(trial: Trial, sunk: float) -> Trial:
    """The trial, begun so many m lower: a foot that begins on top of the floor carries nothing until it has sunk in."""
    place = trial.initial.get(POSITION)
    if not sunk or place is None:
        return trial
    lower = place.replace(values=place.values - sunk * np.array([label == "z" for label in place.labels]))
    return replace(trial, initial={**trial.initial, POSITION: lower})


def _errors(problem: Problem, values: Array) -> Iterator[tuple[str, Array]]:
    """Channels that were reckoned, each with (2, T, k) errors of its values and speeds in a simulated run."""
    every = [(t, problem.recordings[k]) for t, k in zip(problem.trials, problem.owners, strict=True)]
    asked = [(_watched(problem, t, r), r) for t, r in every if reckoned_of(r)]
    brief = by_torque(problem)
    if brief:
        asked = [(part, r) for t, r in asked for part in _brief(t)]
    runs = problem.simulator.rollout([t for t, _ in asked], values[None]) if asked else ()
    for run, (_, recording) in zip(runs, asked, strict=True):
        seen, gone = run.recording(), reckoned_of(recording)
        told = seen.replace(channels={n: _blank(c, recording) for n, c in seen.channels.items() if n not in gone})
        again = None if run.failures else reckoned_as(problem.simulator, told)
        if again is None:
            continue
        for name in gone & seen.channels.keys():
            own, rates = again.channel(name), again.channels.get(name + RATE_OF)
            first, last = own.time[[0, -1]]
            looks = np.array([0.5 * (first + last)]) if brief else np.linspace(first, last, LOOKS)
            pairs = [(at_instant(own, rates, t), at_instant(seen.channel(name), None, t)) for t in looks.tolist()]
            yield name, np.array([[a.value - b.value for a, b in pairs], [a.speed - b.speed for a, b in pairs]])


def _brief(trial: Trial) -> list[Trial]:
    """Parts of a trial, at whose middles a start has shown its effect, and a robot that is told torques still stands."""
    begins = trial.start + np.linspace(0.0, max(trial.duration - 2.0 * SHORTEST, 0.0), LOOKS)
    return [cut(trial, begin, 2.0 * SHORTEST) for begin in begins.tolist()]


def _blank(simulated: Channel, recording: Recording) -> Channel:
    """A simulated channel without the labels that were nowhere measured, as a heading beside roll and pitch."""
    measured = recording.channels.get(simulated.name)
    missing = np.zeros(1, dtype=np.bool_) if measured is None else np.isnan(measured.values).all(axis=0)
    return simulated.replace(values=np.where(missing, np.nan, simulated.values)) if missing.any() else simulated


def _watched(problem: Problem, trial: Trial, recording: Recording) -> Trial:
    """The trial, observing all that the simulator has of its recording, what was reckoned too."""
    whole = recording.replace(provenance={k: v for k, v in recording.provenance.items() if k != RECKONED})
    channels = (recording.channel(name) for name in problem.simulator.observable(whole))
    return replace(trial, observed={c.name: Observed(c.labels, c.unit, c.time) for c in channels})
