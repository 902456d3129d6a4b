# SPDX-License-Identifier: Apache-2.0
"""A leg that lands and balances with a controller of its own: friction of the ground and gains are found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from leg_problem import RUNS, Truth, recordings, simulator

from trueup.loop.calibrate import Options, calibrate

ALONE = Options(seed=1, cross_validate=False, lacking=False)  # neither left-out errors nor what is missing is asked for


def test_friction_and_gains_of_a_leg_that_lands_and_balances_are_found(tmp_path: Path) -> None:
    truth = Truth(friction=0.45, kp=60.0, kd=2.0)
    brief = [replace(run, duration=0.4 * run.duration) for run in RUNS[1:]]
    runs = recordings(truth, np.random.default_rng(7), brief)
    assert len({len(r.time) for r in runs}) == 2
    slid = runs[0].channel("position").column("x")
    assert slid[-1] - slid[0] > 0.02
    result = calibrate(simulator(tmp_path), runs, options=ALONE)
    values = {e.name: e.value for e in result.estimates}
    assert values["controller.kp"] == pytest.approx(truth.kp, rel=0.02)
    assert values["controller.kd"] == pytest.approx(truth.kd, rel=0.02)
    assert values["floor.contact_friction"] == pytest.approx(truth.friction, rel=0.02)


@pytest.mark.parametrize(("robot", "seconds"), [(14, 0.9), (2, 0.6), (5, 0.6)])
def test_one_slide_of_a_leg_tells_its_friction_where_slopes_lead_to_a_foot_that_sticks(
    robot: int, seconds: float, tmp_path: Path
) -> None:
    """Robot 14 is found where the real step leads, 2 in longer and longer parts, 5 once gains are about right."""
    rng = np.random.default_rng([robot, 2026])
    truth = Truth.drawn(rng)
    slide = replace(RUNS[1], duration=seconds)
    result = calibrate(simulator(tmp_path), recordings(truth, rng, [slide]), options=ALONE)
    values = {e.name: e.value for e in result.estimates}
    assert values["floor.contact_friction"] == pytest.approx(truth.friction, rel=0.01)
    assert values["controller.kd"] == pytest.approx(truth.kd, rel=0.02)


@pytest.mark.parametrize("robot", [8, 12])
def test_friction_of_a_foot_that_only_lands_stays_as_it_was(robot: int, tmp_path: Path) -> None:
    """All friction with which it sticks is alike. For 8 a foot that slips a little is no worse, less than half the truth."""
    rng = np.random.default_rng([robot, 2026])
    truth = Truth.drawn(rng)
    result = calibrate(simulator(tmp_path), recordings(truth, rng, RUNS[:1]), options=ALONE)
    friction, stiffness, _ = result.estimates
    assert friction.value == pytest.approx(1.0, rel=1e-3)
    assert friction.verdict in ("not identified", "no effect")
    assert stiffness.low <= truth.kp <= stiffness.high
    assert stiffness.verdict == "identified"
