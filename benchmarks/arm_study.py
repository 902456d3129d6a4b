# SPDX-License-Identifier: Apache-2.0
"""Which excitation and fit predicts an arm's torque best: the papers' algorithms A, A_local, B and ours, test cases 1-3."""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import time

import numpy as np
from results import result

from trueup.arrays import Array
from trueup.studies.arm.comparison import (
    ALGORITHMS,
    CASES,
    Errors,
    Scale,
    compared,
    interval,
    prepared,
    redrawn,
    share_of_best,
    weights,
)
from trueup.studies.arm.hidden import Effects
from trueup.studies.arm.robot import NOMINAL

_QUICK = Scale(excitations=8, tests=8, seconds=30.0, population=20, generations=6)


def show(errors: Errors, words: dict[str, list[str]], rng: np.random.Generator) -> None:
    """One table a case: mean absolute error in % of nominal torque, half the 95 % interval behind it."""
    for case in CASES:
        print(f"\ntest case {case}: mean absolute error, % of nominal torque, +- half of the 95 % interval")
        print(f"{'':10s}" + "".join(f"{f'axis {k}':>12s}" for k in range(1, 7)) + f"{'mean':>7s}")
        for algorithm in ALGORITHMS:
            values = 100.0 * errors.absolute[algorithm, case] / NOMINAL
            low, high = interval(values, rng, 300)
            cells = [f"{m:5.1f} +-{0.5 * (b - a):4.1f}" for m, a, b in zip(values.mean((0, 1)), low, high, strict=True)]
            print(f"{algorithm:10s}" + "".join(f"{c:>12s}" for c in cells) + f"{values.mean():7.1f}")
        print(f"{'ours is':10s}" + "".join(f"{w:>12s}" for w in words[case]))


def as_good(errors: Errors, rng: np.random.Generator, draws: int = 1000) -> tuple[Array, Array]:
    """(C,) by case and axis whether our motions are best or within 5 % of it, and (draws, C) with excitations and tests anew.

    Excitations are drawn alike for all algorithms: those of one number share the arm's temperature.
    """
    runs, tests = errors.absolute["ours", next(iter(CASES))].shape[:2]
    # The first row weighs all alike: the study as it was run.
    by_run = np.vstack([np.full(runs, 1.0 / runs), weights(runs, rng, draws)])
    good = []
    for case in CASES:
        by_test = np.vstack([np.full(tests, 1.0 / tests), weights(tests, rng, draws)])
        means = {a: redrawn(errors.absolute[a, case], by_run, by_test) for a in ALGORITHMS}
        good.append(means["ours"] <= 1.05 * np.min([m for a, m in means.items() if a != "ours"], axis=0))
    every = np.concatenate(good, axis=1)
    return every[0], every[1:]


def main() -> None:
    """Prints the cells of one region (all of them without --quick) and the share in which ours is best."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one region, fewer test motions, 30 s of recording")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.process_time()
    scale = Scale(seed=options.seed)
    if options.quick:
        scale = Scale(
            _QUICK.excitations, _QUICK.tests, _QUICK.seconds, _QUICK.population, _QUICK.generations, options.seed
        )
    shares: list[float] = []
    cells: list[Array] = []
    drawn: list[Array] = []
    for name in ("B",) if options.quick else ("A", "B", "C"):
        region = prepared(name, scale, lambda text: print(text, flush=True))
        errors = compared(region, Effects(), scale.seed)
        rng = np.random.default_rng(scale.seed)
        share, words = share_of_best(errors, rng)
        shares.append(share)
        print(f"\nregion {name}, {scale.excitations} excitations an algorithm, each recorded for {scale.seconds:g} s")
        show(errors, words, rng)
        alike = compared(region, Effects(), scale.seed, our_fit_for=ALGORITHMS)
        print(f"\nregion {name}, our fit for all algorithms")
        show(alike, share_of_best(alike, rng)[1], rng)
        good, anew = as_good(alike, rng)
        cells.append(good)
        drawn.append(anew)
    print(f"\n{time.process_time() - begin:.0f} s of CPU")
    result("ours_share_of_best", float(np.mean(shares)), "of case-axis cells", 0.9, at_most=False)
    spread = float(np.std(np.concatenate(drawn, axis=1).mean(axis=1)))
    said = f"of {np.size(cells)} cells, standard error {spread:.2f}"
    result("as_good_with_our_fit_for_all", float(np.mean(cells)), said, 16 / 18, at_most=False)


if __name__ == "__main__":
    main()
