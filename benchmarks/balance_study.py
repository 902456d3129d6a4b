# SPDX-License-Identifier: Apache-2.0
"""Humanoid transitions on stand-in robots of another engine: how many work as they are, and after at most two calibrations.

The study of `make study-balance` on a few stand-ins whose truths are fixed by their numbers; the peers are the same motions
without calibration, and one motion searched in models drawn widely around the file.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from results import result

from trueup.studies.balance.plan import Depth, Size
from trueup.studies.balance.report import TABLE_ONE
from trueup.studies.balance.study import QUICK, Findings, studied


def main() -> None:
    """Prints shares by task, and those of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two stand-ins, sitting alone, coarsely searched")
    parser.add_argument(
        "--folder", type=Path, help="a folder of `make study-balance` whose results are read, or gone on with"
    )
    parser.add_argument("--report", action="store_true", help="compute nothing: what is in the folder already")
    asked = parser.parse_args()
    few = replace(QUICK, stand_ins=2, scenes=("sit-to-stand",), depth=Depth(searched=8))
    size = few if asked.quick else Size(subsets=3) if asked.report else Size(oracle=0, subsets=0)
    with tempfile.TemporaryDirectory() as made:
        found = studied(asked.folder or Path(made) / "study", size, lambda text, share: None, compute=not asked.report,
                        workers=len(os.sched_getaffinity(0)))  # fmt: skip
    rounds = size.depth.rounds
    for scene in found.campaigns:
        shares = [f"{100 * found.share(scene, k):.0f} %" for k in range(rounds + 1)]
        beside = f"; randomised alone {100 * found.blindly(scene):.0f} %" if scene in found.randomised else ""
        needed, runs = found.needed(scene), [n for n in found.oracle.get(scene, {}).values() if n]
        if scene in found.oracle:
            beside += f"; searched on the robot {len(runs)} of {len(found.oracle[scene])}, runs {sorted(runs)}"
        print(f"{scene:20} {len(found.campaigns[scene])} stand-ins: as it was {shares[0]}, then {', '.join(shares[1:])}; "
              f"rounds needed, median {np.median(needed) if needed else float('nan'):g}{beside}")  # fmt: skip
    without, share = found.overall(0), found.overall(rounds)
    needed = [n for s in found.campaigns for n in found.needed(s)]
    result("transitions_succeeded_share", share, "", 0.9, peer="without calibration", peer_value=without, at_most=False)
    result("uncalibrated_share", without, "", 0.5)
    result(
        "median_rounds", float(np.median(needed)) if needed else float("nan"), "", 1.0, peer="the paper", peer_value=1.0
    )

    table_one(found)
    orientation_errors(found)


def table_one(found: Findings) -> None:
    """Prints the paper's Table I with its numbers of stand-ins, and the share of what was calibrated on several tasks."""
    for on, per in found.subsets.items():
        print(f"calibrated on {on}: {', '.join(f'{scene} {sum(x)} of {len(x)}' for scene, x in per.items())}")
    count, share = found.generalised()
    if count:
        paper = [cell == "S" for on, row in TABLE_ONE.items() if "+" in on for cell in row]
        result("multi_task_share", share, f"of {count}", float(np.mean(paper)), peer="the paper's one robot",
               peer_value=float(np.mean(paper)), at_most=False)  # fmt: skip


def orientation_errors(found: Findings) -> None:
    """Prints the torso's error before and after one calibration, by task, on what was not fitted."""
    ways = {"unfitted_orientation_error_left": (Findings.unfitted, "motions after one calibration on others"),
            "left_out_repeat_error_left": (Findings.left_out, "repeats of the fitted motion that were left out")}  # fmt: skip
    for name, (errors, words) in ways.items():
        count, before, after = errors(found)
        if not count:
            continue
        print(f"torso in {count} {words}: {before:.3f} rad off by the file, {after:.3f} as calibrated")
        for scene in found.campaigns:
            many, *both = errors(replace(found, campaigns={scene: found.campaigns[scene]}))
            print(f"    {scene:20} {many:3}: {both[0]:.3f}, {both[1]:.3f}" if many else f"    {scene:20} none")
        result(name, after / before, f"of before ({count})", 0.3)


if __name__ == "__main__":
    main()
