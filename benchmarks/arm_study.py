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

from trueup.studies.arm.comparison import ALGORITHMS, CASES, Errors, Scale, compared, interval, prepared, share_of_best
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


def as_good(errors: Errors) -> list[bool]:
    """By case and axis: whether our motions are best or within 5 % of it."""
    means = {a: np.concatenate([errors.absolute[a, case].mean(axis=(0, 1)) for case in CASES]) for a in ALGORITHMS}
    rivals = np.min([m for a, m in means.items() if a != "ours"], axis=0)
    return (means["ours"] <= 1.05 * rivals).tolist()


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
    cells: list[bool] = []
    for name in ("B",) if options.quick else ("A", "B", "C"):
        region = prepared(name, scale, lambda text: print(text, flush=True))
        errors = compared(region, Effects(), scale.seed)
        rng = np.random.default_rng(scale.seed)
        share, words = share_of_best(errors, rng)
        shares.append(share)
        print(f"\nregion {name}, {scale.excitations} excitations an algorithm, each recorded for {scale.seconds:g} s")
        show(errors, words, rng)
        cells += as_good(compared(region, Effects(), scale.seed, our_fit_for=ALGORITHMS))
    print(f"\n{time.process_time() - begin:.0f} s of CPU")
    result("ours_share_of_best", float(np.mean(shares)), "of case-axis cells", 0.9, at_most=False)
    result("as_good_with_our_fit_for_all", float(np.mean(cells)), f"of {len(cells)} cells", 16 / 18, at_most=False)


if __name__ == "__main__":
    main()
