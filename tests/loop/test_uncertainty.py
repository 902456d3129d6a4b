# SPDX-License-Identifier: Apache-2.0
"""The 95 % intervals hold what they promise, also where errors last longer than a sample."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from trueup.engines.simulator import InPlaceOf
from trueup.loop.fit import Fit
from trueup.loop.problem import Segment
from trueup.loop.uncertainty import intervals, unit_covariance
from trueup.parameters import Parameter, ParameterSpace

SAMPLES, LABELS = 500, ("a", "b")


def linear_problem() -> tuple[Any, np.ndarray]:
    """Two recordings of two joints, and a smooth dependence of them on four parameters, (m, 4)."""
    time = np.linspace(0, 1, SAMPLES)
    columns = []
    rng = np.random.default_rng(4)
    for _ in range(4):
        parts = [np.sin(2 * np.pi * rng.uniform(1, 12) * time + rng.uniform(0, 6)) for _ in range(4)]
        columns.append(np.concatenate([np.stack(parts[:2], axis=1).ravel(), np.stack(parts[2:], axis=1).ravel()]))
    size = SAMPLES * len(LABELS)
    segments = tuple(
        Segment(k, k, "position", LABELS, "rad", k * size, SAMPLES, np.ones(len(LABELS))) for k in range(2)
    )
    return SimpleNamespace(segments=segments, simulator=None), 50.0 * np.stack(columns, axis=1)


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.9])
def test_intervals_cover_the_truth_as_often_as_they_say(correlation: float) -> None:
    problem, jacobian = linear_problem()
    space = ParameterSpace(tuple(Parameter(n, "", 0.5, 0.0, 1.0) for n in "wxyz"))
    truth = np.array([0.4, 0.5, 0.55, 0.6])
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(150):
        white = rng.standard_normal((4, SAMPLES)) * np.sqrt(1 - correlation**2)
        series = np.asarray(lfilter([1.0], [1.0, -correlation], white, axis=1))
        noise = np.concatenate([series[:2].T.ravel(), series[2:].T.ravel()])
        unit = np.linalg.lstsq(jacobian, jacobian @ truth + noise, rcond=None)[0]
        residual = jacobian @ (unit - truth) - noise
        fit = Fit(space, unit, residual, jacobian, np.ones(len(residual)), "")
        low, high = intervals(fit, unit_covariance(problem, fit))
        inside.append((low <= truth) & (truth <= high))
    assert 0.90 <= np.mean(inside) <= 0.985


class Predicting:
    """A simulator that predicts a trial in stretches of twelve samples."""

    def stretches(self, trial: Any) -> Any:
        return lambda times: (times % 12.0, (times // 12.0).astype(np.int64))


@dataclass(frozen=True, eq=False)
class InItsPlace(InPlaceOf):
    """Another simulator in its place, as where some parameters are not searched."""

    whole: Any


@pytest.mark.parametrize("what", ["windows", "stretches", "stretches of another"])
def test_what_was_wrong_at_the_start_of_a_window_or_a_stretch_widens_intervals(what: str) -> None:
    """Sixty of twelve samples of two joints, each with an error that drifts away alike in both: of sixty trials, or one."""
    windows, samples, rng = 60, 12, np.random.default_rng(3)
    size, drift = samples * len(LABELS), np.repeat(np.linspace(0.0, 1.0, samples), len(LABELS))
    if what == "windows":
        parts = [Segment(k, 0, "position", LABELS, "rad", k * size, samples, np.ones(2)) for k in range(windows)]
    else:
        parts = [Segment(0, 0, "position", LABELS, "rad", 0, windows * samples, np.ones(2))]
    seen = {"position": SimpleNamespace(time=np.arange(float(windows * samples)))}
    simulator = {"windows": None, "stretches": Predicting()}.get(what, InItsPlace(Predicting()))
    problem: Any = SimpleNamespace(segments=tuple(parts), simulator=simulator, trials=(SimpleNamespace(observed=seen),))
    rows = [np.outer(drift, row) for row in rng.standard_normal((windows, 2))]
    jacobian = np.asarray(50.0 * np.concatenate(rows), np.float64)
    space = ParameterSpace(tuple(Parameter(n, "", 0.5, 0.0, 1.0) for n in "wx"))
    inside = []
    for _ in range(150):
        noise = 0.1 * rng.standard_normal(windows * size) + np.outer(rng.standard_normal(windows), drift).ravel()
        moved = np.asarray(np.linalg.lstsq(jacobian, noise, rcond=None)[0], np.float64)
        fit = Fit(space, 0.5 + moved, jacobian @ moved - noise, jacobian, np.ones(len(noise)), "")
        low, high = intervals(fit, unit_covariance(problem, fit))
        inside.append((low <= 0.5) & (high >= 0.5))
    assert 0.90 <= np.mean(inside) <= 0.985
