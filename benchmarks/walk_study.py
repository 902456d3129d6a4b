# SPDX-License-Identifier: Apache-2.0
"""How much faster a walk gets on robots in 60 trials, by its pace and lean or searched in simulators, and how often it falls.

The peer is the start walk at its own best step size on the same robot. Beside it stands the noisy simulator, the control:
nothing is shown by what is not better than that with the same trials.
"""

from __future__ import annotations

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from pathlib import Path

import numpy as np
from results import result

from trueup.studies.saved import Parts
from trueup.studies.walk.comparison import FULL, QUICK, over, performed, summary
from trueup.studies.walk.study import FALL
from trueup.studies.walk.ways import CHALLENGER, CONTROL, ways


def main() -> None:
    """Prints what happened on each robot and the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one robot, short searches, 40 fresh runs")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="number of the first robot")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0, help="number of the first search")
    parser.add_argument(
        "--ways", nargs="*", default=[CHALLENGER, CONTROL], help="names as in the study; the first is judged"
    )
    parser.add_argument("--keep", type=Path, help="folder for what is done: a later run goes on from there")
    asked = parser.parse_args()
    robots, seeds = (1, 1) if asked.quick else (asked.robots, asked.seeds)
    scale = QUICK if asked.quick else FULL
    kept = Parts.at(asked.keep, scale).text if asked.keep else lambda _, compute: compute()
    numbers = range(asked.first, asked.first + robots)
    searches = range(asked.first_seed, asked.first_seed + seeds)
    results = []
    for r in performed(ways(asked.ways), scale, numbers, searches, print, kept):
        results.append(r)
        print(
            f"  {r.way}: {100 * r.speed:.1f} cm/s, {100 * r.falls:.0f} falls in 100, {r.trials} trials, {r.cpu:.0f} CPU s",
            flush=True,
        )
    print("\n".join(summary(results)))
    mine = [r for r in results if r.way == asked.ways[0]]
    peer, start = "the start walk at its best step size", float(np.median([r.start_speed for r in mine]))
    speed = float(np.median([r.speed for r in mine]))
    result("walk_speed", 100 * speed, "cm/s", 1.267, peer=peer, peer_value=100 * start, at_most=False, ratio_goal=True)
    result("walk_speed_gain_percent", 100 * float(np.median([r.gain for r in mine])), "%", 26.7, at_most=False)
    result("falls_in_100", 100 * float(np.median([r.falls for r in mine])), "", 3.0)
    result("walks_slower_than_the_start", float(sum(r.gain < 0.0 for r in mine)), f"of {len(mine)}", 0.0)
    result("robot_trials", float(max(r.trials for r in mine)), "", 60.0)
    result("robot_minutes", max(r.seconds for r in mine) / 60.0, "min", 30.0)
    for other in (w for w in asked.ways if w != CONTROL and CONTROL in asked.ways):
        faster = over(results, other, CONTROL, lambda r: 100.0 * r.gain)
        fewer = over(results, other, CONTROL, lambda r: 100.0 * r.falls)
        worth = over(results, other, CONTROL, lambda r: 100.0 * (r.speed - FALL * r.falls))
        print(f"{other} over {CONTROL}: {faster} points of gain, {fewer} falls in 100, {worth} cm/s where one costs {FALL:g} "
              "cm/s, as in the search (95 %, bootstrap over robots)")  # fmt: skip
        peer = f"{other} over {CONTROL}"
        result("gain_over_noisy_ungrounded", faster.mean, "points", 0.0, peer=peer, at_most=False)
        result("gain_over_noisy_ungrounded_at_least", faster.low, "points", 0.0, peer=peer, at_most=False)
        result("falls_over_noisy_ungrounded", fewer.mean, "in 100", 0.0, peer=peer)
        result("worth_over_noisy_ungrounded", worth.mean, "cm/s", 0.0, peer=peer, at_most=False)
        result("worth_over_noisy_ungrounded_at_least", worth.low, "cm/s", 0.0, peer=peer, at_most=False)


if __name__ == "__main__":
    main()
