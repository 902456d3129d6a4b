# SPDX-License-Identifier: Apache-2.0
"""Excitation search: the papers' genetic algorithm, the same determinant by a better search, feasible motion for a UR10.

The first two are the papers' algorithm A on their arm: sums of five sines a joint, 58 columns, 2000 samples, log10 det
as they print it. The third designs a 30 s motion from rest to rest for a UR10 on a table, whose meshes are missing, and
checks it at every 0.02 rad for collision and at every sample for range, speed, acceleration and torque. (FIGAROH took
275 s for one UR10 trajectory with its collision constraint, and rejected it, where pinocchio's loop took 5 us a sample.)
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from ns16 import NOMINAL, arm
from results import result
from yardstick import PINOCCHIO, pinocchio_seconds

from trueup.errors import TrueupError
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Excitation, Options, design
from trueup.excitation.excite import excite
from trueup.excitation.periodic import Sines
from trueup.excitation.problem import Asked, clearance_for, excitation_problem
from trueup.identification.dynamic_model import DynamicModel


def main() -> None:
    """Prints the three figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the generations, two seeds")
    parser.add_argument("--seeds", type=int, default=10)
    asked = parser.parse_args()
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
    genetic, quick = determinants(15 if asked.quick else 150, min(threads, 2))
    share = 10.0 if asked.quick else 1.0
    individuals = 150 * (15 if asked.quick else 150)
    result("genetic_150x150_cpu_seconds", genetic.cpu_seconds * share, "s", 0.28, peer=PINOCCHIO,
           peer_value=pinocchio_seconds(2000.0 * individuals) * share, ratio_goal=True)  # fmt: skip
    reached = quick.printed >= genetic.printed
    result("same_determinant_seconds", quick.seconds if reached else float("inf"), "s", 0.17, peer="genetic",
           peer_value=genetic.seconds * share, ratio_goal=True)  # fmt: skip
    result("feasible_cpu_seconds", feasible(2 if asked.quick else asked.seeds), "s", 6.0,
           peer=f"{PINOCCHIO}, a million samples", peer_value=pinocchio_seconds(1e6), ratio_goal=True)  # fmt: skip


def determinants(generations: int, threads: int) -> tuple[Excitation, Excitation]:
    """The genetic search, and the better one that stops where it has the same determinant."""
    tree, limits = arm()
    criterion = Criterion.of(DynamicModel.with_friction(tree), NOMINAL, "D", weighting="printed", per_sample=False)
    kind = Sines(limits, 5, longest=20.0)
    design(kind, criterion, Options(method="genetic", population=8, generations=2))  # compiles
    design(kind, criterion, Options(budget=1.0, candidates=200))
    print("search           log10 det  motions   wall s    CPU s")
    genetic = design(kind, criterion, Options(method="genetic", generations=generations, threads=threads))
    _line(f"genetic 150 x {generations}", genetic)
    quick = design(kind, criterion, Options(target=genetic.loss - 1.0, threads=threads))
    _line("coarse CMA-ES", quick)
    full = design(kind, criterion, Options(threads=threads))
    _line("  to its end", full)
    return genetic, quick


def _line(name: str, found: Excitation) -> None:
    print(
        f"{name:16s} {found.printed:9.1f} {found.evaluations:8d} {found.seconds:8.1f} {found.cpu_seconds:8.1f}",
        flush=True,
    )


def feasible(seeds: int) -> float:
    """The most CPU time of all seeds [s], loading included; inf where one found no feasible motion."""
    said = os.environ.get("TRUEUP_DATA")
    data = Path(said) if said else Path(__file__).resolve().parents[2] / "shared" / "data"
    file = data / "ur10" / "ur10_robot.urdf"
    if not file.is_file():
        print(f"no UR10 in {data}: set TRUEUP_DATA")
        return float("nan")
    print("seed  wall s   CPU s  log10 det/sample  clearance cm  problems left")
    longest = 0.0
    for seed in range(seeds):
        began, cpu = time.perf_counter(), time.process_time()
        problem = excitation_problem(file, Asked(seed=seed), lambda joints: clearance_for(file, joints))
        try:
            found = excite(problem.criterion, problem.feasibility, problem.wish, problem.options)
        except TrueupError as error:
            print(f"{seed:4d}  {error}")
            longest = float("inf")
            continue
        seconds = time.perf_counter() - began
        left = problem.feasibility.problems(found.trajectory)
        spent = time.process_time() - cpu
        longest = max(longest, float("inf") if left else spent)
        print(
            f"{seed:4d} {seconds:7.1f} {spent:7.1f} {-found.excitation.loss:17.1f} "
            f"{100 * found.clearance:13.1f}  {'; '.join(str(p) for p in left) or 'none'}", flush=True,
        )  # fmt: skip
    return longest if np.isfinite(longest) else float("inf")


if __name__ == "__main__":
    main()
