# SPDX-License-Identifier: Apache-2.0
"""How much faster a walk gets on robots in 60 trials, searched in a noisy simulator, and how often it falls then.

The peer is the start walk at its own best step size on the same robot. This is the control that grounding must beat.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from results import result

from trueup.studies.walk.comparison import FULL, QUICK, performed, summary
from trueup.studies.walk.study import Ungrounded


def main() -> None:
    """Prints what happened on each robot and the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one robot, short searches, 40 fresh runs")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    robots, seeds = (1, 1) if asked.quick else (asked.robots, asked.seeds)
    scale = QUICK if asked.quick else FULL
    results = list(performed(Ungrounded(), scale, range(robots), range(seeds), print))
    print("\n".join(summary(results)))
    peer, start = "the start walk at its best step size", float(np.median([r.start_speed for r in results]))
    speed = float(np.median([r.speed for r in results]))
    result("walk_speed", 100 * speed, "cm/s", 1.267, peer=peer, peer_value=100 * start, at_most=False, ratio_goal=True)
    result("walk_speed_gain_percent", 100 * float(np.median([r.gain for r in results])), "%", 26.7, at_most=False)
    result("falls_in_100", 100 * float(np.median([r.falls for r in results])), "", 3.0)
    result("robot_trials", float(max(r.trials for r in results)), "", 60.0)
    result("robot_minutes", max(r.seconds for r in results) / 60.0, "min", 30.0)


if __name__ == "__main__":
    main()
