# SPDX-License-Identifier: Apache-2.0
"""A leg that lands and slides under a controller of its own: are ground friction and gains found, for many robots?"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import tempfile
from pathlib import Path

import numpy as np
from leg_problem import Truth, recordings, simulator
from results import result

from trueup.loop.calibrate import calibrate

_NAMES = ("floor.contact_friction", "controller.kp", "controller.kd")


def main() -> None:
    """Prints one line a robot and the RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="three robots")
    parser.add_argument("--robots", type=int, default=20)
    options = parser.parse_args()
    errors, inside, cpu = [], [], []
    print("robot  friction   kp     kd     errors [%]             in their intervals   CPU s")
    for seed in range(3 if options.quick else options.robots):
        rng = np.random.default_rng([seed, 2026])
        truth = Truth.drawn(rng)
        with tempfile.TemporaryDirectory() as folder:
            found = calibrate(simulator(Path(folder)), recordings(truth, rng))
        estimates = {e.name: e for e in found.estimates}
        rows = [(estimates[n], t) for n, t in zip(_NAMES, (truth.friction, truth.kp, truth.kd), strict=True)]
        errors.append([100.0 * (e.value / t - 1.0) for e, t in rows])
        inside += [e.low <= t <= e.high for e, t in rows]
        cpu.append(found.cpu_seconds)
        print(f"{seed:5d}  {truth.friction:8.3f}  {truth.kp:5.1f}  {truth.kd:5.2f}   "
              + "  ".join(f"{e:+6.2f}" for e in errors[-1])
              + f"   {sum(inside[-3:])} of 3   {cpu[-1]:14.1f}", flush=True)  # fmt: skip
    worst = np.abs(errors).max(axis=1)
    print(f"median over robots, worst of the three: {np.median(worst):.2f} %; CPU s: {np.median(cpu):.1f}")
    result("leg_worst_error_percent", float(worst.max()), f"%, {len(worst)} robots", 5.0)
    result("leg_interval_coverage", 100.0 * float(np.mean(inside)), "%", 90.0, at_most=False)


if __name__ == "__main__":
    main()
