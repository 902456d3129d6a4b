# SPDX-License-Identifier: Apache-2.0
"""The shipped plan for path followers on ten robots, each with structure that its simulator does not have.

`trueup new --from stanley` and what it says by default; only robot and course are filled in. The truth is a dynamic bicycle
with slipping tyres, drawn from the series, and one more thing each: see STRANGE. The simulator is a bicycle whose wheels
roll where they point, unless drives show that tyres slip. Errors are what truly happens, localisation aside; the oracle is
the same search on the hidden truth itself. Four numbers were chosen on these robots, see `campaign.drives.DOUBT`;
nothing else was.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from loop import oracle
from results import result

from trueup.campaign.history import History
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.robots.stand_in_vehicle.truth import VehicleTruth
from trueup.studies.stanley import chasi
from trueup.studies.stanley.courses import true_errors
from trueup.studies.stanley.rounds import in_rounds

STRANGE: tuple[tuple[str, dict[str, float]], ...] = (
    ("poses late, ten a second, held", {"latency": 0.08, "pose_period": 0.1}),
    ("steers 15 % less to the right", {"asymmetry": 0.15}),
    ("floor falls by 4 %", {"slope": 0.4}),
    ("tyres take 0.4 m to answer", {"relaxation": 0.4, "front_stiffness": 500.0, "rear_stiffness": 600.0}),
    ("drives take ten orders a second", {"order_period": 0.1}),
    ("steers in steps of two degrees", {"steering_quantum": 0.035}),
    ("loaded to 90 kg, soft steering", {"mass": 90.0, "yaw_inertia": 8.0, "compliance": 1e-4}),
    ("wheelbase declared 17 % too long", {"wheelbase": 0.47, "forward": 0.24}),
    ("three times the slack, twice the lag", {"steering_slack": 0.09, "steering_lag": 0.2}),
    ("slick floor, speed sags by a tenth", {"friction": 0.25, "sag": 0.1}),
)
"""What is strange, and the fields of `VehicleTruth` that make it so; the others are robot 100 + its number of the series."""

DIRECT = (
    "speed_delay", "speed_lag", "steering_delay", "steering_lag", "steering_slack", "steering_scale", "steering_offset",
    "wheel_scale", "relaxation",
)  # fmt: skip
"""Parameters whose counterpart in the truth is one number of the same name, unless the strangeness is about just that."""
ABOUT = {1: ("steering_scale", "steering_offset"), 2: ("steering_offset",), 7: ("steering_scale",), 9: ("wheel_scale",)}


@dataclass(frozen=True)
class Outcome:
    """One robot: true errors in m with today's gains, after the plan, at best; how many intervals hold the truth; tries."""

    start: float
    found: float
    best: float
    held: int
    of: int
    missed: tuple[str, ...]
    runs: int

    @property
    def share(self) -> float:
        """Of what the oracle gains."""
        return (self.start - self.found) / (self.start - self.best)


def strange(number: int) -> StandInVehicle:
    """Robot `number` of STRANGE."""
    truth = dataclasses.replace(VehicleTruth.of_seed(100 + number), **STRANGE[number][1])
    return StandInVehicle(truth, chasi.SETTINGS, seed=number)


def tried(number: int, correct: bool = False, within: float | None = None) -> Outcome:
    """The shipped plan on one robot; `correct`, and `within` if given, as in the plan's [optimize]."""
    robot = strange(number)
    story = in_rounds(robot, seed=number, correct=correct, within=within)
    gains = story.best[0]
    course = chasi.course("hairpin")  # to its end, as the plan drives it; the study's runs end after 170 s
    rows = np.array([chasi.task().parameters.nominal, list(gains.values()), oracle(robot, number, course)])
    start, found, best = true_errors(robot, course, rows, repeats=6)
    missed, of = not_held(story, robot.truth, ABOUT.get(number, ()))
    return Outcome(float(start), float(found), float(best), of - len(missed), of, missed, len(story.trials))


def not_held(story: History, truth: VehicleTruth, about: tuple[str, ...]) -> tuple[tuple[str, ...], int]:
    """Names of the last calibration's parameters whose 95 % interval misses the truth, and how many were compared."""
    last = next(r.calibrated for r in reversed(story.rounds) if r.calibrated is not None)
    rows = zip(last.names, last.fitted, last.low, last.high, strict=True)
    shown = [(n, low, high) for n, fitted, low, high in rows if fitted and n in DIRECT and n not in about]
    return tuple(n for n, low, high in shown if not low <= getattr(truth, n) <= high), len(shown)


def main() -> None:
    """Prints a line for each robot and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two robots")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of robots")
    parser.add_argument("--correct", action="store_true", help="the robot's scores correct the simulator's")
    parser.add_argument(
        "--within", type=float, help="factor within which samples must foretell scores; 0: all are kept"
    )
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    numbers = options.only or ([0, 7] if options.quick else list(range(len(STRANGE))))
    print("true distance from the path, mm rms\n   before  after  oracle  share  runs  intervals  robot")
    done: list[Outcome] = []
    way = functools.partial(tried, correct=options.correct, within=options.within)
    with ProcessPoolExecutor(min(options.workers, len(numbers))) as pool:
        for number, o in zip(numbers, pool.map(way, numbers), strict=True):
            done.append(o)
            misses = f"; misses {', '.join(o.missed)}" if o.missed else ""
            print(f"  {1e3 * o.start:7.1f}{1e3 * o.found:7.1f}{1e3 * o.best:8.1f}{o.share:7.2f}{o.runs:6d}{o.held:7d} of "
                  f"{o.of}   {STRANGE[number][0]}{misses}", flush=True)  # fmt: skip
    shares = np.array([o.share for o in done])
    result("template_share_of_oracle", float(np.median(shares)), "", 0.95, at_most=False)
    result("template_worst_share", float(shares.min()), "", 0.9, at_most=False)
    result("strange_coverage", sum(o.held for o in done) / sum(o.of for o in done), "", 0.9, at_most=False)


if __name__ == "__main__":
    main()
