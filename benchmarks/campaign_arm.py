# SPDX-License-Identifier: Apache-2.0
"""What a campaign's later calibrations cost: the stand-in arm, with one more motion in each round.

The first round is fitted as `trueup calibrate` does; each later one goes on from the round before. Beside it the same
recordings fitted as if there had been no round before. The error is that of two motions which no round was fitted to.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from results import result

from trueup.calibration import Calibration, pooled_rmse
from trueup.formats import read
from trueup.loop.prepare import Preparation, prepare
from trueup.studies.servo_arm.demo import HELD_OUT, model_path, record

FIRST, LATER = ("multisine", "steps"), ("slow_ramps", "waypoints")


def calibrated(ready: Preparation, title: str, earlier: Calibration | None = None) -> tuple[Calibration, float, float]:
    """The calibration, its CPU seconds, and its error on the motions held out in mrad."""
    began = time.process_time()
    found = ready.calibrate(earlier=earlier)
    spent = time.process_time() - began
    error = 1e3 * pooled_rmse(found.held_out(), after=True)
    print(f"{title:24s} {spent:7.1f} s CPU {found.evaluations:6d} simulations   held out {error:.3f} mrad")
    return found, spent, error


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two rounds only")
    later = LATER[:1] if parser.parse_args().quick else LATER
    with tempfile.TemporaryDirectory() as folder:
        recordings = {r.name: r for r in read(record(Path(folder)))}
    held_out = [recordings[name] for name in HELD_OUT]
    known = [recordings[name] for name in FIRST]
    ready = prepare(model_path(), known, held_out)
    last, first, _ = calibrated(ready, "round 1")
    shares, errors, cold = [], [], []
    for number, name in enumerate(later, 2):
        known.append(recordings[name])
        now = ready.with_recordings(known, held_out)
        last, spent, error = calibrated(now, f"round {number}", last)
        _, anew, beside = calibrated(now, f"round {number}, anew")
        shares.append(spent / first)
        errors.append(error)
        cold.append(beside)
        print(f"  {spent / first:.2f} of the first round's CPU, {spent / anew:.2f} of a search anew")
    result("later_round_cpu_share", max(shares), "", 0.25, peer="the first round")
    result("later_round_error", sum(errors) / len(errors), "mrad", 1.0, peer="each round searched anew",
           peer_value=sum(cold) / len(cold), ratio_goal=True)  # fmt: skip


if __name__ == "__main__":
    main()
