# SPDX-License-Identifier: Apache-2.0
"""Tunes a path follower's gains for a robot: one drive, a calibration, a search under its doubt, four drives.

    python examples/tune_gains.py

The robot here is a stand-in with a hidden truth; put your own Robot in its place (docs/campaigns.md says how), or use a
campaign, which does the same in rounds and survives whatever happens.
"""

from __future__ import annotations

import numpy as np

from trueup import Belief, TrustRegion, optimize, shortlist, transfer
from trueup.campaign.kinds import bicycle, drives
from trueup.controllers.stanley import StanleySettings
from trueup.loop.transfer import try_on_robot
from trueup.paths.courses import slalom
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.search.cma_es import CmaEs
from trueup.tasks.follow_path import FollowPath


def main() -> None:
    simulator = bicycle(wheelbase=0.55, max_steering=0.698)
    settings = StanleySettings(wheelbase=0.55, max_steering=0.698)
    task = FollowPath([slalom()], settings, names=("k1", "k2", "k3", "lead"))
    robot = StandInVehicle(3, settings)

    today = try_on_robot(robot, task, task.parameters.nominal)
    print(f"today's gains: {1e3 * today.score:.0f} mm from the path on the robot")

    calibration = drives([r for runs in today.recordings for r in runs], simulator)
    for e in calibration.estimates:
        print(f"  {e.name:15} {e.value:7.3f} {e.unit:6} ({e.verdict})")

    models = Belief.of(calibration, simulator.parameters).sample(8, np.random.default_rng(0))
    region = TrustRegion(task.parameters.to_unit(task.parameters.nominal), radius=0.5)
    search = CmaEs(region.inside(region.centre), seed=0)
    optimum = optimize(task, simulator, models, search, region, evaluations=120)
    print(f"simulated {len(optimum.losses)} candidates on {len(models)} vehicles each; {optimum.ended}")

    picked = shortlist(optimum, region, 3, task=task, simulator=simulator, models=models)
    outcome, _ = transfer(robot, task, picked)
    for unit, expected, measured in zip(picked.unit, picked.predicted, outcome.measured, strict=True):
        gains = ", ".join(f"{v:.2f}" for v in task.parameters.from_unit(unit))
        print(f"  gains {gains}: {1e3 * expected:.0f} mm expected, {1e3 * measured:.0f} mm on the robot")
    rank = outcome.agreement
    print(f"ranked alike with tau {rank.tau:.2f} ({rank.low:.2f} to {rank.high:.2f})")
    print(f"robot: {1e3 * today.score:.1f} -> {1e3 * outcome.measured[outcome.best]:.1f} mm")


if __name__ == "__main__":
    main()
