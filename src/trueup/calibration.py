# SPDX-License-Identifier: Apache-2.0
"""What a calibration found: estimates with intervals, replays before and after, and what could not be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.evidence import Evidence
from trueup.recording import Recording


@dataclass(frozen=True)
class Estimate:
    """One parameter's outcome. `low` and `high` bound the 95 % interval (NaN where it was not estimated)."""

    name: str
    unit: str
    start: float
    value: float
    low: float
    high: float
    lower_bound: float
    upper_bound: float
    fitted: bool
    """False for a frozen parameter: applied to the model, not searched."""
    verdict: str
    """One of: identified, tied, weak, not identified, at bound, no effect, frozen, not supported."""
    note: str = ""
    """Why, in words a user can act on."""
    absent: bool = False
    """Whether it is a limit of which there is none: its value says that nothing ever meets it."""


@dataclass(frozen=True)
class Replay:
    """One recording replayed by the simulator, before and after. Arrays are (T, k), columns follow `labels`."""

    recording: str
    held_out: bool
    channel: str
    labels: tuple[str, ...]
    unit: str
    time: Array
    """(T,) in s."""
    measured: Array
    before: Array
    after: Array
    command: Array | None = None
    """(T, k) commanded values in the same unit, or None where the command is of another kind."""
    noise: Array = field(default_factory=lambda: np.zeros(0))
    """(k,) estimated measurement noise, standard deviation in `unit`."""
    window: float = np.inf
    """s after which it began anew from where the robot was measured to be."""

    def columns(self, which: Sequence[int]) -> Replay:
        """The same of some of its labels."""
        k = list(which)
        return replace(
            self, labels=tuple(self.labels[i] for i in k), measured=self.measured[:, k], before=self.before[:, k],
            after=self.after[:, k], command=None if self.command is None else self.command[:, k],
            noise=self.noise[k] if self.noise.size else self.noise,
        )  # fmt: skip

    def rmse_before(self) -> Array:
        """(k,) root mean square of measured - before, in `unit`; NaN samples are skipped."""
        return _rmse(self.measured, self.before)

    def rmse_after(self) -> Array:
        """(k,) root mean square of measured - after, in `unit`; NaN samples are skipped."""
        return _rmse(self.measured, self.after)

    def mae_after(self) -> Array:
        """(k,) mean of the sizes of after - measured, in `unit`."""
        return _mean(np.abs(self.after - self.measured))

    def end_after(self) -> Array:
        """(k,) after - measured at the last sample that has both, in `unit`."""
        error = self.after - self.measured
        return np.array([c[np.isfinite(c)][-1] if np.isfinite(c).any() else np.nan for c in error.T])


@dataclass(frozen=True, eq=False)
class Ahead:
    """One channel of a recording, predicted again and again from what was measured until then."""

    recording: str
    channel: str
    labels: tuple[str, ...]
    unit: str
    horizons: tuple[float, ...]
    """How far ahead, in s: the next sample first."""
    errors: Array
    """(S, len(horizons), k) simulated minus measured; NaN where the recording ends before."""

    def rmse(self) -> Array:
        """(len(horizons), k) root mean square over the predictions."""
        return np.stack([_rmse(np.zeros_like(e), e) for e in self.errors.transpose(1, 0, 2)])


@dataclass(frozen=True, eq=False)
class Prediction:
    """One recording, predicted again and again from what was measured until then, under its commands alone."""

    recording: str
    horizons: tuple[float, ...]
    """How far ahead, in s."""
    errors: Array
    """(S, len(horizons)) distance of the predicted position from the tracked one, in m."""
    against: Array | None
    """The same of another model."""
    moved: float
    """How far the robot went within the longest horizon, in m, in the mean."""


WINDOWS = "windows of several lengths"
"""Where a search stands that asks how long replays may be: of other ones than what follows."""


@dataclass(frozen=True)
class TracePoint:
    """One step of the search, for the report's search trace."""

    stage: str
    """For example 'gauss-newton', 'cma-es', 'structure'."""
    evaluations: int
    """Simulated candidates so far (each one replays all training recordings)."""
    loss: float
    """Best loss so far: half the sum of squared, noise-weighted residuals (after the robust loss)."""
    rmse: float
    """Pooled replay error of the training recordings in the unit of the main channel."""
    seconds: float
    """Wall time since the start, in s."""
    replayed: float = 0.0
    """s of motion that a candidate replays; early looks are at less than all, whose errors are not to be compared."""


@dataclass(frozen=True)
class CrossValidation:
    """Leave-one-recording-out: replay error of a recording by a fit that never saw it."""

    recording: str
    rmse_before: float
    rmse_after: float
    unit: str


@dataclass(frozen=True)
class Lacked:
    """The fit with a structure that the model lacks, for calibrations to come."""

    intervals: Mapping[str, tuple[float, float, float]]
    """Value, low and high of each parameter that was fitted with it, those of the structure last."""
    shown: Evidence

    @staticmethod
    def beside(parameters: Path) -> Path:
        """The file with these beside the `parameters` file of what was found without."""
        return parameters.with_name(f"{parameters.stem}_lacking{parameters.suffix}")


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Parameters that nobody asked for: as far as the recordings leave them open, and what the fitted ones owe to them."""

    names: tuple[str, ...]
    covariance: Array
    """(k, k) about the values at which they stay, in their units."""
    trade: Array
    """(n, k) by how much each fitted parameter changes for one unit more of each, in their units."""


@dataclass(frozen=True)
class Calibration:
    """The whole outcome of `calibrate`; everything that the report and the files are made from."""

    model_name: str
    estimates: tuple[Estimate, ...]
    replays: tuple[Replay, ...]
    trace: tuple[TracePoint, ...]
    covariance: Array
    """(n, n) over the fitted parameters in the order of `estimates`, in their units."""
    unidentified: tuple[str, ...] = ()
    """Sentences: which directions the recordings cannot see, and which motion would show them."""
    warnings: tuple[str, ...] = ()
    cross_validation: tuple[CrossValidation, ...] = ()
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    evaluations: int = 0
    lacking: str = ""
    """A sentence on the structure that the recordings show or favour and the model lacks; '' for none."""
    lacked: Lacked | None = None
    """The same, for calibrations that go on from here."""
    nuisance: Nuisance | None = None
    """Of parameters that nobody asked for; None where there is none."""
    notes: tuple[str, ...] = ()
    """Choices made automatically and why (structure selected, search picked, recordings aligned)."""

    @property
    def values(self) -> Array:
        """(n_all,) values of all parameters, frozen ones included, in the order of `estimates`."""
        return np.array([e.value for e in self.estimates])

    def training(self) -> tuple[Replay, ...]:
        """The replays of recordings that were fitted."""
        return tuple(r for r in self.replays if not r.held_out)

    def held_out(self) -> tuple[Replay, ...]:
        """The replays of recordings that the fit never saw."""
        return tuple(r for r in self.replays if r.held_out)


def pooled_rmse(replays: Sequence[Replay], *, after: bool) -> float:
    """Root mean square over all samples and columns of `replays`, in their common unit; NaN if there are none."""
    squares = [(r.measured - (r.after if after else r.before)) ** 2 for r in replays]
    if not squares:
        return float("nan")
    every = np.concatenate([s.ravel() for s in squares])
    every = every[np.isfinite(every)]
    return float(np.sqrt(every.mean())) if every.size else float("nan")


def by_label(replays: Sequence[Replay]) -> dict[str, list[Replay]]:
    """Each label that occurs, in the order of first appearance, to the replays that have it, with no other in them."""
    found: dict[str, list[Replay]] = {}
    for replay in replays:
        for k, label in enumerate(replay.labels):
            found.setdefault(label, []).append(replay.columns([k]))
    return found


def by_unit(replays: Sequence[Replay], recordings: Sequence[Recording]) -> tuple[Replay, ...]:
    """Replays with one unit each: those of channels that `recordings` have in several (hinges and slides) come apart.

    Replays of parts, which a calibration made and named itself, are in the units that the same labels have in any recording.
    """
    units = {(r.name, name): dict(zip(c.labels, c.units, strict=False)) for r in recordings
             for name, c in r.channels.items()}  # fmt: skip
    anywhere: dict[str, dict[str, str]] = {}
    for (_, name), of_labels in units.items():
        anywhere.setdefault(name, {}).update(of_labels)
    found: list[Replay] = []
    for replay in replays:
        of = units.get((replay.recording, replay.channel), anywhere.get(replay.channel, {}))
        each = [of.get(label, replay.unit) for label in replay.labels]
        found += [
            replace(replay, unit=unit).columns([i for i, u in enumerate(each) if u == unit])
            for unit in dict.fromkeys(each)
        ]
    return tuple(found)


def _rmse(measured: Array, simulated: Array) -> Array:
    return np.sqrt(_mean((measured - simulated) ** 2))


def _mean(values: Array) -> Array:
    """(k,) of the samples (T, k) that there are; NaN where there are none."""
    count = np.isfinite(values).sum(axis=0)
    return np.divide(np.nansum(values, axis=0), count, out=np.full(len(count), np.nan), where=count > 0)
