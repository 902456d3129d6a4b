# SPDX-License-Identifier: Apache-2.0
"""A wheeled vehicle that steers its front axle: a batched kinematic simulator with delays, limits and lags."""

from trueup.engines.bicycle.rollout import BicycleSimulator
from trueup.engines.bicycle.vehicle import BETAS, QUANTITIES, Vehicle, vehicle_space

__all__ = ["BETAS", "QUANTITIES", "BicycleSimulator", "Vehicle", "vehicle_space"]
