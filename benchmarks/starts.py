# SPDX-License-Identifier: Apache-2.0
"""The 30-parameter arm from starts on bounds and ten times off: how many reach the optimum that the truth leads to."""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from arm_problem import ArmProblem, held_out_over_truth, make_problem
from calibrate_arm import fit
from numpy.typing import NDArray
from results import result

Array = NDArray[np.float64]

_REACHED = 1.001  # held-out error over the truth's; estimates within their noise stay well below


def bad_start(problem: ArmProblem, rng: np.random.Generator) -> Array:
    """(30,) each value on a bound or ten times too large or small (CoM: on a bound or 5 cm off), within its bounds."""
    values = []
    for p, truth in zip(problem.parameters, problem.truth, strict=True):
        where = rng.integers(3)
        off = truth * 10.0 ** rng.choice([-1, 1]) if p.log else truth + 0.05 * rng.choice([-1, 1])
        values.append((p.lower, p.upper, off)[where])
    return np.clip(values, [p.lower for p in problem.parameters], [p.upper for p in problem.parameters])


def main() -> None:
    """Prints one line a start and the share that arrived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two starts")
    parser.add_argument("--starts", type=int, default=20)
    options = parser.parse_args()
    arrived = []
    print("start  held-out/truth   CPU s")
    count = 2 if options.quick else options.starts
    for k in range(count):
        problem = make_problem(k % 4)
        start = bad_start(problem, np.random.default_rng(k))
        found, cpu, _ = fit(problem, start)
        ratio = held_out_over_truth(problem, found.values)
        arrived.append(ratio <= _REACHED)
        print(f"{k:5d}  {ratio:14.4f}  {cpu:6.1f}{'' if arrived[-1] else '   did not arrive'}", flush=True)
    result("starts_that_arrive_percent", 100.0 * float(np.mean(arrived)), "%", 95.0, at_most=False)


if __name__ == "__main__":
    main()
