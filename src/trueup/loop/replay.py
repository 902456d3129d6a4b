# SPDX-License-Identifier: Apache-2.0
"""Recordings replayed by a simulator: sample by sample, or as one error in the unit of the main channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Replay
from trueup.controllers.controller import ControllerFactory
from trueup.discrepancies.discrepancy import Discrepancy, measured_at
from trueup.discrepancies.weighted import Weighted
from trueup.discrepancies.whole_body import in_nearest_angles
from trueup.engines.simulator import Simulator, broken
from trueup.errors import SimulationFailedError, TrueupError
from trueup.loop.problem import Problem
from trueup.loop.windows import in_windows, window_length
from trueup.recording import Channel, Recording
from trueup.trial import Observed, command_of


@dataclass(frozen=True)
class ReplayError:
    """Root mean square of simulated minus measured, pooled; NaN where it cannot be simulated."""

    shipped: float
    calibrated: float
    unit: str


def replay_error(
    simulator: Simulator, values: Array, recordings: Sequence[Recording], *, discrepancy: Discrepancy | None = None,
    channels: Sequence[str] | None = None,
) -> ReplayError:  # fmt: skip
    """How well the simulator with `values` (n,) replays `recordings`, and how well as it came.

    NaN without any, and where they hold nothing that it reproduces: a simulator may be good for scores only.
    """
    if not recordings:
        return ReplayError(float("nan"), float("nan"), "")
    try:
        seen = sorted({c for r in recordings for c in simulator.observable(r)})
        measure = discrepancy or Weighted.estimated(recordings, seen)
        problem = Problem(simulator, recordings, measure, channels)
        if discrepancy is None:
            problem = in_windows(problem, window_length(problem, values))
        unit = problem.main[1]
        shipped = problem.by(simulator.shipped())
        return ReplayError(
            _pooled(shipped, np.zeros((1, 0))), _pooled(problem, np.atleast_2d(values)), unit,
        )  # fmt: skip
    except (TrueupError, IndexError):
        return ReplayError(float("nan"), float("nan"), "")


def _pooled(problem: Problem, values: Array) -> float:
    residual = problem.residuals(values)[0]
    return problem.rmse(residual) if np.isfinite(residual).all() else float("nan")


def replays(
    simulator: Simulator, values: Array, training: Sequence[Recording], held_out: Sequence[Recording],
    measure: Discrepancy | None = None, *, channels: Sequence[str] | None = None,
    controllers: ControllerFactory | None = None, against: Simulator | None = None, windows: float | None = None,
) -> tuple[Replay, ...]:  # fmt: skip
    """Every recording replayed by the simulator with `values` (n,), and before that as it came (or `against` another).

    In windows of `windows` s, each from where the robot was then: what was simulated jumps between them. None: as long as
    the simulator is stable (see `shoot.window_length`).

    Raises SimulationFailedError, with all recordings on which the simulator fails, where there are some.
    """
    everything = (*training, *held_out)
    observable = sorted({c for r in everything for c in simulator.observable(r)})
    if measure is None:
        measure = Weighted.estimated(everything, observable)
    # What errors are counted in may be a tolerance; what is shown as noise is the recordings' own.
    noise = Weighted.estimated(training or everything, observable)
    problem = Problem(simulator, everything, measure, channels, controllers=controllers)
    problem = in_windows(problem, window_length(problem, values) if windows is None else windows)
    window = max(t.duration for t in problem.trials) if problem.windowed else np.inf
    after = problem.rollouts(values[None])
    before = (against or simulator.shipped()).rollout(problem.trials, np.zeros((1, 0)), controllers)
    if failed := broken(after, problem.simulator):
        owners = [k for k, done in zip(problem.owners, after, strict=True) if done.failures]
        each = {k: [done for o, done in zip(problem.owners, after, strict=True) if o == k] for k in owners}
        why = {k: broken(own, problem.simulator) for k, own in each.items()}
        raise SimulationFailedError(f"the simulator fails on {failed}", why)
    parts: dict[tuple[int, str, tuple[str, ...]], list[Replay]] = {}
    for owner, old, new in zip(problem.owners, before, after, strict=True):
        recording = everything[owner]
        first = next(t.start for t, o in zip(problem.trials, problem.owners, strict=True) if o == owner)
        command = command_of(recording)
        for name, observed in new.trial.observed.items():
            measured = measured_at(recording, name, observed.labels, observed.time)
            was, now = (in_nearest_angles(name, observed.labels, measured, x.channels[name][0]) for x in (old, new))
            parts.setdefault((owner, name, observed.labels), []).append(Replay(
                recording=recording.name, held_out=owner >= len(training), channel=name, labels=observed.labels,
                unit=observed.unit, time=observed.time - first, measured=measured, before=was, after=now,
                noise=noise.noise(name, observed.labels), window=window,
                command=_commanded(command, observed) if name == "position" else None,
            ))  # fmt: skip
    return tuple(_joined(own) for own in parts.values())


def _joined(parts: Sequence[Replay]) -> Replay:
    """One replay of several windows of a recording."""
    if len(parts) == 1:
        return parts[0]
    commands = [p.command for p in parts if p.command is not None]
    return replace(
        parts[0], time=np.concatenate([p.time for p in parts]), measured=np.concatenate([p.measured for p in parts]),
        before=np.concatenate([p.before for p in parts]), after=np.concatenate([p.after for p in parts]),
        command=np.concatenate(commands) if len(commands) == len(parts) else None,
    )  # fmt: skip


def _commanded(command: Channel | None, observed: Observed) -> Array | None:
    """What was commanded of the same joints in the same unit."""
    if command is None or not set(observed.labels) <= set(command.labels):
        return None
    if any(command.unit_of(label) not in ("", observed.unit) for label in observed.labels):
        return None
    return command.select(observed.labels).at(observed.time, hold=True)
