# SPDX-License-Identifier: Apache-2.0
"""Each algorithm's error on each test case, with intervals that allow for other excitations and other test motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.excitation.cell import Cell
from trueup.excitation.trajectories import Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.rows import Rows
from trueup.studies.arm.excitation import FAST, SLOW, Workshop, filled
from trueup.studies.arm.fitting import Fitted, our_fit, papers_fit
from trueup.studies.arm.hidden import Effects, HiddenArm
from trueup.studies.arm.measuring import Run, papers_columns, runs, separate, torque_model
from trueup.studies.arm.robot import NOMINAL, REGIONS, limits, ns16

CASES = {
    "1 local, fast": "local fast",
    "1 local, slow": "local slow",
    "2 wide sines": "sines",
    "3 wide planner, gentle": "wide gentle",
    "3 wide planner, abrupt": "wide abrupt",
}
"""Test cases of local identification, section III-D, with the factors that it leaves open -> class of motion."""
DESIGNED = (("A", "A", FAST), ("A_local", "A_local", FAST), ("B fast", "B", FAST), ("B slow", "B", SLOW))
"""Label, the papers' algorithm, the planner's speeds: what the genetic algorithm searches for."""
ALGORITHMS = ("A", "A_local", "B fast", "B slow", "A many", "B many", "ours")
"""'many': different optimised motions instead of one repeated, until the recording time is filled."""


@dataclass(frozen=True)
class Scale:
    """How much is computed."""

    excitations: int = 8
    """Independently optimised for each algorithm."""
    tests: int = 30
    """Trajectories a case."""
    seconds: float = 60.0
    """Recording time of every algorithm."""
    population: int = 30
    generations: int = 10
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Example:
    """One test motion with what the first excitation of each algorithm predicts; (S, 6) N m each."""

    time: Array
    measured: Array
    predicted: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Errors:
    """What each algorithm's model gets wrong, N m; arrays are (excitations, tests, 6), keyed by (algorithm, case)."""

    absolute: Mapping[tuple[str, str], Array]
    """Mean of |e| over the samples of a trajectory: local identification, eq. 10."""
    squared: Mapping[tuple[str, str], Array]
    """Mean of e^2; its root is the RMSE."""
    samples: Mapping[str, Array]
    """(tests,) S of each trajectory: ||e||_2 / S of evolved trajectories, eq. 8, is RMSE / sqrt(S)."""
    indefinite: Mapping[str, Array]
    """(excitations,) share of random postures in which a model's mass matrix is not positive definite, by algorithm."""

    example: Example | None = None
    """Of the first test case."""

    def percent(self, algorithm: str, case: str) -> Array:
        """(6,) mean absolute error, % of nominal torque."""
        return 100.0 * self.absolute[algorithm, case].mean(axis=(0, 1)) / NOMINAL


Told = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Region:
    """One region, with its test runs and the excitations of all algorithms, which no hidden effect changes."""

    model: DynamicModel
    tests: Mapping[str, Sequence[Run]]
    excitations: Sequence[Mapping[str, Sequence[Run]]]
    """For each replicate the runs of each algorithm."""


def prepared(name: str, scale: Scale, told: Told) -> Region:
    """Designs and plans everything for a region."""
    rng = np.random.default_rng([scale.seed, *name.encode()])
    workshop = Workshop.of(Cell.of(ns16(), REGIONS[name], limits()), scale.population, scale.generations)
    model = torque_model()
    tests = {
        case: runs(model, [workshop.random(kind, rng) for _ in range(scale.tests)]) for case, kind in CASES.items()
    }
    told(f"region {name}: {scale.tests} test motions a case")
    seeds = [1000 * scale.seed + k for k in range(scale.excitations)]
    designs = {}
    for label, algorithm, settings in DESIGNED:
        designs[label] = [workshop.designed(algorithm, settings, seed) for seed in seeds]
        told(f"region {name}: {scale.excitations} excitations of {label}")
    every = []
    for r in range(scale.excitations):
        plans = _plans(designs, r, scale.seconds)
        plans["ours"] = workshop.mixed(scale.seconds, rng)
        every.append({algorithm: runs(model, plan) for algorithm, plan in plans.items()})
    told(f"region {name}: {scale.excitations} excitations of ours")
    return Region(model, tests, every)


def _plans(designs: Mapping[str, Sequence[Trajectory]], r: int, seconds: float) -> dict[str, list[Trajectory]]:
    """One motion repeated, or, 'many', the next ones of the same algorithm."""
    plans = {label: filled(seconds, lambda i, own=own: own[r]) for label, own in designs.items()}
    for label, source in (("A many", designs["A"]), ("B many", designs["B fast"])):
        plans[label] = filled(seconds, lambda i, own=source: own[(r + i) % len(own)])
    return plans


def compared(region: Region, effects: Effects, seed: int, *, our_fit_for: Sequence[str] = ("ours",)) -> Errors:
    """All algorithms' errors with these hidden effects. One session has one temperature, the same for all algorithms.

    `our_fit_for`: the algorithms whose recordings get our fit, the others get the papers'.
    """
    rng, arm = np.random.default_rng(seed), HiddenArm(ns16(), effects)
    columns = papers_columns(region.model)
    measured = {case: separate(arm, made, rng) for case, made in region.tests.items()}
    fits: dict[str, list[Fitted]] = {}
    for replicate in region.excitations:
        warmth = float(rng.uniform(-1.0, 1.0))
        for algorithm, made in replicate.items():
            if algorithm in our_fit_for:
                fit: Fitted = our_fit(made, arm, rng, warmth)
            else:
                fit = papers_fit(region.model, [one.torque(arm, rng, warmth) for one in made], columns)
            fits.setdefault(algorithm, []).append(fit)
    return _judged(region, measured, fits)


def _judged(region: Region, measured: Mapping[str, Sequence[Rows]], fits: Mapping[str, Sequence[Fitted]]) -> Errors:
    absolute, squared = {}, {}
    for algorithm, own in fits.items():
        for case, made in region.tests.items():
            errors = [
                [rows.torque - fit.predict(one, rows) for one, rows in zip(made, measured[case], strict=True)]
                for fit in own
            ]  # fmt: skip
            absolute[algorithm, case] = np.array([[np.abs(e).mean(axis=0) for e in each] for each in errors])
            squared[algorithm, case] = np.array([[(e**2).mean(axis=0) for e in each] for each in errors])
    indefinite = {a: np.array([_indefinite(fit) for fit in own]) for a, own in fits.items()}
    samples = {case: np.array([r.length for r in rows]) for case, rows in measured.items()}
    first = next(iter(CASES))
    one, rows = region.tests[first][0], measured[first][0]
    predicted = {a: own[0].predict(one, rows) for a, own in fits.items()}
    return Errors(absolute, squared, samples, indefinite, Example(rows.time, rows.torque, predicted))


def _indefinite(fit: Fitted, postures: int = 200) -> float:
    """The share of random postures in which the energy of some motion is negative: no robot, and no controller likes it."""
    q = np.random.default_rng(1).uniform(limits().lower, limits().upper, (postures, len(NOMINAL)))
    still = np.zeros_like(q)
    holding = fit.torque(q, still, still)
    pushes = [np.broadcast_to(row, q.shape) for row in np.eye(len(NOMINAL))]
    mass = np.stack([fit.torque(q, still, a) - holding for a in pushes], axis=-1)
    return float((np.linalg.eigvalsh(0.5 * (mass + np.swapaxes(mass, 1, 2)))[:, 0] <= 0.0).mean())


def interval(values: Array, rng: np.random.Generator, draws: int = 1000) -> tuple[Array, Array]:
    """Bounds (..., 6) of 95 % for the mean of values (R, N, 6): excitations and test motions drawn anew, both."""
    R, N = values.shape[:2]
    low, high = np.quantile(redrawn(values, weights(R, rng, draws), weights(N, rng, draws)), [0.025, 0.975], axis=0)
    return low, high


def weights(count: int, rng: np.random.Generator, draws: int) -> Array:
    """(draws, count) how much each of `count` things weighs when as many are drawn anew, with replacement."""
    return rng.multinomial(count, np.full(count, 1.0 / count), draws) / count


def redrawn(values: Array, excitations: Array, tests: Array) -> Array:
    """(draws, ...) means of values (R, N, ...) under weights (draws, R) and (draws, N)."""
    R, N = values.shape[:2]
    each = (excitations @ values.reshape(R, -1)).reshape(len(excitations), N, -1)
    return np.einsum("dn,dnk->dk", tests, each).reshape(len(excitations), *values.shape[2:])


def share_of_best(errors: Errors, rng: np.random.Generator) -> tuple[float, dict[str, list[str]]]:
    """In how many (case, axis) cells ours is best, or not surely worse than the best; and in words for each cell.

    Surely worse: the 95 % interval of the difference, excitations paired, lies above zero.
    """
    words: dict[str, list[str]] = {}
    good = []
    for case in CASES:
        mean = {a: errors.absolute[a, case].mean(axis=(0, 1)) for a in ALGORITHMS}
        words[case] = []
        for axis in range(len(NOMINAL)):
            rival = min((a for a in ALGORITHMS if a != "ours"), key=lambda a: mean[a][axis])
            difference = errors.absolute["ours", case][..., axis] - errors.absolute[rival, case][..., axis]
            low = interval(difference[..., None], rng)[0][0]
            best = bool(mean["ours"][axis] <= mean[rival][axis])
            good.append(best or bool(low <= 0.0))
            words[case].append("best" if best else "even" if good[-1] else rival)
    return float(np.mean(good)), words
