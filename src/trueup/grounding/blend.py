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
from trueup.samples import wrapped
from trueup.trial import Trial

SHARES = np.linspace(0.0, 1.0, 11)
"""Shares of what is predicted that are tried; 0 is the simulator as it is."""
_JOINTS, _ORIENTATION = "position", "base_orientation"


@dataclass(frozen=True, eq=False)
class Errors:
    """Root mean squared errors of replays, signal by signal: joints, and all else that was measured and is simulated.

    Joints that go where the robot's went are worth little under a base that leans by it, so all of it is compared.
    """

    channels: tuple[str, ...]
    values: Array
    """(b, recordings, channels) in each channel's unit; NaN where a recording lacks it, inf where its replay failed."""

    def of(self, channel: str) -> Array:
        """(b, recordings) of one channel."""
        return self.values[:, :, self.channels.index(channel)]

    def typical(self) -> Array:
        """(b, recordings) geometric means over channels, of which each counts alike, whatever its unit."""
        known = ~np.isnan(self.values)
        logs = np.log(np.maximum(np.where(known, self.values, 1.0), NEGLIGIBLE))
        return np.exp(logs.sum(axis=2) / known.sum(axis=2))

    def worse(self, row: int) -> tuple[str, ...]:
        """Channels that are surely replayed worse by a row than by the first one."""
        first, other = self.values[0], self.values[row]
        known = ~np.isnan(first)
        return tuple(
            name for k, name in enumerate(self.channels) if evidence(other[known[:, k], k], first[known[:, k], k]).holds
        )


@dataclass(frozen=True, eq=False)
class Blend:
    """What was found of each share."""

    shares: Array
    """(s,)."""
    errors: Errors
    """Of the shares (s,)."""
    best: float
    why: str

    @property
    def least(self) -> float:
        """The geometric mean over recordings and what is compared, with the share that was taken."""
        return float(np.exp(np.log(self.errors.typical()[self.shares == self.best]).mean()))


def blended(
    grounding: Grounding, simulator: Simulator, recordings: Sequence[Recording], values: Array
) -> tuple[Grounding, Blend]:
    """The grounding with the share of what is predicted with which `simulator` replays `recordings` best.

    All that is compared counts (`Errors`), and nothing of it may surely be worse than without. `values` (n,) of the
    simulator's parameters. The share stays 0 where none is surely better (`evidence`). Raises GroundingError where no replay
    succeeds.
    """
    weights = np.column_stack([1.0 - SHARES, SHARES])
    grounded = GroundedSimulator(simulator, grounding, extrapolate=True, weights=weights)
    errors = compared(grounded, recordings, np.tile(values, (len(SHARES), 1)))
    each = errors.typical()
    if not np.isfinite(each).all(axis=1).any():
        raise GroundingError(
            f"'{simulator.name}' replays none of {counted(len(recordings), 'recording')}, grounded or not"
        )
    worse = [errors.worse(row) for row in range(len(SHARES))]
    open_to = np.array([not names for names in worse])
    typical = np.exp(np.log(np.maximum(each, NEGLIGIBLE)).mean(axis=1))
    best = int(np.argmin(np.where(open_to, typical, np.inf)))
    gain = evidence(each[0], each[best])
    sure = best > 0 and (gain.holds or len(recordings) < 2 or not np.isfinite(gain.gain))
    words = f"ln(error ungrounded / error with {SHARES[best]:.1f}) is {gain.gain:.2f} +- {gain.standard_error:.2f}"
    words += f", of {', '.join(errors.channels)} together" if len(errors.channels) > 1 else ""
    bolder = int(np.argmin(typical))
    if worse[bolder]:
        words += f"; with {SHARES[bolder]:.1f} {' and '.join(worse[bolder])} would surely be worse"
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


def compared(simulator: Simulator, recordings: Sequence[Recording], values: Array) -> Errors:
    """Errors of all that recordings measured and `simulator` reproduces, for values (b, n)."""
    seen = [simulator.observable(r) for r in recordings]
    names = tuple(dict.fromkeys(name for each in seen for name in (_JOINTS, *each)))
    trials = [Trial.of(r, [n for n in names if n in (_JOINTS, *own)]) for r, own in zip(recordings, seen, strict=True)]
    found = np.full((len(values), len(recordings), len(names)), np.nan)
    for k, (recording, rollout) in enumerate(zip(recordings, simulator.rollout(trials, values), strict=True)):
        for name in rollout.trial.observed:
            found[:, k, names.index(name)] = _error(recording, rollout, name)
    return Errors(names, found)


def _error(recording: Recording, rollout: Rollout, name: str) -> Array:
    observed = rollout.trial.observed[name]
    real = recording.channel(name).values[: len(observed.time)]
    wrong = rollout.channels[name] - real
    if name == _ORIENTATION and observed.unit == "rad":
        wrong = wrapped(wrong)  # a base that turned half round jumps from pi to -pi
    known = np.isfinite(real)
    error = np.sqrt(np.sum(np.where(known, wrong, 0.0) ** 2, axis=(1, 2)) / max(int(known.sum()), 1))
    return np.where(np.isfinite(error), error, np.inf)


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
