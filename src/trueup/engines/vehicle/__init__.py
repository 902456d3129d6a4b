# SPDX-License-Identifier: Apache-2.0
"""A vehicle that steers its front axle, commanded by speed or by throttle: one batched simulator with delays and limits."""

from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.engines.vehicle.vehicle import BETAS, Vehicle, vehicle_space

BicycleSimulator = VehicleSimulator
"""The name that plans and scripts know: a vehicle without tyres is the kinematic bicycle."""

__all__ = ["BETAS", "BicycleSimulator", "Vehicle", "VehicleSimulator", "vehicle_space"]
