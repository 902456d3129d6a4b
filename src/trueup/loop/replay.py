# SPDX-License-Identifier: Apache-2.0
"""Recordings replayed by a simulator: sample by sample, or as one error in the unit of the main channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Replay
from trueup.controllers.controller import ControllerFactory
from trueup.discrepancies.discrepancy import Discrepancy, measured_at
from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Simulator
from trueup.errors import SimulationFailedError, TrueupError
from trueup.loop.problem import Problem
from trueup.recording import Channel, Recording
from trueup.trial import Observed, command_of

Array = NDArray[np.float64]


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

    NaN where the recordings hold nothing that it reproduces: a simulator may be good for scores only.
    """
    try:
        seen = sorted({c for r in recordings for c in simulator.observable(r)})
        measure = discrepancy or Weighted.estimated(recordings, seen)
        problem = Problem(simulator, recordings, measure, channels)
        unit = problem.main[1]
        shipped = Problem(simulator.shipped(), recordings, measure, channels)
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
    controllers: ControllerFactory | None = None, against: Simulator | None = None,
) -> tuple[Replay, ...]:  # fmt: skip
    """Every recording replayed by the simulator with `values` (n,), and before that as it came (or `against` another).

    Raises SimulationFailedError where the simulator fails.
    """
    everything = (*training, *held_out)
    if measure is None:
        measure = Weighted.estimated(everything, sorted({c for r in everything for c in simulator.observable(r)}))
    problem = Problem(simulator, everything, measure, channels, controllers=controllers)
    after = problem.rollouts(values[None])
    before = (against or simulator.shipped()).rollout(problem.trials, np.zeros((1, 0)), controllers)
    failed = [r.trial.name for r in after if r.failures]
    if failed:
        raise SimulationFailedError(f"the simulator fails on: {', '.join(failed)}")
    found = []
    for k, (recording, old, new) in enumerate(zip(everything, before, after, strict=True)):
        command = command_of(recording)
        for name, observed in new.trial.observed.items():
            measured = measured_at(recording, name, observed.labels, observed.time)
            found.append(Replay(
                recording=recording.name, held_out=k >= len(training), channel=name, labels=observed.labels,
                unit=observed.unit, time=observed.time - new.trial.start, measured=measured, before=old.channels[name][0],
                after=new.channels[name][0], noise=measure.scale(name, observed.labels),
                command=_commanded(command, observed) if name == "position" else None,
            ))  # fmt: skip
    return tuple(found)


def _commanded(command: Channel | None, observed: Observed) -> Array | None:
    """What was commanded of the same joints in the same unit."""
    if command is None or not set(observed.labels) <= set(command.labels):
        return None
    if command.unit not in ("", observed.unit):
        return None
    return command.select(observed.labels).at(observed.time, hold=True)
