# SPDX-License-Identifier: Apache-2.0
"""A car driven by throttle and steering commands, whose pose was tracked: predicted in stretches from what was known."""

from trueup.engines.car.car import QUANTITIES, Car, car_space
from trueup.engines.car.rollout import CarSimulator

__all__ = ["QUANTITIES", "Car", "CarSimulator", "car_space"]
