# SPDX-License-Identifier: Apache-2.0
"""The whole loop on stand-in vehicles with different hidden truths: how much better the robot follows its path.

Beside it, for the same robots: no calibration, the paper's way (calibrated once, by time warping), and domain randomisation
without calibration. Errors are what truly happens, localisation aside; runs on the robot are counted. The study's seconds are
those of one processor, all 440 trials, both searches and both runs of the robot included, compilation not.

Then gains tuned on several courses against gains tuned on one of them, with the same budget, on courses that neither has
seen; all of them are drawn from one distribution of shapes, curvatures and speeds (trueup.studies.stanley.courses).
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result
from scipy.stats import t
from vehicle import loop_seconds

from trueup.campaign.history import History
from trueup.engines.vehicle import BETAS, BicycleSimulator
from trueup.loop.optimize import optimize
from trueup.loop.transfer import try_on_robot
from trueup.paths import Path as PathToFollow
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.search.cma_es import CmaEs
from trueup.studies.stanley import chasi
from trueup.studies.stanley.courses import across_courses, true_errors
from trueup.studies.stanley.paper import paper_study
from trueup.studies.stanley.rounds import in_rounds
from trueup.tracking.windows import noise_of

Array = NDArray[np.float64]

EVALUATIONS = 160
ORACLE = 240  # candidates tried on the hidden truth itself

WAYS = {
    "no": "no calibration, k1 k2 k3 lead",
    "random": "domain randomisation, k1 k2 k3 lead",
    "paper": "calibration once (the paper), k1 k2 k3",
    "once": "calibration once (the paper), k1 k2 k3 lead",
    "first": "trueup, one round, k1 k2 k3 lead",
    "rounds": "trueup, two rounds, k1 k2 k3 lead",
}
RUNS = {"no": 1, "random": 1, "paper": 2, "once": 2, "first": 5, "rounds": 12}


@dataclass(frozen=True)
class Outcome:
    """One stand-in: true errors in m by way, with today's gains, and at best; processor seconds of the paper's 440 trials."""

    number: int
    start: float
    oracle: float
    errors: dict[str, float]
    study_seconds: float
    agreement: float


@dataclass(frozen=True)
class HeldOut:
    """One stand-in on courses that nothing was tuned on: errors in m by row of `Courses`."""

    number: int
    mean: tuple[float, ...]
    """Geometric: today's gains, tuned on each training course alone, tuned on all of them."""
    worst: tuple[float, ...]


Kept = TypeVar("Kept", Outcome, HeldOut)


def all_ways(number: int) -> Outcome:
    """All ways on one stand-in."""
    robot, task = chasi.robot(number), chasi.task()
    start = task.parameters.nominal
    paper_study(chasi.robot(number, 1), calibration_trials=2, tuning_trials=2)  # compiles
    began = time.process_time()
    paper = paper_study(robot, seed=number)
    seconds = time.process_time() - began
    first = try_on_robot(robot, task, start)
    noise = noise_of([r for runs in first.recordings for r in runs])
    simulator = chasi.simulator(position_noise=noise[0], heading_noise=noise[1], threads=1)
    story = in_rounds(robot, seed=number)
    shipped = chasi.simulator(BETAS, 0.0, 0.0, threads=1)
    rng = np.random.default_rng(number)
    rolling = simulator.parameters.without(p.name for p in simulator.parameters.parameters if p.optional)
    prior = rolling.from_unit(rng.random((8, int(rolling.free.sum()))))
    gains = {
        "no": tuned_in(shipped, shipped.parameters.nominal, number),
        "random": tuned_in(simulator, prior, number),
        "paper": np.array([*paper.tuning.best, 0.0]),
        "once": tuned_in(shipped, paper.calibration.best, number),
        "first": np.array(list(best_after(story, 1).values())),
        "rounds": np.array(list(story.best[0].values())),
    }
    errors = true_errors(robot, "hairpin", np.array([start, oracle(robot, number), *gains.values()]), repeats=6)
    best = {way: float(e) for way, e in zip(gains, errors[2:], strict=True)}
    tau = float(np.mean([r.validated.tau for r in story.rounds if r.validated is not None]))
    return Outcome(number, float(errors[0]), float(errors[1]), best, seconds, tau)


def best_after(story: History, rounds: int) -> Mapping[str, float]:
    """The settings that the robot had shown to be best after so many rounds."""
    return History(story.begun, story.rounds[:rounds]).best[0]


def on_other_courses(number: int) -> HeldOut:
    """Gains tuned on one course and on several, on one stand-in."""
    found = across_courses(chasi.robot(number, 3), seed=number)
    return HeldOut(number, tuple(found.held_out.tolist()), tuple(found.worst.tolist()))


def outcome(number: int, folder: Path | None) -> Outcome:
    """All ways on a stand-in, from an earlier run where `folder` has it."""
    return kept(folder / f"robot_{number}.json" if folder else None, Outcome, lambda: all_ways(number))


def held_out(number: int, folder: Path | None) -> HeldOut:
    """Other courses on a stand-in, from an earlier run where `folder` has it."""
    return kept(folder / f"courses_{number}.json" if folder else None, HeldOut, lambda: on_other_courses(number))


def kept(file: Path | None, kind: type[Kept], make: Callable[[], Kept]) -> Kept:
    """What a file holds, or what is made now and put there."""
    if file is not None and file.exists():
        return kind(**json.loads(file.read_text(encoding="utf-8")))
    done = make()
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_text(json.dumps(asdict(done)), encoding="utf-8")
        part.replace(file)
    return done


def tuned_in(simulator: BicycleSimulator, models: Array, seed: int) -> Array:
    """(4,) gains by the same search as in the loop, from models (p, n) of the simulator."""
    task = chasi.task()
    start = np.clip(task.parameters.to_unit(task.parameters.nominal), 0.0, 1.0)
    found = optimize(task, simulator, np.atleast_2d(models), CmaEs(start, seed=seed, max_evaluations=EVALUATIONS))
    return task.parameters.from_unit(found.unit[found.best])


def oracle(robot: StandInVehicle, seed: int, course: str | PathToFollow = "hairpin") -> Array:
    """(4,) gains tuned directly on the hidden truth, each candidate judged by what truly happens."""
    space = chasi.task().parameters
    search = CmaEs(np.clip(space.to_unit(space.nominal), 0.0, 1.0), seed=seed, max_evaluations=ORACLE)
    while not search.done:
        asked = search.ask()
        search.tell(asked, true_errors(robot, course, space.from_unit(asked), repeats=1))
    return space.from_unit(search.best[0])


def main() -> None:
    """Prints a line for each stand-in, the table of ways, and the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two stand-ins")
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first stand-in")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--keep", type=Path, help="folder for what is done: a later run goes on from there")
    parser.add_argument("--only", choices=("ways", "courses"), help="one half of it")
    options = parser.parse_args()
    numbers = range(options.first, options.first + (2 if options.quick else options.robots))
    with ProcessPoolExecutor(min(options.workers, len(numbers))) as pool:
        if options.only != "courses":
            print("true distance from the path, mm rms\nrobot  start  oracle  " + "  ".join(f"{w:>6s}" for w in WAYS))
            done: list[Outcome] = []
            for one in pool.map(functools.partial(outcome, folder=options.keep), numbers):
                done.append(one)
                cells = "  ".join(f"{1e3 * one.errors[w]:6.1f}" for w in WAYS)
                print(f"{one.number:5d} {1e3 * one.start:6.1f}  {1e3 * one.oracle:6.1f}  {cells}", flush=True)
            report(done)
        if options.only != "ways":
            print("\nheld-out courses, mm: with today's gains, tuned on each of the others alone, on all of them")
            seen: list[HeldOut] = []
            for one in pool.map(functools.partial(held_out, folder=options.keep), numbers):
                seen.append(one)
                print(f"{one.number:5d}  " + " ".join(f"{1e3 * e:6.2f}" for e in one.mean), flush=True)
            report_courses(seen)


def report(done: list[Outcome]) -> None:
    """The table of ways and the RESULT lines."""
    start, best = (np.array([getattr(o, k) for o in done]) for k in ("start", "oracle"))
    print(
        "\nway                                          runs   error falls by (median, least)  share of oracle  got worse"
    )
    for way, words in WAYS.items():
        errors = np.array([o.errors[way] for o in done])
        fall, share = 100.0 * (1.0 - errors / start), 100.0 * (start - errors) / (start - best)
        print(f"{words:45s}{RUNS[way]:4d} {np.median(fall):16.1f} % {fall.min():8.1f} % {np.median(share):13.1f} %"
              f"  {int(np.sum(errors > start)):4d} of {len(done)}")  # fmt: skip
    print(
        f"the simulator's ranking of candidates against the robot's: Kendall's tau {np.mean([o.agreement for o in done]):.2f}"
    )
    errors = np.array([o.errors["rounds"] for o in done])
    paper = np.array([o.errors["paper"] for o in done])
    fall = 100.0 * (1.0 - errors / start)
    result("stanley_error_reduction_percent", float(np.median(fall)), "%", 51.0, peer="calibration once (the paper)",
           peer_value=float(np.median(100.0 * (1.0 - paper / start))), at_most=False)  # fmt: skip
    result("stanley_share_of_oracle", float(np.median((start - errors) / (start - best))), "", 0.9, at_most=False)
    result("stanley_robots_made_worse", float(np.sum(errors > start)), "", 0.0)
    result("stanley_study_seconds", float(np.median([o.study_seconds for o in done])), "s CPU", 0.65,
           peer="the same 440 drives alone in a numpy loop", peer_value=loop_seconds(440), ratio_goal=True)  # fmt: skip


def report_courses(seen: list[HeldOut]) -> None:
    """Tuned on several over tuned on one, robot by robot: the geometric mean of what each choice of the one course gives."""
    mean, worst = np.array([o.mean for o in seen]), np.array([o.worst for o in seen])
    gain = np.log(mean[:, -1]) - np.log(mean[:, 1:-1]).mean(axis=1)
    ratio, low, high = with_interval(gain)
    rest = with_interval(np.log(worst[:, -1]) - np.log(worst[:, 1:-1]).mean(axis=1))
    beaten = np.mean(mean[:, 1:-1] > mean[:, -1:], axis=1)
    print(f"held-out courses, mm (median of robots): today's gains {1e3 * np.median(mean[:, 0]):.1f}, tuned on one course "
          f"{1e3 * np.median(np.exp(np.log(mean[:, 1:-1]).mean(axis=1))):.2f}, on {mean.shape[1] - 2} "
          f"{1e3 * np.median(mean[:, -1]):.2f}\nseveral over one: {ratio:.3f} (95 % {low:.3f} ... {high:.3f}); better on "
          f"{int(np.sum(gain < 0))} of {len(gain)} robots, than {100 * beaten.mean():.0f} % of all single courses; on the "
          f"worst held-out course {rest[0]:.3f} ({rest[1]:.3f} ... {rest[2]:.3f})")  # fmt: skip
    result("stanley_held_out_several_over_one", ratio, "", 1.0)
    result("stanley_held_out_several_over_one_at_most", high, "", 1.0)


def with_interval(gain: Array) -> tuple[float, float, float]:
    """The mean ratio and its 95 % interval, by Student's t of the robots' own log ratios."""
    half = float(t.ppf(0.975, len(gain) - 1) * gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else float("inf")
    ratio = float(np.exp(gain.mean()))
    return ratio, ratio * math.exp(-half), ratio * float(np.exp(half))


if __name__ == "__main__":
    main()
