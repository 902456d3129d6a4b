# SPDX-License-Identifier: Apache-2.0
"""What counts as one unit of error when a vehicle is predicted: more, the longer ago the prediction began."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.recording import Recording
from trueup.rounding import TINY
from trueup.tracking.cleaned import usual_speed
from trueup.trial import Trial


@dataclass(frozen=True, eq=False)
class Shared:
    """What residuals of one stretch have in common with noise of its start, and how much of it is taken out."""

    places: Integers
    """(m,) of the trial's residuals."""
    directions: Array
    """(m, 4) orthonormal."""
    sizes: Array
    """(4,) of the noise along these, in units of the residuals' level."""

    @classmethod
    def of(cls, parts: Sequence[tuple[int, Integers, Array]], inside: Mask, level: float) -> Shared:
        """From places and changes (m, 4) by a standard deviation of each number, channel by channel."""
        places, changes = np.concatenate([p[1] for p in parts]), np.concatenate([p[2] for p in parts])
        counted = inside[places]
        directions, sizes, _ = np.linalg.svd(changes[counted] / level, full_matrices=False)
        return cls(places[counted], directions, sizes)

    def take_out(self, residuals: Array) -> None:
        """Changes residuals (b, M) in place: by the root of (1 + S S')^-1, S the changes."""
        part, shrink = residuals[:, self.places], 1.0 - 1.0 / np.sqrt(1.0 + self.sizes**2)
        residuals[:, self.places] = part - ((part @ self.directions) * shrink) @ self.directions.T


class Ahead:
    """A Discrepancy for a VehicleSimulator: (predicted - tracked) over a unit that grows with the time ahead.

    Without it the last moments of each stretch, where errors are largest, would decide everything, and what acts at once
    (delays, the servo's lag and play) would be bent to mend them.
    """

    unit: ClassVar[Mapping[str, float]] = {"position": 0.02, "heading": 0.04}
    """m and rad, a second ahead."""
    usual: ClassVar[float] = 1.5
    """m/s: of faster cars, the unit of position grows in proportion."""
    at_once: ClassVar[float] = 0.25
    """Share of the unit at once; the rest grows with time."""

    def __init__(
        self, simulator: VehicleSimulator, drives: Sequence[Recording] = (), *, level: float | None = None,
        values: Array | None = None,
    ) -> None:  # fmt: skip
        """With the `level` of residuals where drives are replayed best, by the `values` (n,), predictions begin at poses and
        speeds that are measured with noise: corrections of these are eliminated (see
        `trueup.loop.condensing.Eliminated`), the more, the less of the level other errors are. Without it they are exact.
        """
        self._simulator, self._level, self._values = simulator, level, values
        self._starts: WeakKeyDictionary[Trial, list[Shared]] = WeakKeyDictionary()
        # A fast car's position is off by metres where its heading is as well predicted as a slow one's.
        speeds = [s for s in (usual_speed(d.channel("position")) for d in drives) if np.isfinite(s)]
        self._larger = max(1.0, float(np.median(speeds)) / self.usual) if speeds else 1.0

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) the unit a second ahead, in m or rad."""
        return np.full(len(labels), self.unit.get(channel, 1.0) * (self._larger if channel == "position" else 1.0))

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        parts = []
        for name, values in simulated.channels.items():
            o = simulated.trial.observed[name]
            ahead = self._simulator.ahead(simulated.trial, o.time)[:, None]
            unit = (self.at_once + (1.0 - self.at_once) * ahead) * self.scale(name, o.labels)
            parts.append(((values - measured_at(real, name, o.labels, o.time)) / unit).reshape(len(values), -1))
        residuals = np.concatenate(parts, axis=1)
        for shared in () if self._level is None else self._shared(real, simulated.trial):
            shared.take_out(residuals)
        return residuals

    def residuals(self, values: Array, drives: Sequence[Recording]) -> list[Array]:
        """(M,) of each drive, replayed with values (n,) of the simulator's parameters; 0 where nothing is compared."""
        trials = [Trial.of(d, self._simulator.observable(d)) for d in drives]
        done = self._simulator.rollout(trials, values[None])
        return [
            np.where(self.compared(d, r.trial), self.residual(d, r)[0], 0.0) for d, r in zip(drives, done, strict=True)
        ]

    def noise_of_starts(self, residuals: Sequence[Array], drives: Sequence[Recording]) -> float:
        """Which share of what samples of a stretch have in common, of residuals (M,) of drives that begin at poses taken as
        exact, noise of these poses makes likely.
        """
        likely = seen = 0.0
        for drive, residual in zip(drives, residuals, strict=True):
            for shared in self._shared(drive, Trial.of(drive, self._simulator.observable(drive))):
                seen += float(np.sum((shared.directions.T @ residual[shared.places]) ** 2))
                likely += (self._level or 1.0) ** 2 * float(np.sum(shared.sizes**2))
        return likely / max(seen, TINY)

    def _shared(self, real: Recording, trial: Trial) -> list[Shared]:
        """What the samples of each stretch share of the noise of its start: x, y, heading and speed."""
        if trial not in self._starts:
            self._starts[trial] = self._of_stretches(real, trial)
        return self._starts[trial]

    def _of_stretches(self, real: Recording, trial: Trial) -> list[Shared]:
        columns, first = [], 0
        inside = self.compared(real, trial)
        stretches, doubt = self._simulator.stretches(trial), self._simulator.past(trial).doubt
        by_speed = self._by_speed(trial, doubt[3])
        for name, o in trial.observed.items():
            since, stretch = stretches(o.time)
            unit = (self.at_once + (1.0 - self.at_once) * since)[:, None] * self.scale(name, o.labels)
            way = measured_at(real, "position", ("x", "y"), o.time)
            for n in range(int(stretch.max(initial=-1)) + 1):
                here = np.flatnonzero((stretch == n) & np.isfinite(since) & np.isfinite(way).all(axis=1))
                if len(here):
                    columns.append(
                        (
                            n,
                            (first + here[:, None] * len(o.labels) + np.arange(len(o.labels))).ravel(),
                            _moved(o.labels, way[here], unit[here], doubt, by_speed[name][here]),
                        )
                    )
            first += len(o.time) * len(o.labels)
        return [
            Shared.of([c for c in columns if c[0] == n], inside, self._level or 1.0) for n in {c[0] for c in columns}
        ]

    def _by_speed(self, trial: Trial, doubt: float) -> dict[str, Array]:
        """(T, k) by channel: how what is predicted changes with a standard deviation of the speed at the starts."""
        if self._values is None:
            return {name: np.zeros((len(o.time), len(o.labels))) for name, o in trial.observed.items()}
        return self._simulator.moved_by_speed(trial, self._values, doubt)

    def compared(self, real: Recording, trial: Trial) -> Mask:
        """(m,) what was measured and predicted."""
        parts = []
        for name, o in trial.observed.items():
            predicted = np.isfinite(self._simulator.ahead(trial, o.time))[:, None]
            parts.append((np.isfinite(measured_at(real, name, o.labels, o.time)) & predicted).ravel())
        return np.concatenate(parts)


def _moved(labels: Sequence[str], way: Array, unit: Array, doubt: Array, by_speed: Array) -> Array:
    """(T * k, 4) by how much residuals of `labels` change with a standard deviation `doubt` (4,) of x, y and heading at the
    first of the places `way` (T, 2), and with one of the speed there, `by_speed` (T, k); unit (T, k).
    """
    along = way - way[0]
    turned = {"x": -along[:, 1], "y": along[:, 0]}
    changes = np.zeros((len(way), len(labels), 4))
    for j, label in enumerate(labels):
        changes[:, j, 2] = turned.get(label, np.ones(len(way)))
        if label in turned:
            changes[:, j, "xy".index(label)] = 1.0
    changes *= doubt
    changes[:, :, 3] = by_speed
    return (changes / unit[:, :, None]).reshape(-1, 4)
