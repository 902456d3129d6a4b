# SPDX-License-Identifier: Apache-2.0
"""A vehicle on tyres moves the same at every integration step, and under the same held commands whenever they come."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.engines.vehicle import Vehicle
from trueup.engines.vehicle.kernels import ANGLE, SIDEWAYS, SPEED, STATE, TURNING, WHEEL, X, Y, step_chassis
from trueup.samples import in_force_over


def turned_in(stiffness: float, speed: float, step: float, seconds: float = 0.04) -> np.ndarray:
    """(4,) x, y, sideways speed and turn rate of a car that drove straight on, and whose wheels stand at 0.1 rad now."""
    values = {"grip": stiffness, "steering_left": 1.0, "steering_right": 1.0, "understeer": 0.0, "relaxation": 0.0,
              "friction_limit": 12.0, "weight_in_front": 0.45, "drive": 5.0, "friction": 0.0, "speed_loss": 0.0,
              "throttle_dead": 0.0}  # fmt: skip
    row = Vehicle("car", 0.3, drive="throttle", values=values).row
    state = np.zeros(STATE)
    state[[SPEED, ANGLE, WHEEL]] = speed, 0.1, 0.1
    for _ in range(round(seconds / step)):
        step_chassis(row, step, state)
    return state[[X, Y, SIDEWAYS, TURNING]]


@pytest.mark.parametrize("stiffness", [40.0, 100.0, 300.0])
def test_a_car_turns_in_at_steps_of_ten_milliseconds_as_at_finer_ones(stiffness: float) -> None:
    """Where slopes were taken at the end of a step, tyres answered half of one late."""
    for speed in (0.8, 2.0):
        fine, coarse = turned_in(stiffness, speed, 1e-4), turned_in(stiffness, speed, 1e-2)
        np.testing.assert_allclose(coarse, fine, rtol=0.0, atol=0.02 * np.abs(fine).max(), err_msg=f"{speed} m/s")


def test_held_commands_count_over_each_step_for_as_long_as_they_were_in_force() -> None:
    time, values = np.array([0.0, 0.014, 0.03]), np.array([[1.0], [3.0], [-2.0]])
    over = in_force_over(time, values, np.linspace(-0.01, 0.04, 6), 0.01)
    np.testing.assert_allclose(over[:, 0], [1.0, 1.0, 0.4 * 1.0 + 0.6 * 3.0, 3.0, -2.0, -2.0], atol=1e-12)
