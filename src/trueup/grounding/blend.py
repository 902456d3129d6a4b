# SPDX-License-Identifier: Apache-2.0
"""How much of what is predicted is told to a simulator: the share with which it replays the robot best."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Rollout, Simulator
from trueup.errors import GroundingError, counted
from trueup.evidence import evidence
from trueup.grounding.grounded import GroundedSimulator
from trueup.grounding.grounding import Grounding
from trueup.grounding.learners import LEARNERS
from trueup.grounding.residual import with_residual
from trueup.grounding.rows import rows_of
from trueup.grounding.views import Model, fitted
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE
from trueup.trial import Trial

SHARES = np.linspace(0.0, 1.0, 11)
"""Shares of what is predicted that are tried; 0 is the simulator as it is."""


@dataclass(frozen=True, eq=False)
class Blend:
    """What was found of each share."""

    shares: Array
    """(s,)."""
    errors: Array
    """(s, recordings) root mean squared error of the joints, in their unit; NaN where the simulation failed."""
    best: float
    why: str

    @property
    def least(self) -> float:
        """The least geometric mean over recordings, of those shares with which none failed."""
        whole = self.errors[np.isfinite(self.errors).all(axis=1)]
        return float(np.exp(np.log(whole).mean(axis=1)).min()) if len(whole) else float("inf")


def blended(
    grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array
) -> tuple[Grounding, Blend]:
    """The grounding with the share of what is predicted with which `simulator` replays `recordings` best.

    `values` (n,) of the simulator's parameters. The share stays 0 where none is surely better (`evidence`).
    Raises GroundingError where no replay succeeds.
    """
    weights = np.column_stack([1.0 - SHARES, SHARES])
    grounded = GroundedSimulator(simulator, grounding, extrapolate=True, weights=weights)
    errors = replayed(grounded, recordings, np.tile(values, (len(SHARES), 1)))
    known = np.where(np.isfinite(errors), errors, np.inf)
    if not np.isfinite(known).all(axis=1).any():
        raise GroundingError(
            f"'{simulator.name}' replays none of {counted(len(recordings), 'recording')}, grounded or not"
        )
    typical = np.exp(np.mean(np.log(np.maximum(known, NEGLIGIBLE)), axis=1))
    best = int(np.argmin(typical))
    gain = evidence(known[0], known[best])
    sure = best > 0 and (gain.holds or len(recordings) < 2 or not np.isfinite(gain.gain))
    words = f"ln(error ungrounded / error with {SHARES[best]:.1f}) is {gain.gain:.2f} +- {gain.standard_error:.2f}"
    share = float(SHARES[best]) if sure else 0.0
    return grounding.weighted(1.0 - share, share), Blend(SHARES, errors, share, words)


def best_way(
    grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array, *, inverse: bool = True,
    residual: str = "", share: float | None = None, seed: int = 0,
) -> tuple[Grounding, str]:  # fmt: skip
    """The grounding as it makes `simulator` replay `recordings` best, and why: with its inverse model or not, chained or not.

    `residual`: instead what the simulator lacks, added to its 'command' or as 'torque'. A `share` that is given settles it.
    """
    if residual:
        grounding = with_residual(grounding, simulator, recordings, values, torque=residual == "torque", seed=seed)
    if share is not None:
        return grounding.weighted(1.0 - share, share), f"a share of {share:g} was asked for"
    ways = [grounding]
    if inverse and not residual:
        ways.append(with_inverse(grounding, simulator, recordings, values, seed=seed))
    ways += [dataclasses.replace(way, chained=True) for way in ways]
    tried = [blended(way, simulator, recordings, values) for way in ways]
    best, found = min(tried, key=lambda each: each[1].least)
    return best, found.why


def replayed(simulator: Simulator, recordings: Sequence[Recording], values: Array) -> Array:
    """(b, recordings) root mean squared error of all joints that both have, for values (b, n); NaN for failed rows."""
    trials = [Trial.of(r, ["position"]) for r in recordings]
    return np.stack([_error(r, o) for r, o in zip(recordings, simulator.rollout(trials, values), strict=True)], axis=1)


def _error(recording: Recording, rollout: Rollout) -> Array:
    real = recording.channel("position").values[: len(rollout.trial.observed["position"].time)]
    wrong = rollout.channels["position"] - real
    known = np.isfinite(real)
    return np.sqrt(np.sum(np.where(known, wrong, 0.0) ** 2, axis=(1, 2)) / max(int(known.sum()), 1))


def with_inverse(
    grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array, *, seed: int = 0
) -> Grounding:
    """The grounding with the simulator's inverse model after its own: commands that take the simulated joints to where the
    robot's would be.

    The simulator explores by the recorded commands with noise added, without which commands follow from those before and say
    nothing of what they do. Farchy et al. (AAMAS 2013) section 6.1; with a history of frames and a blend it is grounded
    action transformation (Hanna and Stone, AAAI 2017). Raises GroundingError where every replay fails.
    """
    rng = np.random.default_rng(seed)
    trials = [_explored(r, grounding, rng) for r in recordings]
    simulated = [o.recording() for o in simulator.rollout(trials, values[None]) if not o.failures]
    if not simulated:
        raise GroundingError(f"'{simulator.name}' replays none of {counted(len(recordings), 'recording')} to its end")
    return dataclasses.replace(grounding, inverse=inverse_of(grounding, simulated, seed=seed))


def _explored(recording: Recording, grounding: Grounding, rng: np.random.Generator) -> Trial:
    """A recording's trial with noise on its commands, new in each frame and as large as they change from one to the next."""
    inputs = grounding.inputs
    trial = Trial.of(recording, ["position", *inputs.others])
    if trial.command is None:
        raise GroundingError(f"recording '{recording.name}' holds no commands")
    time = trial.start + inputs.period * np.arange(int(trial.duration / inputs.period) + 1)
    values = trial.command.at(time, hold=True)
    change = np.sqrt(np.mean(np.diff(values, axis=0) ** 2, axis=0)) if len(values) > 1 else np.zeros(values.shape[1])
    values = values + change * rng.standard_normal(values.shape)
    return dataclasses.replace(trial, command=trial.command.replace(time=time, values=values))


def inverse_of(grounding: Grounding, recordings: Sequence[Recording], *, seed: int = 0) -> Model:
    """The model of commands that led to the next frames of `recordings`, by the learner and view of a grounding."""
    rows = rows_of(recordings, grounding.inputs).inverse()
    learner, view = grounding.about.get("learner", "linear"), grounding.about.get("view", "own")
    return fitted(LEARNERS[learner], rows, np.random.default_rng(seed), view)
