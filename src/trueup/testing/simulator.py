# SPDX-License-Identifier: Apache-2.0
"""What every Simulator must do, whatever it simulates."""

from __future__ import annotations

import numpy as np

from trueup.engines.simulator import Rollout, Simulator
from trueup.recording import Recording
from trueup.testing.broken import require
from trueup.trial import Trial


def check_simulator(simulator: Simulator, recording: Recording) -> None:
    """Checks the contract of `Simulator` with one recording that it can replay, and with its parameters.

    Shapes and instants are those of the trial; rows do not depend on their neighbours, on the other trials in the call
    or on earlier calls; inputs stay untouched; another step keeps the parameters; a shipped simulator takes none.
    Raises ContractBrokenError (an AssertionError) that says what was broken.
    """
    trial = Trial.of(recording, simulator.observable(recording))
    values = _values(simulator)
    given = values.copy()
    (both,) = simulator.rollout([trial], values)
    require(np.array_equal(values, given), "rollout wrote into its values")
    _check_shapes(both, trial, len(values))
    (again,) = simulator.rollout([trial], values)
    _check_equal(both, again, slice(None), "two equal calls gave different results")
    for row in range(len(values)):
        (alone,) = simulator.rollout([trial], values[row : row + 1])
        _check_equal(both, alone, slice(row, row + 1), f"row {row} alone differs from row {row} in a batch")
    half = _shortened(recording)
    short = Trial.of(half, simulator.observable(half))
    together = simulator.rollout([short, trial], values)
    require([r.trial.name for r in together] == [short.name, trial.name], "rollouts come in another order than trials")
    _check_equal(both, together[1], slice(None), "a trial's result depends on the other trials in the call")
    coarser = simulator.at_step(2.0 * simulator.step)
    require(abs(coarser.step - 2.0 * simulator.step) < 1e-12, "at_step returned a simulator with another step")
    require(coarser.parameters.names == simulator.parameters.names, "at_step changed the parameters")
    shipped = simulator.shipped()
    require(len(shipped.parameters) == 0, "a shipped simulator still has parameters")
    _check_shapes(shipped.rollout([trial], np.zeros((1, 0)))[0], trial, 1)


def _values(simulator: Simulator) -> np.ndarray:
    """(3, n) the nominal values and two more inside the bounds."""
    space = simulator.parameters
    nominal = np.clip(space.to_unit(space.nominal), 0.05, 0.95)
    moved = [np.clip(nominal + shift, 0.0, 1.0) for shift in (0.02, -0.02)]
    return np.concatenate([space.nominal[None], space.from_unit(np.array(moved))])


def _check_shapes(rollout: Rollout, trial: Trial, rows: int) -> None:
    for name, observed in trial.observed.items():
        require(name in rollout.channels, f"channel '{name}' is observed but missing from the rollout")
        expected = (rows, len(observed.time), len(observed.labels))
        found = rollout.channels[name].shape
        require(found == expected, f"channel '{name}' has shape {found}, expected {expected}")
        failed = sorted(rollout.failures)
        good = np.delete(rollout.channels[name], failed, axis=0)
        require(bool(np.isfinite(good).all()), f"channel '{name}' is not finite, yet no failure is reported")


def _check_equal(a: Rollout, b: Rollout, rows: slice, what: str) -> None:
    for name, values in a.channels.items():
        require(np.array_equal(values[rows], b.channels[name], equal_nan=True), f"{what} (channel '{name}')")


def _shortened(recording: Recording) -> Recording:
    middle = recording.start + 0.5 * recording.duration
    return recording.slice(recording.start, middle).replace(name=f"{recording.name}, first half")
