# SPDX-License-Identifier: Apache-2.0
"""A stand-in for a real carrying robot, whose structure is another one than that of the bicycle simulator."""

from trueup.robots.stand_in_vehicle.robot import StandInVehicle
from trueup.robots.stand_in_vehicle.truth import VehicleTruth

__all__ = ["StandInVehicle", "VehicleTruth"]
