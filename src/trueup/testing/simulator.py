# SPDX-License-Identifier: Apache-2.0
"""What every Simulator must do, whatever it simulates."""

from __future__ import annotations

import numpy as np

from trueup.engines.simulator import Rollout, Simulator
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE
from trueup.testing.broken import require
from trueup.testing.runs import check_runs
from trueup.trial import Trial


def check_simulator(simulator: Simulator, recording: Recording, *, width: int | None = None) -> None:
    """Checks the contract of `Simulator` with one recording that it can replay, and with its parameters.

    Shapes and instants are those of the trial; rows do not depend on their neighbours (but for rounding), on the other trials
    in the call or on earlier calls; inputs stay untouched; another step keeps the parameters; a shipped simulator takes none;
    a row that fails says why and leaves the others alone; controllers know their trial; ends, disturbances and noise do what
    the trial says (`testing.runs`). `width` is the number of commands of a controller, by default that of the recording.
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
        what = f"row {row} alone differs from row {row} in a batch"
        _check_equal(both, alone, slice(row, row + 1), what, NEGLIGIBLE)
    half = _shortened(recording)
    short = Trial.of(half, simulator.observable(half))
    together = simulator.rollout([short, trial], values)
    require([r.trial.name for r in together] == [short.name, trial.name], "rollouts come in another order than trials")
    _check_equal(both, together[1], slice(None), "a trial's result depends on the other trials in the call")
    coarser = simulator.at_step(2.0 * simulator.step)
    require(abs(coarser.step - 2.0 * simulator.step) < NEGLIGIBLE, "at_step returned a simulator with another step")
    require(coarser.parameters.names == simulator.parameters.names, "at_step changed the parameters")
    shipped = simulator.shipped()
    require(len(shipped.parameters) == 0, "a shipped simulator still has parameters")
    _check_shapes(shipped.rollout([trial], np.zeros((1, 0)))[0], trial, 1)
    _check_failures(simulator, trial, values)
    check_runs(simulator, trial, short, values[:2], width)


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
        shape = rollout.channels[name].shape
        require(shape == expected, f"channel '{name}' has shape {shape}, expected {expected}")
        failed = sorted(rollout.failures)
        good = np.delete(rollout.channels[name], failed, axis=0)
        require(bool(np.isfinite(good).all()), f"channel '{name}' is not finite, yet no failure is reported")


def _check_equal(a: Rollout, b: Rollout, rows: slice, what: str, apart: float = 0.0) -> None:
    for name, values in a.channels.items():
        alike = np.allclose(values[rows], b.channels[name], rtol=0.0, atol=apart, equal_nan=True)
        require(alike, f"{what} (channel '{name}')")


def _check_failures(simulator: Simulator, trial: Trial, values: np.ndarray) -> None:
    """A row whose parameters are no numbers fails; what it showed before stays, its neighbours do not notice."""
    if not values.shape[1]:
        return
    mixed = np.concatenate([values[:1], np.full((1, values.shape[1]), np.nan), values[1:2]])
    (rollout,) = simulator.rollout([trial], mixed)
    require(sorted(rollout.failures) == [1], f"row 1 has no number, but rows {sorted(rollout.failures)} failed")
    require(bool(rollout.failures[1]), "a failure without a reason")
    (alone,) = simulator.rollout([trial], values[:2])
    for name, channel in rollout.channels.items():
        require(
            np.array_equal(channel[[0, 2]], alone.channels[name]), f"a failed row changed others (channel '{name}')"
        )
        gone = np.isnan(channel[1]).any(axis=1)
        require(bool((np.diff(gone.astype(int)) >= 0).all()), f"channel '{name}' of a failed row comes back after NaN")


def _shortened(recording: Recording) -> Recording:
    middle = recording.start + 0.5 * recording.duration
    return recording.slice(recording.start, middle).replace(name=f"{recording.name}, first half")
