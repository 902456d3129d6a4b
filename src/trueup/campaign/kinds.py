# SPDX-License-Identifier: Apache-2.0
"""The short names that a plan may use, and the functions that make what is behind them out of a plan's options.

Concrete classes are imported inside functions only, so that a plan loads nothing that it does not use.
"""

from __future__ import annotations

ROBOTS = {
    "by-hand": "trueup.robots.by_hand:ByHand",
    "stand-in-arm": "trueup.robots.stand_in:StandInArm",
}
SIMULATORS: dict[str, str] = {"mujoco": "trueup.campaign.kinds:mujoco_simulator"}
TASKS: dict[str, str] = {}
SEARCHES = {
    "cma-es": "trueup.search.cma_es:CmaEs",
    "optuna": "trueup.search.optuna:OptunaSearch",
    "genetic": "trueup.search.genetic:Genetic",
}
DISCREPANCIES: dict[str, str] = {}
CALIBRATIONS = {"fit": "", "none": ""}
