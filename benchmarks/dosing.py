# SPDX-License-Identifier: Apache-2.0
"""What the parts of `loop.dosing` earn, on robots that are formulas: risks and speeds drawn from a walk's priors.

Sixty trials of three laps each, as a plan of walks has. How far is what is found from the best pace there is, with no last
trials of the best alone, with more of them, and where the priors are believed to be half and twice as wide as they are?
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from numpy.typing import NDArray
from results import result

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.loop.dosing import SURE, Ledger
from trueup.tasks.paces import Paces

Array = NDArray[np.float64]

GRADES = Paces().grades(PARAMETERS, 0.7)
TRIALS, LAPS, FIRST = 60, 3, 2
WAYS: Mapping[str, tuple[float, float]] = {
    "as it is": (SURE, 1.0), "no last trials": (0.0, 1.0), "half as many": (0.5 * SURE, 1.0), "more": (0.5, 1.0),
    "priors half as wide": (SURE, 0.5), "priors twice as wide": (SURE, 2.0),
}  # fmt: skip
"""Share of last trials, and factor on the priors' deviations."""


@dataclass(frozen=True, eq=False)
class Formula:
    """A robot: coefficients of its risks (w, c), and of the logarithm of its speed (c,)."""

    risks: Array
    speeds: Array

    @classmethod
    def drawn(cls, number: int) -> Formula:
        """From the priors; bolder is never safer, and any lean is safest somewhere."""
        rng = np.random.default_rng([number, 7])
        (mean, deviation), (fast, unsure) = GRADES.risks, GRADES.worth
        risks = mean + deviation * rng.standard_normal(mean.shape)
        risks[:, 1], risks[:, 3] = np.maximum(risks[:, 1], 1.0), np.abs(risks[:, 3])
        spread = np.minimum(unsure, 0.3)  # the level of speeds is a prior of robots of any size
        return cls(risks, fast + spread * rng.standard_normal(len(fast)))

    def shares(self, features: Array) -> Array:
        """(b, w) of runs that end early in each way."""
        odds = np.exp(np.clip(features @ self.risks.T, -30.0, 30.0))
        return odds / (1.0 + odds.sum(axis=1, keepdims=True))

    def worth(self) -> Array:
        """(g,) m/s of each grade, falls taken off."""
        early = self.shares(GRADES.features[0]).sum(axis=1)
        return (1.0 - early) * np.exp(GRADES.features[0] @ self.speeds) - GRADES.cost * early

    def trial(self, grade: int, rng: np.random.Generator) -> Array:
        """A tally of one trial."""
        tally = np.zeros((2, 2 + len(GRADES.ways)))
        for lap in range(LAPS):
            row = min(lap, 1)
            shares = self.shares(GRADES.features[row, grade][None])[0]
            fate = int(rng.choice(len(shares) + 1, p=[*shares, 1.0 - shares.sum()]))
            if fate < len(shares):
                tally[row, 2 + fate] += 1.0
                break
            log = GRADES.features[row, grade] @ self.speeds + GRADES.scatter * rng.standard_normal()
            tally[row, :2] += 1.0, log
        return tally


def found(number: int, sure: float, wide: float) -> tuple[float, bool]:
    """m/s by which what is found on a robot is worth less than the best grade, and whether the interval of the share of its
    runs that end early holds the truth.
    """
    robot, (mean, deviation) = Formula.drawn(number), GRADES.risks
    ledger = Ledger(replace(GRADES, risks=(mean, wide * deviation)))
    rng, luck = np.random.default_rng(number), np.random.default_rng([number, 3])
    for k in range(TRIALS):
        grade = 0 if k < FIRST else ledger.next(rng, settled=k >= TRIALS - round(sure * TRIALS))
        assert grade is not None
        ledger.add(grade, robot.trial(grade, luck))
    worth, best = robot.worth(), ledger.best(rng)[0]
    _, low, high = ledger.early(best, rng)
    share = float(robot.shares(GRADES.features[0, [best]]).sum())
    return float(worth.max() - worth[best]), low <= share <= high


def main() -> None:
    """Prints RESULT lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="six robots, with and without last trials")
    parser.add_argument("--robots", type=int, default=40)
    options = parser.parse_args()
    robots = 6 if options.quick else options.robots
    most = np.array([[w.max(), w[0]] for w in (Formula.drawn(k).worth() for k in range(robots))]).mean(axis=0)
    print(
        f"the best pace is worth {100 * most[0]:.2f} cm/s in the mean of {robots}, the first {100 * most[1]:.2f}",
        flush=True,
    )
    lost, held = dict[str, float](), dict[str, float]()
    for name, (sure, wide) in list(WAYS.items())[: 2 if options.quick else None]:
        rows = [found(k, sure, wide) for k in range(robots)]
        each, held[name] = 100.0 * np.array([lost for lost, _ in rows]), float(np.mean([holds for _, holds in rows]))
        lost[name] = float(each.mean())
        print(
            f"{name:22} {each.mean():6.2f} +- {each.std() / robots**0.5:.2f} cm/s less, at worst {each.max():.1f}",
            flush=True,
        )
    result("dosing_regret", lost["as it is"], "cm/s", 1.0, peer="without last trials of the best alone",
           peer_value=lost["no last trials"])  # fmt: skip
    result("dosing_falls_coverage", held["as it is"], f"of {robots}", 0.9, at_most=False)


if __name__ == "__main__":
    main()
